"""Checks of the arguments of public functions. They run before any computation."""

# pyright: strict

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from dynamics.arrays import Array
from dynamics.errors import OutsideDomain

_SPEED_RATIO = 1e8
"""Largest speed ratio and inverse of the smallest. Inertial terms are to spring terms as its square; beyond 2^53, the
resolution of a double, one of them vanishes in the sum, and any larger value yields the same limit or an overflow."""


def check_number(**values: object) -> None:
    """Check that each value is a single real number.

    Raises:
        OutsideDomain: a value is not a real number. The message contains the argument's name and the value.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise OutsideDomain(f"{name}: expected a number, got {value!r}")


def check_speed(speed_rad_s: float, natural_frequencies_rad_s: tuple[float, float]) -> None:
    """Check that a running speed is a number for which the answer depends on springs and masses.

    Raises:
        OutsideDomain: the speed is not a number, not above 0, or outside 1e-8 … 1e8 natural frequencies.
    """
    check_number(speed_rad_s=speed_rad_s)
    if not 0 < speed_rad_s < math.inf:
        raise OutsideDomain(f"speed: expected a finite value above 0 rad/s, got {speed_rad_s!r}")
    least, most = min(natural_frequencies_rad_s) / _SPEED_RATIO, max(natural_frequencies_rad_s) * _SPEED_RATIO
    if not least <= speed_rad_s <= most:
        raise OutsideDomain(
            f"speed: expected {least:.2g} to {most:.2g} rad/s, 1e-8 to 1e8 natural frequencies, got {speed_rad_s!r}"
        )


def check_pair(**values: object) -> None:
    """Check that each value is a pair (pendulum A, pendulum B) of finite numbers or of booleans.

    Raises:
        OutsideDomain: a value is not such a pair. The message contains the argument's name and the value.
    """
    for name, value in values.items():
        try:
            pair = np.asarray(value)
            fits = pair.shape == (2,) and pair.dtype.kind in "bifu" and bool(np.all(np.isfinite(pair)))
        except (TypeError, ValueError):  # usual: a value that is not a pair
            fits = False
        if not fits:
            raise OutsideDomain(f"{name}: expected two values, for A and for B, got {value!r}")


def real_array(name: str, value: object) -> Array:
    """Convert a value to a C-contiguous array of float64.

    Raises:
        OutsideDomain: the value is text, None, a ragged list or complex.
    """
    try:
        found = np.asarray(cast(Any, value))
        if found.dtype.kind in "iuf":
            return np.asarray(found, np.float64, order="C")
    except (TypeError, ValueError):  # usual: the value is not a number; OutsideDomain is raised below
        pass
    raise OutsideDomain(f"{name}: expected real numbers, got {value!r}")
