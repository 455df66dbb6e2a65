"""Arguments of the public verbs: what is no number is refused in words, before any work."""

# pyright: strict

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import OutsideDomain


def need_number(**values: object) -> None:
    """Refuse what is no single real number.

    Raises:
        OutsideDomain: names the argument and what came.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise OutsideDomain(f"{name}: expected a number, got {value!r}")


def need_pair(**values: object) -> None:
    """Refuse what is no pair, one for A and one for B, of finite numbers or of yes and no.

    Raises:
        OutsideDomain: names the argument and what came.
    """
    for name, value in values.items():
        try:
            pair = np.asarray(value)
            fits = pair.shape == (2,) and pair.dtype.kind in "bifu" and bool(np.all(np.isfinite(pair)))
        except (TypeError, ValueError):
            fits = False
        if not fits:
            raise OutsideDomain(f"{name}: expected two values, for A and for B, got {value!r}")


def numbers(name: str, value: object) -> NDArray[np.float64]:
    """A real array.

    Raises:
        OutsideDomain: text, None, ragged lists, complex numbers.
    """
    try:
        found = np.asarray(cast(Any, value))
        if found.dtype.kind in "iuf":
            return np.asarray(found, np.float64, order="C")
    except (TypeError, ValueError):
        pass
    raise OutsideDomain(f"{name}: expected real numbers, got {value!r}")
