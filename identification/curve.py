"""Measured signal and its fit, for a plot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FittedCurve:
    """Measured signal and its fit, for a plot.

    Attributes:
        label, unit: name and unit of the signal.
        time_s, measured, fitted: shape (n,).
    """

    label: str
    unit: str
    time_s: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
