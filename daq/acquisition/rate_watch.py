"""Check of the sample rate of a device against the rig file, and of its clock against the host's clock.

The input is batches with the host time of their reads; the module has no clock and no I/O. The last sample of a batch
reaches the host with a delay that has a lower bound. The least delayed samples therefore lie on a line of host time
over device time, whose slope is the ratio of the two clocks (`daq.clock.lower_line`). Their scatter about the line
gives the uncertainty of the slope: about 0.1 % after 2 s, about 50 ppm after 30 s. A rate is wrong if its deviation
exceeds this uncertainty plus the tolerance of the clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST
from daq.clock import lower_line, steps_from
from daq.drivers.contract import SampleClock
from daq.drivers.devices import devices_of
from daq.items import Batch, DeviceEvent
from rig_configs.device import DeviceSettings

_BIN_NS = 250_000_000
_BINS = 120  # 30 s
_STDS = 5.0  # permitted deviation of the clock, in standard uncertainties
_MIN_DELAY_ERROR_S = 2e-3  # least uncertainty of the bound of the delay …
_JITTERS = 5.0  # … and its multiple of the scatter; the larger of both applies
_MAX_GAP_NS = 5_000_000_000  # after a longer silence or difference of the clocks, a clock has stopped or restarted
_MIN_SPAN_S = 3.0  # over shorter spans the uncertainty covers every deviation
_LOOK_NS, _FIRST_LOOK_NS = 1_000_000_000, 4_000_000_000  # period of the checks, and time of the first one


@dataclass(frozen=True)
class Rate:
    """Rate of a device over the last stretch of samples.

    Attributes:
        rate_Hz: samples per second of host time, lost samples included.
        nominal_Hz: rate of the rig file.
        clock_ppm: rate of the device's clock relative to the host's clock, minus 1.
        bound_ppm: bound of the error of `rate_Hz` and `clock_ppm`, from the length of the stretch and its scatter.
        tolerance_ppm: permitted deviation of the clock.
        span_s: length of the stretch, s of host time.
    """

    rate_Hz: float
    nominal_Hz: float
    clock_ppm: float
    bound_ppm: float
    tolerance_ppm: float
    span_s: float

    @property
    def off_ppm(self) -> float:
        """Deviation of the sample rate from the rig file."""
        return (self.rate_Hz / self.nominal_Hz - 1.0) * 1e6

    @property
    def rate_ok(self) -> bool:
        """Whether the sample rate agrees with the rig file within the bounds."""
        return abs(self.off_ppm) <= self.tolerance_ppm + self.bound_ppm

    @property
    def clock_ok(self) -> bool:
        """Whether the device's clock agrees with the host's clock within the bounds."""
        return abs(self.clock_ppm) <= self.tolerance_ppm + self.bound_ppm

    @property
    def ok(self) -> bool:
        """Whether both rate and clock agree."""
        return self.rate_ok and self.clock_ok

    @property
    def certain(self) -> bool:
        """Whether the error bound is smaller than the tolerance of the clock."""
        return self.bound_ppm <= self.tolerance_ppm

    def words(self) -> str:
        """Return the deviation as text."""
        bound = f"over {self.span_s:.0f} s, ± {self.bound_ppm:.0f} ppm"
        if not self.rate_ok:
            return f"{self.rate_Hz:.1f} Hz instead of {self.nominal_Hz:g} Hz ({bound})"
        clock = f"its clock runs {self.clock_ppm:+.0f} ppm against the host's"
        return f"{clock}, expected ± {self.tolerance_ppm:.0f} ({bound})"


class RateWatch:
    """Estimates the rate of one channel.

    Args:
        clock: the driver's description of the sample times.

    Attributes:
        wrong: the present rate if it is wrong; None otherwise.
        worst: the rate with the largest deviation while it was wrong; None if it never was.
        wrong_s: time for which it was wrong, s.
    """

    def __init__(self, clock: SampleClock) -> None:
        self.wrong: Rate | None = None
        self.worst: Rate | None = None
        self.wrong_s: float = 0.0
        self._topic, self._look_ns, self._is_suspect = clock.topic, 0, False
        self._nominal, self._tolerance = clock.rate_Hz, _STDS * clock.tolerance_ppm
        self._field, self._tick_ns, self._wrap = clock.field, clock.tick_ns, clock.count_wrap
        self._bins: deque[tuple[int, int, int, int]] = deque(maxlen=_BINS)  # number, device ns, lag ns, count
        self._last: tuple[int, int, int] | None = None  # device ns, host ns, sequence
        self._count = 0
        self._restarted = False

    def restart(self) -> None:
        """Discard earlier samples before the next batch, since clock and counter of the device have restarted."""
        self._restarted = True  # only a flag, since another thread may call `feed` at the same time

    def feed(self, batch: Batch, host_ns: int) -> None:
        """Add the samples of one read."""
        device_ns = int(batch.columns[self._field][-1]) * self._tick_ns
        sequence = batch.sequence.astype(np.int64)
        if self._restarted:
            self._restarted, self._last = False, None
            self._bins.clear()
        if self._last is not None:
            passed, passed_host = device_ns - self._last[0], host_ns - self._last[1]
            if passed < 0 or max(passed_host, abs(passed - passed_host)) > _MAX_GAP_NS:
                self._bins.clear()
            # step by step, since a counter of a few bits begins again several times in one read
            self._count += int(np.sum(steps_from(self._last[2], sequence) % self._wrap))
        self._last = device_ns, host_ns, int(sequence[-1])
        number, lag = device_ns // _BIN_NS, host_ns - device_ns
        if self._bins and self._bins[-1][0] == number:
            if lag < self._bins[-1][2]:
                self._bins[-1] = number, device_ns, lag, self._count
        else:
            self._bins.append((number, device_ns, lag, self._count))

    def rate(self) -> Rate | None:
        """Return the newest rate, or None if there are too few samples."""
        if len(bins := list(self._bins)) < 3:
            return None
        table: NDArray[np.int64] = np.array(bins, np.int64)
        device: NDArray[np.float64] = 1e-9 * (table[:, 1] - table[0, 1])
        lag: NDArray[np.float64] = 1e-9 * (table[:, 2] - table[0, 2])
        count = bins[-1][3] - bins[0][3]
        offset, slope = lower_line(device, lag)
        span = float(device[-1]) * (1.0 + slope)
        if span <= 0 or count <= 0:
            return None
        jitter = float(np.mean(lag - offset - slope * device))
        return Rate(
            rate_Hz=count / span,
            nominal_Hz=self._nominal,
            clock_ppm=(1.0 / (1.0 + slope) - 1.0) * 1e6,
            bound_ppm=max(_MIN_DELAY_ERROR_S, _JITTERS * jitter) / span * 1e6,
            tolerance_ppm=self._tolerance,
            span_s=span,
        )

    def look(self, host_ns: int) -> list[DeviceEvent]:
        """Return an event when the rate has become wrong or is correct again; it is checked once a second.

        It is wrong in two consecutive checks: a single one may be caused by a suspended host.
        """
        self._look_ns = self._look_ns or host_ns + _FIRST_LOOK_NS
        if host_ns < self._look_ns:
            return []
        self._look_ns = host_ns + _LOOK_NS
        rate = self.rate()
        if rate is None or rate.span_s < _MIN_SPAN_S:
            return []
        before, was_suspect = self.wrong, self._is_suspect
        self._is_suspect = not rate.ok
        if rate.ok:
            self.wrong = None
            return [] if before is None else [_event(self._topic, rate, f"back at {rate.rate_Hz:.1f} Hz")]
        if not was_suspect:
            return []
        self.wrong, self.wrong_s = rate, self.wrong_s + _LOOK_NS * 1e-9
        self.worst = max(self.worst or rate, rate, key=lambda each: abs(each.off_ppm))
        return [_event(self._topic, rate, rate.words())] if before is None else []


class RateWatches:
    """Monitors the rates of all devices with a clock of their own, and counts the time with a wrong rate.

    Each device's batches may come from a separate thread.

    Args:
        devices: devices of the rig file.
    """

    def __init__(self, devices: Mapping[str, DeviceSettings]) -> None:
        self._clocks_of = {name: device.clocks for name, device in devices_of(devices).items()}
        self.begin()

    def begin(self) -> None:
        """Begin a log: discard all samples and counts."""
        self._watches = {clock.topic: RateWatch(clock) for clocks in self._clocks_of.values() for clock in clocks}

    def feed(self, found: Iterable[Batch | DeviceEvent], host_ns: int) -> list[DeviceEvent]:
        """Add the items of one read. Return an event when a rate becomes wrong and when it is correct again."""
        out: list[DeviceEvent] = []
        for item in found:
            if isinstance(item, DeviceEvent):
                if item.kind == "restart":
                    self.restart(item.device)
            elif (watch := self._watches.get(item.channel.topic)) is not None:
                watch.feed(item, host_ns)
                out += watch.look(host_ns)
        return out

    def restart(self, device: str) -> None:
        """Discard earlier samples of a device that restarted or was reopened."""
        for clock in self._clocks_of.get(device, ()):
            self._watches[clock.topic].restart()

    def rates(self) -> Mapping[str, Rate | None]:
        """Return the newest rate of each channel."""
        return {topic: watch.rate() for topic, watch in self._watches.items()}

    def now(self) -> str:
        """Return the channels with a wrong rate at present, in one line; empty if there are none."""
        wrong = ((topic, watch.wrong) for topic, watch in self._watches.items())
        return "; ".join(f"{topic}: {rate.words()}" for topic, rate in wrong if rate is not None)

    def summary(self) -> str:
        """Return the channels that had a wrong rate, with the duration, in one line; empty if there were none."""
        had = ((topic, watch.worst, watch.wrong_s) for topic, watch in self._watches.items())
        return "; ".join(f"{topic}: {rate.words()}, for {s:.0f} s" for topic, rate, s in had if rate is not None)


def _event(topic: str, rate: Rate, text: str) -> DeviceEvent:
    facts = {
        "channel": topic,
        "rate_Hz": rate.rate_Hz,
        "nominal_Hz": rate.nominal_Hz,
        "clock_ppm": rate.clock_ppm,
        "bound_ppm": rate.bound_ppm,
    }
    return DeviceEvent("rate", HOST, f"{topic}: {text}", facts)
