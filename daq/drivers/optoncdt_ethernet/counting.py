"""What the counter of a sensor's packets states: missing frames, a restart, and a measuring rate that was changed."""

from __future__ import annotations

from collections import deque
from typing import Literal

from daq.drivers.optoncdt_ethernet.wire import COUNTER_WRAP
from rig_basics.texts import number_of

Counts = Literal["frames", "packets"]

_SHORT_WRAP = 2**24
_RESTART_FRAMES = 2**31  # a larger step of the counter is one backwards
_EARLY_S = 1.0  # by which frames would have been received before they were measured
_CERTAIN_STEPS = 3  # steps that fit one meaning of the counter only

_WINDOW_NS = 1_000_000_000
_LEAST_READS = 10  # of a window, so that its rate is known well enough
_RIGHT, _WRONG = 0.1, 0.2  # deviations of a window's rate; the rates of the sensor differ by a factor of 1.5 or more
_SAME = 0.05  # deviation of the windows from each other
_WINDOWS = 4
_SENSOR_RATES_HZ = (1500.0, 2500.0, 5000.0, 10_000.0, 20_000.0, 30_000.0, 49_140.0)
_MOST_REDUCED = 10  # frames of which one is sent, if output reduction is selected
_NEAR = 0.02  # deviation from a rate that the sensor has


class FrameCounter:
    """Compares the counters of consecutive packets with the number of their frames.

    The manual does not state whether the counter is that of the packet's first frame or the number of frames up to its
    end. In the first case it steps by the number of frames of the packet before, in the second by that of its own. The
    meaning that explains the steps is taken. The counter may have 24 bits, as the one that can be selected for frames.

    Args:
        counts: what the counter counts.
    """

    def __init__(self, counts: Counts) -> None:
        self._of_frames = counts == "frames"
        self._counter: int | None = None
        self._frames = 0
        self._steps = [0, 0]  # that fit only the counter of the first frame, and of the end
        self._others = 0  # consecutive steps that fit the other setting of `counts`
        self.of_end: bool = False
        """Whether the counter is that of the packet's end."""

    def missing(self, counter: int, frames: int) -> int | None:
        """Return the number of frames, or packets, missing before a packet.

        Returns:
            0 for the first packet; None if the counter steps back: the sensor started again.
        """
        before, self._counter = self._counter, counter
        previous, self._frames = self._frames, frames
        if before is None:
            return 0
        step = (counter - before) % COUNTER_WRAP
        fits_other = min(previous, frames) > 1 and (step == 1 if self._of_frames else step in (previous, frames))
        self._others = self._others + 1 if fits_other else 0
        if self._others and self._of_frames:
            return 0  # no restart: `contradiction` states it
        if self._of_frames and previous != frames and step in (previous, frames):
            self._learn(int(step == frames))
        expected = 1 if not self._of_frames else frames if self.of_end else previous
        missing = step - expected
        if 0 <= missing < _RESTART_FRAMES:
            return missing
        is_wrap = before < _SHORT_WRAP and (counter - before) % _SHORT_WRAP == expected
        return 0 if is_wrap else None

    @property
    def contradiction(self) -> str:
        """What contradicts the setting `counts`, from consecutive steps of the counter; empty otherwise."""
        if self._others < _CERTAIN_STEPS:
            return ""
        if self._of_frames:
            packet = f"each packet of about {number_of(self._frames, 'frame')}"
            return f'its counter steps by 1 with {packet}: set counts = "packets"'
        return f'its counter steps by the number of frames of each packet, about {self._frames}: set counts = "frames"'

    def _learn(self, meaning: int) -> None:
        if self._steps[1 - meaning] < _CERTAIN_STEPS:
            self._steps[meaning] += 1
            self.of_end = bool(meaning)


class LeastDelay:
    """Finds frames that would have been received before they were measured: the counter does not continue.

    The counter of a sensor that started again can be larger than before: after 2³¹ frames, which are five days at
    5 kHz, and after a short time. A bit error can do the same.
    """

    def __init__(self) -> None:
        self._least_ns: float | None = None

    def clear(self) -> None:
        """Begin again."""
        self._least_ns = None

    def is_possible(self, device_ns: float, host_ns: int) -> bool:
        """Whether frames up to a time of the sensor's clock can have been received at a host time, both in ns."""
        return self._least_ns is None or host_ns - device_ns > self._least_ns - _EARLY_S * 1e9

    def feed(self, device_ns: float, host_ns: int) -> None:
        """Take frames up to a time of the sensor's clock, received at a host time, both in ns."""
        delay = host_ns - device_ns
        self._least_ns = delay if self._least_ns is None else min(delay, self._least_ns)


class RateChange:
    """Finds that a sensor was set to another measuring rate while it is read.

    The time of a sample is its number times the sampling period, so all later samples would have a wrong time. Frames
    that are received late, or are read late by a host under load, do not have the same rate for so long, or have one
    that the sensor does not have. A rate that is wrong from the beginning is not judged here, since the host compares
    each device's rate with the rig file.

    Args:
        rate_Hz: rate of the rig file, Hz.

    Attributes:
        found_Hz: the other rate, Hz; 0 while the rate is that of the rig file.
    """

    def __init__(self, rate_Hz: float) -> None:
        self._rate_Hz = rate_Hz
        self._rates_Hz = (*_SENSOR_RATES_HZ, *(rate_Hz / n for n in range(2, _MOST_REDUCED + 1)))
        self._begin: tuple[int, int] | None = None  # frames, host ns
        self._reads = 0
        self._was_right = False
        self._others: deque[float] = deque(maxlen=_WINDOWS)
        self.found_Hz: float = 0.0

    def clear(self) -> None:
        """Begin the present window again, after the counter did not continue."""
        self._begin = None
        self._others.clear()

    def feed(self, frames: int, host_ns: int) -> bool:
        """Take the number of frames up to now, missing ones included; return whether `found_Hz` has changed."""
        if self._begin is None or host_ns - self._begin[1] > 2 * _WINDOW_NS or host_ns < self._begin[1]:
            self._begin, self._reads = (frames, host_ns), 0
            self._others.clear()
            return False
        self._reads += 1
        if host_ns - self._begin[1] < _WINDOW_NS or self._reads < _LEAST_READS:
            return False
        rate_Hz = (frames - self._begin[0]) / (host_ns - self._begin[1]) * 1e9
        self._begin, self._reads = (frames, host_ns), 0
        deviation = abs(rate_Hz / self._rate_Hz - 1)
        if deviation < _RIGHT:
            self._was_right = True
            self._others.clear()
            changed, self.found_Hz = self.found_Hz != 0.0, 0.0
            return changed
        if deviation < _WRONG or not self._was_right or self.found_Hz:
            self._others.clear()
            return False
        self._others.append(rate_Hz)
        mean = sum(self._others) / len(self._others)
        if len(self._others) == _WINDOWS and self._is_known(mean):
            self.found_Hz = mean
        return self.found_Hz != 0.0

    def _is_known(self, mean_Hz: float) -> bool:
        """Whether all windows have the same rate, and it is one that the sensor has."""
        same = all(abs(rate - mean_Hz) <= _SAME * mean_Hz for rate in self._others)
        return same and any(abs(mean_Hz / rate - 1) <= _NEAR for rate in self._rates_Hz)
