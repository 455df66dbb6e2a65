# pyright: strict
"""The measurement model: errors of the sources in, values of the quantities out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uncertainty.errors import BadModel

Model = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Errors of shape (n, columns of the sources) to values of shape (n, quantities)."""


def values_of(model: Model, errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The model's values for some errors, shape (n, quantities), all finite.

    Raises:
        BadModel: the values have another shape or are not finite.
    """
    values = np.asarray(model(errors), dtype=np.float64)
    if values.ndim != 2 or len(values) != len(errors) or values.shape[1] == 0:
        raise BadModel(
            f"the model returned shape {values.shape} for errors of shape {errors.shape}; ({len(errors)}, quantities) "
            "is needed"
        )
    bad = ~np.all(np.isfinite(values), axis=1)
    if bool(np.any(bad)):
        raise BadModel(
            f"the model returned values that are not finite in {int(np.sum(bad))} of {len(errors)} rows, first for "
            f"the errors {errors[int(np.argmax(bad))].tolist()}"
        )
    return values
