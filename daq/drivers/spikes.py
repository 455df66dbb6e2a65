# pyright: reportMissingParameterType=false
"""Lone false readings of a laser: one distance word among many that neither goes before it nor comes after it.

A sensor's line has no checksum, so a flipped bit in a distance word is a distance like any other. What gives it away
is that the signal jumps for one sample and is back at once. The rule looks at codes, whole numbers, and gives the same
on every machine and however the bytes were split into reads.

For sample i let D(i) = |x(i−2) − 4x(i−1) + 6x(i) − 4x(i+1) + x(i+2)|, the fourth difference: what a smooth motion
leaves nothing of, white noise of σ leaves 8.4 σ of, and a lone jump of s leaves 6 s of. It is a spike where

1. D(i) is 14 times its own running median (never taken for less than `_QUIET_CODES`): a jump of some 13 σ;
2. D is at most a third of that at the six places before and after which see nothing of sample i: no burst, no onset;
3. with x(i) put where its four neighbours want it, D is at most a third all around, too: one sample mends it all, so
   there is no ringing that begins;
4. what goes on before x(i) does not lead to it, and what comes behind does not lead back to it: no step and no corner,
   as a knock makes one. It leads by a straight line, or by a cubic where it bends by more than half the jump.

The verdict on a sample comes `LOOK_AHEAD` samples later and is written there: samples never wait for it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from daq.channels import SUSPECT_BEFORE, SUSPECT_PLACES

LOOK_AHEAD = SUSPECT_PLACES
"""By how many samples a verdict stands behind the sample it is about."""

_TIMES_MEDIAN = 14
_TIMES_NEIGHBOURS = 3
_NEEDED = 2 * LOOK_AHEAD + 1  # readings in a row
_QUIET_CODES = 4  # a median below is that of rounding alone
_SCALE = 8  # bits behind the point of the running median
_QUICK_SAMPLES = 96  # after the beginning, while the median is still looked for
_COUNTER_WRAP, _CODE_MAX = 2**18, 65520  # codes above are no readings of most sensors


@njit(cache=True, nogil=True)
def _fourth(code, i):  # pragma: no cover - compiled
    return abs(code[i - 2] - 4 * code[i - 1] + 6 * code[i] - 4 * code[i + 1] + code[i + 2])


@njit(cache=True, nogil=True)
def _alone(code, i):  # pragma: no cover - compiled
    """Conditions 2 to 4 of the rule for a sample whose fourth difference, six times its jump, is large."""
    own = _fourth(code, i)
    for away in range(3, LOOK_AHEAD - 1):
        if _TIMES_NEIGHBOURS * max(_fourth(code, i - away), _fourth(code, i + away)) > own:
            return False
    kept = code[i]
    code[i] = (4 * (code[i - 1] + code[i + 1]) - code[i - 2] - code[i + 2]) // 6
    rough = max(_fourth(code, i - 2), _fourth(code, i - 1), _fourth(code, i + 1), _fourth(code, i + 2))
    code[i] = kept
    half = own // 12
    return _TIMES_NEIGHBOURS * rough <= own and min(_off(code, i, -1, half), _off(code, i, 1, half)) >= half


@njit(cache=True, nogil=True)
def _off(code, i, side, half):  # pragma: no cover - compiled
    """How far a sample lies from where those on one side of it lead to; `half` is half the jump."""
    one, two, three, four = code[i + side], code[i + 2 * side], code[i + 3 * side], code[i + 4 * side]
    if max(abs(one - 2 * two + three), abs(two - 2 * three + four)) < half:
        return abs(code[i] - 2 * one + two)
    return abs(code[i] - 4 * one + 6 * two - 4 * three + four)


@njit(cache=True, nogil=True)
def _watch(new, counter, most, before, state, flags):  # pragma: no cover - compiled
    """Judge new samples; state: running median, samples seen, readings in a row, last counter. True if any is found."""
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
        step = median >> (3 if seen < _QUICK_SAMPLES else 5)
        median += step if _fourth(code, j - 2) << _SCALE > median else -step
        median = max(median, _QUIET_CODES << _SCALE)
        seen += 1
        i = j - LOOK_AHEAD
        if row >= _NEEDED and _fourth(code, i) << _SCALE > _TIMES_MEDIAN * median and _alone(code, i):
            flags[k] = SUSPECT_BEFORE
            found = True
    before[:] = code[len(new) :]
    state[0], state[1], state[2], state[3] = median, seen, row, last
    return found


class SpikeWatch:
    """Watches one laser's codes as they come.

    Args:
        most: largest code that is a reading.

    Attributes:
        found: whether the last `feed` gave a verdict.
    """

    def __init__(self, most: int = _CODE_MAX) -> None:
        self._most = most
        # far above any median, so that nothing is judged until it has come down to the signal's own
        self._state = np.array([most << _SCALE, 0, 0, 0], np.int64)
        self._before = np.zeros(_NEEDED, np.int64)
        self.found = False

    def feed(self, code: NDArray[np.integer], counter: NDArray[np.integer]) -> NDArray[np.uint32]:
        """Verdicts that these samples bring.

        Args:
            code, counter: the next samples' words as they were on the line, shape (n,).

        Returns:
            `SUSPECT_BEFORE` on every sample `LOOK_AHEAD` places behind a spike, otherwise 0; shape (n,).
        """
        flags = np.empty(len(code), np.uint32)
        words, counts = np.ascontiguousarray(code, np.uint32), np.ascontiguousarray(counter, np.uint32)
        self.found = _watch(words, counts, self._most, self._before, self._state, flags)
        return flags


def compile_watch() -> None:
    """Load what is compiled, or compile it, before any byte waits for it."""
    SpikeWatch().feed(np.zeros(2, np.uint32), np.zeros(2, np.uint32))
