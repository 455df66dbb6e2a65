"""Measured steady states against the model: order tracking, validation, report (`analysis.report`)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.errors import AnalysisError, NoStableState, NotEnoughData
    from analysis.prediction import Prediction, predict_point
    from analysis.quantities.order_tracking import OrderTrack, order_track
    from analysis.results import PointResult
    from analysis.steady_state import SteadyMeasurement, measure
    from analysis.validation import Validation, validate, validate_point

_HOME = {  # loaded when first used: an error class or one figure need not wait for the drivers and fits
    "AnalysisError": "analysis.errors",
    "NoStableState": "analysis.errors",
    "NotEnoughData": "analysis.errors",
    "OrderTrack": "analysis.quantities.order_tracking",
    "PointResult": "analysis.results",
    "Prediction": "analysis.prediction",
    "SteadyMeasurement": "analysis.steady_state",
    "Validation": "analysis.validation",
    "measure": "analysis.steady_state",
    "order_track": "analysis.quantities.order_tracking",
    "predict_point": "analysis.prediction",
    "validate": "analysis.validation",
    "validate_point": "analysis.validation",
}

__all__ = [
    "AnalysisError",
    "NoStableState",
    "NotEnoughData",
    "OrderTrack",
    "PointResult",
    "Prediction",
    "SteadyMeasurement",
    "Validation",
    "measure",
    "order_track",
    "predict_point",
    "validate",
    "validate_point",
]


def __getattr__(name: str) -> Any:
    """A public name from its room."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
