"""RotorLink bytes to pendulum angles, tachometer marks and lock events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from daq import channels
from daq.clock import ClockMap, ClockSeed, clock_rules
from daq.drivers.items import TX, Batch, Event
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.repeats import Arrived, Repeats
from daq.drivers.rotorlink.sender_clock import SenderClock
from daq.errors import DeviceError
from rig_configs.device import RotorNodeSettings

_REPEATS_RULES = 3  # of a log, since which blocks wait for those that are sent again
_WRAP = 2**32
_NODES = 256
_SILENCE_US = 30_000_000  # behind a longer one the sequence, which wraps, tells nothing of a new beginning
_OLD_US = 1_000_000  # a block that lies further back, and is not said to be sent again, is of a node that began anew


class NodePipeline:
    """RotorLink bytes to pendulum angles, tachometer marks and lock events; losses on air and cable counted apart.

    Here payloads are COBS runs on a serial line. What carries them otherwise overrides `feed` and hands the frames it
    found to `take`, the damaged ones to `damaged`.
    """

    def __init__(self, device: str, config: RotorNodeSettings, identity: Mapping[str, Any]) -> None:
        self.losses = {"radio_frames": 0, "cable_frames": 0, "damaged_frames": 0, "samples": 0}
        self.status: rotorlink.Status | None = None  # the node's newest word of itself …
        self.rssi_dBm: int | None = None  # … and how strong its frames come in
        self.complaint = ""  # what is wrong with its counts, by its own word
        self.battery_low = False
        self.heard_frames: tuple[int, int] | None = None  # seq of the first and of the newest frame from the air
        self._device = device
        self._counts_per_revolution = config.counts_per_revolution
        self._radian = 2 * math.pi / config.counts_per_revolution
        self._tolerance_ppm, self._rules = config.clock_tolerance_ppm, clock_rules(identity)
        self._decoder = rotorlink.FrameDecoder()
        self._cable = rotorlink.SequenceCounter()
        self._cable_lost = 0  # frames lost on the cable since a node's frame came: some of them were its own
        self._joined = False
        self._last_dongle_us: int | None = None
        self._dongle = SenderClock()
        self._wrapped = False  # the node's frames come in those of a dongle, which counts them
        self._node = _node_of(identity) if config.node is None else config.node
        self._others = set[int]()
        self._restart()
        self._clock = ClockMap(self._tolerance_ppm, self._rules, ClockSeed.of(identity))

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See KeepsTime."""
        return self._clock.seed(1000 * 2**32)

    @property
    def learned(self) -> dict[str, int]:
        """See LearnsIdentity."""
        return {} if self._node is None else {"node": self._node}

    def _restart(self) -> None:
        self._air = rotorlink.SequenceCounter()
        self._time = SenderClock()
        self._clock = ClockMap(self._tolerance_ppm, self._rules)
        self._next_index: int | None = None
        self._next_us = 0  # when that sample is due
        self._repeats = Repeats(waits=self._rules >= _REPEATS_RULES)
        self._last_us: int | None = None

    @property
    def told(self) -> bool:
        """See TellsItself."""
        return self.status is not None

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """See Pipeline."""
        if direction == TX:
            return []
        if not data:
            return self.waited()
        found = self._decoder.feed(data)
        bad = found.bad if self._joined else found.bad[1:]  # a log may begin in the middle of a frame
        self._joined |= bool(found.frames or found.bad)
        return [*(self.damaged(reason) for reason, _ in bad), *self.take(found.frames, host_ns)]

    def waited(self) -> list[Batch | Event]:
        """Samples that wait for others to come before them, which will not."""
        return self._blocks(self._repeats.end())

    def damaged(self, reason: str) -> Event:
        """Count a frame that is dropped, and why."""
        self.losses["damaged_frames"] += 1
        return Event("damage", self._device, f"frame dropped: {reason}", {"reason": reason})

    def take(self, frames: Iterable[rotorlink.Frame], host_ns: int) -> list[Batch | Event]:
        """Samples and events of sound frames.

        Args:
            frames: in the order in which they came.
            host_ns: host time at which they came.
        """
        out: list[Batch | Event] = []
        for frame in frames:
            if isinstance(frame, rotorlink.Wrapped | rotorlink.DongleStatus):
                self.rssi_dBm = frame.rssi_dbm
                repeated = self._dongle_frame(frame, host_ns, out)
                inner = frame.inner if isinstance(frame, rotorlink.Wrapped) and not repeated else None
                if inner is not None:
                    out += self._node_frame(inner, host_ns)
            elif isinstance(frame, rotorlink.Skipped) and frame.kind not in frame.NODES:
                if frame.kind in frame.DONGLES:
                    self._count("cable_frames", self._cable.feed(frame.seq)[0], 0.0, out)
            elif not isinstance(frame, rotorlink.Command | rotorlink.Ping):
                out += self._node_frame(frame, host_ns)
        return out

    def _dongle_frame(
        self, frame: rotorlink.Wrapped | rotorlink.DongleStatus, host_ns: int, out: list[Batch | Event]
    ) -> bool:
        """Count what the cable lost; whether the frame came before."""
        if self._dongle.begins_anew(frame.dongle_time_us, host_ns):
            out.append(Event("dongle", self._device, "the dongle started again: what it counts begins anew"))
            self._dongle, self._last_dongle_us = SenderClock(), None
            self._dongle.begins_anew(frame.dongle_time_us, host_ns)
            self._cable.reset()
        lost, repeated = self._cable.feed(frame.seq)
        self._wrapped = self._wrapped or isinstance(frame, rotorlink.Wrapped)
        self._cable_lost += lost if self._wrapped else 0
        self._count("cable_frames", lost, self._since_dongle(frame.dongle_time_us), out)
        return repeated

    def _since_dongle(self, dongle_us: int) -> float:
        """Seconds since the dongle's frame before."""
        last, self._last_dongle_us = self._last_dongle_us, dongle_us
        return 0.0 if last is None else _seconds(last, dongle_us)

    def _count(self, what: str, lost: int, span_s: float, out: list[Batch | Event]) -> None:
        """Count lost frames; `span_s` lies between the frame before them and the one after."""
        if lost:
            self.losses[what] += lost
            text = f"{lost} {what.replace('_', ' ')} lost within {span_s * 1e3:.0f} ms"
            out.append(Event("gap", self._device, text, {what: lost, "span_s": span_s}))

    def _node_frame(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, host_ns: int) -> list[Batch | Event]:
        out: list[Batch | Event] = []
        if not self._is_ours(frame, out):
            return out
        block = frame if isinstance(frame, rotorlink.EncoderBlock) else None
        again = block is not None and bool(block.flags & rotorlink.FLAG_REPEATS)
        node_us = None if again else getattr(frame, "node_time_us", None)
        span_s = 0.0 if node_us is None or self._last_us is None else _seconds(self._last_us, node_us)
        lost, repeated, anew = self._counted(frame.seq, block if not again else None, node_us, host_ns, again)
        if repeated and not again:
            return out
        if anew:
            out += self.waited()
            out.append(Event("restart", self._device, "the node started again: its counters begin anew"))
            self._restart()
            self._counted(frame.seq, block if not again else None, node_us, host_ns, again)
        if node_us is not None and (self._last_us is None or 0 < (node_us - self._last_us) % _WRAP < _WRAP // 2):
            self._last_us = node_us
        lost, self._cable_lost = max(0, lost - self._cable_lost), 0  # what the cable lost the air had brought
        if not repeated:
            self.heard_frames = (frame.seq if self.heard_frames is None else self.heard_frames[0], frame.seq)
        self._count("radio_frames", lost, span_s, out)
        match frame:
            case rotorlink.EncoderBlock():
                arrived = Arrived(self._index(frame.first_index), frame, host_ns)
                out += self._blocks(self._repeats.feed(arrived, self._next_index))
            case rotorlink.IndexMark():
                node_us = np.array([self._time.unwrap(frame.node_time_us)])
                time_ns = self._clock.map(node_us * 1000, host_ns)
                columns = {"revolutions": np.array([frame.revolutions]), "node_time_us": node_us.astype(np.uint64)}
                out.append(Batch(channels.TACHO, time_ns, np.array([frame.seq], np.uint32), columns))
            case rotorlink.LockEvent():
                node_us = np.array([self._time.unwrap(frame.node_time_us)])
                name, state = "AB"[frame.pendulum & 1], rotorlink.LOCK_STATES[min(frame.state, 3)]
                out.append(
                    Event(
                        "lock",
                        self._device,
                        f"pendulum {name} {state}",
                        {
                            "pendulum": frame.pendulum,
                            "state": state,
                            "node_time_us": int(node_us[0]),
                            "time_ns": int(self._clock.map(node_us * 1000, host_ns)[0]),
                        },
                    )
                )
            case rotorlink.Acknowledge():
                result = rotorlink.RESULTS[min(frame.result, len(rotorlink.RESULTS) - 1)]
                out.append(
                    Event(
                        "acknowledge",
                        self._device,
                        f"command {frame.command_seq}: {result}",
                        {"command_seq": frame.command_seq, "result": frame.result},
                    )
                )
            case rotorlink.Status():
                self.status = frame
                if frame.counts_per_revolution != self._counts_per_revolution:
                    text = (
                        f"the node says {frame.counts_per_revolution} counts per revolution, the rig file "
                        f"{self._counts_per_revolution}: every angle would be scaled wrongly. Correct the rig file"
                    )
                    self.complaint = text
                    out.append(Event("fault", self._device, text))
                out.append(
                    Event(
                        "status",
                        self._device,
                        f"battery {frame.battery_mv} mV",
                        {
                            "battery_mv": frame.battery_mv,
                            "frames_sent": frame.frames_sent,
                            "overruns": frame.overruns,
                            "counts_per_revolution": frame.counts_per_revolution,
                            "temperature_degC": frame.temperature_decidegc / 10,
                        },
                    )
                )
            case _:
                pass
        return out

    def _counted(
        self, seq: int, block: rotorlink.EncoderBlock | None, node_us: int | None, host_ns: int, again: bool
    ) -> tuple[int, bool, bool]:
        """How many frames are missing before one, whether it came before, and whether its node began anew.

        Args:
            seq: its number.
            block: it, where it is one that is not sent again.
            node_us: its time, where that is newer than its predecessor's.
            host_ns: when it came.
            again: whether it is sent again.
        """
        before_us, restarts = self._time.newest_us, self._air.restarts
        if node_us is not None and self._time.begins_anew(_newest_us(node_us, block), host_ns):
            return 0, False, True
        if self._time.newest_us - before_us > _SILENCE_US:
            lost, repeated = self._air.go_on(seq), False
        else:
            lost, repeated = self._air.feed(seq, again=again)
        if self._air.restarts > restarts or (block is not None and not repeated and self._fell_back(block)):
            return 0, False, True
        return lost, repeated, False

    def _is_ours(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, out: list[Batch | Event]) -> bool:
        """Whether a frame is of this rig's node: the rig file's, or the first one heard."""
        if self._node is None:
            self._node = frame.node
            if frame.node != 1:  # else whoever commands it has it right
                out.append(
                    Event("acknowledge", self._device, f"the node's number is {frame.node}", {"node": frame.node})
                )
        if frame.node != self._node and frame.node not in self._others:
            self._others.add(frame.node)
            text = f"frames of node {frame.node} ignored: this rig's is node {self._node}"
            out.append(Event("foreign", self._device, text, {"node": frame.node}))
        return frame.node == self._node

    def _index(self, first: int) -> int:
        """A sample's index, which wraps at 2**32, as one that grows for ever."""
        near = first if self._next_index is None else self._next_index
        return first + _WRAP * round((near - first) / _WRAP)

    def _fell_back(self, block: rotorlink.EncoderBlock) -> bool:
        """Whether a block that is not said to be sent again counts samples of long ago: its node began anew."""
        if self._next_index is None:
            return False
        return (self._next_index - self._index(block.first_index)) * block.period_us > _OLD_US

    def _blocks(self, arrived: Iterable[Arrived]) -> list[Batch | Event]:
        return [item for each in arrived for item in self._encoder(each)]

    def _encoder(self, arrived: Arrived) -> list[Batch | Event]:
        first, block, host_ns = arrived
        n = len(block.counts)
        self.battery_low = bool(block.flags & channels.BATTERY_LOW)
        index = first + np.arange(n, dtype=np.int64)
        first_us = self._time.unwrap(block.node_time_us)
        node_us = first_us + block.period_us * np.arange(n, dtype=np.int64)
        expected = first if self._next_index is None else self._next_index
        fresh, missing = max(0, expected - first), max(0, first - expected)
        if self._next_index == first and block.flags & rotorlink.FLAG_SAMPLES_LOST and block.period_us:
            missing = max(0, round((first_us - self._next_us) / block.period_us))  # lost before they were counted
        if expected < arrived.behind:
            self._next_us = int(node_us[-1]) + block.period_us
        self._next_index = max(expected, arrived.behind)
        if fresh >= n:
            return []
        counts = block.counts[fresh:]
        columns = {
            "theta3_rad": counts[:, 0] * self._radian,
            "theta4_rad": counts[:, 1] * self._radian,
            "count_a": counts[:, 0],
            "count_b": counts[:, 1],
            "index": index[fresh:].astype(np.uint32),
            "node_time_us": node_us[fresh:].astype(np.uint64),
            "flags": np.full(n - fresh, block.flags, np.uint32),
        }
        time_ns = self._clock.map(node_us[fresh:] * 1000, host_ns)
        out: list[Batch | Event] = []
        if missing:
            self.losses["samples"] += missing
            span_s = missing * block.period_us * 1e-6
            facts = {"samples": missing, "span_s": span_s, "time_ns": int(time_ns[0])}
            out.append(Event("gap", self._device, f"{missing} samples lost ({span_s * 1e3:.2f} ms)", facts))
        return [*out, Batch(channels.PENDULUMS, time_ns, columns["index"], columns)]


def _node_of(identity: Mapping[str, Any]) -> int | None:
    """The node that logs before this one chose."""
    node = identity.get("node")
    if node is None or (type(node) is int and 0 <= node < _NODES):
        return node
    raise DeviceError(f"identities.json: expected a node's number, 0 to {_NODES - 1}, got {node!r:.80}")


def _newest_us(node_us: int, block: rotorlink.EncoderBlock | None) -> int:
    """Node time of the newest that a frame tells of."""
    return node_us if block is None else (node_us + (len(block.counts) - 1) * block.period_us) % _WRAP


def _seconds(before_us: int, after_us: int) -> float:
    """From one instant of a clock that wraps at 2**32 µs to a later one; 0 for two that came in the wrong order."""
    passed = (after_us - before_us) & 0xFFFFFFFF
    return passed * 1e-6 if passed < 0x80000000 else 0.0
