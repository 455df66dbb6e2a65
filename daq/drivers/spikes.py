"""Detection of single false readings (spikes) of a laser.

A sensor's line has no checksum, so a flipped bit in a distance word gives a valid distance. Such a reading is
recognised because the signal jumps for one sample and returns at once. The rule uses codes, which are integers, and
gives the same result on every machine and for every split of the bytes into reads.

For sample i let D(i) = |x(i−2) − 4x(i−1) + 6x(i) − 4x(i+1) + x(i+2)|, the fourth difference. It vanishes for a smooth
motion, has a standard deviation of 8.4 σ for white noise of σ, and is 6 s for a single jump of s. Sample i is a spike
if all four conditions hold:

1. D(i) is more than 14 times its own running median (at least `_MIN_MEDIAN_CODES`): a jump of about 13 σ. The median
   follows D in groups of samples, by the share of those above it.
2. D is at most a third of D(i) at the six places before and after that do not depend on sample i. This excludes bursts
   and onsets.
3. With x(i) replaced by the interpolation from its four neighbours, D is at most a third of D(i) at the places around
   it. One changed sample then explains everything, which excludes the beginning of a ringing.
4. Neither the extrapolation of the samples before x(i) nor that of the samples after it reaches x(i). This excludes
   steps and corners, as from a knock. The extrapolation is linear, or cubic if the signal bends by more than half the
   jump.

The verdict on a sample is written `LOOK_AHEAD` samples later, so no sample is delayed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.channels import SUSPECT_BEFORE, SUSPECT_PLACES

LOOK_AHEAD = SUSPECT_PLACES
"""Number of samples between a sample and its verdict."""

_MIN_MEDIAN_RATIO = 14
_MIN_PEAK_RATIO = 3
_MIN_CONSECUTIVE = 2 * LOOK_AHEAD + 1  # consecutive readings that a verdict needs
_MIN_DIFFERENCE = 5  # consecutive readings of a fourth difference
_MIN_MEDIAN_CODES = 4  # a smaller median results from rounding alone
_FRACTION_BITS = 8  # fractional bits of the running median
_GROUP, _FIRST_GROUP = 32, 8  # samples after which the median adapts: usually, and at the beginning
_FAST_SAMPLES = 96  # samples at the beginning
_COUNTER_WRAP, _CODE_MAX = 2**18, 65520  # codes above _CODE_MAX are not readings of most sensors


class SpikeWatch:
    """Detector of spikes in the codes of one laser.

    Args:
        most: largest code that is a reading.

    Attributes:
        found: whether the last `feed` found a spike.
    """

    def __init__(self, most: int = _CODE_MAX) -> None:
        self._most = most
        # far above any median: no sample is a spike until the running median has come down to that of the signal
        self._median = most << _FRACTION_BITS
        self._seen = self._above = 0  # fourth differences so far, and those of the present group above the median
        self._before = np.zeros(_MIN_CONSECUTIVE, np.int64)
        self._consecutive = 0  # readings up to the newest sample
        self._counter = 0  # of the newest sample
        self.found: bool = False

    def feed(self, code: NDArray[np.integer], counter: NDArray[np.integer]) -> NDArray[np.uint32]:
        """Return the verdicts that become available with these samples.

        Args:
            code, counter: words of the next samples as received, shape (n,).

        Returns:
            `SUSPECT_BEFORE` for every sample `LOOK_AHEAD` places after a spike, otherwise 0; shape (n,).
        """
        flags, self.found = np.zeros(len(code), np.uint32), False
        if not len(code):
            return flags
        codes = np.concatenate([self._before, code.astype(np.int64)])
        consecutive = self._consecutive_up_to(codes[_MIN_CONSECUTIVE:], counter.astype(np.int64))
        differences = np.abs(np.diff(codes, 4)) << _FRACTION_BITS
        newest, judged = differences[_MIN_CONSECUTIVE - 4 :], differences[_MIN_CONSECUTIVE - LOOK_AHEAD - 2 :]
        known, first = np.flatnonzero(consecutive >= _MIN_DIFFERENCE), 0
        while first < len(known):
            group = _FIRST_GROUP if self._seen < _FAST_SAMPLES else _GROUP
            now = known[first : first + group - self._seen % group]
            for k in now[judged[now] > _MIN_MEDIAN_RATIO * self._median].tolist():
                if consecutive[k] >= _MIN_CONSECUTIVE and _is_single(codes[k + 1 : k + 1 + _MIN_CONSECUTIVE].tolist()):
                    flags[k], self.found = SUSPECT_BEFORE, True
            self._follow(newest[now], group)
            first += len(now)
        self._before = codes[len(code) :]
        return flags

    def _consecutive_up_to(self, code: NDArray[np.int64], counter: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of consecutive readings up to each sample; 0 for a sample that is not a reading."""
        place = np.arange(1, len(code) + 1)
        before = np.concatenate([[self._counter], counter[:-1]])
        begins = np.where((counter - before) % _COUNTER_WRAP == 1, -self._consecutive, place - 1)
        begins[code > self._most] = place[code > self._most]
        found: NDArray[np.int64] = place - np.maximum.accumulate(begins)
        self._consecutive, self._counter = int(found[-1]), int(counter[-1])
        return found

    def _follow(self, differences: NDArray[np.int64], group: int) -> None:
        """Adapt the running median after each group by the share of the fourth differences above it."""
        self._above += int(np.count_nonzero(differences > self._median))
        self._seen += len(differences)
        if self._seen % group == 0:
            more = 2 * self._above - group
            self._median = max(
                self._median * (2 * group + more) // (2 * group - more), _MIN_MEDIAN_CODES << _FRACTION_BITS
            )
            self._above = 0


def _is_single(code: list[int]) -> bool:
    """Evaluate conditions 2 to 4 of the rule for the middle one of the codes, whose fourth difference is large."""
    i = LOOK_AHEAD
    own = _difference(code, i)
    for away in range(3, LOOK_AHEAD - 1):  # the places whose fourth difference does not contain sample i
        if _MIN_PEAK_RATIO * max(_difference(code, i - away), _difference(code, i + away)) > own:
            return False
    half = own // 12  # of the jump
    if min(_jump_from(code[:i], code[i], half), _jump_from(code[:i:-1], code[i], half)) < half:
        return False
    code[i] = (4 * (code[i - 1] + code[i + 1]) - code[i - 2] - code[i + 2]) // 6
    return _MIN_PEAK_RATIO * max(_difference(code, i + near) for near in (-2, -1, 1, 2)) <= own


def _difference(code: list[int], i: int) -> int:
    return abs(code[i - 2] - 4 * code[i - 1] + 6 * code[i] - 4 * code[i + 1] + code[i + 2])


def _jump_from(side: list[int], code: int, half: int) -> int:
    """Return the distance of a code from the extrapolation of those on one side of it, the nearest last."""
    four, three, two, one = side[-4:]
    if max(abs(one - 2 * two + three), abs(two - 2 * three + four)) < half:
        return abs(code - 2 * one + two)
    return abs(code - 4 * one + 6 * two - 4 * three + four)
