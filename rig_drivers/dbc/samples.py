"""Displacements in the frames of one message, with the times of their sensor.

Watch of a message that has stopped while the bus carries others.

Further signals of one message: recorded with the host's times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import displacement_channel
from daq.clock import ClockMap, ClockSeed
from daq.drivers.displacement import displacement_batch
from daq.items import Batch, DeviceEvent
from daq.numbered.messages import Count, Stretch
from daq.numbered.stream import NumberedStream
from rig_basics.texts import number_of
from rig_drivers.dbc.layouts import MessageLayout, SignalLayout
from rig_drivers.dbc.settings import CanSensors, LaserGroup, LaserSignal, quantity_channel


class SilenceWatch:
    """Reports once that a message has not been received for too long, and that it is received again.

    Args:
        name: name of the message, for the text.
        timeout_s: longest time between two messages, s; 0: any.
        kind: kind of the event.
    """

    def __init__(self, device: str, name: str, timeout_s: float, kind: str = "fault") -> None:
        self._device, self._name, self._timeout_ns, self._kind = device, name, round(timeout_s * 1e9), kind
        self._heard_ns: int | None = None
        self._silent = self._waited = False

    def heard(self, host_ns: int) -> list[DeviceEvent]:
        """Take the time of a message; return the event about a silence that no read has reported."""
        found = self.tick(host_ns)
        self._heard_ns, self._silent, self._waited = host_ns, False, False
        return found

    def bus_back(self, host_ns: int, since_ns: int) -> None:
        """Wait once more for the message after a time in which the bus carried no frame at all.

        Args:
            host_ns, since_ns: times of the newest frame of the bus and of the one before it.
        """
        if host_ns - since_ns > self._timeout_ns and not self._waited:
            self._heard_ns, self._waited = host_ns, True

    def tick(self, host_ns: int) -> list[DeviceEvent]:
        """Return the event if the silence has become too long."""
        self._heard_ns = host_ns if self._heard_ns is None else self._heard_ns
        if self._silent or not self._timeout_ns or host_ns - self._heard_ns <= self._timeout_ns:
            return []
        self._silent = True
        seconds = (host_ns - self._heard_ns) * 1e-9
        text = f"no frame of {self._name} for {seconds:.2f} s: look at the sensor, the bus and its bit rate"
        return [DeviceEvent(self._kind, self._device, text, {"silence_s": seconds})]


_MOST_BITS = 62
"""Bits of a counter or timestamp that are used, so that continuous numbers have 64."""

Items = list[Batch | DeviceEvent]


@dataclass(frozen=True)
class Frames:
    """Frames of one message.

    Attributes:
        data: uint8, shape (n, 8).
        numbers: continuous numbers, int64, shape (n,), where they are known.
    """

    data: NDArray[np.uint8]
    numbers: NDArray[np.int64]

    def __getitem__(self, part: slice) -> Frames:
        return Frames(self.data[part], self.numbers[part])

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Join several."""
        return Frames(np.concatenate([each.data for each in parts]), np.concatenate([each.numbers for each in parts]))


