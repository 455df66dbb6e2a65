"""Decision whether a record determines both directions, and whether their axes are resolved."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from identification.colour import colour_of
from identification.errors import IdentificationError
from identification.ring_down.attempt import FitOptions
from identification.ring_down.backbone import averaged_course
from identification.ring_down.decay import COARSE_S, DecayData, FittedDecay, Priors
from identification.ring_down.model import BETA
from identification.ring_down.modes import damped_periodogram, rate, without_modes
from identification.ring_down.rungs import climbed
from identification.samples import Averages

_log = logging.getLogger(__name__)

RESOLVED_SPLIT = 0.1  # smallest distance of resolved modes in half-bandwidths
RESOLVED_GAIN = 100.0  # smallest gain of χ² by the second mode
CLOSE, _MAX_SPLIT_STD = 3.0, 0.1  # distance of close modes in half-bandwidths; relative std of a significant distance
WALD_STD = np.radians(3.0)  # largest std of an axis angle whose interval comes from the covariance
_STEP = 1e-7  # of ln ω and ζ
_MIN_GAIN = 45.0  # of χ²: noise alone explains 2 ln(number of searched cells), about 25
WEAK = 0.25  # amplitude of the weaker sensor over that of the stronger


@dataclass(frozen=True)
class Lone:
    """Single direction that a record determines, and the message about it."""

    axis: int
    sentence: str


def lone_direction(decay: DecayData) -> Lone | None:
    """Return the direction if one sensor shows no mode of its own; None if the records contain both directions.

    The criterion is the residual of the weaker sensor after removal of the stronger sensor's mode.
    """
    strong = stronger_sensor(decay, WEAK)
    if strong is None:
        return None
    coarse = decay.averages(COARSE_S)[0]
    try:
        fitted = _alone(decay, strong)
    except IdentificationError as error:
        _log.debug("the stronger sensor alone has no fit, its second mode is not examined: %s", error)
        return None
    weak = coarse[1 - strong]
    rest = _without_strong(weak, fitted)
    if _explained(_whitened(rest, fitted)) > _MIN_GAIN * max(1.0, fitted.solution.chi2_per_dof):
        return None
    return own_mode_missing(strong, _explained(weak) > _MIN_GAIN)


def stronger_sensor(decay: DecayData, ratio: float) -> int | None:
    """Sensor of a single record whose motion exceeds the other's by more than 1/ratio, or None."""
    if len(decay.records) != 1 or len(decay.records[0]) < 2:
        return None
    coarse = decay.averages(COARSE_S)[0]
    energy = [float(np.var(c.value)) - c.noise**2 / float(np.median(c.count)) for c in coarse]
    strong = int(np.argmax(energy))
    return strong if max(energy[1 - strong], 0.0) < ratio**2 * energy[strong] else None


def own_mode_missing(strong: int, others: bool) -> Lone:
    """Result for a record whose weaker sensor shows no mode of its own.

    Args:
        strong: index of the stronger sensor.
        others: whether the weaker sensor shows the stronger one's mode.
    """
    axis = "xy"[1 - strong]
    if others:
        reason = f"axes not resolved: sensor {axis} shows the other's mode and none of its own"
    else:
        reason = f"sensor {axis} shows no mode of its own"
    return Lone(strong, f"{reason}; direction {strong + 1} alone is fitted. Add a ring-down along {axis}")


def not_of_the_pair(strong: int, omega: float) -> Lone:
    """Result for a record whose weaker oscillation moves in another direction than a mode of the pair."""
    axis = "xy"[1 - strong]
    return Lone(
        strong,
        f"direction {2 - strong} is not shown by this record: the oscillation at {omega / (2 * np.pi):.3g} Hz moves in "
        f"another direction, or phase, than a mode perpendicular to direction {strong + 1} (a floor, a cable?); "
        f"direction {strong + 1} alone is fitted. Add a ring-down along {axis}",
    )


def _alone(decay: DecayData, axis: int) -> FittedDecay:
    """Fit of one free mode in one sensor."""
    own = decay.only(axis)
    valid = tuple(tuple(c.keep for c in channels) for channels in own.records)
    return climbed(FitOptions(False, "fast", Priors(), valid)(own), Priors(), True)


