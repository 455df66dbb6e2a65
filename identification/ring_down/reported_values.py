"""Conversion of a ring-down's θ to the reported values: units, intervals and their widening."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.errors import NotIdentifiable
from identification.ring_down.amplitude import AmplitudeDependence, amplitude_dependence
from identification.ring_down.decay import FittedDecay, Priors
from identification.ring_down.evidence import friction_std
from identification.ring_down.over_amplitude import RatesOverAmplitude
from identification.ring_down.profile import profile_axis, profile_parameter
from identification.ring_down.resolution import Resolution
from identification.setting import Setting
from rig_basics.arrays import Array

_NORMAL_95 = 1.959964


@dataclass
class Numbers:
    """Physical part of θ in reported units, with covariance and 95 % intervals."""

    names: list[str]
    values: Array
    covariance: Array
    low: Array
    high: Array


def numbers_of(
    fitted: FittedDecay,
    setting: Setting,
    priors: Priors,
    labels: tuple[str, ...],
    stretch: Array,
    found: Resolution | None,
) -> Numbers:
    """Return values, covariance and 95 % intervals of the physical part of θ.

    Args:
        fitted: solved fit.
        setting: effort of the fit.
        priors: priors of the fit.
        labels: numbers of the directions.
        stretch: factor on the standard deviation of each parameter, shape (size,).
        found: resolution of a turned pair's axes; None for free modes.
    """
    names = [name for label in labels for name in (f"f{label}_Hz", f"zeta{label}")]
    theta = fitted.theta
    if found is not None:
        names.append("axis_angle_deg")
    n = len(names)
    covariance = fitted.solution.minimum.covariance[:n, :n] * np.outer(stretch[:n], stretch[:n])
    std = np.sqrt(np.diag(covariance))
    low, high = theta[:n] - _NORMAL_95 * std, theta[:n] + _NORMAL_95 * std
    if found is not None and (not found.resolved or setting == "reference"):
        factor = float(np.max(stretch[:n]))
        profile = profile_axis(fitted, priors, factor)
        low, high = profile.low, profile.high
        if not found.resolved:
            wider = np.sqrt(np.maximum(1.0, np.diag(profile.covariance) / np.diag(covariance)))
            covariance = covariance * np.outer(wider, wider)
    elif setting == "reference":
        low, high = np.array([profile_parameter(fitted, priors, i, float(stretch[i])) for i in range(n)]).T
    values, lows, highs, scale = theta[:n].copy(), low.copy(), high.copy(), np.ones(n)
    for i, name in enumerate(names):
        if name.endswith("_Hz"):
            values[i], lows[i], highs[i] = (float(np.exp(v)) / (2 * np.pi) for v in (theta[i], low[i], high[i]))
            scale[i] = values[i]
        elif name.endswith("_deg"):
            scale[i] = np.degrees(1.0)
            values[i], lows[i], highs[i] = np.degrees([theta[i], low[i], high[i]])
    return Numbers(names, values, covariance * np.outer(scale, scale), lows, highs)


def amplitudes_of(fitted: FittedDecay, count: int, stretch: Array) -> list[AmplitudeDependence]:
    """Rates of each mode in windows of decreasing amplitude, for modes with a sufficiently long decay."""
    found = [amplitude_dependence(fitted, mode, float(stretch[2 * mode + 1])) for mode in range(count)]
    return [f for f in found if f is not None]


def beyond_terms(
    fitted: FittedDecay, dependence: list[AmplitudeDependence], stretch: Array
) -> list[AmplitudeDependence]:
    """Amplitude dependence that the fitted terms do not explain."""
    if fitted.model.backbone is None:
        return dependence
    found = [amplitude_dependence(fitted, one.mode - 1, float(stretch[2 * one.mode - 1]), False) for one in dependence]
    return [f for f in found if f is not None]


def widen_for_amplitude(numbers: Numbers, dependence: list[AmplitudeDependence], labels: tuple[str, ...]) -> list[str]:
    """Widen the intervals for a change over amplitude, by its range over sqrt(12). Return messages."""
    out: list[str] = []
    for one in dependence:
        label, i = labels[one.mode - 1], 2 * (one.mode - 1)
        top, bottom = 1e3 * float(one.amplitude_m[0]), 1e3 * float(one.amplitude_m[-1])
        for at, name, matters, span, slope in (
            (i + 1, f"zeta{label}", one.zeta_matters, one.zeta_range, one.zeta_slope_per_m),
            (i, f"f{label}", one.f_matters, one.f_range_Hz, one.f_slope_Hz_per_m),
        ):
            extra = span / np.sqrt(12)
            if not matters or extra < 0.5 * np.sqrt(numbers.covariance[at, at]):
                continue
            out.append(
                f"{name} depends on amplitude: {slope * 1e-3:+.3g} per mm from {top:.3g} to {bottom:.3g} mm, "
                f"a change of {span / abs(numbers.values[at]):.2%}; the value is a mean, its interval covers the change"
            )
            _widen(numbers, at, extra)
    return out


def widen_for_other_law(numbers: Numbers, nonlinear: Sequence[RatesOverAmplitude], labels: tuple[str, ...]) -> None:
    """Widen the values at zero amplitude if the rates follow another law than the one they are extrapolated with."""
    for one in nonlinear:
        i = 2 * labels.index(str(one.direction))
        bent = float(numbers.values[i]) * one.f_change_at_1mm * (1e3 * one.largest_m) ** 2
        for at, change in ((i, bent), (i + 1, one.zeta_slope_per_m * one.largest_m)):
            _widen(numbers, at, abs(change) / float(np.sqrt(12)))


def widen_for_friction(numbers: Numbers, nonlinear: Sequence[RatesOverAmplitude], labels: tuple[str, ...]) -> None:
    """Widen the damping ratio of each direction whose damping falls with amplitude, as dry friction does."""
    for one in nonlinear:
        if one.fall > 0:
            _widen(numbers, 2 * labels.index(str(one.direction)) + 1, friction_std(one))


def _widen(numbers: Numbers, at: int, extra: float) -> None:
    numbers.covariance[at, at] += extra**2
    numbers.low[at] -= _NORMAL_95 * extra
    numbers.high[at] += _NORMAL_95 * extra


def damping_remark(numbers: Numbers, label: str, at: int) -> list[str]:
    """Return a message if a damping ratio is not distinguishable from zero.

    Args:
        numbers: values.
        label: number of the direction.
        at: index of the damping ratio in the values.
    Raises:
        NotIdentifiable: the motion grows, or its damping is below the noise.
    """
    value, std = float(numbers.values[at]), float(np.sqrt(numbers.covariance[at, at]))
    if value < -2 * std:
        raise NotIdentifiable(
            f"the motion grows: zeta{label} = {value:.3g} ± {std:.2g}; nothing may drive the rotor during a ring-down, "
            "and the recording must run forwards in time"
        )
    if value <= 0:
        raise NotIdentifiable(
            f"the decay of direction {label} is lost in noise: ζ is below {value + 2 * std:.2g} (95 %); "
            "record longer or pull farther"
        )
    numbers.low[at] = max(float(numbers.low[at]), 0.0)
    if value < 2 * std:
        return [f"zeta{label} is not distinguishable from zero: {value:.2g} ± {std:.2g}; record longer"]
    return []


def with_stiffness(numbers: Numbers, mass: float | None) -> Numbers:
    """Add the stiffnesses k = M (2π f)² to the frequencies."""
    if mass is None:
        return numbers
    names, rows = list(numbers.names), [np.eye(len(numbers.names))]
    values, low, high = list(numbers.values), list(numbers.low), list(numbers.high)
    for i, name in enumerate(numbers.names):
        if name.endswith("_Hz"):
            names.append(f"k{name[1]}_N_per_m")
            for target, source in ((values, numbers.values), (low, numbers.low), (high, numbers.high)):
                target.append(mass * (2 * np.pi * float(source[i])) ** 2)
            rows.append(np.eye(len(numbers.names))[i : i + 1] * 2 * mass * (2 * np.pi) ** 2 * numbers.values[i])
    full = np.concatenate(rows)
    return Numbers(names, np.array(values), full @ numbers.covariance @ full.T, np.array(low), np.array(high))
