"""RotorLink bytes to pendulum angles, tachometer marks and lock events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from daq import channels
from daq.clock import ClockMap, ClockSeed, Unwrap, clock_rules
from daq.drivers.items import TX, Batch, Event
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.repeats import Arrived, Repeats
from rig_configs.device import RotorNodeSettings


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
        self._restart()
        self._clock = ClockMap(self._tolerance_ppm, self._rules, ClockSeed.of(identity))

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See KeepsTime."""
        return self._clock.seed(1000 * 2**32)

    def _restart(self) -> None:
        self._air = rotorlink.SequenceCounter()
        self._time = Unwrap(2**32)
        self._clock = ClockMap(self._tolerance_ppm, self._rules)
        self._next_index: int | None = None
        self._repeats = Repeats()
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
            if isinstance(frame, rotorlink.Wrapped):
                lost, repeated = self._cable.feed(frame.seq)
                self._cable_lost += lost
                self._count("cable_frames", lost, self._since_dongle(frame.dongle_time_us), out)
                if frame.inner is not None and not repeated:
                    out += self._node_frame(frame.inner, host_ns)
            elif isinstance(frame, rotorlink.DongleStatus):
                lost, _ = self._cable.feed(frame.seq)
                self._cable_lost += lost
                self._count("cable_frames", lost, self._since_dongle(frame.dongle_time_us), out)
            elif not isinstance(frame, rotorlink.Command | rotorlink.Ping):
                out += self._node_frame(frame, host_ns)
        return out

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

    def _node_frame(self, frame: rotorlink.NodeFrame, host_ns: int) -> list[Batch | Event]:
        out: list[Batch | Event] = []
        restarts = self._air.restarts
        node_us, last_us = getattr(frame, "node_time_us", None), self._last_us
        span_s = 0.0 if node_us is None or last_us is None else _seconds(last_us, node_us)
        stepped_back = self._time_stepped_back(node_us)
        lost, repeated = (0, False) if stepped_back else self._air.feed(frame.seq)
        if repeated and not (isinstance(frame, rotorlink.EncoderBlock) and frame.flags & channels.REPEATED):
            return out
        if stepped_back or self._air.restarts > restarts:
            out += self.waited()
            out.append(Event("restart", self._device, "the node started again: its counters begin anew"))
            self._restart()
            self._air.feed(frame.seq)
            self._time_stepped_back(node_us)
        lost, self._cable_lost = max(0, lost - self._cable_lost), 0  # what the cable lost the air had brought
        if not repeated:
            self.heard_frames = (frame.seq if self.heard_frames is None else self.heard_frames[0], frame.seq)
        self._count("radio_frames", lost, span_s, out)
        match frame:
            case rotorlink.EncoderBlock():
                out += self._blocks(self._repeats.feed(frame, host_ns, self._next_index))
            case rotorlink.IndexMark():
                node_us = self._time.feed(np.array([frame.node_time_us]))
                time_ns = self._clock.map(node_us * 1000, host_ns)
                columns = {"revolutions": np.array([frame.revolutions]), "node_time_us": node_us.astype(np.uint64)}
                out.append(Batch(channels.TACHO, time_ns, np.array([frame.seq], np.uint32), columns))
            case rotorlink.LockEvent():
                node_us = self._time.feed(np.array([frame.node_time_us]))
                name, state = "AB"[frame.pendulum & 1], rotorlink.LOCK_STATES[min(frame.state, 3)]
                out.append(Event("lock", self._device, f"pendulum {name} {state}",
                                 {"pendulum": frame.pendulum, "state": state, "node_time_us": int(node_us[0]),
                                  "time_ns": int(self._clock.map(node_us * 1000, host_ns)[0])}))  # fmt: skip
            case rotorlink.Acknowledge():
                result = rotorlink.RESULTS[min(frame.result, len(rotorlink.RESULTS) - 1)]
                out.append(Event("acknowledge", self._device, f"command {frame.command_seq}: {result}",
                                 {"command_seq": frame.command_seq, "result": frame.result}))  # fmt: skip
            case rotorlink.Status():
                self.status = frame
                if frame.counts_per_revolution != self._counts_per_revolution:
                    text = (
                        f"the node says {frame.counts_per_revolution} counts per revolution, the rig file "
                        f"{self._counts_per_revolution}: every angle would be scaled wrongly. Correct the rig file"
                    )
                    self.complaint = text
                    out.append(Event("fault", self._device, text))
                out.append(Event("status", self._device, f"battery {frame.battery_mv} mV",
                                 {"battery_mv": frame.battery_mv, "frames_sent": frame.frames_sent,
                                  "overruns": frame.overruns, "counts_per_revolution": frame.counts_per_revolution,
                                  "temperature_degC": frame.temperature_decidegc / 10}))  # fmt: skip
            case _:
                pass
        return out

    def _time_stepped_back(self, node_time_us: int | None) -> bool:
        """Whether a frame's node time lies well before the last one's (frames on air keep their order)."""
        if node_time_us is None:
            return False
        back = 0 if self._last_us is None else (self._last_us - node_time_us) & 0xFFFFFFFF
        stepped = 1_000_000 < back < 0x80000000
        if not stepped and (self._last_us is None or back > 0x80000000):
            self._last_us = node_time_us
        return stepped

    def _blocks(self, arrived: Iterable[Arrived]) -> list[Batch | Event]:
        return [item for block, host_ns in arrived for item in self._encoder(block, host_ns)]

    def _encoder(self, block: rotorlink.EncoderBlock, host_ns: int) -> list[Batch | Event]:
        n = len(block.counts)
        self.battery_low = bool(block.flags & channels.BATTERY_LOW)
        index = block.first_index + np.arange(n, dtype=np.int64)
        first_us = self._time.feed(np.array([block.node_time_us]))[0]
        node_us = first_us + block.period_us * np.arange(n, dtype=np.int64)
        expected = block.first_index if self._next_index is None else self._next_index
        fresh, missing = max(0, expected - block.first_index), max(0, block.first_index - expected)
        self._next_index = max(expected, int(index[-1]) + 1)
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


def _seconds(before_us: int, after_us: int) -> float:
    """From one instant of a clock that wraps at 2**32 µs to a later one; 0 for two that came in the wrong order."""
    passed = (after_us - before_us) & 0xFFFFFFFF
    return passed * 1e-6 if passed < 0x80000000 else 0.0
