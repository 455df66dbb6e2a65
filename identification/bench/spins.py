"""Synthetic spin-downs of one pendulum on a resting rotor with an encoder's readings, common methods, and bounds.

θ = θ0 + (v0/λ)(1 − e^{−λt}), λ = c/J. The encoder has 2000 steps a revolution and a jitter of 0.3 steps; reading and
jitter together are nearly white noise of sqrt(1/12 + 0.09) steps, for which the bound is computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from identification.bench.fisher import bound
from identification.bench.trials import MethodResult, SyntheticRecord

INERTIA_KG_M2 = 2.187e-4
STEP_RAD = 2 * np.pi / 2000
_JITTER_STEPS = 0.3
_NOISE_RAD = STEP_RAD * np.sqrt(1 / 12 + _JITTER_STEPS**2)
_START_RAD_S, _RATE_HZ, _LOST = 2 * np.pi * 5, 1000.0, 0.02
_LONGEST_S, _TIME_CONSTANTS = 10.0, 8.0
_SPEED_S = 0.04


@dataclass(frozen=True)
class SpinRecord:
    """Record of a spin-down, the input of a method: times in s and angles in rad, shape (n,)."""

    time_s: np.ndarray
    angle_rad: np.ndarray


def spin_down(rng: np.random.Generator, damping_Nms_per_rad: float) -> SyntheticRecord:
    """Draw a spin-down from 5 revolutions per second with two per cent of the samples lost."""
    rate = damping_Nms_per_rad / INERTIA_KG_M2
    time = np.arange(round(min(_LONGEST_S, _TIME_CONSTANTS / rate) * _RATE_HZ)) / _RATE_HZ
    time = time[rng.random(len(time)) >= _LOST]
    theta = np.array([damping_Nms_per_rad, _START_RAD_S * (1 + 0.02 * rng.uniform(-1, 1)), rng.uniform(-np.pi, np.pi)])

    def mean(at: np.ndarray) -> np.ndarray:
        return _angle(time, *at)

    std = bound(mean, theta, np.array([1e-5 * damping_Nms_per_rad, 1e-4, 1e-4]), _NOISE_RAD)
    angle = STEP_RAD * np.round(mean(theta) / STEP_RAD + _JITTER_STEPS * rng.normal(size=len(time)))
    return SyntheticRecord(SpinRecord(time, angle), {"c_Nms_per_rad": theta[0]}, {"c_Nms_per_rad": std[0]})


def log_speed_line(record: SpinRecord) -> MethodResult:
    """Estimate by the slope of the logarithm of differences over 40 ms, down to a tenth of the first speed."""
    time, angle = record.time_s, record.angle_rad
    late = int(np.searchsorted(time, float(time[0]) + _SPEED_S))
    speed = np.abs(angle[late:] - angle[:-late]) / (time[late:] - time[:-late])
    middle = 0.5 * (time[late:] + time[:-late])
    slow = np.flatnonzero(speed < 0.1 * speed[0])
    cut = slice(0, int(slow[0]) if len(slow) else len(speed))
    slope = np.polyfit(middle[cut], np.log(speed[cut]), 1)[0]
    return MethodResult({"c_Nms_per_rad": float(-slope * INERTIA_KG_M2)})


def curve_fitting(record: SpinRecord) -> MethodResult:
    """Estimate by scipy's curve_fit of the closed form to all samples, started by the line, with its intervals."""
    line = log_speed_line(record).values["c_Nms_per_rad"]
    time, angle = record.time_s, record.angle_rad
    speed = (angle[20] - angle[0]) / (time[20] - time[0])
    fitted = cast("Any", optimize).curve_fit(_angle, time, angle, p0=[line, speed, angle[0]])  # scipy has no types
    found, covariance = cast("tuple[NDArray[np.float64], NDArray[np.float64]]", fitted[:2])
    std = float(np.sqrt(covariance[0, 0]))
    return MethodResult(
        {"c_Nms_per_rad": float(found[0])}, {"c_Nms_per_rad": (found[0] - 1.96 * std, found[0] + 1.96 * std)}
    )


def _angle(time: np.ndarray, damping: float, speed: float, start: float) -> np.ndarray:
    rate = damping / INERTIA_KG_M2
    return start - speed / rate * np.expm1(-rate * time)
