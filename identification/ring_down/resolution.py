"""Whether a record speaks of both directions, and whether their axes can be told apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.colour import colour_of
from identification.errors import IdentificationError
from identification.ring_down.attempt import Plan
from identification.ring_down.backbone import averaged_course
from identification.ring_down.decay import COARSE_S, Decay, Fitted, Priors
from identification.ring_down.model import BETA
from identification.ring_down.modes import damped_periodogram, rate, without_modes
from identification.ring_down.rungs import climbed
from identification.samples import Averages

RESOLVED_SPLIT = 0.1  # of a half-bandwidth
RESOLVED_GAIN = 100.0
CLOSE, _CERTAIN = 3.0, 0.1  # half-bandwidths; relative standard deviation of a split that is believed
WALD_STD = np.radians(3.0)  # beyond, the axis angle's interval is no ellipse
_STEP = 1e-7  # of ln ω and ζ
_NOTICED = 45.0  # of χ²: noise alone explains 2 ln of the number of cells searched, about 25
WEAK = 0.25  # amplitude of the weaker sensor against the stronger


@dataclass(frozen=True)
class Lone:
    """The only direction that a record can speak of."""

    axis: int
    sentence: str


def lone_direction(decay: Decay) -> Lone | None:
    """The direction when one sensor shows nothing of its own; None when the record, or several, hold both.

    The weaker sensor is asked whether anything is left once the stronger one's mode is taken out of it.
    """
    strong = stronger_sensor(decay, WEAK)
    if strong is None:
        return None
    coarse = decay.averages(COARSE_S)[0]
    try:
        fitted = _alone(decay, strong)
    except IdentificationError:
        return None
    weak = coarse[1 - strong]
    rest = _without_strong(weak, fitted)
    if _explained(_whitened(rest, fitted)) > _NOTICED * max(1.0, fitted.solution.chi2_per_dof):
        return None
    return own_mode_missing(strong, _explained(weak) > _NOTICED)


def stronger_sensor(decay: Decay, ratio: float) -> int | None:
    """The sensor of a single record whose motion exceeds the other's by more than 1/ratio; None where neither does."""
    if len(decay.records) != 1 or len(decay.records[0]) < 2:
        return None
    coarse = decay.averages(COARSE_S)[0]
    energy = [float(np.var(c.value)) - c.noise**2 / float(np.median(c.count)) for c in coarse]
    strong = int(np.argmax(energy))
    return strong if max(energy[1 - strong], 0.0) < ratio**2 * energy[strong] else None


def own_mode_missing(strong: int, others: bool) -> Lone:
    """A record in which the weaker sensor shows no mode of its own; others: but the stronger one's."""
    axis = "xy"[1 - strong]
    if others:
        reason = f"axes not resolved: sensor {axis} shows the other's mode and none of its own"
    else:
        reason = f"sensor {axis} shows no mode of its own"
    return Lone(strong, f"{reason}; direction {strong + 1} alone is fitted. Add a ring-down along {axis}")


def not_of_the_pair(strong: int, omega: float) -> Lone:
    """A record in which what seems the weaker mode moves in another direction than a mode of the pair can."""
    axis = "xy"[1 - strong]
    return Lone(
        strong,
        f"direction {2 - strong} is not shown by this record: what rings at {omega / (2 * np.pi):.3g} Hz moves in "
        f"another direction, or phase, than a mode square to direction {strong + 1} can (a floor, a cable?); "
        f"direction {strong + 1} alone is fitted. Add a ring-down along {axis}",
    )


def _alone(decay: Decay, axis: int) -> Fitted:
    """One free mode in one sensor."""
    own = decay.only(axis)
    valid = tuple(tuple(c.keep for c in channels) for channels in own.records)
    return climbed(Plan(False, "fast", Priors(), valid)(own), Priors(), True)


