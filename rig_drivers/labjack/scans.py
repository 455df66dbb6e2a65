"""Samples of consecutive answers cut into scans.

An answer may end within a scan. The place of a sample in its scan is then known from the answers before it. Without
them (the log begins, answers are missing) it is derived from the number of samples that still wait, since the device's
buffer ends with a whole scan. Answers are dropped as long as this number contradicts answers that have whole scans.

If a device has been seen to keep this, and the number that waits contradicts the place of the samples, another program
may have read a part of a scan. A device that stores a scan while it is read disagrees once; missing samples disagree in
the same way in all further answers. The answers are held until this is decided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig_drivers.labjack.wire import FIRST_STREAM_ID, NO_VALUE, StreamRead

_DECIDED = 20
"""Answers in a row that show how a device fills its buffer: by whole scans, or a sample at a time."""
_MOST_HELD = 3

Counts = NDArray[np.uint16]
_NONE: Counts = np.empty(0, np.uint16)


def have_no_value(scans: Counts) -> NDArray[np.bool_]:
    """Return for each scan whether it has no value at any input, like the scan that stands for skipped ones."""
    return np.all(scans == NO_VALUE, axis=1)


class CutAnswer(NamedTuple):
    """An answer to a stream read.

    Attributes:
        read: its content.
        host_ns: host time of its arrival, ns.
        scans: scans that it completes, shape (n, inputs); None if the place of its samples is unknown.
        is_after_missing: whether answers are missing before it.
        dropped: number of samples before it that were dropped because their inputs are not certain.
    """

    read: StreamRead
    host_ns: int
    scans: Counts | None = None
    is_after_missing: bool = False
    dropped: int = 0


class ScanCutter:
    """Cuts the samples of consecutive answers; see the module.

    Args:
        inputs: number of samples of a scan.
    """

    def __init__(self, inputs: int) -> None:
        self._inputs = inputs
        self._number: int | None = None  # transaction number of the newest stream read
        self._begins = False  # whether the next answer is the first one of a new stream
        self._rest: Counts | None = None  # samples of a scan that is not complete; None if their place is unknown
        self._missing = False  # whether answers are missing before the next one with scans
        self._undecided = 0  # answers of whole scans in a row whose place is contradicted
        self._agreed = 0  # answers in a row whose number of waiting samples agrees with the place of their samples
        self._surplus = 0  # samples that the held answers have beyond whole scans
        self._held: list[CutAnswer] = []

    def begin(self) -> None:
        """Begin with a new stream, whose first sample belongs to the first input."""
        self._begins, self._rest, self._missing, self._held = True, _NONE, False, []

    def refused(self, number: int) -> None:
        """Take that the device has refused a read: its scans come with the next answer."""
        self._number = number

    @property
    def begins_without_value(self) -> bool:
        """Whether the samples of a scan that is not complete are all NO_VALUE."""
        return self._rest is not None and len(self._rest) > 0 and bool(np.all(self._rest == NO_VALUE))

    def feed(self, number: int, read: StreamRead, host_ns: int) -> list[CutAnswer]:
        """Take an answer with its transaction number; return the answers whose samples are cut now."""
        before, self._number = self._number, number
        ready, dropped = [*self._held, CutAnswer(read, host_ns)], 0
        if not self._begins and before is not None and (number - before) % FIRST_STREAM_ID != 1:
            self._lose()
        elif self._is_doubted(ready):
            if len(ready) <= _MOST_HELD:
                self._held = ready
                return []
            dropped = sum(len(each.read.samples) for each in ready[:-1])
            ready = ready[-1:]
            self._lose()
        self._begins, self._held = False, []
        return [self._cut(each, dropped) for each in ready]

    def _lose(self) -> None:
        self._rest, self._undecided, self._missing = None, 0, True

    def _is_doubted(self, answers: list[CutAnswer]) -> bool:
        """Whether the newest of these answers must be held, with those that are."""
        if self._rest is None or self._begins:
            return False
        samples = sum(len(each.read.samples) for each in answers)
        surplus = (len(self._rest) + samples + answers[-1].read.waiting) % self._inputs
        if surplus and (surplus == self._surplus if len(answers) > 1 else self._agreed >= _DECIDED):
            self._surplus = surplus
            return True
        self._agreed = 0 if surplus else self._agreed + 1
        return False

    def _cut(self, answer: CutAnswer, dropped: int) -> CutAnswer:
        samples = answer.read.samples
        if self._rest is None:
            before = (len(samples) + answer.read.waiting) % self._inputs  # of the scan that began in an earlier answer
            if before and len(samples) % self._inputs == 0:
                self._undecided += 1
                before = len(samples) + 1 if self._undecided <= _DECIDED else 0
            if before > len(samples):
                return answer._replace(dropped=dropped)
            self._rest, samples = _NONE, samples[before:]
        joined = np.concatenate([self._rest, samples])
        whole = len(joined) // self._inputs * self._inputs
        self._rest, missing, self._missing = joined[whole:], self._missing, False
        scans = joined[:whole].reshape(-1, self._inputs)
        return answer._replace(scans=scans, is_after_missing=missing, dropped=dropped)
