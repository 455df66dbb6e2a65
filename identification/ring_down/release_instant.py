"""First estimate of the release in a record that also contains rest, a pull and a hold."""

from __future__ import annotations

import numpy as np

from identification.errors import NotIdentifiable
from identification.samples import Averages
from identification.typed_scipy import maximum_filter1d, median_filter, minimum_filter1d

_WINDOW_S, _MARGIN_S = 0.1, 0.017
_MAX_HOLD_CHANGE, _SMOOTH = 0.1, 5  # of a hold's level, beyond which it has ended; block means of a median
_MAX_STILL_SPREAD = 0.03  # of the largest displacement
_MIN_CHI2 = 60.0  # χ² of the largest stretch's means: noise alone explains 2 ln of their number, about 20


def release_instant(channels: list[Averages]) -> float:
    """Estimate a time at or after the release, s. identification.ring_down.begin corrects it by the model.

    The end of the hold is the last stretch of 100 ms in which every channel is constant (within 3 % of the displacement
    and noise) and far from rest. A free oscillation above 2 Hz changes by a fifth of its amplitude around its peak.

    Args:
        channels: one or two channels, block averages on one clock.
    Returns:
        The time, or −inf (the start of the record) without a hold or if noise could look like one.
    Raises:
        NotIdentifiable: the record contains no motion.
    """
    moves = [c.value - float(np.median(c.value[3 * len(c.value) // 4 :])) for c in channels]
    noise = [c.noise / np.sqrt(float(np.median(c.count))) for c in channels]
    _refuse_quiet(channels, moves)
    largest = max(float(np.max(np.abs(m))) for m in moves)
    ends: list[tuple[np.ndarray, np.ndarray, np.ndarray, float]] = []
    for channel, move, own in zip(channels, moves, noise, strict=True):
        count = max(3, round(_WINDOW_S / float(np.median(np.diff(channel.time_s)))))
        # reflection at the ends has no effect: a hold is never the last window of a ring-down
        spread = maximum_filter1d(move, count) - minimum_filter1d(move, count)
        middle = np.abs(median_filter(move, min(count, 25)))
        ends.append((channel.time_s, middle, spread, own))
    time = ends[int(np.argmax([float(np.max(e[1])) for e in ends]))][0]
    displaced = np.max([np.interp(time, t, middle) for t, middle, _, _ in ends], axis=0)
    spread = np.max([np.interp(time, t, s) for t, _, s, _ in ends], axis=0)
    # the spread of the stillest windows contains low-frequency noise; a permanent motion has a larger spread
    still = float(np.percentile(spread, 10))
    restless = max(6 * max(noise), 1.3 * still if still < _MAX_STILL_SPREAD * largest else 0.0)
    level = 0.03 * displaced + restless
    if 6 * max(noise) > 0.1 * largest:
        return -np.inf
    held = np.flatnonzero((spread < level) & (displaced > 0.5 * largest))
    if not len(held):
        return -np.inf
    usual = float(time[held[-1]] + _WINDOW_S / 2 + _MARGIN_S)
    most = int(np.argmax([float(np.max(e[1])) for e in ends]))
    left = _left_hold(channels[most].time_s, moves[most], float(time[held[-1]]), restless)
    return left + _MARGIN_S if left > usual + _WINDOW_S else usual


def _left_hold(time: np.ndarray, move: np.ndarray, held_s: float, restless: float) -> float:
    """Time at which the displacement leaves the level of the last window of the hold, s; −inf if it does not.

    Low-frequency noise enlarges the spread of single windows of a hold, but does not shift it by a tenth of its level.
    """
    smooth = median_filter(move, _SMOOTH)
    near = np.abs(time - held_s) <= _WINDOW_S / 2
    level = float(np.median(move[near]))
    gone = (time > held_s) & (np.abs(smooth - level) > max(_MAX_HOLD_CHANGE * abs(level), restless))
    return float(time[np.argmax(gone)]) if gone.any() else -np.inf


def _refuse_quiet(channels: list[Averages], moves: list[np.ndarray]) -> None:
    """Raise NotIdentifiable if no stretch has more energy than noise.

    The energy is the only criterion for a signal that falls below the noise within a cycle.
    """
    largest = 0.0
    for channel, move in zip(channels, moves, strict=True):
        squares = (move * channel.weight) ** 2 - 1
        count = max(8, round(0.2 / max(float(np.median(np.diff(channel.time_s))), 1e-9)))
        sums = np.add.reduceat(squares, np.arange(0, len(squares), count))
        largest = max(largest, float(np.max(sums)))
    if largest < _MIN_CHI2:
        top = max(float(np.max(np.abs(m))) for m in moves)
        raise NotIdentifiable(
            f"nothing rings down: the largest displacement is {top:.2g} m at a noise of {channels[0].noise:.2g} m; "
            "pull farther, or check which sensor was recorded"
        )
