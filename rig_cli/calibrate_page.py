"""Numbers of a calibration for the record, and their lines on the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from daq.calibration.encoder import EncoderCalibration
from daq.calibration.sensor import SensorCalibration, SensorSetup
from rig_cli.console import show


def sensor_facts(found: SensorCalibration, setup: SensorSetup) -> dict[str, Any]:
    """Return the numbers of a sensor's calibration as JSON values."""
    line = found.line
    return {
        "gain": line.gain,
        "gain_std": line.gain_std,
        "offset_m": found.offset_m,
        "offset_std_m": found.offset_std_m,
        "scatter_m": line.scatter_m,
        "repeatability_m": _finite(line.repeatability_m),
        "hysteresis_m": _finite(line.hysteresis_m),
        "hysteresis_std_m": _finite(line.hysteresis_std_m),
        "nonlinearity_m": line.nonlinearity_m,
        "nonlinearity_is_significant": line.curved,
        "degrees_of_freedom": line.freedom,
        "readings": [asdict(reading) for reading in line.readings],
        "residuals_m": line.residuals_m.tolist(),
        "setup": asdict(setup),
    }


def encoder_facts(found: EncoderCalibration, lock_std_deg: float) -> dict[str, Any]:
    """Return the numbers of the encoders' calibration as JSON values."""
    return {
        "zero_deg": list(found.zero_deg),
        "spread_deg": list(found.spread_deg),
        "zero_std_deg": found.zero_std_deg,
        "lock_std_deg": lock_std_deg,
        "senses": list(found.senses),
        "closings_deg": [list(each) for each in found.closings_deg],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def show_sensor(facts: Mapping[str, Any]) -> None:
    """Print the result of a sensor."""
    show(f"gain_factor      {facts['gain']:.6f} ± {facts['gain_std']:.2g}")
    if facts["offset_m"] is not None:
        show(f"offset           {1e6 * facts['offset_m']:.2f} ± {1e6 * facts['offset_std_m']:.2g} µm")
    for name, key in (("scatter", "scatter_m"), ("repeatability", "repeatability_m"), ("hysteresis", "hysteresis_m")):
        if facts[key] is not None:
            show(f"{name:16} {1e6 * facts[key]:.2f} µm")
    significant = "" if facts["nonlinearity_is_significant"] else ", not significant"
    show(f"nonlinearity     {1e6 * facts['nonlinearity_m']:.2f} µm{significant}")


def show_encoder(facts: Mapping[str, Any]) -> None:
    """Print the result of the encoders."""
    for name, zero, spread, sense in zip("AB", facts["zero_deg"], facts["spread_deg"], facts["senses"], strict=True):
        words = {1: "counter-clockwise", -1: "reversed", 0: "exchanged"}[sense]
        show(f"{name}: zero {zero:+.3f}°, one closing ± {spread:.3f}°, sense {words}")
    show(f"zero_std_deg     {facts['zero_std_deg']:.3f}")
