# pyright: strict
"""Whether a device samples at the rig file's rate, and whether its clock runs as fast as the host's.

Fed with batches and the host time of the read they came with; no clock and no I/O in here. A batch's last sample
reached the host some delay after it was made. The delay has a floor, so the least delayed samples of a stretch lie on
a line of host time against device time whose slope is the ratio of the two clocks (`daq.clock.lower_line`). How far
the least delayed ones scatter about it says how well the slope is known: after 2 s hardly better than 0.1 %, after half
a minute some 50 ppm. A rate is called wrong only where it is off by more than that and the clock's tolerance together.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.clock import lower_line
from daq.drivers.contract import SampleClock
from daq.drivers.devices import devices_of
from daq.drivers.items import Batch, Event
from rig_configs.device import DeviceSettings

_BIN_NS = 250_000_000
_BINS = 120  # 30 s
_STDS = 5.0  # of the clock's tolerance
_FLOOR_S = 2e-3  # a delay's floor is no better known than this …
_JITTERS = 5.0  # … nor than so many times its scatter
_LOST_TRACK_NS = 5_000_000_000  # silent, or device and host apart, for longer: one of them stood still or began anew
_LEAST_SPAN_S = 3.0
_LOOK_NS, _FIRST_LOOK_NS = 1_000_000_000, 4_000_000_000


@dataclass(frozen=True)
class Rate:
    """A device's rate over the last stretch.

    Attributes:
        rate_Hz: samples a second of host time, lost ones included.
        nominal_Hz: the rig file's.
        clock_ppm: how much faster than the host's clock the device's own runs.
        bound_ppm: how far `rate_Hz` and `clock_ppm` may be off, of so short a look over so uneven a line.
        tolerance_ppm: how far the clock may be off by the rig file.
        span_s: the stretch, s of host time.
    """

    rate_Hz: float
    nominal_Hz: float
    clock_ppm: float
    bound_ppm: float
    tolerance_ppm: float
    span_s: float

    @property
    def off_ppm(self) -> float:
        """Sample rate against the rig file's."""
        return (self.rate_Hz / self.nominal_Hz - 1.0) * 1e6

    @property
    def rate_ok(self) -> bool:
        """Whether the sample rate may be the rig file's."""
        return abs(self.off_ppm) <= self.tolerance_ppm + self.bound_ppm

    @property
    def clock_ok(self) -> bool:
        """Whether the device's clock may be within its tolerance."""
        return abs(self.clock_ppm) <= self.tolerance_ppm + self.bound_ppm

    @property
    def ok(self) -> bool:
        """Both."""
        return self.rate_ok and self.clock_ok

    @property
    def certain(self) -> bool:
        """Whether the stretch was long enough to see the clock's own tolerance."""
        return self.bound_ppm <= self.tolerance_ppm

    def words(self) -> str:
        """What is wrong, for people."""
        how = f"over {self.span_s:.0f} s, ± {self.bound_ppm:.0f} ppm"
        if not self.rate_ok:
            return f"{self.rate_Hz:.1f} Hz instead of {self.nominal_Hz:g} Hz ({how})"
        clock = f"its clock runs {self.clock_ppm:+.0f} ppm against the host's"
        return f"{clock}, expected ± {self.tolerance_ppm:.0f} ({how})"


class RateWatch:
    """One channel's rate.

    Args:
        clock: what its driver says of its samples' times.
        floor_s: how well the delay's floor is known at best, s.
    """

    def __init__(self, clock: SampleClock, floor_s: float = _FLOOR_S) -> None:
        self._floor_s = floor_s
        self._nominal, self._tolerance = clock.rate_Hz, _STDS * clock.tolerance_ppm
        self._field, self._tick_ns, self._wrap = clock.field, clock.tick_ns, clock.count_wrap
        self._bins: deque[tuple[int, int, int, int]] = deque(maxlen=_BINS)  # number, device ns, lag ns, count
        self._last: tuple[int, int, int] | None = None  # device ns, host ns, sequence
        self._count = 0
        self._anew = False

    def begin_anew(self) -> None:
        """The device's clock and counter have: what came before the next samples says nothing of them."""
        self._anew = True  # another thread may be feeding

    def feed(self, batch: Batch, host_ns: int) -> None:
        """Take the samples of one read."""
        device_ns = int(batch.columns[self._field][-1]) * self._tick_ns
        sequence = int(batch.sequence[-1])
        if self._anew:
            self._anew, self._last = False, None
            self._bins.clear()
        if self._last is not None:
            passed, passed_host = device_ns - self._last[0], host_ns - self._last[1]
            if passed < 0 or max(passed_host, abs(passed - passed_host)) > _LOST_TRACK_NS:
                self._bins.clear()
            self._count += (sequence - self._last[2]) % self._wrap
        self._last = device_ns, host_ns, sequence
        number, lag = device_ns // _BIN_NS, host_ns - device_ns
        if self._bins and self._bins[-1][0] == number:
            if lag < self._bins[-1][2]:
                self._bins[-1] = number, device_ns, lag, self._count
        else:
            self._bins.append((number, device_ns, lag, self._count))

    def rate(self) -> Rate | None:
        """The newest rate; None as long as there is too little to tell."""
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
            bound_ppm=max(self._floor_s, _JITTERS * jitter) / span * 1e6,
            tolerance_ppm=self._tolerance,
            span_s=span,
        )


