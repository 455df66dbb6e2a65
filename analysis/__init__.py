"""Measured steady states against the model: order tracking, validation, report (`analysis.report`)."""

from analysis.errors import AnalysisError, NoStableState, NotEnoughData
from analysis.order_tracking import OrderTrack, order_track
from analysis.prediction import Prediction, predict_point
from analysis.steady_state import SteadyMeasurement, measure
from analysis.validation import PointResult, Validation, validate, validate_point

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
