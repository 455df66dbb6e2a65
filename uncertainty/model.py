"""The measurement model: a function from errors of the sources to values of the quantities."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rig_basics.texts import number_of
from uncertainty.errors import BadModel

Model = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Maps errors of shape (n, columns of the sources) to values of shape (n, quantities)."""


def values_of(model: Model, errors: NDArray[np.float64], quantities: int | None = None) -> NDArray[np.float64]:
    """Return the model's values for given errors, shape (n, quantities), all finite.

    Args:
        model: measurement model.
        errors: shape (n, columns).
        quantities: number of quantities in an earlier call; None if there was no call, then at least one is required.

    Raises:
        BadModel: the values have another shape or are not finite.
    """
    values = np.array(model(errors), dtype=np.float64)  # a copy, because the model may reuse its array
    width = "quantities" if quantities is None else quantities
    fits = values.ndim == 2 and len(values) == len(errors) and values.shape[1] > 0
    if not fits or quantities not in (None, values.shape[1]):
        raise BadModel(
            f"the model returned shape {values.shape} for errors of shape {errors.shape}; "
            f"({len(errors)}, {width}) is needed"
        )
    bad = ~np.all(np.isfinite(values), axis=1)
    if bool(np.any(bad)):
        raise BadModel(
            f"the model returned values that are not finite in {int(np.sum(bad))} of "
            f"{number_of(len(errors), 'row')}, first for "
            f"the errors {errors[int(np.argmax(bad))].tolist()}"
        )
    return values
