"""Pipeline of a RotorLink node: bytes to pendulum angles, tachometer marks and lock events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap, ClockSeed
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.index_marks import MarkSequence
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.rotorlink.node_choice import NodeChoice
from daq.drivers.rotorlink.sender import MAX_WAIT_NS, NodeClock, Sender, Step
from daq.errors import DeviceError
from daq.items import TX, Batch, DeviceEvent, loss_words
from daq.numbered.look_ahead import LookAhead, Run
from rig_basics.texts import number_of
from rig_configs.device import RotorNodeSettings

_LOOK_AHEAD_NS = 1e9
"""Longest wait for a block that is sent again."""
_MAX_STEP_BACK_US = 1_000_000  # a block that is older, and not marked as repeated, shows a restart of the node


class NodePipeline(Pipeline):
    """Decoder of RotorLink bytes to pendulum angles, tachometer marks and lock events.

    Losses on air and on the cable are counted separately. Payloads are COBS runs on a serial line. A subclass for
    another carrier overrides `feed` and passes intact frames to `take` and damaged ones to `damaged`.

    Attributes:
        losses: see Pipeline.
        node_status: newest status that the node has sent; None before the first.
        rssi_dBm: signal strength of the newest frame, dBm; None if unknown.
        battery_low: whether the node reports a low battery.

    Raises:
        DeviceError: the node's number in the identity is invalid.
    """

    def __init__(self, device: str, config: RotorNodeSettings, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "radio_frames", "cable_frames", "damaged_frames", "samples")
        self.node_status: rotorlink.NodeStatus | None = None
        self.rssi_dBm: int | None = None
        self.battery_low: bool = False
        self._heard_frames: tuple[int, int] | None = None  # numbers of the first and of the newest frame
        self._records_angles = config.angles
        self._counts_per_revolution = config.counts_per_revolution
        self._radian = 2 * math.pi / config.counts_per_revolution
        self._marks_phase = config.index_marks
        self._decoder = FrameDecoder()
        self._cable_lost = 0  # frames lost on the cable since the last node frame; they may have contained node frames
        self._joined = False
        self._dongle = Sender()
        self._wrapped = False  # whether node frames arrive in frames of a dongle, which counts them
        self._choice = NodeChoice(device, config.node, _node_of(identity))
        self._contradiction = ""  # between the node's status and the rig file
        self._mark_sequence = MarkSequence(device, self.losses)
        self._clock = ClockMap(config.clock_tolerance_ppm, ClockSeed.of(identity))
        self._begin()

    @property
    @override
    def status(self) -> PipelineStatus:
        return PipelineStatus(
            self.node_status is not None,
            self._choice.complaint or self._contradiction,
            clock_seed=self._clock.seed(1000 * 2**32),
            clock_std_ns=self._clock.std_ns,
            learned={} if self._choice.node is None else {"node": self._choice.node},
            heard_frames=self._heard_frames,
        )

    def _restart(self) -> None:
        self._clock.restart()
        self._mark_sequence.restart()
        self._begin()

    def _begin(self) -> None:
        self._node = Sender()
        self._next_index: int | None = None
        self._next_us = 0  # node time at which that sample is due
        self._ahead = LookAhead[list[rotorlink.EncoderBlock]](0.0, _LOOK_AHEAD_NS)
        self._own = NodeClock()
        self._held: list[tuple[rotorlink.IndexMark, int]] = []  # marks that wait for the next block, their host times

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        if direction == TX:
            return []
        if not data:
            return self.waited()
        found = self._decoder.feed(data)
        bad = found.bad if self._joined else found.bad[1:]  # a log may begin in the middle of a frame
        self._joined |= bool(found.frames or found.bad)
        return [*(self.damaged(reason) for reason, _ in bad), *self.take(found.frames, host_ns)]

    def waited(self) -> list[Batch | DeviceEvent]:
        """Return the samples that wait for earlier ones, which will not arrive any more."""
        return [*self._blocks(self._ahead.end()), *self._released(None)]

    def damaged(self, reason: str) -> DeviceEvent:
        """Count a dropped frame; return the event with the reason."""
        return self.damage("damaged_frames", f"frame dropped: {reason}", reason=reason)

    def take(self, frames: Iterable[rotorlink.Frame], host_ns: int) -> list[Batch | DeviceEvent]:
        """Return the samples and events of intact frames.

        Args:
            frames: the frames in the order of arrival.
            host_ns: host time of their arrival, ns since 1970.
        """
        out: list[Batch | DeviceEvent] = []
        for frame in frames:
            if isinstance(frame, rotorlink.Wrapped | rotorlink.DongleStatus):
                self.rssi_dBm = frame.rssi_dbm
                repeated = self._dongle_frame(frame, host_ns, out)
                inner = frame.inner if isinstance(frame, rotorlink.Wrapped) and not repeated else None
                if inner is not None:
                    out += self._node_frame(inner, host_ns)
            elif isinstance(frame, rotorlink.Skipped) and frame.kind not in frame.NODES:
                if frame.kind in frame.DONGLES:
                    self._count("cable_frames", self._dongle.feed(frame.seq, None, host_ns).lost, 0.0, out)
            elif not isinstance(frame, rotorlink.NodeCommand | rotorlink.Ping):
                out += self._node_frame(frame, host_ns)
        return out

    def _dongle_frame(
        self, frame: rotorlink.Wrapped | rotorlink.DongleStatus, host_ns: int, out: list[Batch | DeviceEvent]
    ) -> bool:
        """Count the frames lost on the cable; return whether the frame is a repeated one."""
        place = self._dongle.feed(frame.seq, frame.dongle_time_us, host_ns)
        if place.is_restart:
            out.append(DeviceEvent("dongle", self._device, "the dongle started again: its counters restart"))
            self._dongle = Sender()
            place = self._dongle.feed(frame.seq, frame.dongle_time_us, host_ns)
        self._wrapped = self._wrapped or isinstance(frame, rotorlink.Wrapped)
        self._cable_lost += place.lost if self._wrapped else 0
        self._count("cable_frames", place.lost, place.span_s, out)
        return place.is_repeated

    def _count(self, what: str, lost: int, span_s: float, out: list[Batch | DeviceEvent]) -> None:
        """Count lost frames; `span_s` is the time from the frame before them to the frame after them, s; 0: unknown."""
        if lost:
            self.losses[what] += lost
            within = f" within {span_s * 1e3:.0f} ms" if span_s else ""
            text = f"{loss_words(lost, what)} lost{within}"
            out.append(DeviceEvent("gap", self._device, text, {what: lost, "span_s": span_s}))

    def _node_frame(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, host_ns: int) -> list[Batch | DeviceEvent]:
        out: list[Batch | DeviceEvent] = []
        if not self._is_ours(frame, out):
            return out
        block = frame if isinstance(frame, rotorlink.EncoderBlock) else None
        is_old = self._is_late(frame, host_ns) or (block is not None and bool(block.flags & rotorlink.FLAG_REPEATS))
        node_us = None if is_old else getattr(frame, "node_time_us", None)
        span_us = 0 if block is None or is_old else (len(block.counts) - 1) * block.period_us
        place = self._node.feed(frame.seq, node_us, host_ns, span_us=span_us, is_old=is_old)
        if place.is_repeated and not (is_old and block is not None):
            return out
        if place.is_restart or (block is not None and not is_old and self._fell_back(block)):
            out += self.waited()
            out.append(DeviceEvent("restart", self._device, "the node started again: its counters restart"))
            self._restart()
            place = self._node.feed(frame.seq, node_us, host_ns, span_us=span_us, is_old=is_old)
        lost = max(0, place.lost - self._cable_lost)  # frames lost on the cable were not lost on air
        self._cable_lost = 0
        if not place.is_repeated:
            self._heard_frames = (frame.seq if self._heard_frames is None else self._heard_frames[0], frame.seq)
        self._count("radio_frames", lost, place.span_s, out)
        return [*out, *self._content(frame, host_ns)]

    def _is_late(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, host_ns: int) -> bool:
        """Whether the radio itself delivers a frame late, or once more; overridden for radios that do so."""
        return False

    def _content(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, host_ns: int) -> list[Batch | DeviceEvent]:
        """Return the samples and events of a node frame that has been counted."""
        match frame:
            case rotorlink.EncoderBlock():
                return self._block(frame, host_ns)
            case rotorlink.IndexMark() if self._marks_phase:
                return self._index_mark(frame, host_ns)
            case rotorlink.LockEvent():
                return [self._lock_event(frame, host_ns)]
            case rotorlink.Acknowledge() | rotorlink.Pong():
                return [self._answer(frame, host_ns)]
            case rotorlink.NodeStatus():
                return [*self._status_events(frame)]
            case _:
                return []

    def _index_mark(self, frame: rotorlink.IndexMark, host_ns: int) -> list[Batch | DeviceEvent]:
        """Return the sample of a mark, unless the mark waits for the next block."""
        stated_us = self._node.unwrap(frame.node_time_us)
        since_ns = self._held[0][1] if self._held else host_ns
        if self._own.is_out_of_place(stated_us) and host_ns - since_ns < MAX_WAIT_NS:
            self._held.append((frame, host_ns))
            return []
        out = self._released(None)
        return [*out, *self._mark(frame, stated_us - self._own.shift_us, host_ns, learn=True)]

    def _mark(self, frame: rotorlink.IndexMark, own_us: int, host_ns: int, *, learn: bool) -> list[Batch | DeviceEvent]:
        """Return the sample of a mark, and the events about marks that contradict one another."""
        node_us = np.array([own_us])
        time_ns = self._clock.map(node_us * 1000, host_ns, learn=learn)
        number, events = self._mark_sequence.feed(own_us * 1000, frame.revolutions, int(time_ns[0]))
        if number is None:
            return [*events]
        columns = {"revolutions": np.array([number]), "node_time_us": node_us.astype(np.uint64)}
        return [*events, Batch(channels.TACHO, time_ns, np.array([frame.seq], np.uint32), columns)]

    def _released(self, due: tuple[int, int] | None) -> list[Batch | DeviceEvent]:
        """Return the marks that wait.

        Args:
            due: sum of the clock's steps before the block that came after them, and the time without steps of the
                block's first sample, µs; None without such a block.
        """
        held, self._held = self._held, []
        out: list[Batch | DeviceEvent] = []
        for frame, host_ns in held:
            own_us = self._node.unwrap(frame.node_time_us) - self._own.shift_us
            if due is not None:
                expected_ns = self._mark_sequence.due_ns(frame.revolutions)
                at_us = due[1] if expected_ns is None else 1e-3 * expected_ns
                own_us = self._own.own_us(own_us + self._own.shift_us, due[0], at_us)
            out += self._mark(frame, own_us, host_ns, learn=False)
        return out

    def _stepped(self, step: Step, time_ns: int) -> DeviceEvent:
        self.losses["clock_steps"] = self.losses.get("clock_steps", 0) + 1
        text = (
            f"the node's clock stepped by {step.us * 1e-3:+.1f} ms within {step.span_us * 1e-3:.0f} ms: samples are "
            "counted, so times after it are put back by the step. Look at the node's supply and firmware"
        )
        facts = {"clock_steps": 1, "step_s": step.us * 1e-6, "span_s": step.span_us * 1e-6, "time_ns": time_ns}
        return DeviceEvent("clock", self._device, text, facts)

    def _lock_event(self, frame: rotorlink.LockEvent, host_ns: int) -> DeviceEvent:
        node_us = np.array([self._node.unwrap(frame.node_time_us) - self._own.shift_us])
        name, state = "AB"[frame.pendulum & 1], rotorlink.LOCK_STATES[min(frame.state, 3)]
        facts = {
            "pendulum": frame.pendulum,
            "state": state,
            "node_time_us": int(node_us[0]),
            "time_ns": int(self._clock.map(node_us * 1000, host_ns)[0]),
        }
        return DeviceEvent("lock", self._device, f"pendulum {name} {state}", facts)

    def _answer(self, frame: rotorlink.Acknowledge | rotorlink.Pong, host_ns: int) -> DeviceEvent:
        if isinstance(frame, rotorlink.Acknowledge):
            result = rotorlink.RESULTS[min(frame.result, len(rotorlink.RESULTS) - 1)]
            facts = {"command_seq": frame.command_seq, "result": frame.result}
            return DeviceEvent("acknowledge", self._device, f"command {frame.command_seq}: {result}", facts)
        node_us = np.array([self._node.unwrap(frame.received_us) - self._own.shift_us])
        time_ns = int(self._clock.map(node_us * 1000, host_ns, learn=False)[0])
        facts = {"ping_seq": frame.ping_seq, "time_ns": time_ns}
        return DeviceEvent("acknowledge", self._device, f"ping {frame.ping_seq} received", facts)

    def _status_events(self, frame: rotorlink.NodeStatus) -> list[DeviceEvent]:
        """Keep the node's status; return its events, with a fault if it contradicts the rig file."""
        self.node_status = frame
        out: list[DeviceEvent] = []
        if frame.counts_per_revolution != self._counts_per_revolution:
            self._contradiction = (
                f"the node reports {number_of(frame.counts_per_revolution, 'count')} per revolution, the rig "
                f"file states "
                f"{self._counts_per_revolution}: every angle would be scaled wrongly. Correct the rig file"
            )
            out.append(DeviceEvent("fault", self._device, self._contradiction))
        facts = {
            "battery_mv": frame.battery_mv,
            "frames_sent": frame.frames_sent,
            "overruns": frame.overruns,
            "counts_per_revolution": frame.counts_per_revolution,
            "temperature_degC": frame.temperature_decidegc / 10,
        }
        return [*out, DeviceEvent("status", self._device, f"battery {frame.battery_mv} mV", facts)]

    def _is_ours(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, out: list[Batch | DeviceEvent]) -> bool:
        """Whether a frame is of this rig's node."""
        before = self._choice.node
        out += self._choice.feed(frame)
        if before is not None and before != self._choice.node:  # what was counted was another node's
            self.losses["radio_frames"], self.node_status, self._heard_frames, self._contradiction = 0, None, None, ""
            self._restart()
        return frame.node == self._choice.node

    def _index(self, first: int) -> int:
        """Return the unwrapped index of a sample, whose index on the wire wraps at 2**32."""
        near = first if self._next_index is None else self._next_index
        return first + 2**32 * round((near - first) / 2**32)

    def _fell_back(self, block: rotorlink.EncoderBlock) -> bool:
        """Whether a block that is not marked as repeated contains old samples, which shows a restart of its node."""
        if self._next_index is None:
            return False
        return (self._next_index - self._index(block.first_index)) * block.period_us > _MAX_STEP_BACK_US

    def _block(self, block: rotorlink.EncoderBlock, host_ns: int) -> list[Batch | DeviceEvent]:
        """Return the samples of a block and of those that waited for it, unless it waits for others itself."""
        first = self._index(block.first_index)
        self._ahead.period_ns = 1000.0 * block.period_us
        self._ahead.fills_gaps |= bool(block.flags & rotorlink.FLAG_REPEATS)
        index = first + np.arange(len(block.counts), dtype=np.int64)
        expected = first if self._next_index is None else self._next_index
        return self._blocks(self._ahead.feed(first, Run(index, index, [block], host_ns), expected))

    def _blocks(self, runs: Iterable[Run[list[rotorlink.EncoderBlock]]]) -> list[Batch | DeviceEvent]:
        return [item for each in runs for item in self._encoder(each.numbers, each.rows[0], each.host_ns)]

    def _encoder(
        self, index: NDArray[np.int64], block: rotorlink.EncoderBlock, host_ns: int
    ) -> list[Batch | DeviceEvent]:
        first, n = int(index[0]), len(index)
        self.battery_low = bool(block.flags & channels.BATTERY_LOW)
        first_us = self._node.unwrap(block.node_time_us)
        node_us = first_us + block.period_us * np.arange(n, dtype=np.int64)
        expected = first if self._next_index is None else self._next_index
        fresh, missing = max(0, expected - first), max(0, first - expected)
        if self._next_index == first and block.flags & rotorlink.FLAG_SAMPLES_LOST and block.period_us:
            missing = max(0, round((first_us - self._next_us) / block.period_us))  # lost in the node without an index
        shift_us, step = self._own.shift_us, self._step_before(block, first_us, missing, fresh)
        if expected < first + n:
            self._next_us = int(node_us[-1]) + block.period_us
        node_us -= self._own.shift_us
        held = self._released((shift_us, int(node_us[0])))
        self._next_index = max(expected, first + n)
        if fresh >= n:
            return held
        counts = block.counts[fresh:]
        sequence = index[fresh:].astype(np.uint32)
        columns = {
            "theta3_rad": counts[:, 0] * self._radian,
            "theta4_rad": counts[:, 1] * self._radian,
            "count_a": counts[:, 0],
            "count_b": counts[:, 1],
            "index": sequence,
            "node_time_us": node_us[fresh:].astype(np.uint64),
            "flags": np.full(n - fresh, block.flags, np.uint32),
        }
        time_ns = self._clock.map(node_us[fresh:] * 1000, host_ns)
        out: list[Batch | DeviceEvent] = [*held]
        if step is not None:
            out.append(self._stepped(step, time_ns=int(time_ns[0])))
        if not self._records_angles:
            return out
        if missing:
            out.append(self.lost_samples(missing, missing * block.period_us * 1e-6, time_ns=int(time_ns[0])))
        return [*out, Batch(channels.PENDULUMS, time_ns, sequence, columns)]

    def _step_before(self, block: rotorlink.EncoderBlock, first_us: int, missing: int, fresh: int) -> Step | None:
        """Take the time of a block; return the step of the node's clock before it, if its samples are new."""
        n = len(block.counts)
        if fresh >= n:
            return None
        due_us = self._next_us + (missing - fresh) * block.period_us
        unknown = self._next_index is None or block.flags & rotorlink.FLAG_SAMPLES_LOST
        since = 0 if unknown else n + missing
        return self._own.take(first_us, due_us, since, block.period_us, n)


def _node_of(identity: Mapping[str, Any]) -> int | None:
    """Return the number of the node in an identity, which earlier logs have chosen; None if it is missing."""
    node = identity.get("node")
    if node is None or (type(node) is int and 0 <= node < 256):
        return node
    raise DeviceError(f"identities.json: expected a node's number, 0 to 255, got {node!r:.80}")
