"""Displacements in the frames of one message, with the times of their sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import DEVICE_TICK_S, Channel
from daq.clock import ClockMap, ClockSeed
from daq.drivers.dbc.layouts import FRAME_BYTES, MessageLayout, SignalLayout
from daq.drivers.dbc.positions import Placed, Positions, Stamps
from daq.drivers.dbc.settings import CanSensors, LaserGroup, LaserSignal
from daq.drivers.dbc.silence import SilenceWatch
from daq.items import Batch, DeviceEvent
from rig_basics.texts import number_of

_TICK_NS = round(DEVICE_TICK_S * 1e9)

Items = list[Batch | DeviceEvent]


class LaserStream:
    """Decoder of the frames of one group. Displacement is 0 in the middle of the range.

    Args:
        by_topic: channels of the device.
        seed: seed of the clock's map.
        losses: losses of the device, which are counted here.

    Attributes:
        message: its message.
        watch: watch of its silence.
    """

    def __init__(
        self,
        device: str,
        settings: CanSensors,
        group: LaserGroup,
        by_topic: Mapping[str, Channel],
        seed: ClockSeed | None,
        losses: dict[str, int],
    ) -> None:
        self.message: MessageLayout = group.message
        self._device, self._group, self._losses = device, group, losses
        self._lasers = [_Laser(settings, table, signal, by_topic[table.topic]) for table, signal in group.lasers]
        table = group.lasers[0][0]
        self._period_ns = 1e9 / table.rate_Hz
        self._tolerance_ppm = table.clock_tolerance_ppm
        self._clock = ClockMap(self._tolerance_ppm, seed)
        ahead = group.timestamp is None
        self._frames = (
            Positions(self._period_ns, group.counter.bits.length, 1.0, looks_ahead=ahead) if group.counter else None
        )
        self._waiting = np.zeros((0, FRAME_BYTES), np.uint8)  # frames that are not placed yet
        self._waiting_ns = 0  # time of the newest read of them
        self._times = (
            Positions(group.tick_ns, group.timestamp.bits.length, self._period_ns / group.tick_ns)
            if group.timestamp
            else None
        )
        # a doubt, no fault: silent displacements are an interlock of the host
        self.watch: SilenceWatch = SilenceWatch(device, self.message.name, settings.timeout_s, "doubt")
        self._number, self._last_ns = 0, 0  # of the next sample without a counter; time of the newest one

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See HasClockSeed."""
        if self._times is not None:
            return self._clock.seed(round(self._times.wrap * self._group.tick_ns))
        return None if self._frames is None else self._clock.seed(round(self._frames.wrap * self._period_ns))

    def feed(self, data: NDArray[np.uint8], host_ns: int) -> Items:
        """Decode frames of the message, shape (n, 8)."""
        there = self._lasers[0].signal.present(data)
        data = data if bool(there.all()) else data[there]
        if not len(data):
            return []
        out: Items = [*self.watch.heard(host_ns)]
        if self._frames is not None and self._group.counter is not None:
            new = len(data)
            data = np.concatenate([self._waiting, data]) if len(self._waiting) else data
            undecided = self._frames.undecided(self._group.counter.raw(data), new, host_ns)
            self._waiting, self._waiting_ns = (data if undecided else data[:0]), host_ns
            if undecided:
                return out
        return out + self._decided(data, host_ns)

    def rest(self) -> Items:
        """Decode the frames that still wait at the end of a log, with nothing but their counter to place them."""
        data, self._waiting = self._waiting, self._waiting[:0]
        return self._decided(data, self._waiting_ns) if len(data) else []

    def _decided(self, data: NDArray[np.uint8], host_ns: int) -> Items:
        """Decode frames of shape (n, 8), n ≥ 1, that do not wait any longer; `host_ns` belongs to the last one."""
        out: Items = []
        number = device = None
        if self._frames is not None and self._group.counter is not None:
            number = self._frames.feed(self._group.counter.raw(data), host_ns, self._stamps(data))
            out += self._events(number)
            data = data[number.kept]
        if self._times is not None and self._group.timestamp is not None and len(data):
            device = self._times.feed(self._group.timestamp.raw(data), host_ns)
            out += self._events(device) if number is None else self._contradictions(device, number)
            data = data[device.kept]
        if len(data):
            out += self._samples(data, number, device, host_ns)
        return out

    def _stamps(self, data: NDArray[np.uint8]) -> Stamps | None:
        """Return the timestamps of frames, or None without a timestamp."""
        if self._times is None or self._group.timestamp is None:
            return None
        wrap = self._times.wrap
        return Stamps(self._group.timestamp.raw(data) & (wrap - 1), wrap, self._period_ns / self._group.tick_ns)

    def _samples(self, data: NDArray[np.uint8], number: Placed | None, device: Placed | None, host_ns: int) -> Items:
        if number is None:
            numbers = np.arange(self._number, self._number + len(data))
            self._number += len(data)
        else:
            numbers = number.position if device is None else number.position[device.kept]
        if device is not None:
            device_ns = np.rint(device.position * self._group.tick_ns).astype(np.int64)
        elif number is not None:
            device_ns = np.rint(number.position * self._period_ns).astype(np.int64)
        else:
            device_ns = None
        placed = device or number
        restarts = placed.restarts if placed else []
        out: Items = []
        for start, end in zip([0, *restarts], [*restarts, len(data)], strict=True):
            if start in restarts:
                self._clock = ClockMap(self._tolerance_ppm)
            if start < end:
                out += self._batches(data[start:end], numbers[start:end], device_ns, slice(start, end), host_ns)
        return out

    def _batches(
        self,
        data: NDArray[np.uint8],
        numbers: NDArray[np.int64],
        device_ns: NDArray[np.int64] | None,
        part: slice,
        host_ns: int,
    ) -> Items:
        own_ns = time_ns = self._host_times(len(data), host_ns)
        if device_ns is not None:
            own_ns = device_ns[part]
            time_ns = self._clock.map(own_ns, host_ns)
            if time_ns[0] <= self._last_ns:  # a new map of a sensor that started again
                time_ns = np.maximum(time_ns, self._last_ns + 1 + np.arange(len(time_ns)))
        self._last_ns = int(time_ns[-1])
        sequence = (numbers % 2**32).astype(np.uint32)
        ticks = (own_ns // _TICK_NS).astype(np.uint64)
        out: Items = []
        for laser in self._lasers:
            columns, invalid = laser.columns(data)
            self._losses["invalid"] += invalid
            more = {"counter": sequence, "device_ticks": ticks, "flags": np.zeros(len(data), np.uint32)}
            out.append(Batch(laser.channel, time_ns, sequence, columns | more))
        return out

    def _host_times(self, count: int, host_ns: int) -> NDArray[np.int64]:
        """Return increasing times of samples of which the last arrived at the time of the read, shape (n,)."""
        spread = host_ns - np.rint(np.arange(count - 1, -1, -1) * self._period_ns).astype(np.int64)
        return np.maximum(spread, self._last_ns + 1 + np.arange(count))

    def _events(self, placed: Placed) -> Items:
        """Count losses and return their events."""
        out: Items = self._doubtful(placed)
        for index, frames in placed.gaps.items():
            samples, span_s = frames * len(self._lasers), frames * self._period_ns * 1e-9
            self._losses["samples"] += samples
            about = "about " if index in placed.about else ""
            facts: dict[str, Any] = {"samples": samples, "span_s": span_s}
            if about:
                facts["uncertain_samples"] = samples
            text = f"{about}{number_of(frames, 'frame')} of {self.message.name} lost ({span_s * 1e3:.2f} ms)"
            out.append(DeviceEvent("gap", self._device, text, facts))
        return [*out, *self._restarts(placed)]

    def _contradictions(self, device: Placed, number: Placed) -> Items:
        """Count frames whose number is right and whose time is not; return the events."""
        self._losses["samples"] += device.doubtful * len(self._lasers)
        return self._doubtful(device) + ([] if number.restarts else self._restarts(device))

    def _restarts(self, placed: Placed) -> Items:
        text = f"the numbers of {self.message.name} do not continue: the sensor started again"
        return [DeviceEvent("restart", self._device, text) for _ in placed.restarts]

    def _doubtful(self, placed: Placed) -> Items:
        if not placed.doubtful:
            return []
        self._losses["doubtful_frames"] += placed.doubtful
        text = (
            f"{number_of(placed.doubtful, 'frame')} of {self.message.name} dropped: their number or time "
            f"cannot be right"
        )
        return [DeviceEvent("damage", self._device, text, {"frames": placed.doubtful})]


class _Laser:
    """Conversion of one signal to a displacement."""

    def __init__(self, settings: CanSensors, table: LaserSignal, signal: SignalLayout, channel: Channel) -> None:
        self.signal, self.channel = signal, channel
        sign = 1.0 if table.positive == "away" else -1.0
        self._sensor_m = sign * settings.unit_m(table, signal)
        self._middle, self._lever, self._half_m = table.middle, table.lever_ratio, 0.5 * table.range_m
        self._invalid = np.array(settings.invalid_raw(table.invalid, signal), np.int64)

    def columns(self, data: NDArray[np.uint8]) -> tuple[dict[str, NDArray[Any]], int]:
        """Return displacement, m, and raw number of each frame, and the number of samples without a reading."""
        raw = self.signal.raw(data)
        from_middle = (self.signal.values(data) - self._middle) * self._sensor_m
        reading = np.abs(from_middle) <= self._half_m  # False for NaN
        if len(self._invalid):
            reading &= ~np.isin(raw, self._invalid)
        displacement = np.where(reading, from_middle, np.nan) / self._lever
        code = (raw & 0xFFFFFFFF).astype(np.uint32)
        return {"displacement_m": displacement, "code": code}, int(np.count_nonzero(~reading))
