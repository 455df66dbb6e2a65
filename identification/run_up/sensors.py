"""Preparation of a laser's samples in a passage: masks for rail, dropouts and outliers, noise, block averages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from identification.errors import NotIdentifiable
from identification.lines import SpectralLine, sentences, steady_lines
from identification.samples import Averages, block_averages, clipped, white_noise
from rig_basics.texts import number_of

_MIN_BLOCKS = 200
_SCALE_SAMPLES = 20000  # samples for the median of a scale
_OUTLIER_STD = 7.0  # robust standard deviations
_MAX_STEP_RAD = 0.7  # rotation per sample at top speed; above it, a sine differs from the median of its neighbours


def sensor_averages(
    name: str,
    time_s: np.ndarray,
    value_m: np.ndarray,
    span_s: tuple[float, float],
    top_rad_s: float,
    per_turn: float,
) -> tuple[Averages, list[str]]:
    """Average one sensor's samples over blocks within a span.

    Args:
        name: name of the sensor, for messages.
        time_s, value_m: samples, shape (n,), s and m. NaN, samples at the rail and outliers are left out.
        span_s: first and last instant, s.
        top_rad_s: fastest speed, rad/s, which limits the change of a smooth signal between samples.
        per_turn: blocks per turn at the fastest speed.
    Returns:
        Averages and warnings.
    Raises:
        NotIdentifiable: the span contains too few valid samples, or the sensor is dead.
    """
    known = (time_s >= span_s[0]) & (time_s <= span_s[1])
    inside = known & np.isfinite(value_m)
    time, value = np.asarray(time_s, float)[inside], np.asarray(value_m, float)[inside]
    if len(time) < _MIN_BLOCKS:
        raise NotIdentifiable(
            f"sensor {name} has {number_of(len(time), 'valid sample')} with a known phase, "
            f"{np.count_nonzero(known & ~inside)} are "
            "NaN; a passage needs hundreds"
        )
    if np.ptp(value) == 0.0:
        raise NotIdentifiable(f"sensor {name} is constant, {value[0]:.6g} m throughout; is it connected?")
    warnings: list[str] = []
    rail = clipped(value)
    if rail.any():
        warnings.append(f"{number_of(np.count_nonzero(rail), 'sample')} at the rail of sensor {name} left out")
        time, value = time[~rail], value[~rail]
    value, lines = _without_lines(time, value)
    warnings += [f"sensor {name}: {text}" for text in sentences([(name, lines)])]
    every = max(1, len(time) // _SCALE_SAMPLES)
    step = float(np.median(np.diff(time)[::every]))
    if top_rad_s * step < _MAX_STEP_RAD:
        value = value.copy()
        outliers = _without_outliers(value, float(np.median(value[::every])), 2 * (top_rad_s * step) ** 2, _OUTLIER_STD)
        if outliers > 3 + 1e-4 * len(value):
            warnings.append(f"{number_of(outliers, 'outlier')} of sensor {name} left out")
    else:
        warnings.append(
            f"sensor {name} gives {2 * np.pi / (top_rad_s * step):.1f} samples a turn at top speed, too few to "
            "distinguish outliers from motion; sample faster"
        )
    noise = white_noise(value)
    if noise == 0.0:
        raise NotIdentifiable(f"sensor {name} shows no noise: it is constant except for a few samples")
    averages = block_averages(time, value, 2 * np.pi / top_rad_s / per_turn, noise)
    if len(averages.time_s) < _MIN_BLOCKS:
        raise NotIdentifiable(f"sensor {name} gives {number_of(len(averages.time_s), 'block average')}; record longer")
    return averages, warnings


def _without_lines(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, list[SpectralLine]]:
    """Subtract steady lines; return the values and the lines. The motion of a passage has no steady frequency."""
    lines = steady_lines(time, value, np.ones(len(time), bool))
    for line in lines:
        value = value - line.at(time)
    return value, lines


@compiled(part=True)
def _median5(a: float, b: float, c: float, d: float, e: float) -> float:
    """Median of five numbers."""
    a, b = min(a, b), max(a, b)
    c, d = min(c, d), max(c, d)
    # the smallest of four and the largest of four are not the middle
    low, high = max(a, c), min(b, d)
    low, high = min(low, high), max(low, high)
    return max(low, min(high, e))


@compiled(nogil=True)
def _bends(value: NDArray[np.float64], middle: float, bend: float, off: NDArray[np.float64]) -> None:
    """Write the distance of each value from the median of five neighbours, less the permitted bend, to off."""
    n = len(value)
    for i in range(n):
        k = min(max(i, 2), n - 3)
        centre = _median5(value[k - 2], value[k - 1], value[k], value[k + 1], value[k + 2])
        off[i] = max(0.0, abs(value[i] - centre) - bend * abs(centre - middle))


def _without_outliers(value: NDArray[np.float64], middle: float, bend: float, factor: float) -> int:
    """Set outliers to NaN: values that differ from the median of five neighbours. Return their number.

    A smooth signal differs by at most `bend` times its size, at its extremes.
    """
    off = np.empty(len(value))
    _bends(value, middle, bend, off)
    # a value of white noise is the median of five itself in a part of the cases, which do not count for the scale
    moved = off[:: max(1, len(value) // _SCALE_SAMPLES)]
    moved = moved[moved > 0]
    limit = factor * float(np.median(moved)) / 0.6745 if len(moved) else np.inf
    outliers = 2 + np.flatnonzero(off[2:-2] > limit)
    value[outliers] = np.nan
    return len(outliers)