class LaserStream:
    """Decoder of the frames of one group. Displacement is 0 in the middle of the range.

    Args:
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
        seed: ClockSeed | None,
        losses: dict[str, int],
    ) -> None:
        self.message: MessageLayout = group.message
        self._device, self._group, self._losses = device, group, losses
        self._lasers = [_Laser(settings, table, signal) for table, signal in group.lasers]
        table = group.lasers[0][0]
        self._period_ns = 1e9 / table.rate_Hz
        self._clock = ClockMap(table.clock_tolerance_ppm, seed)
        self._frames = None if group.counter is None else self._counting(group.counter)
        self._times = None if group.timestamp is None else self._timing(group.timestamp)
        # a doubt, no fault: silent displacements are an interlock of the host
        self.watch: SilenceWatch = SilenceWatch(device, self.message.name, settings.timeout_s, "doubt")
        self._number, self._last_ns = 0, 0  # of the next sample without a counter; time of the newest one without both

    def _counting(self, counter: SignalLayout) -> NumberedStream[Frames]:
        """Return the order of frames by their counter; a timestamp shows how often it begins again in a gap."""
        timestamp, tick_ns = self._group.timestamp, self._group.tick_ns
        clock = (0, 1.0) if timestamp is None else (_size(timestamp), self._period_ns / tick_ns)
        return NumberedStream(Count(_size(counter), self._period_ns, 1.0, *clock, is_checked=False), Frames.joined)

    def _timing(self, timestamp: SignalLayout) -> NumberedStream[Frames]:
        """Return the order of frames by their timestamp."""
        step = self._period_ns / self._group.tick_ns
        return NumberedStream(Count(_size(timestamp), self._period_ns, step, is_checked=False), Frames.joined)

    @property
    def clock_seed(self) -> ClockSeed | None:
        """State of the sensor's clock; None without one."""
        group = self._group
        if group.timestamp is not None:
            return self._clock.seed(round(_size(group.timestamp) * group.tick_ns))
        return None if group.counter is None else self._clock.seed(round(_size(group.counter) * self._period_ns))

    def feed(self, data: NDArray[np.uint8], host_ns: int) -> Items:
        """Decode frames of the message, shape (n, 8)."""
        there = self._lasers[0].signal.present(data)
        data = data if bool(there.all()) else data[there]
        if not len(data):
            return []
        out: Items = [*self.watch.heard(host_ns)]
        counter, timestamp = self._group.counter, self._group.timestamp
        frames = Frames(data, np.arange(self._number, self._number + len(data)))
        if self._frames is not None and counter is not None:
            times = None if timestamp is None else _numbers(timestamp, data)
            return out + self._counted(self._frames, self._frames.feed(_numbers(counter, data), frames, host_ns, times))
        self._number += len(data)
        if self._times is not None:
            return out + self._stamped(self._times, self._times_of(self._times, frames, host_ns), None)
        return out + self._batches(frames, None, host_ns)

    def end(self) -> Items:
        """Decode the frames that still wait at the end of a log."""
        out = [] if self._frames is None else self._counted(self._frames, self._frames.end())
        return out if self._times is None else out + self._stamped(self._times, self._times.end(), self._frames)

    def _times_of(self, times: NumberedStream[Frames], frames: Frames, host_ns: int) -> list[Stretch[Frames]]:
        assert self._group.timestamp is not None
        return times.feed(_numbers(self._group.timestamp, frames.data), frames, host_ns)

    def _counted(self, numbered: NumberedStream[Frames], found: list[Stretch[Frames]]) -> Items:
        """Return the samples of frames that are placed by their counter."""
        out = self._damaged(numbered)
        for stretch in found:
            if stretch.is_restart and self._times is not None:  # frames before it whose times wait
                out += self._stamped(self._times, self._times.end(), numbered)
            out += self._lost(stretch)
            frames = Frames(stretch.rows.data, stretch.numbers)
            if stretch.is_restart:
                out += self._started_again()
                self._times = None if self._group.timestamp is None else self._timing(self._group.timestamp)
            if self._times is not None:
                out += self._stamped(self._times, self._times_of(self._times, frames, stretch.host_ns), numbered)
            else:
                own_ns = np.rint(stretch.numbers * self._period_ns).astype(np.int64)
                out += self._batches(frames, own_ns, stretch.host_ns)
        return out

    def _stamped(
        self, times: NumberedStream[Frames], found: list[Stretch[Frames]], numbered: NumberedStream[Frames] | None
    ) -> Items:
        """Return the samples of frames that are placed by their timestamps, or have them besides their counter."""
        out = self._damaged(times)
        for stretch in found:
            if numbered is None:
                out += self._lost(stretch)
            if stretch.is_restart:
                out += self._started_again()
            own_ns = np.rint(stretch.numbers * self._group.tick_ns).astype(np.int64)
            out += self._batches(stretch.rows, own_ns, stretch.host_ns)
        return out

    def _started_again(self) -> Items:
        self._clock.restart()
        text = f"the numbers of {self.message.name} do not continue: the sensor started again"
        return [DeviceEvent("restart", self._device, text)]

    def _batches(self, frames: Frames, own_ns: NDArray[np.int64] | None, host_ns: int) -> Items:
        """Return samples; `own_ns` are their times on the sensor's clock, ns, shape (n,)."""
        data = frames.data
        time_ns = self._host_times(len(data), host_ns) if own_ns is None else self._clock.map(own_ns, host_ns)
        own_ns = time_ns if own_ns is None else own_ns
        numbers = frames.numbers % 2**32
        out: Items = []
        for laser in self._lasers:
            displacement, code = laser.measured(data)
            self._losses["invalid"] += int(np.count_nonzero(np.isnan(displacement)))
            out.append(displacement_batch(laser.channel, time_ns, numbers, own_ns, displacement, code))
        return out

    def _host_times(self, count: int, host_ns: int) -> NDArray[np.int64]:
        """Return increasing times of samples of which the last arrived at the time of the read, shape (n,)."""
        spread = host_ns - np.rint(np.arange(count - 1, -1, -1) * self._period_ns).astype(np.int64)
        times = np.maximum(spread, self._last_ns + 1 + np.arange(count))
        self._last_ns = int(times[-1])
        return times

    def _lost(self, stretch: Stretch[Frames]) -> Items:
        """Count lost frames and return their event."""
        if not stretch.lost:
            return []
        samples, span_s = stretch.lost * len(self._lasers), stretch.lost * self._period_ns * 1e-9
        self._losses["samples"] += samples
        facts: dict[str, Any] = {"samples": samples, "span_s": span_s}
        if stretch.is_about:
            facts["uncertain_samples"] = samples
        about = "about " if stretch.is_about else ""
        text = f"{about}{number_of(stretch.lost, 'frame')} of {self.message.name} lost ({span_s * 1e3:.2f} ms)"
        return [DeviceEvent("gap", self._device, text, facts)]

    def _damaged(self, numbered: NumberedStream[Frames]) -> Items:
        """Count the frames that were dropped since the last call, and return their event."""
        dropped, numbered.damaged = numbered.damaged, 0
        if not dropped:
            return []
        self._losses["doubtful_frames"] += dropped
        if numbered is self._times and self._frames is not None:  # their counter does not show that they are missing
            self._losses["samples"] += dropped * len(self._lasers)
        text = f"{number_of(dropped, 'frame')} of {self.message.name} dropped: their number or time cannot be right"
        return [DeviceEvent("damage", self._device, text, {"frames": dropped})]


