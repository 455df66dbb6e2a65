"""Spin-down on a rotor at rest: a pendulum's damping from the decay of its speed, dry friction tested and estimated.

The model is closed (identification.pendulums.run_down). Least squares use the first five time constants: beyond them
the encoder's rounding is one constant and no noise. What the rounding still does to the estimate is found by sending
the fitted curve through a quantiser (identification.pendulums.quantiser), and where a decline is only a few dozen
samples long, dry friction is looked for with the likelihood of whole steps over all of it. The disk's reaction is left
out here: it enters in identification.pendulums.transient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from daq.signals.threads import on_one_thread
from identification.curve import Curve
from identification.errors import FitFailed, NotIdentifiable
from identification.pendulums.decline import decline_of
from identification.pendulums.quantiser import quantised_posterior
from identification.pendulums.rounded_fit import FittedRunDown, cut, plain_fit, rounded_fit
from identification.pendulums.run_down import RunDown, fit_run_down, from_stop, run_down_angle, stop_time
from identification.setting import ModelChoice, Setting, check_setting

FRICTION_P = 5e-4  # a chance below it is friction
_WHOLE = 9.0  # time constants: all that a decline shows
_SHORT = {"fast": 0, "balanced": 450, "reference": 4000}  # samples up to which whole steps are worth their likelihood
_SWEEPS = {"fast": 0, "balanced": 250, "reference": 1000}
_MUCH = 0.5  # share of dry friction from which it rules the run-down
_UNTOLD = 0.3  # ln λ, standard deviation
_ENOUGH = 4.0  # time constants that hold nearly all a decline says of its rate
_WRONG = 0.02  # residual over travel of a model that is none


@dataclass(frozen=True)
class SpinDownFit:
    """What one pendulum's spin-down says.

    Attributes:
        values: rate_per_s (λ), start_speed_rad_s; with an inertia c_Nms_per_rad; where friction is found
            coulomb_rad_per_s2 (M_c/J) and, with an inertia, coulomb_Nm (M_c).
        covariance: shape (n, n), in the values' order.
        intervals: 95 % by name.
        friction_p: chance of friction this large without friction (one-sided).
        model, model_table: the smallest adequate model in words; the criterion of both is friction_p's complement, see
            docs/theory/pendulum_damping.md.
        warnings: what a reader must know.
        curve: the fitted stretch.
        start_s, end_s: that stretch.
        chi2_per_dof: residuals against the encoder's white noise.
    """

    values: dict[str, float]
    covariance: np.ndarray
    intervals: dict[str, tuple[float, float]]
    friction_p: float
    model: str
    model_table: list[ModelChoice]
    warnings: list[str]
    curve: Curve
    start_s: float
    end_s: float
    chi2_per_dof: float

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def curves(self) -> list[Curve]:
        """The fitted stretch as a list, as every fit has it."""
        return [self.curve]


@on_one_thread
def fit_spin_down(
    time_s: np.ndarray, angle_rad: np.ndarray, inertia_kg_m2: float | None = None, *, setting: Setting = "balanced"
) -> SpinDownFit:
    """Fit one pendulum's run-down on a rotor at rest.

    Args:
        time_s, angle_rad: shape (n,); angle relative to the rotor, wrapped or not; NaN is left out; samples out of
            order are sorted by time. What comes before the fastest instant and after a second push is ignored.
        inertia_kg_m2: J > 0; adds the damping c = λ J and the friction's torque.
        setting: fast takes the rounding for white noise and stretches intervals where it is not; balanced sends the
            curve through the quantiser; reference takes values and intervals from the likelihood of whole steps
            wherever the decline has at most 4000 samples.
    Raises:
        NotIdentifiable: the pendulum hardly moves, or stops within too few samples; the inertia is not positive.
        FitFailed: no convergence, residuals far above the noise, or dry friction that hides the viscous damping.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    if inertia_kg_m2 is not None and not 0 < inertia_kg_m2 < np.inf:
        raise NotIdentifiable(f"spin-down: an inertia above 0 kg m² is needed, got {inertia_kg_m2:g}; leave it out")
    whole = decline_of(time_s, angle_rad)
    start_s, data, theta = _settled(whole)
    dry = _with_friction(data, theta, setting)
    # beside much friction no more than a row of the table, on the same stretch
    viscous = rounded_fit(data, theta[:3], setting) if dry.theta[3] < _MUCH else plain_fit(dry.data, theta[:3])
    left, travel = np.sqrt(dry.chi2_per_dof) * data.noise_rad, float(np.ptp(data.angle_rad))
    if left > _WRONG * travel:
        raise FitFailed(
            f"spin-down: a decay with dry friction leaves residuals of {left:.2g} rad of {travel:.3g} rad of travel, "
            f"the noise is {data.noise_rad:.2g} rad; is the rotor held still?"
        )
    p, draws = _friction(data, viscous, dry, setting)
    found = p < FRICTION_P
    chosen = dry if found else viscous
    fit = _result(chosen, found, p, inertia_kg_m2, start_s, draws, (viscous, dry))
    fit.warnings.extend(_cut_short(whole, chosen, float(np.nanmax(time_s))))
    return fit


