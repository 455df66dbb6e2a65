"""From a laser's samples in a passage to block averages: rail, dropouts and outliers masked, noise known."""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import numpy as np
from numba import njit

from identification.errors import NotIdentifiable
from identification.lines import Line, sentences, steady_lines
from identification.samples import Averages, block_averages, clipped, white_noise

_FEWEST_BLOCKS = 200
_ENOUGH = 20000  # samples for a median that sets a scale
_OUTLIER = 7.0  # robust standard deviations
_COARSE = 0.7  # rad a sample at top speed, beyond which a sine itself stands off its neighbours' median


def sensor_averages(
    name: str,
    time_s: np.ndarray,
    value_m: np.ndarray,
    span_s: tuple[float, float],
    top_rad_s: float,
    per_turn: float,
) -> tuple[Averages, list[str]]:
    """One sensor's block averages over a span.

    Args:
        name: the sensor's, for messages.
        time_s, value_m: samples, shape (n,), s and m; NaN is left out, and so are railed samples and outliers.
        span_s: first and last instant wanted.
        top_rad_s: fastest speed; sets what a smooth signal can do between samples.
        per_turn: blocks per fastest turn.
    Returns:
        The averages and what a reader should know.
    Raises:
        NotIdentifiable: too few valid samples in the span, or a dead sensor.
    """
    known = (time_s >= span_s[0]) & (time_s <= span_s[1])
    inside = known & np.isfinite(value_m)
    time, value = np.asarray(time_s, float)[inside], np.asarray(value_m, float)[inside]
    if len(time) < _FEWEST_BLOCKS:
        raise NotIdentifiable(
            f"sensor {name} has {len(time)} valid samples with a known phase, {np.count_nonzero(known & ~inside)} are "
            "NaN; a passage needs hundreds"
        )
    if np.ptp(value) == 0.0:
        raise NotIdentifiable(f"sensor {name} is constant, {value[0]:.6g} m throughout; is it connected?")
    warnings = []
    rail = clipped(value)
    if rail.any():
        warnings.append(f"{np.count_nonzero(rail)} samples at the rail of sensor {name} left out")
        time, value = time[~rail], value[~rail]
    value, lines = _without_lines(time, value)
    warnings += [f"sensor {name}: {said}" for said in sentences([(name, lines)])]
    every = max(1, len(time) // _ENOUGH)
    step = float(np.median(np.diff(time)[::every]))
    if top_rad_s * step < _COARSE:
        value = value.copy()
        outliers = _without_outliers(value, float(np.median(value[::every])), 2 * (top_rad_s * step) ** 2, _OUTLIER)
        if outliers > 3 + 1e-4 * len(value):
            warnings.append(f"{outliers} outliers of sensor {name} left out")
    else:
        warnings.append(
            f"sensor {name} gives {2 * np.pi / (top_rad_s * step):.1f} samples a turn at top speed, too few to tell "
            "outliers from motion; sample faster"
        )
    noise = white_noise(value)
    if noise == 0.0:
        raise NotIdentifiable(f"sensor {name} shows no noise at all: it is constant but for a few samples")
    averages = block_averages(time, value, 2 * np.pi / top_rad_s / per_turn, noise)
    if len(averages.time_s) < _FEWEST_BLOCKS:
        raise NotIdentifiable(f"sensor {name} gives {len(averages.time_s)} block averages; record longer")
    return averages, warnings


def _without_lines(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, list[Line]]:
    """Values less their steady lines, and these. A passage sweeps over its frequencies and is steady at none."""
    lines = steady_lines(time, value, np.ones(len(time), bool))
    for line in lines:
        value = value - line.at(time)
    return value, lines


@njit(cache=True, nogil=True, error_model="numpy")
def _median5(a, b, c, d, e):
    """The middle one of five."""
    a, b = min(a, b), max(a, b)
    c, d = min(c, d), max(c, d)
    # the smallest of four and the largest of four are not the middle
    low, high = max(a, c), min(b, d)
    low, high = min(low, high), max(low, high)
    return max(low, min(high, e))


@njit(cache=True, nogil=True, error_model="numpy")
def _without_outliers(value, middle, bend, factor):
    """Set to NaN what stands off its four neighbours' median; returns how many.

    A smooth signal stands off by at most bend times its own size, where it turns round.
    """
    n = len(value)
    centre = np.empty(n)
    off = np.empty(n)
    for i in range(n):
        k = min(max(i, 2), n - 3)
        centre[i] = _median5(value[k - 2], value[k - 1], value[k], value[k + 1], value[k + 2])
        off[i] = max(0.0, abs(value[i] - centre[i]) - bend * abs(centre[i] - middle))
    # of white noise against the median of five: two thirds of the time it is not the median itself
    every = max(1, n // _ENOUGH)
    moved = off[::every]
    moved = moved[moved > 0]
    limit = factor * np.median(moved) / 0.6745 if len(moved) else np.inf
    count = 0
    for i in range(2, n - 2):
        if off[i] > limit:
            value[i] = np.nan
            count += 1
    return count
