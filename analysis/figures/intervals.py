"""95 % intervals of order vectors in figures: light bands, and their widths in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from analysis.figures.order_vectors import OrderVectors
from rig_basics.arrays import Array

TIMES = 1.96
"""Half width of a 95 % interval of one number, in standard deviations."""
TIMES_IN_PLANE = math.sqrt(-2 * math.log(0.05))
"""Radius of a circle that contains 95 % of vectors, in standard deviations of either part."""
NAME = "95 % interval"
_LOOK: dict[str, Any] = {"alpha": 0.22, "lw": 0.0, "zorder": 1.2}


def band(axes: Axes, x: Array, low: Array, high: Array, colour: str) -> None:
    """Fill the area between two curves behind the other artists."""
    axes.fill_between(x, low, high, color=colour, label=NAME, **_LOOK)


def area(axes: Axes, x: Array, y: Array, colour: str) -> None:
    """Fill a closed curve behind the other artists."""
    axes.fill(x, y, color=colour, label=NAME, **_LOOK)


def phase_half_deg(found: OrderVectors) -> Array:
    """Return half of the 95 % interval of the phase, °, at most 180, shape (n,), with that of the stamps' lag."""
    return np.minimum(np.degrees(TIMES * found.phase_std_rad), 180.0)


def interval_words(measured: Mapping[str, OrderVectors]) -> list[str]:
    """Describe the widths of the intervals of vectors in a sentence."""
    widths: list[str] = []
    for name, found in measured.items():
        good = np.isfinite(found.std_m) & np.isfinite(found.amplitude_m)
        if not good.any():
            continue
        half, size = TIMES * found.std_m[good], np.abs(found.amplitude_m[good])
        at = int(np.argmax(size))
        phase = f"± {_two(float(phase_half_deg(found)[good][at]))}°" if size[at] > half[at] else "lost in noise"
        largest = " of the largest" if len(size) > 1 else ""
        widths.append(f"{name} {_range_um(half)}, phase{largest} {phase}")
    if not widths:
        return []
    return [f"95 % intervals of the measured vectors, light where wider than the line: {'; '.join(widths)}."]


def _range_um(half_m: Array) -> str:
    """Format the least and the largest half width; one number if they are equal."""
    low, high = _two(1e6 * float(half_m.min())), _two(1e6 * float(half_m.max()))
    return f"± {low} µm" if low == high else f"± {low}…{high} µm"


def _two(value: float) -> str:
    """Format two significant digits without an exponent."""
    digits = 1 - math.floor(math.log10(value)) if value > 0 else 0
    return f"{round(value, digits):.{max(digits, 0)}f}"