def _without_strong(weak: Averages, fitted: FittedDecay) -> Averages:
    """Weaker sensor with the stronger one's mode and an offset removed by linear regression."""
    backbone = fitted.model.backbone
    if backbone is None:
        return without_modes(weak, [complex(rate(float(fitted.omegas[0]), float(fitted.zetas[0])))], weak.time_s[0])
    t = weak.time_s - fitted.model.records[0].zero_s
    rates, level = fitted.model.mode_rates(fitted.theta, 0), backbone.amplitudes_m[0][0]
    wave, _ = averaged_course(rates, level, t, weak.spread_s2)
    basis = np.column_stack([wave.real, wave.imag, np.ones_like(t)])
    own, *_ = np.linalg.lstsq(basis, weak.value, rcond=None)
    return replace(weak, value=weak.value - basis @ own)


def _whitened(rest: Averages, fitted: FittedDecay) -> Averages:
    """Residual of a sensor with whitened noise."""
    width = float(np.median(np.diff(rest.time_s)))
    modes = [(w / (2 * np.pi), z * w / (2 * np.pi)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    colour = colour_of(rest.value * rest.weight, rest.noise, width, modes)
    if colour is None:
        return rest
    weight = np.sqrt(rest.count) / colour.noise
    return replace(rest, value=colour.whitened(rest.value * weight) / weight, noise=colour.noise)


def _explained(channel: Averages) -> float:
    """Part of χ² that the best decaying sinusoid explains."""
    centred = channel.value - channel.value.mean()
    return damped_periodogram([[channel]]).share * float(np.sum((centred * channel.weight) ** 2))


@dataclass(frozen=True)
class Resolution:
    """Resolution of a turned pair's axes.

    Attributes:
        split, split_std: |λ1 − λ2| over the mean half-bandwidth ζω, and its standard deviation.
        axis_std_rad: standard deviation of the axis angle from the data alone, rad.
        gain: gain of χ² compared with one mode in both sensors. An angle with a standard deviation of 3° has a gain of
            some hundreds. If the gain is small, the second mode follows noise.
    """

    split: float
    split_std: float
    axis_std_rad: float
    gain: float

    @property
    def certain(self) -> bool:
        """Whether the distance of the modes is significant."""
        return self.split >= CLOSE or self.split_std <= _MAX_SPLIT_STD * self.split

    @property
    def resolved(self) -> bool:
        """Whether the standard deviation of the angle is at most 3° and the distance of the modes is significant."""
        # a mode with a very small amplitude has an arbitrary rate, with a large distance of large uncertainty
        apart = self.split >= RESOLVED_SPLIT and self.certain
        return apart and self.axis_std_rad <= WALD_STD and self.gain >= RESOLVED_GAIN


def resolution(fitted: FittedDecay, priors: Priors, stretch: float, gain: float) -> Resolution:
    """Compute the distance of the two modes and the uncertainty of their axes.

    Args:
        fitted: solved fit of a turned pair.
        priors: priors of the fit.
        stretch: factor on standard deviations for noise above white noise.
        gain: gain of χ² compared with one mode in both sensors.
    """
    covariance = fitted.solution.minimum.covariance
    precision = 1 / float(covariance[BETA, BETA]) - 1 / priors.axis_rad**2
    std = np.inf if precision <= 0 else precision**-0.5
    own = np.r_[fitted.omegas[0], fitted.zetas[0], fitted.omegas[1], fitted.zetas[1]]
    # θ contains ln ω and ζ
    slope = np.array(
        [
            (_split(own + step) - _split(own - step)) / (2 * _STEP)
            for step in _STEP * np.diag(np.r_[own[0], 1.0, own[2], 1.0])
        ]
    )
    split_std = float(np.sqrt(max(0.0, slope @ covariance[:BETA, :BETA] @ slope)))
    return Resolution(_split(own), split_std * stretch, float(std) * stretch, gain)


def _split(modes: np.ndarray) -> float:
    """Distance of the rates of two modes (ω1, ζ1, ω2, ζ2) in half-bandwidths."""
    lams = [rate(float(modes[0]), float(modes[1])), rate(float(modes[2]), float(modes[3]))]
    return float(abs(lams[0] - lams[1]) / np.mean([max(-lam.real, 1e-12) for lam in lams]))
