"""Measured steady states against the model: order tracking, validation, report (`analysis.report`)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.errors import AnalysisError, NoStableState, NotEnoughData
    from analysis.figures.bode import draw_bode
    from analysis.figures.dial import draw_dial
    from analysis.figures.fit import FitCurve, fit_curves
    from analysis.figures.health import draw_health
    from analysis.figures.multipliers import draw_multipliers
    from analysis.figures.orbit import draw_orbit
    from analysis.figures.orders import draw_orders
    from analysis.figures.page import write_figure
    from analysis.figures.polar import draw_polar
    from analysis.figures.residuals import draw_residuals
    from analysis.figures.slip import draw_slip
    from analysis.figures.spectrum import draw_spectrum
    from analysis.figures.stability_map import MapPoint, draw_points_on_map
    from analysis.figures.time_history import draw_time
    from analysis.figures.waterfall import draw_waterfall
    from analysis.prediction import Prediction, predict_point
    from analysis.quantities.amplification import Amplification, amplification_factors, principal_axis
    from analysis.quantities.orbits import OrbitEllipse, forward_backward, orbit_ellipse
    from analysis.quantities.order_maps import OrderMap, order_map, resampled_order_track
    from analysis.quantities.order_tracking import OrderTrack, order_track
    from analysis.quantities.rotor_phase import phase_at, speed_at
    from analysis.quantities.slip import SlipTrack, slip_track
    from analysis.quantities.slow_roll import slow_roll_vector, without_slow_roll
    from analysis.quantities.spectra import Spectrum, amplitude_spectrum, full_spectrum, power_density
    from analysis.results import PointResult
    from analysis.rig_model import RigModel
    from analysis.simulated_run import SimulatedRun, simulate_run
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
    "OrbitEllipse": "analysis.quantities.orbits",
    "orbit_ellipse": "analysis.quantities.orbits",
    "forward_backward": "analysis.quantities.orbits",
    "Spectrum": "analysis.quantities.spectra",
    "power_density": "analysis.quantities.spectra",
    "amplitude_spectrum": "analysis.quantities.spectra",
    "full_spectrum": "analysis.quantities.spectra",
    "OrderMap": "analysis.quantities.order_maps",
    "order_map": "analysis.quantities.order_maps",
    "resampled_order_track": "analysis.quantities.order_maps",
    "SlipTrack": "analysis.quantities.slip",
    "slip_track": "analysis.quantities.slip",
    "Amplification": "analysis.quantities.amplification",
    "amplification_factors": "analysis.quantities.amplification",
    "principal_axis": "analysis.quantities.amplification",
    "slow_roll_vector": "analysis.quantities.slow_roll",
    "without_slow_roll": "analysis.quantities.slow_roll",
    "phase_at": "analysis.quantities.rotor_phase",
    "speed_at": "analysis.quantities.rotor_phase",
    "RigModel": "analysis.rig_model",
    "SimulatedRun": "analysis.simulated_run",
    "simulate_run": "analysis.simulated_run",
    "draw_time": "analysis.figures.time_history",
    "draw_orbit": "analysis.figures.orbit",
    "draw_dial": "analysis.figures.dial",
    "draw_bode": "analysis.figures.bode",
    "draw_polar": "analysis.figures.polar",
    "draw_waterfall": "analysis.figures.waterfall",
    "draw_spectrum": "analysis.figures.spectrum",
    "draw_orders": "analysis.figures.orders",
    "draw_slip": "analysis.figures.slip",
    "draw_multipliers": "analysis.figures.multipliers",
    "draw_health": "analysis.figures.health",
    "draw_residuals": "analysis.figures.residuals",
    "FitCurve": "analysis.figures.fit",
    "fit_curves": "analysis.figures.fit",
    "MapPoint": "analysis.figures.stability_map",
    "draw_points_on_map": "analysis.figures.stability_map",
    "write_figure": "analysis.figures.page",
}

__all__ = [
    "Amplification",
    "AnalysisError",
    "FitCurve",
    "MapPoint",
    "NoStableState",
    "NotEnoughData",
    "OrbitEllipse",
    "OrderMap",
    "OrderTrack",
    "PointResult",
    "Prediction",
    "RigModel",
    "SimulatedRun",
    "SlipTrack",
    "Spectrum",
    "SteadyMeasurement",
    "Validation",
    "amplification_factors",
    "amplitude_spectrum",
    "draw_bode",
    "draw_dial",
    "draw_health",
    "draw_multipliers",
    "draw_orbit",
    "draw_orders",
    "draw_points_on_map",
    "draw_polar",
    "draw_residuals",
    "draw_slip",
    "draw_spectrum",
    "draw_time",
    "draw_waterfall",
    "fit_curves",
    "forward_backward",
    "full_spectrum",
    "measure",
    "orbit_ellipse",
    "order_map",
    "order_track",
    "phase_at",
    "power_density",
    "predict_point",
    "principal_axis",
    "resampled_order_track",
    "simulate_run",
    "slip_track",
    "slow_roll_vector",
    "speed_at",
    "validate",
    "validate_point",
    "without_slow_roll",
    "write_figure",
]


def __getattr__(name: str) -> Any:
    """A public name from its room."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names, also those that are not loaded yet."""
    return sorted(__all__)
