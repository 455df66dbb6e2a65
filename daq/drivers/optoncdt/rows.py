"""Order of the blocks of a laser's stream, and the sampling period in clock ticks.

The line has no checksum. Counter and timestamp must advance together, and by no more than the host's time allows. A row
that contradicts the rows before it is damaged, unless the rows after it continue it. In that case the sensor has
restarted, the row is the first of all, or a long gap has ended. The row waits until the rows after it have arrived.

The sampling period is that of the rig file until the stream shows another. A sensor that measures at another rate than
the rig file states is decoded correctly, with correct samples, times and losses, and the difference is reported.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.drivers.optoncdt import wire as optoncdt

Row = NDArray[np.int64]  # counter and ticks as received
Words = NDArray[np.uint32]

_RESTART_ROWS = 3  # consecutive rows that show a restart …
_PERIOD_ROWS = 8  # … and those that show another sampling period
_MIN_DRIFT_TICKS = 4  # deviation over those rows that shows another period; rounding in the sensor gives less
_LONG_JUMP_TICKS = 100_000  # 1 s
_MAX_STALL_TICKS = 3_000_000  # 30 s; a restart is mistaken for such a gap in at most 2 of 1000 cases
_MAX_LATE_NS = 2_000_000_000  # excess of a gap on the sensor over that on the host: bytes wait in buffers
_COMPARED_AFTER = (64, 4096)  # samples after which the sampling period is compared with the assumed one
_CLOCK_DEVIATION = 2e-4  # relative deviation of a period that the tolerance of the sensor's clock explains


@dataclass(eq=False)
class _Chain:
    """Rows that continue one another, with their words."""

    rows: list[Row]
    values: list[Words]

    def without(self, taken: set[int]) -> _Chain:
        left = [(row, value) for row, value in zip(self.rows, self.values, strict=True) if id(row) not in taken]
        return _Chain([row for row, _ in left], [value for _, value in left])


@dataclass(frozen=True)
class Sorted:
    """Result for the rows of one read.

    Attributes:
        stretches: sequences of rows that continue one another, each with whether the sensor restarted at its beginning.
        dropped: number of rows that do not fit.
    """

    stretches: list[tuple[bool, Words]]
    dropped: int = 0


class RowOrder:
    """The order of one laser's rows.

    Args:
        nominal_ticks: sampling period of the rig file, ticks.

    Attributes:
        period_ticks: sampling period, ticks.
        last: last of the rows that fitted; None before the first.
    """

    def __init__(self, nominal_ticks: float) -> None:
        self.period_ticks: float = nominal_ticks
        self.last: Row | None = None
        self._last_host_ns = 0
        self._doubtful: list[_Chain] = []  # rows that do not fit so far
        self._newest: deque[tuple[Row, Words]] = deque(maxlen=_PERIOD_ROWS)  # newest rows that were examined singly
        self._uncertainty = 0.0  # relative uncertainty of a period that was just found
        self._origin: tuple[int, int] | None = None  # counter and ticks from which the period is measured
        self._comparisons = 0

    @property
    def is_period_measured(self) -> bool:
        """Whether the sampling period has been compared with that of the stream."""
        return self._comparisons > 0

    @property
    def in_doubt(self) -> bool:
        """Whether rows wait for confirmation by later rows, or no row has arrived yet."""
        return self.last is None or bool(self._doubtful)

    def go_on(self, counter: int, ticks: int, host_ns: int) -> None:
        """Set the last row after rows that continue the preceding ones."""
        self.last, self._last_host_ns = np.array([counter, ticks], np.int64), host_ns
        if self._comparisons < len(_COMPARED_AFTER):
            self._measure()

    def sort(self, rows: NDArray[np.int64], values: NDArray[np.uint32], host_ns: int) -> Sorted:
        """Assign the rows of one read to sequences.

        Args:
            rows: counter and ticks, shape (n, 2).
            values: words of each row, shape (n, words).
            host_ns: host time of the read, ns since 1970.
        """
        if self.last is not None and not self._doubtful:
            every = np.concatenate([self.last[None], rows])
            if bool(np.all(self.follows(every[:-1], every[1:]))):
                self.go_on(int(rows[-1, 0]), int(rows[-1, 1]), host_ns)
                self._newest.clear()
                return Sorted([(False, values)])
        stretches: list[tuple[bool, list[NDArray[np.uint32]]]] = [(False, [])]
        dropped = 0
        for row, value in zip(rows, values, strict=True):
            self._newest.append((row, value))
            if self.last is not None and self.follows(self.last, row):
                chain = _Chain([row], [value])
            else:
                chain = self._doubt(row, value)
                begins = self._begins(chain, host_ns)
                if begins is None:
                    if len(self._doubtful) > _PERIOD_ROWS:
                        dropped += len(self._doubtful.pop(0).rows)
                    continue
                if begins:
                    stretches.append((True, []))
                    self._origin, self._comparisons = None, 0
                self._doubtful = [other for other in self._doubtful if other is not chain]
            dropped += sum(len(other.rows) for other in self._doubtful)
            self._doubtful = []
            stretches[-1][1].extend(chain.values)
            self.go_on(int(row[0]), int(row[1]), host_ns)
        return Sorted([(restarted, np.array(kept, np.uint32)) for restarted, kept in stretches if kept], dropped)

    def follows(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> Any:
        """Whether counter and ticks advance together, by one sample or over a short gap; rows of shape (…, 2)."""
        passed, fits = self._advance(before, after)
        return fits & (passed <= _LONG_JUMP_TICKS)

    def _doubt(self, row: Row, value: Words) -> _Chain:
        """Keep a row that does not follow the preceding ones; return the chain that it continues or starts."""
        chain = next((chain for chain in self._doubtful if self.follows(chain.rows[-1], row)), None)
        if chain is None:
            chain = _Chain([], [])
            self._doubtful.append(chain)
        chain.rows.append(row)
        chain.values.append(value)
        return self._with_another_period() or chain

    def _with_another_period(self) -> _Chain | None:
        """Change the sampling period if the newest rows count up by one and are evenly spaced by another period.

        Returns:
            The doubtful rows among the newest rows; None if the period is unchanged.
        """
        if len(self._newest) < _PERIOD_ROWS:
            return None
        rows = np.array([row for row, _ in self._newest])
        steps = _ticks(rows[:-1], rows[1:])
        period = float(np.mean(steps))
        if np.any(_counts(rows[:-1], rows[1:]) != 1) or np.ptp(steps) > 2 or not 0 < period <= _LONG_JUMP_TICKS:
            return None
        if abs(period - self.period_ticks) * len(steps) < _MIN_DRIFT_TICKS:
            return None
        self.period_ticks, self._uncertainty = period, 1.0 / float(np.sum(steps))
        self._origin, self._comparisons = None, 0
        waiting = {id(row) for chain in self._doubtful for row in chain.rows}
        new = _Chain([], [])
        for row, value in self._newest:
            if id(row) in waiting:
                new.rows.append(row)
                new.values.append(value)
        taken = {id(row) for row in new.rows}
        self._doubtful = [left for chain in self._doubtful if (left := chain.without(taken)).rows]
        self._doubtful.append(new)
        return new

    def _begins(self, chain: _Chain, host_ns: int) -> bool | None:
        """Whether the sensor restarted at the beginning of a chain; None while the chain is too short to decide."""
        first, last = chain.rows[0], self.last
        if last is None:
            return False if len(chain.rows) >= 2 else None
        if self.follows(last, first):  # with the period that has just been found
            return False
        resumes = self._resumes(last, first, host_ns)
        if len(chain.rows) < (2 if resumes else _RESTART_ROWS):
            return None
        return not (resumes or self._was_held_up(last, first) or _counts_on(last, first, self.period_ticks))

    def _measure(self) -> None:
        """Compare the sampling period with the mean period of the rows since the first."""
        assert self.last is not None
        counter, ticks = self.last.tolist()
        if self._origin is None:
            self._origin = counter, ticks
            return
        counts = (counter - self._origin[0]) % optoncdt.COUNTER_WRAP
        passed = (ticks - self._origin[1]) % optoncdt.TIMESTAMP_WRAP
        if passed > optoncdt.COUNTER_WRAP // 2 * self.period_ticks:  # a gap in which the counter may have wrapped
            self._origin = counter, ticks
            return
        if counts < _COMPARED_AFTER[self._comparisons]:
            return
        self._comparisons += 1
        period = passed / counts
        if self._uncertainty or abs(period - self.period_ticks) > 2.0 / counts + _CLOCK_DEVIATION * self.period_ticks:
            self.period_ticks, self._uncertainty = period, 1.0 / passed

    def _resumes(self, before: Row, after: Row, host_ns: int) -> bool:
        """Whether counter and ticks advance together over a gap that is possible by the host's time."""
        passed, fits = self._advance(before, after)
        room_ns = max(0, host_ns - self._last_host_ns) + _MAX_LATE_NS
        return bool(fits) and int(passed) * 10_000 <= room_ns

    def _was_held_up(self, before: Row, after: Row) -> bool:
        """Whether counter and ticks advance together over a gap that a restart does not explain.

        The host's time is not used. A stalled host reads full buffers late, and immediately afterwards the bytes that
        arrived later. By its time the gap between them is impossible. Counter and timestamp advance together over this
        gap, which those of a restart do not.
        """
        passed, fits = self._advance(before, after)
        return bool(fits) and int(passed) <= _MAX_STALL_TICKS

    def _advance(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> tuple[Any, Any]:
        """Return the elapsed ticks, and whether the counter agrees, modulo both wraps; rows of shape (…, 2)."""
        passed = _ticks(before, after)
        # the counter alone may have wrapped several times in a long gap
        expected = _counts(before, after) * self.period_ticks
        around = optoncdt.COUNTER_WRAP * self.period_ticks
        off = np.abs((passed - expected + around / 2) % around - around / 2)
        ahead = (passed > 0.5 * self.period_ticks) & (passed < optoncdt.TIMESTAMP_WRAP // 2)
        return passed, ahead & (off <= (1e-3 + self._uncertainty) * passed + 2)


def _counts(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of samples from one row to another; rows of shape (…, 2)."""
    return (after[..., 0] - before[..., 0]) % optoncdt.COUNTER_WRAP


def _ticks(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ticks from one row to another; rows of shape (…, 2)."""
    return (after[..., 1] - before[..., 1]) % optoncdt.TIMESTAMP_WRAP


def _counts_on(before: Row, after: Row, period: float) -> bool:
    """Whether a row comes a few samples after another by its counter, at about the expected time."""
    samples = int(_counts(before, after))
    return 0 < samples <= _PERIOD_ROWS and 0.5 < int(_ticks(before, after)) / (samples * period) < 2.0
