"""A measured signal beside its fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Curve:
    """A measured signal beside its fit, for a plot.

    Attributes:
        label, unit: what it is.
        time_s, measured, fitted: shape (n,).
    """

    label: str
    unit: str
    time_s: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