class RateWatches:
    """All of a rig's devices that have a clock of their own: tells when one leaves the rig file's rate, and counts.

    Each device's batches may come from a thread of its own.

    Args:
        devices: of the rig file.
        patience: rig seconds of so many of the host's: a host dozes by its own clock, however fast the rig runs.
    """

    def __init__(self, devices: Mapping[str, DeviceSettings], patience: Callable[[float], float] = float) -> None:
        known = devices_of(devices)
        clocks = [clock for device in known.values() for clock in device.clocks]
        self._watches = {clock.topic: RateWatch(clock, patience(_FLOOR_S)) for clock in clocks}
        self._least_s = min(patience(_LEAST_SPAN_S), 0.9e-9 * _BINS * _BIN_NS)
        self._look_ns = round(patience(_LOOK_NS))
        self._first_look_ns = round(patience(_FIRST_LOOK_NS))
        self._topics_of = {name: [clock.topic for clock in device.clocks] for name, device in known.items()}
        self._due: dict[str, int] = {}
        self._suspect: set[str] = set()
        self._wrong: dict[str, Rate] = {}
        self._worst: dict[str, Rate] = {}
        self._seconds = dict.fromkeys(self._watches, 0.0)

    def feed(self, found: Iterable[Batch | Event], host_ns: int) -> list[Event]:
        """Take what one read decoded to; gives an event when a rate turns wrong, and when it is right again."""
        out: list[Event] = []
        for item in found:
            if isinstance(item, Event):
                if item.kind == "restart":
                    self.begin_anew(item.device)
                continue
            if (watch := self._watches.get(item.channel.topic)) is not None:
                watch.feed(item, host_ns)
                topic = item.channel.topic
                if host_ns >= self._due.setdefault(topic, host_ns + self._first_look_ns):
                    self._due[topic] = host_ns + self._look_ns
                    out += self._look(topic, watch.rate())
        return out

    def begin_anew(self, device: str) -> None:
        """A device's clocks and counters have: it started again, or was opened again."""
        for topic in self._topics_of.get(device, ()):
            self._watches[topic].begin_anew()

    def _look(self, topic: str, rate: Rate | None) -> list[Event]:
        """Wrong twice in a row is wrong: once may be a host that dozed."""
        if rate is None or rate.span_s < self._least_s:  # so short a stretch would pass anything
            return []
        if rate.ok:
            self._suspect.discard(topic)
            if self._wrong.pop(topic, None) is None:
                return []
            return [_event(topic, rate, f"{topic}: back at {rate.rate_Hz:.1f} Hz")]
        if topic not in self._suspect:
            self._suspect.add(topic)
            return []
        news = topic not in self._wrong
        self._wrong[topic] = rate
        self._worst[topic] = max(self._worst.get(topic, rate), rate, key=lambda r: abs(r.off_ppm))
        self._seconds[topic] += self._look_ns * 1e-9
        return [_event(topic, rate, f"{topic}: {rate.words()}")] if news else []

    def rates(self) -> Mapping[str, Rate | None]:
        """The newest rate of each channel."""
        return {topic: watch.rate() for topic, watch in self._watches.items()}

    def now(self) -> str:
        """Which channels are off now, in a line; empty when none is."""
        return "; ".join(f"{topic}: {rate.words()}" for topic, rate in self._wrong.copy().items())

    def summary(self) -> str:
        """Which channels were off and for how long, in a line; empty when none was."""
        return "; ".join(
            f"{topic}: {rate.words()}, for {self._seconds[topic]:.0f} s" for topic, rate in self._worst.copy().items()
        )


def _event(topic: str, rate: Rate, text: str) -> Event:
    facts = {
        "channel": topic,
        "rate_Hz": rate.rate_Hz,
        "nominal_Hz": rate.nominal_Hz,
        "clock_ppm": rate.clock_ppm,
        "bound_ppm": rate.bound_ppm,
    }
    return Event("rate", "host", text, facts)  # the host's judgement: replaying a device's bytes does not make it
