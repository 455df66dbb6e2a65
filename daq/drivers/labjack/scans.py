"""Samples of a stream cut into scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.drivers.labjack.wire import NO_VALUE

_MAX_UNDECIDED = 20
"""Answers of whole scans in a row after which a device is taken for one that never divides a scan."""

_TRUSTED = 20
"""Answers in a row whose numbers agree, after which a number that disagrees is a sign of samples that are missing."""
_MAX_DOUBTED = 3
"""Answers in a row that are held because their numbers disagree; the next one decides."""

Counts = NDArray[np.uint16]


def have_no_value(scans: Counts) -> NDArray[np.bool_]:
    """Return for each scan whether it has no value at any input, like the scan that stands for skipped ones."""
    return np.all(scans == NO_VALUE, axis=1)


class ScanCutter:
    """Cuts the samples of consecutive answers into scans.

    An answer may end within a scan. The place of a sample in its scan is then known from the answers before it. Without
    them (the log begins, answers are missing) it is derived from the number of samples that still wait, since the
    device's buffer ends with a whole scan. Answers are dropped as long as this number contradicts answers that have
    whole scans.

    Args:
        inputs: number of samples of a scan.
    """

    def __init__(self, inputs: int) -> None:
        self._inputs = inputs
        self._rest: Counts | None = None  # samples of a scan that is not complete; None if their place is unknown
        self._undecided = 0
        self._agreed = 0  # answers in a row whose number of waiting samples agrees with the place of their samples
        self._surplus = 0  # samples that the doubted answers have beyond whole scans
        self._doubted: list[int] = []  # numbers of samples of the answers that are held

    def begin(self) -> None:
        """Begin with a new stream, whose first sample belongs to the first input."""
        self._rest, self._doubted = np.empty(0, np.uint16), []

    def lose(self) -> None:
        """Note that answers are missing before the next one, or that the place of its samples is wrong."""
        self._rest, self._undecided, self._doubted = None, 0, []

    def doubts(self, samples: int, waiting: int) -> bool:
        """Return whether the next answer must be held, since samples before it may be missing.

        The buffer ends with a whole scan. If a device has been seen to keep this, and the number that waits contradicts
        the place of the samples, another program may have read a part of a scan. A device that stores a scan while it
        is read disagrees once; missing samples disagree in the same way in all further answers.

        Args:
            samples: number of samples of the answer.
            waiting: number of samples that still wait in the device.
        """
        if self._rest is None:
            return False
        surplus = (len(self._rest) + sum(self._doubted) + samples + waiting) % self._inputs
        is_new = surplus > 0 and not self._doubted and self._agreed >= _TRUSTED
        if is_new or (self._doubted and surplus == self._surplus):
            self._surplus = surplus
            self._doubted.append(samples)
            return True
        self._agreed, self._doubted = 0 if surplus else self._agreed + 1, []
        return False

    @property
    def is_contradicted(self) -> bool:
        """Whether so many answers were doubted that their places are wrong."""
        return len(self._doubted) > _MAX_DOUBTED

    @property
    def begins_without_value(self) -> bool:
        """Whether the samples of a scan that is not complete are all NO_VALUE."""
        return self._rest is not None and len(self._rest) > 0 and bool(np.all(self._rest == NO_VALUE))

    def cut(self, samples: Counts, waiting: int) -> Counts | None:
        """Return the scans that are complete with these samples, shape (n, inputs); None if their place is unknown.

        Args:
            samples: samples of one answer, shape (m,).
            waiting: number of samples that still wait in the device.
        """
        if self._rest is None:
            before = (len(samples) + waiting) % self._inputs  # of the scan that began in an earlier answer
            if before > len(samples):
                return None
            if before and len(samples) % self._inputs == 0:
                self._undecided += 1
                if self._undecided <= _MAX_UNDECIDED:
                    return None
                before = 0
            self._rest, samples = np.empty(0, np.uint16), samples[before:]
        joined = np.concatenate([self._rest, samples])
        whole = len(joined) // self._inputs
        self._rest = joined[whole * self._inputs :]
        return joined[: whole * self._inputs].reshape(whole, self._inputs)
