"""Continuous numbers of the frames of one message, from a counter or a timestamp that begins again.

A number that jumps forward is a gap. The timestamps of the same frames, or else the host's times, decide how often the
counter began again in a gap. The host's times decide whether the jump leads into the future, which no gap does: the
sensor started again, or the frame is damaged.

Frames wait if their number does not decide (`Lateness`): late ones until the host's times show whether the counter has
begun again, a jump at the end of a read until the next frame shows whether the number is damaged. Frames that still
wait at the end of a log are placed by their counter alone. Late frames show a restart if numbers do not continue, their
lateness is at least `LATE_NS`, and it differs from whole cycles of the counter by at least `_REST_NS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.drivers.dbc.lateness import LateGap, Lateness

LATE_NS = 100e6
"""Delay of a host that is not taken for lost frames, ns."""
_MOST_BITS = 62
_EARLY_NS = 10e6  # by which a frame may be earlier than the least delayed ones before it
_LEAK = 1e-3  # rate at which the least delay may grow, above the error of any clock or stated rate
_REST_NS = 20e6  # by which the lateness after a gap may differ from whole cycles of the counter
_LEAST_LATE_NS = 5e6  # lateness that is looked at: busy hosts cause less


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
        looks_ahead: whether a jump is compared with the frame after it, and late frames may wait.
    """

    def __init__(self, unit_ns: float, bits: int, step: float, *, looks_ahead: bool = False) -> None:
        self.wrap: int = 2 ** min(bits, _MOST_BITS)
        self._unit_ns, self._step = unit_ns, step
        self._last: int | None = None  # position of the newest frame
        self._odd: int | None = None  # number of the newest frame that was not kept
        self._least_ns = math.inf  # least delay so far
        self._heard_ns = 0
        self._stamp: int = 0  # timestamp of the newest frame
        self._offset: int = 0  # of the positions to the numbers, after restarts whose place the host's time gave
        late_ns = max(_LEAST_LATE_NS, min(_EARLY_NS, 0.5 * self.wrap * unit_ns))
        self._lateness = Lateness(late_ns, unit_ns) if looks_ahead else None

    def undecided(self, values: NDArray[np.int64], new: int, host_ns: int) -> bool:
        """Whether these frames, without timestamps, must wait for the next read, with which they are given again.

        Args:
            values: numbers of all frames that are not placed, shape (n,), n ≥ 1.
            new: number of frames of the newest read.
            host_ns: time of the newest read.
        """
        if self._lateness is None or self._last is None:
            return False
        steps = np.diff((values + self._offset) & (self.wrap - 1), prepend=self._last % self.wrap) % self.wrap
        delay_ns = self._delay_ns(self._last + int(steps.sum()), host_ns)
        return self._lateness.undecided(delay_ns, host_ns, (len(values) - new, new), steps[-new:])

    def feed(self, values: NDArray[np.int64], host_ns: int, stamps: Stamps | None = None) -> Placed:
        """Place the frames of one read.

        Args:
            values: numbers of the frames, shape (n,), n ≥ 1.
            host_ns: time of the read.
            stamps: the sensor's own times of these frames.
        """
        values = (values + self._offset) & (self.wrap - 1)
        self._least_ns += _LEAK * (host_ns - self._heard_ns)
        self._heard_ns = host_ns
        if self._last is None:
            self._last = int(values[0]) - round(self._step)
            self._stamp = int(stamps.values[0]) - round(stamps.step) if stamps else 0
        steps = np.diff(values, prepend=self._last % self.wrap) % self.wrap
        late = self._lateness.gap if self._lateness is not None and stamps is None else None
        if late is None and bool(np.all(np.abs(steps - self._step) < 0.5 * self._step)) and self._agree(steps, stamps):
            self._odd = None
            placed = Placed(np.ones(len(values), np.bool_), self._last + np.cumsum(steps))
            self._stamp = int(stamps.values[-1]) if stamps else 0
        else:
            placed = self._each(values, host_ns, stamps, late)
        if len(placed.position):
            self._last = int(placed.position[-1])
            self._least_ns = min(self._least_ns, self._delay_ns(self._last, host_ns))
            if self._lateness is not None:
                self._lateness.placed(self._delay_ns(self._last, host_ns), host_ns)
        return placed

    def _delay_ns(self, position: int, host_ns: int) -> float:
        return host_ns - position * self._unit_ns

    def _agree(self, steps: NDArray[np.int64], stamps: Stamps | None) -> bool:
        """Whether no frame is later by its timestamp than by its number, by half a cycle of the number or more."""
        if stamps is None:
            return True
        passed = np.diff(stamps.values, prepend=self._stamp) % stamps.wrap / stamps.step
        return bool(np.all(passed - steps / self._step < 0.5 * self.wrap / self._step))

    def _each(self, values: NDArray[np.int64], host_ns: int, stamps: Stamps | None, late: LateGap | None) -> Placed:
        """Place frames one by one."""
        placed = Placed(np.zeros(len(values), np.bool_), np.zeros(0, np.int64))
        positions: list[int] = []
        last = self._last or 0
        gap_at, offset = self._end_of(late, values, last) if late else -1, 0
        behind_ns = len(values) * self._step * self._unit_ns
        for index, number in enumerate(values.tolist()):
            value = (number + offset) % self.wrap
            step = (value - last) % self.wrap
            missing = round(step / self._step) - 1
            behind_ns -= self._step * self._unit_ns
            late_ns = self._delay_ns(last + step, host_ns) - behind_ns - self._least_ns
            late_ns = late_ns if math.isfinite(late_ns) else 0.0
            more, restarted = self._unseen(late, index == gap_at, late_ns, stamps, (index, step))
            goes_on = missing > 0 and self._goes_on(values[index + 1 :], last - offset)
            if not more and (missing < 0 or goes_on):  # the same number again, or a number that is passed over
                placed.doubtful += 1
                continue
            if missing > 0 and late_ns < -_EARLY_NS and not more:
                follows = self._odd is not None and round((value - self._odd) % self.wrap / self._step) == 1
                self._odd = value
                if not follows:
                    placed.doubtful += 1
                    continue
                placed.restarts.append(len(positions))
                self._least_ns = math.inf
                if self._lateness is not None:
                    self._lateness.begin_again()
            elif missing or more:
                step += more
                placed.gaps[len(positions)] = round(step / self._step) - 1
                if restarted:
                    placed.restarts.append(len(positions))
                    offset = (last + step - number) % self.wrap
                if restarted or (more and stamps is None and self.wrap * self._unit_ns < LATE_NS):
                    placed.about.add(len(positions))
            self._odd = None
            self._stamp = int(stamps.values[index]) if stamps else 0
            last += step
            positions.append(last)
            placed.kept[index] = True
        placed.position = np.array(positions, np.int64)
        self._offset += offset
        return placed

    def _goes_on(self, later: NDArray[np.int64], last: int) -> bool:
        """Whether the next frame continues the numbers as if this one were damaged, or from another sender."""
        return self._lateness is not None and len(later) > 0 and (int(later[0]) - last) % self.wrap in (1, 2)

    def _end_of(self, late: LateGap, values: NDArray[np.int64], last: int) -> int:
        """Return the index of the frame at which a gap ends: the first jump from the read on that showed it."""
        steps = np.diff(values, prepend=last % self.wrap)[late.waited :] % self.wrap
        return late.waited + int(np.argmax(steps > 1 if (steps > 1).any() else steps != 1))

    def _unseen(
        self, late: LateGap | None, here: bool, late_ns: float, stamps: Stamps | None, place: tuple[int, int]
    ) -> tuple[int, bool]:
        """Return the numbers that are missing beyond the difference of two numbers, and whether the sensor restarted.

        Args:
            late: gap that the host's times show.
            here: whether it ends at this frame.
            late_ns: lateness of the frame, ns.
            stamps, place: timestamps, with the index of the frame and the difference of its number to the last one.
        """
        if stamps is not None:
            return self._stamped_turns(stamps, *place, late_ns) * self.wrap, False
        if self._lateness is None:
            return self._turns(late_ns) * self.wrap, False
        if late is None or not here:
            return 0, False
        turns = max(0, round(late.late_ns / (self.wrap * self._unit_ns)))
        rest_ns = abs(late.late_ns - turns * self.wrap * self._unit_ns)
        if rest_ns > _REST_NS + _LEAK * late.silent_ns + late.spread_ns:  # no cycle of the counter explains it
            goes_on = place[1] == 1  # a sensor that starts again hardly goes on counting
            is_host = goes_on or late.late_ns < LATE_NS
            return (0, False) if is_host else (round(late.late_ns / self._unit_ns), True)
        return turns * self.wrap, False

    def _turns(self, late_ns: float) -> int:
        """Return how often the counter has begun again in a gap, from the delay of its end by the host's clock."""
        wrap_ns = self.wrap * self._unit_ns
        if late_ns < max(wrap_ns - _EARLY_NS, LATE_NS):
            return 0
        return int((late_ns + _EARLY_NS) / wrap_ns)

    def _stamped_turns(self, stamps: Stamps, index: int, step: int, late_ns: float) -> int:
        """Return how often the counter has begun again in a gap, from the timestamps at its ends.

        A timestamp that the host's time contradicts is damaged, or began again too: then the host's time decides. If
        timestamp and number agree on whole cycles, only the host was late.
        """
        passed = (int(stamps.values[index]) - self._stamp) % stamps.wrap / stamps.step * self._step
        turns = max(0, round((passed - step) / self.wrap))
        later_ns = late_ns - turns * self.wrap * self._unit_ns
        unlike = min(0.5 * self._step + _LEAK * passed, self.wrap / 4)
        agree = abs(passed - step - turns * self.wrap) < unlike
        unseen_ns = stamps.wrap / stamps.step * self._step * self._unit_ns - LATE_NS  # the timestamp began again
        if -LATE_NS < later_ns < (max(unseen_ns, LATE_NS) if agree else LATE_NS):
            return turns
        return self._turns(late_ns)
