"""True rows of a laser's stream, and the sampling period that they show.

The line has no checksum. Counter and timestamp of a row must advance together from the row before it, or to the row
after it; otherwise the row is damaged. The sampling period is that of the rig file until rows show another. A sensor
that measures at another rate than the rig file states is thus decoded correctly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.clock import steps_from
from daq.drivers.optoncdt.wire import COUNTER_WRAP, TICK_S, TIMESTAMP_WRAP
from daq.numbered.due_line import RATE_ERROR

_PERIOD_ROWS = 8
"""Consecutive rows that show another sampling period."""
_ROUNDING_TICKS = 2.0
"""Rounding of two timestamps, and one tick that a sensor may be late."""
_LONGEST_TICKS = round(1.0 / TICK_S)
"""Longest gap over which counter and timestamp alone show that a row is true; a false one passes in 3 of 10⁵ cases."""
_MEASURED_TICKS = 5000
"""Duration over which a period is measured: one tick of rounding is then 0.2 ‰."""

Rows = NDArray[np.int64]


class TrueRows:
    """Finds the true rows of one sensor.

    Args:
        period_ticks: sampling period of the rig file, ticks.

    Attributes:
        period_ticks: sampling period, ticks.
        error: its relative uncertainty.
        damaged: number of rows that were dropped.
    """

    def __init__(self, period_ticks: float) -> None:
        self.period_ticks: float = period_ticks
        self.error: float = RATE_ERROR
        self.damaged: int = 0
        self._last: Rows | None = None  # counter and timestamp of the newest true row
        self._held: Rows | None = None  # rows that follow no other one so far
        self._counts = self._ticks = 0  # over which the period is measured

    @property
    def is_measured(self) -> bool:
        """Whether the sampling period is that of the stream."""
        return self._ticks >= _MEASURED_TICKS

    def measure_again(self) -> None:
        """Measure the sampling period again: the sensor may have started with another one."""
        self._counts = self._ticks = 0

    def feed(self, rows: Rows) -> Rows:
        """Return the true ones of these rows, and of those that were held before.

        Args:
            rows: counter and timestamp as received, and any other columns, shape (n, columns).
        """
        if self._held is not None:
            rows, self._held = np.concatenate([self._held, rows]), None
        found: list[Rows] = []
        while len(rows):
            follows = self._follow(rows)
            taken = len(rows) if follows.all() else int(np.argmin(follows))
            if taken:
                found.append(rows[:taken])
                self._last, rows = rows[taken - 1, :2], rows[taken:]
                continue
            later = None if self._last is None else self._advance(self._last, rows)[1]
            if later is not None and later.any():
                self.damaged += int(later.argmax())
                rows = rows[later.argmax() :]
            elif self._advance(rows[0], rows[1:])[1].any():  # the first rows, after a long gap, or after a new start
                found.append(rows[:1])
                self._last, rows = rows[0, :2], rows[1:]
            elif self._finds_period(rows):
                continue
            elif len(rows) <= _PERIOD_ROWS:
                self._held = rows
                break
            else:
                self.damaged += 1
                rows = rows[1:]
        return np.concatenate(found) if found else rows[:0]

    def _follow(self, rows: Rows) -> NDArray[np.bool_]:
        """Return whether each row follows the one before it, and measure the period by those at the beginning."""
        before = rows[:, :2].copy()
        before[1:] = rows[:-1, :2]
        if self._last is not None:
            before[0] = self._last
        passed, follows = self._advance(before, rows)
        if not self.is_measured and follows.all():
            self._counts += int(((rows[:, 0] - before[:, 0]) % COUNTER_WRAP).sum())
            self._ticks += int(passed.sum())
            self.period_ticks, self.error = self._ticks / self._counts, RATE_ERROR + 1.0 / self._ticks
        return follows

    def _advance(self, before: Rows, rows: Rows) -> tuple[Rows, NDArray[np.bool_]]:
        """Return the ticks from other rows, or from another one, to these, and whether their counters agree."""
        passed = (rows[:, 1] - before[..., 1]) % TIMESTAMP_WRAP
        expected = (rows[:, 0] - before[..., 0]) % COUNTER_WRAP * self.period_ticks
        off = np.abs(passed - expected)
        follows = (off <= _ROUNDING_TICKS + self.error * passed) & (passed > 0.5 * self.period_ticks)
        return passed, follows & (passed <= max(_LONGEST_TICKS, 2 * self.period_ticks))

    def _finds_period(self, rows: Rows) -> bool:
        """Take the period of consecutive rows that are evenly spaced, if it is another one."""
        steps = np.diff(rows[: _PERIOD_ROWS + 1, :2], axis=0)
        ticks = steps[:, 1] % TIMESTAMP_WRAP
        if len(ticks) < _PERIOD_ROWS or np.any(steps[:, 0] % COUNTER_WRAP != 1) or np.ptp(ticks) > _ROUNDING_TICKS:
            return False
        period = float(np.mean(ticks))
        if period <= 0 or abs(period - self.period_ticks) * _PERIOD_ROWS <= _ROUNDING_TICKS:
            return False
        self.period_ticks, self.error = period, RATE_ERROR + 1.0 / float(np.sum(ticks))
        self.measure_again()
        return True


class SampleTimes:
    """Times of samples that have a place in the sensor's count, by its timestamp."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # place and time of the newest sample

    def restart(self) -> None:
        """Let the next sample have no other before it."""
        self._last = None

    def feed(self, places: Rows, ticks: Rows, rows: TrueRows) -> Rows | None:
        """Return the times of consecutive samples, ticks; None if those before them had another clock.

        Args:
            places: places in the count, shape (n,).
            ticks: timestamps as received, shape (n,).
            rows: the sampling period.
        """
        place, time = self._last or (int(places[0]) - 1, int(ticks[0]) - round(rows.period_ticks))
        expected = steps_from(place, places) * rows.period_ticks
        off = (steps_from(time, ticks) - expected + TIMESTAMP_WRAP / 2) % TIMESTAMP_WRAP - TIMESTAMP_WRAP / 2
        if abs(off[0]) > _PERIOD_ROWS * rows.period_ticks + rows.error * expected[0]:
            return None
        times = time + np.cumsum(np.rint(expected + off).astype(np.int64))
        self._last = int(places[-1]), int(times[-1])
        return times
