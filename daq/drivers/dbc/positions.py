"""Continuous numbers of the frames of one message, from a counter or a timestamp that begins again.

A number that jumps forward is a gap. The timestamps of the same frames, or else the host's times, decide how often the
counter began again in a gap. The host's times decide whether the jump leads into the future, which no gap does: the
sensor started again, or the frame is damaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

_MOST_BITS = 62
_EARLY_NS = 10e6  # by which a frame may be earlier than the least delayed ones before it
_LATE_NS = 100e6  # delay of a host that is not taken for lost frames
_LEAK = 1e-3  # rate at which the least delay may grow, above the error of any clock or stated rate


@dataclass
class Placed:
    """Frames of one read.

    Attributes:
        kept: which frames have a place, shape (n,).
        position: continuous numbers of the kept frames, in the unit of counter or timestamp.
        gaps: missing frames before a kept frame, by its index among the kept ones.
        about: those of the gaps in which the counter may have begun again unseen.
        restarts: indices of kept frames at which the sensor had started again.
        doubtful: number of frames that are not kept.
    """

    kept: NDArray[np.bool_]
    position: NDArray[np.int64]
    gaps: dict[int, int] = field(default_factory=dict[int, int])
    about: set[int] = field(default_factory=set[int])
    restarts: list[int] = field(default_factory=list[int])
    doubtful: int = 0


@dataclass
class Stamps:
    """Timestamps of the frames of one read.

    Attributes:
        values: raw numbers, shape (n,).
        wrap: number of values, after which they begin again; longer than the gaps that a counter is asked about.
        step: their difference from one frame to the next.
    """

    values: NDArray[np.int64]
    wrap: int
    step: float


class Positions:
    """Places the frames of one message.

    Args:
        unit_ns: time between two consecutive numbers, ns.
        bits: number of bits.
        step: numbers from one frame to the next: 1 of a counter, the sampling period of a timestamp.
    """

    def __init__(self, unit_ns: float, bits: int, step: float) -> None:
        self.wrap: int = 2 ** min(bits, _MOST_BITS)
        self._unit_ns, self._step = unit_ns, step
        self._last: int | None = None  # position of the newest frame
        self._odd: int | None = None  # number of the newest frame that was not kept
        self._least_ns = math.inf  # least delay so far
        self._heard_ns = 0
        self._stamp: int = 0  # timestamp of the newest frame

    def feed(self, values: NDArray[np.int64], host_ns: int, stamps: Stamps | None = None) -> Placed:
        """Place the frames of one read.

        Args:
            values: numbers of the frames, shape (n,), n ≥ 1.
            host_ns: time of the read.
            stamps: the sensor's own times of these frames.
        """
        values = values & (self.wrap - 1)
        self._least_ns += _LEAK * (host_ns - self._heard_ns)
        self._heard_ns = host_ns
        if self._last is None:
            self._last = int(values[0]) - round(self._step)
            self._stamp = int(stamps.values[0]) - round(stamps.step) if stamps else 0
        steps = np.diff(values, prepend=self._last % self.wrap) % self.wrap
        if bool(np.all(np.abs(steps - self._step) < 0.5 * self._step)) and self._agree(steps, stamps):
            self._odd = None
            placed = Placed(np.ones(len(values), np.bool_), self._last + np.cumsum(steps))
            self._stamp = int(stamps.values[-1]) if stamps else 0
        else:
            placed = self._each(values, host_ns, stamps)
        if len(placed.position):
            self._last = int(placed.position[-1])
            self._least_ns = min(self._least_ns, self._delay_ns(self._last, host_ns))
        return placed

    def _delay_ns(self, position: int, host_ns: int) -> float:
        return host_ns - position * self._unit_ns

    def _agree(self, steps: NDArray[np.int64], stamps: Stamps | None) -> bool:
        """Whether no frame is later by its timestamp than by its number, by half a cycle of the number or more."""
        if stamps is None:
            return True
        passed = np.diff(stamps.values, prepend=self._stamp) % stamps.wrap / stamps.step
        return bool(np.all(passed - steps / self._step < 0.5 * self.wrap / self._step))

    def _each(self, values: NDArray[np.int64], host_ns: int, stamps: Stamps | None) -> Placed:
        """Place frames one by one."""
        placed = Placed(np.zeros(len(values), np.bool_), np.zeros(0, np.int64))
        positions: list[int] = []
        last = self._last or 0
        for index, value in enumerate(values.tolist()):
            step = (value - last) % self.wrap
            missing = round(step / self._step) - 1
            behind_ns = (len(values) - 1 - index) * self._step * self._unit_ns
            late_ns = self._delay_ns(last + step, host_ns) - behind_ns - self._least_ns
            late_ns = late_ns if math.isfinite(late_ns) else 0.0
            turns = self._turns(late_ns) if stamps is None else self._stamped_turns(stamps, index, step, late_ns)
            if missing < 0 and not turns:  # the same number again
                placed.doubtful += 1
                continue
            if missing > 0 and late_ns < -_EARLY_NS:
                follows = self._odd is not None and round((value - self._odd) % self.wrap / self._step) == 1
                self._odd = value
                if not follows:
                    placed.doubtful += 1
                    continue
                placed.restarts.append(len(positions))
                self._least_ns = math.inf
            elif missing or turns:
                step += turns * self.wrap
                placed.gaps[len(positions)] = round(step / self._step) - 1
                if turns and stamps is None and self.wrap * self._unit_ns < _LATE_NS:
                    placed.about.add(len(positions))
            self._odd = None
            self._stamp = int(stamps.values[index]) if stamps else 0
            last += step
            positions.append(last)
            placed.kept[index] = True
        placed.position = np.array(positions, np.int64)
        return placed

    def _turns(self, late_ns: float) -> int:
        """Return how often the counter has begun again in a gap, from the delay of its end by the host's clock."""
        wrap_ns = self.wrap * self._unit_ns
        if late_ns < max(wrap_ns - _EARLY_NS, _LATE_NS):
            return 0
        return int((late_ns + _EARLY_NS) / wrap_ns)

    def _stamped_turns(self, stamps: Stamps, index: int, step: int, late_ns: float) -> int:
        """Return how often the counter has begun again in a gap, from the timestamps at its ends.

        A timestamp that the host's time contradicts is damaged, or began again too: then the host's time decides.
        """
        passed = (int(stamps.values[index]) - self._stamp) % stamps.wrap / stamps.step * self._step
        turns = max(0, round((passed - step) / self.wrap))
        if abs(late_ns - turns * self.wrap * self._unit_ns) < _LATE_NS:
            return turns
        return self._turns(late_ns)