def _with_friction(data: RunDown, theta: np.ndarray, setting: Setting) -> FittedRunDown:
    """Both kinds of damping; refused where dry friction stops the pendulum before the viscous kind shows."""
    part = cut(data, theta)
    first = fit_run_down(part, theta)
    if theta[3] > _MUCH and not (first.converged and first.covariance[2, 2] < _UNTOLD**2):
        raise FitFailed(
            "spin-down: dry friction dominates: the pendulum stops before its viscous damping shows (χ²/dof "
            f"{first.cost / len(part.time_s):.3g}); clean or replace the bearing, or flick harder"
        )
    return rounded_fit(data, theta, setting)


def _settled(whole: RunDown) -> tuple[float, RunDown, np.ndarray]:
    """The decline from where the hand has let go, and a first fit of it."""
    begin, theta = 0, None
    for _ in range(60):
        data = RunDown(whole.time_s[begin:] - whole.time_s[begin], whole.angle_rad[begin:], *_noise(whole))
        if len(data.time_s) < 40:
            break
        theta = first_fit(data)
        part = cut(data, theta)
        residual = (part.angle_rad - run_down_angle(part.time_s, theta)[0]) / part.noise_rad
        m = max(10, len(residual) // 30)
        level, later = float(np.mean(residual[:m] ** 2)), float(np.mean(residual[m:] ** 2))
        if level < (1 + 6 * np.sqrt(2 / m)) * max(1.0, later):
            return float(whole.time_s[begin]), data, theta
        begin += max(3, m // 2)
    raise NotIdentifiable("no stretch of the record is a free run-down: the hand never lets go, or the rotor moves")


def _noise(data: RunDown) -> tuple[float, float]:
    return data.noise_rad, data.step_rad


def first_fit(data: RunDown) -> np.ndarray:
    """θ0, v0, ln λ, h from nothing: the time in which the travel left falls to 1/e, then the fit on what that cuts."""
    t, angle = data.time_s, data.angle_rad
    left = np.abs(np.mean(angle[-5:]) - angle)
    tau = max(float(t[np.argmax(left < left[0] / np.e)]), 5 * float(np.median(np.diff(t))))
    theta = np.r_[angle[0], (np.mean(angle[-5:]) - angle[0]) / tau, -np.log(tau)]
    for _ in range(3):
        part = cut(data, theta)
        if len(part.time_s) < 20:
            raise NotIdentifiable(f"the pendulum runs down within {len(part.time_s)} samples; flick it harder")
        theta = fit_run_down(part, theta).theta
        if not -np.log(20 * (t[-1] + 1e-9)) < theta[2] < np.log(1e6):
            raise NotIdentifiable("the pendulum's speed does not fall; record longer")
    fits = [fit_run_down(cut(data, theta), np.r_[theta, 0.0])]
    stopped = from_stop(data)
    if stopped is not None:  # much dry friction is out of the reach of a start without any
        fits.append(fit_run_down(cut(data, stopped), stopped))
    return min(fits, key=lambda m: m.cost / len(m.residual)).theta


def _friction(
    data: RunDown, viscous: FittedRunDown, dry: FittedRunDown, setting: Setting
) -> tuple[float, np.ndarray | None]:
    """Chance of this much friction without friction, and draws from the likelihood of whole steps where it was used."""
    share, spread = float(dry.theta[3]), float(np.sqrt(dry.covariance[3, 3]))
    p = float(ndtr(-share / spread))
    whole = data.until(_WHOLE * np.exp(-viscous.theta[2]))
    if not data.step_rad or len(whole.time_s) > _SHORT[setting] or dry.inflation > 1.5:
        return p, None
    draws = quantised_posterior(whole, dry.theta, dry.covariance, _SWEEPS[setting])
    p = (np.count_nonzero(draws[:, 3] <= 0) + 0.5) / (len(draws) + 1.0)
    if setting != "reference":
        return p, None
    if p >= FRICTION_P:
        draws = quantised_posterior(whole, viscous.theta, viscous.covariance, _SWEEPS[setting])
    return p, draws


def _reported(inertia: float | None, friction: bool) -> tuple[list[str], Callable[[np.ndarray], np.ndarray]]:
    """Names, and the map from (θ0, v0, ln λ, h) to their values."""
    names = ["rate_per_s", "start_speed_rad_s"]
    names += ["coulomb_rad_per_s2"] if friction else []
    names += (["c_Nms_per_rad"] + (["coulomb_Nm"] if friction else [])) if inertia is not None else []

    def values(theta: np.ndarray) -> np.ndarray:
        rate, speed = np.exp(theta[..., 2]), theta[..., 1]
        out = [rate, speed]
        dry = rate * theta[..., 3] * np.abs(speed) if friction else np.zeros_like(rate)
        out += [dry] if friction else []
        out += ([rate * inertia] + ([dry * inertia] if friction else [])) if inertia is not None else []
        return np.stack(out, axis=-1)

    return names, values


def _result(
    chosen: FittedRunDown,
    friction: bool,
    p: float,
    inertia: float | None,
    start_s: float,
    draws: np.ndarray | None,
    both: tuple[FittedRunDown, FittedRunDown],
) -> SpinDownFit:
    names, of = _reported(inertia, friction)
    if draws is not None:
        sample = of(draws)
        values, covariance = sample.mean(axis=0), np.atleast_2d(np.cov(sample.T))
        low, high = np.quantile(sample, [0.025, 0.975], axis=0)
    else:
        theta = np.array(chosen.theta if friction else np.r_[chosen.theta[:3], 0.0])
        values, jacobian = of(theta), np.zeros((len(names), len(chosen.theta)))
        for j in range(len(chosen.theta)):  # smooth products of few numbers: a central difference is exact to 1e-10
            moved = np.zeros(4)
            moved[j] = 1e-5 * max(1e-3, abs(theta[j]))
            jacobian[:, j] = (of(theta + moved) - of(theta - moved)) / (2 * moved[j])
        covariance = jacobian @ chosen.covariance @ jacobian.T
        half = 1.96 * np.sqrt(np.diag(covariance))
        low, high = values - half, values + half
    data = chosen.data
    curve = Curve(
        "spin-down", "rad", start_s + data.time_s, data.angle_rad, run_down_angle(data.time_s, chosen.theta)[0]
    )
    end_s = start_s + float(data.time_s[-1])
    model = "viscous damping and dry friction" if friction else "viscous damping"
    return SpinDownFit(
        dict(zip(names, values.tolist(), strict=True)),
        covariance,
        dict(zip(names, zip(low.tolist(), high.tolist(), strict=True), strict=True)),
        p,
        model,
        _model_table(*both, p, friction),
        _warnings(chosen, both[1], friction, p),
        curve,
        start_s,
        end_s,
        chosen.chi2_per_dof,
    )


def _cut_short(whole: RunDown, chosen: FittedRunDown, record_end_s: float) -> list[str]:
    """A warning where the decline ends long before its motion does."""
    lasts, rate = float(chosen.data.time_s[-1]), float(np.exp(chosen.theta[2]))
    share = float(chosen.theta[3]) if len(chosen.theta) > 3 else 0.0
    if lasts >= min(_ENOUGH / rate, stop_time(rate, share)):
        return []
    end_s = float(whole.time_s[-1])
    pushed = record_end_s - end_s > 0.01 * (record_end_s - float(whole.time_s[0]))
    why = "a second push is seen there" if pushed else "the record ends there"
    return [
        f"the free run-down ends at {end_s:.4g} s after {lasts * rate:.2g} time constants ({why}); {_ENOUGH:g} hold "
        "nearly all it says: the intervals are wider than they need be"
    ]


def _model_table(viscous: FittedRunDown, dry: FittedRunDown, p: float, friction: bool) -> list[ModelChoice]:
    limit = dry.theta[3] + 1.645 * np.sqrt(dry.covariance[3, 3])
    why = f"friction share {dry.theta[3]:.2g} of the first torque, below {limit:.2g} at 95 %; p = {p:.2g}"
    verdict = f"p {'<' if friction else '≥'} {FRICTION_P:g}"
    return [
        ModelChoice("viscous damping", 3, viscous.cost + 2 * 3, not friction, f"{verdict} for friction beside it"),
        ModelChoice("viscous damping and dry friction", 4, dry.cost + 2 * 4, friction, why),
    ]


def _warnings(chosen: FittedRunDown, dry: FittedRunDown, friction: bool, p: float) -> list[str]:
    warnings = []
    if friction:
        warnings.append(
            f"the run-down is not purely viscous (p = {p:.1g}): dry friction takes {dry.theta[3]:.2g} ± "
            f"{np.sqrt(dry.covariance[3, 3]):.1g} of the first torque and is in the fit"
        )
    if chosen.inflation > 1.3:
        warnings.append(
            f"residuals exceed the encoder's noise or hang together (χ²/dof {chosen.chi2_per_dof:.3g}): the rotor may "
            f"move; standard deviations are scaled up by {chosen.inflation:.2g}"
        )
    return warnings
