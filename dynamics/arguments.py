"""Checks of the arguments of public functions. They run before any computation."""

# pyright: strict

from __future__ import annotations

from typing import Any, cast

import numpy as np

from dynamics.arrays import Array
from dynamics.errors import OutsideDomain


def check_number(**values: object) -> None:
    """Check that each value is a single real number.

    Raises:
        OutsideDomain: a value is not a real number. The message contains the argument's name and the value.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise OutsideDomain(f"{name}: expected a number, got {value!r}")


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
