# pyright: strict
"""The measurement model: errors of the sources in, values of the quantities out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uncertainty.errors import BadModel

Model = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Errors of shape (n, columns of the sources) to values of shape (n, quantities)."""


def values_of(model: Model, errors: NDArray[np.float64], quantities: int | None = None) -> NDArray[np.float64]:
    """The model's values for some errors, shape (n, quantities), all finite.

    Args:
        model: the model.
        errors: shape (n, columns).
        quantities: how many there were in an earlier call; None: at least one.

    Raises:
        BadModel: the values have another shape or are not finite.
    """
    values = np.array(model(errors), dtype=np.float64)  # a copy: the model may fill the same array again
    width = "quantities" if quantities is None else quantities
    fits = values.ndim == 2 and len(values) == len(errors) and values.shape[1] > 0
    if not fits or quantities not in (None, values.shape[1]):
        raise BadModel(
            f"the model returned shape {values.shape} for errors of shape {errors.shape}; ({len(errors)}, {width}) is "
            "needed"
        )
    bad = ~np.all(np.isfinite(values), axis=1)
    if bool(np.any(bad)):
        raise BadModel(
            f"the model returned values that are not finite in {int(np.sum(bad))} of {len(errors)} rows, first for "
            f"the errors {errors[int(np.argmax(bad))].tolist()}"
        )
    return values
