"""The clock of a node compared with the number of its samples: steps of the clock, and times without them.

The samples of a node are equally spaced, and their index counts them. A time stamp that contradicts index × period by
more than one period belongs to another sample. The node's clock has then stepped, and all times after it are put back
by the step. A mark between two blocks may come before the block that shows a step. It waits for this block if its time
does not fit between the blocks, for half a second at most.
"""

from __future__ import annotations

from typing import NamedTuple

MAX_WAIT_NS = 500_000_000
"""Time for which a mark waits for the next block."""
_MAX_STEP_US = 1_000_000  # off the next block by more, a mark comes after a silence of the node
_SHARE_OFF = 0.25  # of a block, by which marks and blocks may be stamped or sent in another order
_PERIOD_ROUNDING_US = 0.5  # the period is a whole number of microseconds


class Step(NamedTuple):
    """A step of the node's clock.

    Attributes:
        us: size, µs.
        span_us: time from the sample before it to the sample after it, by the number of samples, µs.
    """

    us: int
    span_us: int


class NodeClock:
    """Time of a node without the steps of its clock.

    Attributes:
        shift_us: sum of the steps so far, µs.
    """

    def __init__(self) -> None:
        self.shift_us: int = 0
        self._due: tuple[int, int] | None = None  # time of the sample after the newest one, and span of its block, µs

    def take(self, first_us: int, due_us: int, samples: int, period_us: int, count: int) -> Step | None:
        """Take a block; return the step of the clock before it.

        Args:
            first_us: stated time of its first sample, µs.
            due_us: time that follows from the number of samples since the newest block, µs.
            samples: number of samples from the beginning of the newest block to this one; 0 if it is unknown.
            period_us, count: period and number of its samples.
        """
        self._due = first_us + count * period_us, count * period_us
        off = first_us - due_us
        if not (samples and period_us):
            return None
        if abs(off) <= period_us + _PERIOD_ROUNDING_US * samples:
            return None
        self.shift_us += off
        return Step(off, samples * period_us)

    def is_out_of_place(self, us: int) -> bool:
        """Whether a mark at a stated time does not fit between the newest block and the next one."""
        if self._due is None:
            return False
        due_us, span_us = self._due
        early_us, late_us = due_us - us, us - due_us - span_us
        return max(early_us, late_us) > _SHARE_OFF * span_us and max(early_us, late_us) < _MAX_STEP_US

    def own_us(self, us: int, before_shift_us: int, due_us: float) -> int:
        """Return the time of a mark without steps.

        Args:
            us: stated time.
            before_shift_us: sum of the steps before the block that came after the mark.
            due_us: time at which the mark is expected. The mark is before or after the step: its time is the one of
                both that is nearer.
        """
        candidates = us - before_shift_us, us - self.shift_us
        return min(candidates, key=lambda own: abs(own - due_us))
