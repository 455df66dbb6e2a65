# pyright: strict
"""Which blocks of a laser's stream continue one another, and how many clock ticks lie between two.

The line has no checksum. Counter and timestamp must advance together, and by no more than the host's time allows; a
row that disagrees with what came before it is damage, unless the rows after it agree with it: then the sensor has
restarted, or this is the first of all, or a long gap is over. Until they have come it waits.

How far the timestamp goes from one sample to the next, the beat, is the rig file's until the stream shows another. A
sensor that measures at another rate than its file is read all the same: its samples, their times and its losses are
right, and the difference is told.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.drivers.optoncdt import wire as optoncdt

Row = NDArray[np.int64]  # counter and ticks, as they were on the line
Words = NDArray[np.uint32]

_AGREE = 3  # rows in a row that make a new beginning …
_STEADY = 8  # … and those that make a new beat
_OTHER_TICKS = 4  # by which a row is early or late, then, of the sensor's rounding alone it is not
_LONG_JUMP_TICKS = 100_000  # 1 s
_HELD_UP_TICKS = 3_000_000  # 30 s; a restart looks like such a gap in two of a thousand cases at most
_LATE_NS = 2_000_000_000  # by how much longer than on the host a gap may last on the sensor: bytes wait in buffers
_LOOKS = (64, 4096)  # samples after which the beat is compared with what was taken for it
_CLOCK_SHARE = 2e-4  # by which a beat may be off because the sensor's clock is


@dataclass(eq=False)
class _Chain:
    """Rows that continue one another, and their words."""

    rows: list[Row]
    values: list[Words]

    def without(self, taken: set[int]) -> _Chain:
        left = [(row, value) for row, value in zip(self.rows, self.values, strict=True) if id(row) not in taken]
        return _Chain([row for row, _ in left], [value for _, value in left])


@dataclass(frozen=True)
class Sorted:
    """What a read's rows come to.

    Attributes:
        stretches: rows that continue one another, each with whether the sensor began anew with it.
        dropped: rows that fit nowhere.
    """

    stretches: list[tuple[bool, Words]]
    dropped: int = 0


class RowOrder:
    """The order of one laser's rows.

    Args:
        nominal_ticks: between two samples, by the rig file.

    Attributes:
        beat: ticks between two samples.
        last: of the rows that fitted; None before the first.
    """

    def __init__(self, nominal_ticks: float) -> None:
        self.beat = nominal_ticks
        self.last: Row | None = None
        self._last_host_ns = 0
        self._doubtful: list[_Chain] = []  # rows that fit nowhere yet
        self._newest: deque[tuple[Row, Words]] = deque(maxlen=_STEADY)  # looked at one by one, whatever became of them
        self._unsure = 0.0  # relative uncertainty of a beat just found
        self._origin: tuple[int, int] | None = None  # counter and ticks from which the beat is measured
        self._looks = 0

    @property
    def knows_beat(self) -> bool:
        """Whether the beat has been compared with the stream's."""
        return self._looks > 0

    @property
    def in_doubt(self) -> bool:
        """Whether rows wait for those that confirm them, or none has come yet."""
        return self.last is None or bool(self._doubtful)

    def go_on(self, counter: int, ticks: int, host_ns: int) -> None:
        """Take the last of some rows that are known to continue what came before."""
        self.last, self._last_host_ns = np.array([counter, ticks], np.int64), host_ns
        if self._looks < len(_LOOKS):
            self._measure()

    def sort(self, rows: NDArray[np.int64], values: NDArray[np.uint32], host_ns: int) -> Sorted:
        """Put rows where they belong.

        Args:
            rows: counter and ticks, (n, 2).
            values: the words of each, (n, words).
            host_ns: when they came.
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
                    if len(self._doubtful) > _STEADY:
                        dropped += len(self._doubtful.pop(0).rows)
                    continue
                if begins:
                    stretches.append((True, []))
                    self._origin, self._looks = None, 0
                self._doubtful = [other for other in self._doubtful if other is not chain]
            dropped += sum(len(other.rows) for other in self._doubtful)
            self._doubtful = []
            stretches[-1][1].extend(chain.values)
            self.go_on(int(row[0]), int(row[1]), host_ns)
        return Sorted([(anew, np.array(kept, np.uint32)) for anew, kept in stretches if kept], dropped)

    def follows(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> Any:
        """Whether counter and ticks advance together, by one sample or over a short gap; rows (…, 2)."""
        passed, fits = self._advance(before, after)
        return fits & (passed <= _LONG_JUMP_TICKS)

    def _doubt(self, row: Row, value: Words) -> _Chain:
        """Keep a row that does not follow what came before; returns the rows it goes on from, and itself."""
        chain = next((chain for chain in self._doubtful if self.follows(chain.rows[-1], row)), None)
        if chain is None:
            chain = _Chain([], [])
            self._doubtful.append(chain)
        chain.rows.append(row)
        chain.values.append(value)
        return self._by_another_beat() or chain

    def _by_another_beat(self) -> _Chain | None:
        """The rows in doubt of the newest rows, if these count on by one and are evenly spaced, by another beat."""
        if len(self._newest) < _STEADY:
            return None
        rows = np.array([row for row, _ in self._newest])
        steps = _ticks(rows[:-1], rows[1:])
        beat = float(np.mean(steps))
        if np.any(_counts(rows[:-1], rows[1:]) != 1) or np.ptp(steps) > 2 or not 0 < beat <= _LONG_JUMP_TICKS:
            return None
        if abs(beat - self.beat) * len(steps) < _OTHER_TICKS:
            return None
        self.beat, self._unsure = beat, 1.0 / float(np.sum(steps))
        self._origin, self._looks = None, 0
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
        """Whether the sensor began anew with a chain of rows; None as long as the chain is too short to tell."""
        first, last = chain.rows[0], self.last
        if last is None:
            return False if len(chain.rows) >= 2 else None
        if self.follows(last, first):  # by the beat that has just been found
            return False
        onward = self._resumes(last, first, host_ns)
        if len(chain.rows) < (2 if onward else _AGREE):
            return None
        return not (onward or self._was_held_up(last, first) or _counts_on(last, first, self.beat))

    def _measure(self) -> None:
        """Compare the beat with what the rows since the first have shown."""
        assert self.last is not None
        counter, ticks = self.last.tolist()
        if self._origin is None:
            self._origin, self._looks = (counter, ticks), 0
            return
        counts = (counter - self._origin[0]) % optoncdt.COUNTER_WRAP
        passed = (ticks - self._origin[1]) % optoncdt.TIMESTAMP_WRAP
        if passed > optoncdt.COUNTER_WRAP // 2 * self.beat:  # a gap in which the counter may have wrapped
            self._origin = counter, ticks
            return
        if counts < _LOOKS[self._looks]:
            return
        self._looks += 1
        beat = passed / counts
        if self._unsure or abs(beat - self.beat) > 2.0 / counts + _CLOCK_SHARE * self.beat:
            self.beat, self._unsure = beat, 1.0 / passed

    def _resumes(self, before: Row, after: Row, host_ns: int) -> bool:
        """Whether counter and ticks advance together over a gap that the host's time has room for."""
        passed, fits = self._advance(before, after)
        room_ns = max(0, host_ns - self._last_host_ns) + _LATE_NS
        return bool(fits) and int(passed) * 10_000 <= room_ns

    def _was_held_up(self, before: Row, after: Row) -> bool:
        """Whether counter and ticks advance together over a gap that no restart explains, whatever the host's time.

        A host that was held up reads full buffers late and what came after them at once: its time has no room for the
        gap between them, yet counter and timestamp advance together over it, which those of a restart do not.
        """
        passed, fits = self._advance(before, after)
        return bool(fits) and int(passed) <= _HELD_UP_TICKS

    def _advance(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> tuple[Any, Any]:
        """Ticks passed, and whether the counter agrees, modulo both wraps; rows (…, 2)."""
        passed = _ticks(before, after)
        # the counter alone may have wrapped several times in a long gap
        expected = _counts(before, after) * self.beat
        around = optoncdt.COUNTER_WRAP * self.beat
        off = np.abs((passed - expected + around / 2) % around - around / 2)
        ahead = (passed > 0.5 * self.beat) & (passed < optoncdt.TIMESTAMP_WRAP // 2)
        return passed, ahead & (off <= (1e-3 + self._unsure) * passed + 2)


def _counts(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.int64]:
    """Samples from one row to another; rows (…, 2)."""
    return (after[..., 0] - before[..., 0]) % optoncdt.COUNTER_WRAP


def _ticks(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ticks from one row to another; rows (…, 2)."""
    return (after[..., 1] - before[..., 1]) % optoncdt.TIMESTAMP_WRAP


def _counts_on(before: Row, after: Row, beat: float) -> bool:
    """Whether a row comes a few samples after another by its counter, at about the right time."""
    samples = int(_counts(before, after))
    return 0 < samples <= _STEADY and 0.5 < int(_ticks(before, after)) / (samples * beat) < 2.0
