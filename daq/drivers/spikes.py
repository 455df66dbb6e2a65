"""Detection of single false readings (spikes) of a laser.

A sensor's line has no checksum, so a flipped bit in a distance word gives a valid distance. Such a reading is
recognised because the signal jumps for one sample and returns at once. The rule uses codes, which are integers, and
gives the same result on every machine and for every split of the bytes into reads.

For sample i let D(i) = |x(i−2) − 4x(i−1) + 6x(i) − 4x(i+1) + x(i+2)|, the fourth difference. It vanishes for a smooth
motion, has a standard deviation of 8.4 σ for white noise of σ, and is 6 s for a single jump of s. Sample i is a spike
if all four conditions hold:

1. D(i) is more than 14 times its own running median (at least `_MIN_MEDIAN_CODES`): a jump of about 13 σ.
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
from numba import njit
from numpy.typing import NDArray

from daq.channels import SUSPECT_BEFORE, SUSPECT_PLACES

LOOK_AHEAD = SUSPECT_PLACES
"""Number of samples between a sample and its verdict."""

_Codes = NDArray[np.int64]

_MIN_MEDIAN_RATIO = 14
_MIN_PEAK_RATIO = 3
_MIN_CONSECUTIVE = 2 * LOOK_AHEAD + 1  # consecutive readings that a verdict needs
_MIN_MEDIAN_CODES = 4  # a smaller median results from rounding alone
_FRACTION_BITS = 8  # fractional bits of the running median
_FAST_SAMPLES = 96  # samples after the beginning during which the median adapts fast
_COUNTER_WRAP, _CODE_MAX = 2**18, 65520  # codes above _CODE_MAX are not readings of most sensors


@njit(cache=True, nogil=True)
def _difference(code: _Codes, i: int) -> int:  # pragma: no cover - compiled
    return abs(code[i - 2] - 4 * code[i - 1] + 6 * code[i] - 4 * code[i + 1] + code[i + 2])


@njit(cache=True, nogil=True)
def _is_single(code: _Codes, i: int) -> bool:  # pragma: no cover - compiled
    """Evaluate conditions 2 to 4 of the rule for a sample whose fourth difference, six times its jump, is large."""
    own = _difference(code, i)
    for away in range(3, LOOK_AHEAD - 1):  # the places whose fourth difference does not contain sample i
        if _MIN_PEAK_RATIO * max(_difference(code, i - away), _difference(code, i + away)) > own:
            return False
    kept = code[i]
    code[i] = (4 * (code[i - 1] + code[i + 1]) - code[i - 2] - code[i + 2]) // 6
    rough = max(
        _difference(code, i - 2),
        _difference(code, i - 1),
        _difference(code, i + 1),
        _difference(code, i + 2),
    )
    code[i] = kept
    half = own // 12
    return _MIN_PEAK_RATIO * rough <= own and min(_jump_from(code, i, -1, half), _jump_from(code, i, 1, half)) >= half


@njit(cache=True, nogil=True)
def _jump_from(code: _Codes, i: int, side: int, half: int) -> int:  # pragma: no cover - compiled
    """Return the distance of sample i from the extrapolation of the samples before (side −1) or after it (1), codes.

    `half` is half the jump, codes.
    """
    one, two, three, four = code[i + side], code[i + 2 * side], code[i + 3 * side], code[i + 4 * side]
    if max(abs(one - 2 * two + three), abs(two - 2 * three + four)) < half:
        return abs(code[i] - 2 * one + two)
    return abs(code[i] - 4 * one + 6 * two - 4 * three + four)


@njit(cache=True, nogil=True)
def _watch(
    new: NDArray[np.uint32],
    counter: NDArray[np.uint32],
    most: int,
    before: _Codes,
    state: _Codes,
    flags: NDArray[np.uint32],
) -> bool:  # pragma: no cover - compiled
    """Fill `flags` for new samples; return whether any is a spike.

    `state`: running median, number of samples, number of consecutive readings, last counter.
    """
    median, seen, row, last = state
    begin, found = len(before), False
    code = np.empty(begin + len(new), np.int64)
    code[:begin] = before
    code[begin:] = new
    for k in range(len(new)):
        j = begin + k
        count = np.int64(counter[k])
        if code[j] > most or (count != last + 1 and (count - last) % _COUNTER_WRAP != 1):
            row = 0
        last = count
        flags[k] = 0
        if code[j] <= most:
            row += 1
        if row < 5:
            continue
        step = median >> (3 if seen < _FAST_SAMPLES else 5)
        median += step if _difference(code, j - 2) << _FRACTION_BITS > median else -step
        median = max(median, _MIN_MEDIAN_CODES << _FRACTION_BITS)
        seen += 1
        i = j - LOOK_AHEAD
        if (
            row >= _MIN_CONSECUTIVE
            and _difference(code, i) << _FRACTION_BITS > _MIN_MEDIAN_RATIO * median
            and _is_single(code, i)
        ):
            flags[k] = SUSPECT_BEFORE
            found = True
    before[:] = code[len(new) :]
    state[0], state[1], state[2], state[3] = median, seen, row, last
    return found


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
        self._state = np.array([most << _FRACTION_BITS, 0, 0, 0], np.int64)
        self._before = np.zeros(_MIN_CONSECUTIVE, np.int64)
        self.found: bool = False

    def feed(self, code: NDArray[np.integer], counter: NDArray[np.integer]) -> NDArray[np.uint32]:
        """Return the verdicts that become available with these samples.

        Args:
            code, counter: words of the next samples as received, shape (n,).

        Returns:
            `SUSPECT_BEFORE` for every sample `LOOK_AHEAD` places after a spike, otherwise 0; shape (n,).
        """
        flags = np.empty(len(code), np.uint32)
        words, counts = np.ascontiguousarray(code, np.uint32), np.ascontiguousarray(counter, np.uint32)
        self.found = _watch(words, counts, self._most, self._before, self._state, flags)
        return flags


def compile_watch() -> None:
    """Load or compile the compiled code before the first byte arrives."""
    SpikeWatch().feed(np.zeros(2, np.uint32), np.zeros(2, np.uint32))