def _without_strong(weak: Averages, fitted: Fitted) -> Averages:
    """The weaker sensor with the stronger one's only mode, and an offset, regressed out."""
    backbone = fitted.model.backbone
    if backbone is None:
        return without_modes(weak, [complex(rate(float(fitted.omegas[0]), float(fitted.zetas[0])))], weak.time_s[0])
    t = weak.time_s - fitted.model.records[0].zero_s
    rates, level = fitted.model.mode_rates(fitted.theta, 0), backbone.amplitudes_m[0][0]
    wave, _ = averaged_course(rates, level, t, weak.spread_s2)
    basis = np.column_stack([wave.real, wave.imag, np.ones_like(t)])
    own, *_ = np.linalg.lstsq(basis, weak.value, rcond=None)
    return replace(weak, value=weak.value - basis @ own)


def _whitened(rest: Averages, fitted: Fitted) -> Averages:
    """What is left of a sensor, its noise's correlation taken out."""
    width = float(np.median(np.diff(rest.time_s)))
    modes = [(w / (2 * np.pi), z * w / (2 * np.pi)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    colour = colour_of(rest.value * rest.weight, rest.noise, width, modes)
    if colour is None:
        return rest
    weight = np.sqrt(rest.count) / colour.noise
    return replace(rest, value=colour.whitened(rest.value * weight) / weight, noise=colour.noise)


def _explained(channel: Averages) -> float:
    """χ² that the best decaying sinusoid explains."""
    centred = channel.value - channel.value.mean()
    return damped_periodogram([[channel]]).share * float(np.sum((centred * channel.weight) ** 2))


@dataclass(frozen=True)
class Resolution:
    """Whether a turned pair's axes can be told apart.

    Attributes:
        split, split_std: |λ1 − λ2| over the mean half-bandwidth ζω.
        axis_std_rad: of the axis angle, from the data alone.
        gain: of χ², over one mode in both sensors. An angle known to 3° makes it some hundreds; a small one means that
            the second mode follows noise.
    """

    split: float
    split_std: float
    axis_std_rad: float
    gain: float

    @property
    def certain(self) -> bool:
        """Whether the distance is known well enough to be believed."""
        return self.split >= CLOSE or self.split_std <= _CERTAIN * self.split

    @property
    def resolved(self) -> bool:
        """Two axes, with an angle known to 3° or better, and modes that stand apart beyond doubt."""
        # a mode that has hardly any amplitude can be anywhere: it seems far off, and nobody knows how far
        apart = self.split >= RESOLVED_SPLIT and self.certain
        return apart and self.axis_std_rad <= WALD_STD and self.gain >= RESOLVED_GAIN


def resolution(fitted: Fitted, priors: Priors, stretch: float, gain: float) -> Resolution:
    """How far apart the two modes are and how well their axes are known.

    Args:
        stretch: noise above white, as a factor of standard deviations.
        gain: of χ², over one mode in both sensors.
    """
    covariance = fitted.solution.minimum.covariance
    precision = 1 / float(covariance[BETA, BETA]) - 1 / priors.axis_rad**2
    std = np.inf if precision <= 0 else precision**-0.5
    own = np.r_[fitted.omegas[0], fitted.zetas[0], fitted.omegas[1], fitted.zetas[1]]
    # θ holds ln ω and ζ
    slope = np.array(
        [
            (_split(own + step) - _split(own - step)) / (2 * _STEP)
            for step in _STEP * np.diag(np.r_[own[0], 1.0, own[2], 1.0])
        ]
    )
    split_std = float(np.sqrt(max(0.0, slope @ covariance[:BETA, :BETA] @ slope)))
    return Resolution(_split(own), split_std * stretch, float(std) * stretch, gain)


def _split(modes: np.ndarray) -> float:
    """Distance of two modes' rates in half-bandwidths; ω1, ζ1, ω2, ζ2."""
    lams = [rate(float(modes[0]), float(modes[1])), rate(float(modes[2]), float(modes[3]))]
    return float(abs(lams[0] - lams[1]) / np.mean([max(-lam.real, 1e-12) for lam in lams]))
