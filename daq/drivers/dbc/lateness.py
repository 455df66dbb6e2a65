"""Wait after frames that came late: a gap of whole cycles of its counter, or a host or adapter that was delayed.

After a delay the frames that were kept back come at once, and those after them are in time again. After a gap every
frame is late by the cycles of the counter that are missing, and the sensor was silent before. A counter that stands
still, or a sensor slower than stated, becomes later and later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

_WAIT_NS, _MOST_WAIT_NS = 120e6, 250e6  # until frames count as late for good; for frames that still catch up
_LEAST_READS = 4
_NEAR_NS = 5e6  # by which reads on a busy host differ
_GROWTH = 0.5  # of lateness over time, above which no gap explains it
_BUSY_NS = 20e6  # by which the least lateness of a few reads grows on a busy host
_CAUGHT_UP = 0.25  # share of the lateness
_SILENT = 0.8  # share of the lateness for which the sensor was silent before it
_LEAK = 0.02  # rate at which the least delay may grow, above the error of a usual stated rate
_MOST_LEAK_NS = 1e8  # of a time without frames


@dataclass
class LateGap:
    """A gap that the host's times show.

    Attributes:
        late_ns: lateness of the frames after it, if its counter did not begin again in it, ns.
        waited: number of waiting frames before the read in which it ended.
        silent_ns: time without a frame before it ended, ns.
        spread_ns: difference of the least lateness of the earlier and the later reads, ns.
    """

    late_ns: float
    waited: int
    silent_ns: float
    spread_ns: float


@dataclass
class Lateness:
    """Lateness of the frames of one message, read by read.

    Args:
        least_ns: smallest lateness that is looked at, ns.
        period_ns: time between two frames, ns.

    Attributes:
        gap: gap that the newest decision has found.
    """

    least_ns: float
    period_ns: float
    gap: LateGap | None = None
    _delay_ns: float = math.inf  # least delay of late
    _kept_ns: int = 0  # time of the newest read with a placed frame
    _read_ns: int = 0  # time of the newest read
    _again: bool = False  # whether earlier late reads were discarded
    _waited: int = 0  # frames that waited before the first late read
    _reads: list[tuple[int, float]] = field(default_factory=list[tuple[int, float]])
    _jump_ns: int | None = None  # time of the first read that is kept back because of a jump at its end

    def undecided(self, delay_ns: float, host_ns: int, frames: tuple[int, int], steps: NDArray[np.int64]) -> bool:
        """Whether the frames of the newest reads must wait for the next read.

        Args:
            delay_ns: delay of the newest frame, if no counter began again in a gap, ns.
            host_ns: time of the read.
            frames: number of frames that waited before it, and of its own.
            steps: differences of the numbers of its own frames, each to the one before.
        """
        self.gap = None
        late_ns = delay_ns - self._delay_ns
        silent_ns, self._read_ns = host_ns - self._read_ns - frames[1] * self.period_ns, host_ns
        if silent_ns < self.least_ns and not steps.any():  # the same number again and again
            return False
        if late_ns < self.least_ns or not math.isfinite(late_ns):
            self._reads.clear()
            if steps[-1] > 1 and (self._jump_ns is None or host_ns - self._jump_ns < _WAIT_NS):
                self._jump_ns = host_ns if self._jump_ns is None else self._jump_ns
                return True
            return False
        if not self._reads and host_ns - self._kept_ns < _SILENT * late_ns:
            return False
        if (
            self._reads
            and not self._again
            and silent_ns > _SILENT * (late_ns - self._reads[-1][1]) > _SILENT * self.least_ns
        ):
            self._again = True
            self._reads.clear()  # those before were read while the gap lasted
        self._waited = self._waited if self._reads else frames[0]
        self._reads.append((host_ns, late_ns))
        return self._look()

    def _look(self) -> bool:
        """Decide about late reads; return whether it is too early for it."""
        began_ns, ended_ns = self._reads[0][0], self._reads[-1][0]
        passed_ns = ended_ns - began_ns
        few = passed_ns < _WAIT_NS or len(self._reads) < _LEAST_READS
        if len(self._reads) == 1 or (few and passed_ns < _MOST_WAIT_NS):
            return True
        middle_ns = began_ns + passed_ns / 2
        first_ns = min(late_ns for at_ns, late_ns in self._reads if at_ns <= middle_ns)
        newest_ns = min(late_ns for at_ns, late_ns in self._reads if at_ns > middle_ns)
        if newest_ns < first_ns - max(_NEAR_NS, _CAUGHT_UP * first_ns):  # what was kept back is still coming
            return passed_ns < _MOST_WAIT_NS
        if newest_ns - first_ns < max(_GROWTH * passed_ns / 2, _BUSY_NS):
            self.gap = LateGap(
                min(first_ns, newest_ns), self._waited, began_ns - self._kept_ns, abs(newest_ns - first_ns)
            )
        return False

    def placed(self, delay_ns: float, host_ns: int) -> None:
        """Take the delay of the newest placed frame, ns, and the time of its read."""
        self._delay_ns += _LEAK * min(host_ns - self._kept_ns, _MOST_LEAK_NS)
        self._delay_ns = min(self._delay_ns, delay_ns)
        self._kept_ns = host_ns
        self._reads.clear()
        self._jump_ns, self._again = None, False

    def begin_again(self) -> None:
        """Discard the delays before a restart of the sensor."""
        self._delay_ns = math.inf
