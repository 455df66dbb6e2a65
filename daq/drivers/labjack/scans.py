"""Samples of a stream cut into scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.drivers.labjack.wire import NO_VALUE

_MAX_UNDECIDED = 20
"""Answers of whole scans in a row after which a device is taken for one that never divides a scan."""

Counts = NDArray[np.uint16]


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

    def begin(self) -> None:
        """Begin with a new stream, whose first sample belongs to the first input."""
        self._rest = np.empty(0, np.uint16)

    def lose(self) -> None:
        """Note that answers are missing before the next one."""
        self._rest, self._undecided = None, 0

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