def _size(number: SignalLayout) -> int:
    """Return the number of different values of a counter or timestamp."""
    return 2 ** min(number.bits.length, _MOST_BITS)


def _numbers(number: SignalLayout, data: NDArray[np.uint8]) -> NDArray[np.int64]:
    return number.raw(data) & (_size(number) - 1)


class _Laser:
    """Conversion of one signal to a displacement."""

    def __init__(self, settings: CanSensors, table: LaserSignal, signal: SignalLayout) -> None:
        self.signal, self.channel = signal, displacement_channel(table.topic)
        sign = 1.0 if table.positive == "away" else -1.0
        self._sensor_m = sign * settings.unit_m(table, signal)
        self._middle, self._lever, self._half_m = table.middle, table.lever_ratio, 0.5 * table.range_m
        self._invalid = np.array(settings.invalid_raw(table.invalid, signal), np.int64)

    def measured(self, data: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return displacement, m, and raw number of each frame; NaN without a reading."""
        raw = self.signal.raw(data)
        from_middle = (self.signal.values(data) - self._middle) * self._sensor_m
        reading = np.abs(from_middle) <= self._half_m  # False for NaN
        if len(self._invalid):
            reading &= ~np.isin(raw, self._invalid)
        return np.where(reading, from_middle, np.nan) / self._lever, raw & 0xFFFFFFFF


class QuantityStream:
    """Decoder of a quantity's frames. A signal that is not in a frame, or has no reading, is NaN.

    Attributes:
        message: its message.
        watch: watch of its silence.
    """

    def __init__(self, device: str, settings: CanSensors, name: str) -> None:
        table = settings.quantities[name]
        self.message: MessageLayout = settings.message(table.message)
        self._channel, self._number = quantity_channel(name, table), 0
        self._signals = {field: self.message.signals[signal] for field, signal in table.fields.items()}
        self._invalid = {field: settings.invalid_raw(table.invalid, signal) for field, signal in self._signals.items()}
        self.watch: SilenceWatch = SilenceWatch(device, f"{self.message.name} (can/{name})", table.timeout_s)

    def feed(self, data: NDArray[np.uint8], host_ns: int) -> list[Batch | DeviceEvent]:
        """Decode frames of the message, shape (n, 8)."""
        columns: dict[str, NDArray[np.float64]] = {}
        seen = np.zeros(len(data), np.bool_)
        for field, signal in self._signals.items():
            there = signal.present(data)
            seen |= there
            there &= ~np.isin(signal.raw(data), self._invalid[field])
            columns[field] = np.where(there, signal.values(data), np.nan)
        count = int(np.count_nonzero(seen))
        if not count:
            return []
        sequence = (np.arange(self._number, self._number + count) % 2**32).astype(np.uint32)
        self._number += count
        rows = {field: values[seen] for field, values in columns.items()}
        batch = Batch(self._channel, np.full(count, host_ns, np.int64), sequence, rows)
        return [*self.watch.heard(host_ns), batch]
