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
        min_error_s: least uncertainty of the bound of the delay, s.
    """

    def __init__(self, clock: SampleClock, min_error_s: float = _MIN_DELAY_ERROR_S) -> None:
        self._min_error_s = min_error_s
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
            bound_ppm=max(self._min_error_s, _JITTERS * jitter) / span * 1e6,
            tolerance_ppm=self._tolerance,
            span_s=span,
        )


class RateWatches:
    """Monitors the rates of all devices with a clock of their own, and counts the time with a wrong rate.

    Each device's batches may come from a separate thread.

    Args:
        devices: devices of the rig file.
    """

    def __init__(self, devices: Mapping[str, DeviceSettings]) -> None:
        known = devices_of(devices)
        self._clocks = [clock for device in known.values() for clock in device.clocks]
        self._min_span_s = min(_MIN_SPAN_S, 0.9e-9 * _BINS * _BIN_NS)
        self._topics_of = {name: [clock.topic for clock in device.clocks] for name, device in known.items()}
        self.begin()

    def begin(self) -> None:
        """Begin a log: discard all samples and counts."""
        self._watches = {clock.topic: RateWatch(clock, _MIN_DELAY_ERROR_S) for clock in self._clocks}
        self._due: dict[str, int] = {}
        self._suspect: set[str] = set()
        self._wrong: dict[str, Rate] = {}
        self._worst: dict[str, Rate] = {}
        self._seconds = dict.fromkeys(self._watches, 0.0)

    def feed(self, found: Iterable[Batch | DeviceEvent], host_ns: int) -> list[DeviceEvent]:
        """Add the items of one read. Return an event when a rate becomes wrong and when it is correct again."""
        out: list[DeviceEvent] = []
        for item in found:
            if isinstance(item, DeviceEvent):
                if item.kind == "restart":
                    self.restart(item.device)
                continue
            if (watch := self._watches.get(item.channel.topic)) is not None:
                watch.feed(item, host_ns)
                topic = item.channel.topic
                if host_ns >= self._due.setdefault(topic, host_ns + _FIRST_LOOK_NS):
                    self._due[topic] = host_ns + _LOOK_NS
                    out += self._look(topic, watch.rate())
        return out

    def restart(self, device: str) -> None:
        """Discard earlier samples of a device that restarted or was reopened."""
        for topic in self._topics_of.get(device, ()):
            self._watches[topic].restart()

    def _look(self, topic: str, rate: Rate | None) -> list[DeviceEvent]:
        """Report a rate that is wrong in two consecutive checks. A single one may be caused by a suspended host."""
        if rate is None or rate.span_s < self._min_span_s:
            return []
        if rate.ok:
            self._suspect.discard(topic)
            if self._wrong.pop(topic, None) is None:
                return []
            return [_event(topic, rate, f"{topic}: back at {rate.rate_Hz:.1f} Hz")]
        if topic not in self._suspect:
            self._suspect.add(topic)
            return []
        is_new = topic not in self._wrong
        self._wrong[topic] = rate
        self._worst[topic] = max(self._worst.get(topic, rate), rate, key=lambda r: abs(r.off_ppm))
        self._seconds[topic] += _LOOK_NS * 1e-9
        return [_event(topic, rate, f"{topic}: {rate.words()}")] if is_new else []

    def rates(self) -> Mapping[str, Rate | None]:
        """Return the newest rate of each channel."""
        return {topic: watch.rate() for topic, watch in self._watches.items()}

    def now(self) -> str:
        """Return the channels with a wrong rate at present, in one line; empty if there are none."""
        return "; ".join(f"{topic}: {rate.words()}" for topic, rate in self._wrong.copy().items())

    def summary(self) -> str:
        """Return the channels that had a wrong rate, with the duration, in one line; empty if there were none."""
        return "; ".join(
            f"{topic}: {rate.words()}, for {self._seconds[topic]:.0f} s" for topic, rate in self._worst.copy().items()
        )


def _event(topic: str, rate: Rate, text: str) -> DeviceEvent:
    facts = {
        "channel": topic,
        "rate_Hz": rate.rate_Hz,
        "nominal_Hz": rate.nominal_Hz,
        "clock_ppm": rate.clock_ppm,
        "bound_ppm": rate.bound_ppm,
    }
    return DeviceEvent("rate", HOST, text, facts)
