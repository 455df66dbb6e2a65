"""Spin-down on a rotor at rest: damping of a pendulum from the decay of its speed, with a test for dry friction.

The model is in closed form (identification.pendulums.run_down). Least squares use about the first five time constants,
because the encoder's rounding is constant instead of noise after them. The effect of rounding on the estimate is found
by quantising the fitted curve (identification.pendulums.quantiser). If a run-down has only a few dozen samples, the
test for dry friction uses the likelihood of the integer readings over all of it. The reaction of the disk is neglected
here; identification.pendulums.transient includes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from daq.signals.threads import on_one_thread
from identification.curve import FittedCurve
from identification.errors import FitFailed, NotIdentifiable
from identification.fit_result import FitResult
from identification.pendulums.decline import decline_of
from identification.pendulums.quantiser import quantised_posterior
from identification.pendulums.rounded_fit import FittedRunDown, cut, plain_fit, rounded_fit
from identification.pendulums.run_down import RunDown, fit_run_down, from_stop, run_down_angle, stop_time
from identification.samples import checked_times
from identification.setting import ModelChoice, Setting, check_setting
from rig_basics.texts import number_of

FRICTION_P = 5e-4
"""Probability by chance below which dry friction counts as found."""
_WHOLE = 9.0  # length of a complete run-down in time constants
_SHORT = {"fast": 0, "balanced": 450, "reference": 4000}  # largest number of samples for the integer likelihood
_SWEEPS = {"fast": 0, "balanced": 250, "reference": 1000}
_DOMINANT_SHARE = 0.5  # share of dry friction above which it dominates the run-down
_MAX_LOG_RATE_STD = 0.3  # standard deviation of ln λ above which the viscous damping is not determined
_SUFFICIENT_TIME_CONSTANTS = 4.0  # length with nearly all information on the rate
_MAX_RESIDUAL_RATIO = 0.02  # ratio of residual to travel above which a model is rejected


@dataclass(frozen=True)
class SpinDownFit(FitResult):
    """Estimate of one pendulum's spin-down.

    Attributes:
        values: rate_per_s (λ) and start_speed_rad_s; with an inertia c_Nms_per_rad; if friction is found
            coulomb_rad_per_s2 (M_c/J) and, with an inertia, coulomb_Nm (M_c).
        covariance: covariance in the order of the values, shape (n, n).
        intervals: 95 % intervals by name.
        friction_p: one-sided probability of an estimate of friction this large without friction.
        model, model_table: smallest adequate model, and the compared models. The criterion is friction_p, see
            docs/theory/pendulum_damping.md.
        warnings: limitations of the result, as sentences.
        curve: measured and fitted angle of the stretch.
        start_s, end_s: begin and end of the stretch, s.
        chi2_per_dof: χ²/dof against the encoder's white noise.
    """

    values: dict[str, float]
    covariance: np.ndarray
    intervals: dict[str, tuple[float, float]]
    friction_p: float
    model: str
    model_table: list[ModelChoice]
    warnings: list[str]
    curve: FittedCurve
    start_s: float
    end_s: float
    chi2_per_dof: float

    @property
    def curves(self) -> list[FittedCurve]:
        """Fitted stretch as a list, as for every fit."""
        return [self.curve]


@on_one_thread
def fit_spin_down(
    time_s: np.ndarray, angle_rad: np.ndarray, inertia_kg_m2: float | None = None, *, setting: Setting = "balanced"
) -> SpinDownFit:
    """Fit one pendulum's run-down on a rotor at rest.

    Args:
        time_s, angle_rad: time and angle relative to the rotor, wrapped or unwrapped, shape (n,). NaN is left out, and
            samples are sorted by time. Samples before the fastest instant and after a second push are ignored.
        inertia_kg_m2: J > 0; adds the damping c = λ J and the friction torque to the values.
        setting: fast assumes white rounding noise and stretches the intervals if it is not white. balanced quantises
            the fitted curve. reference uses the likelihood of the integer readings for values and intervals if the
            run-down has at most 4000 samples.
    Raises:
        NotIdentifiable: the pendulum hardly moves or stops within too few samples, or the inertia is not positive.
        FitFailed: the fit does not converge, the residuals are far above the noise, or dry friction hides the viscous
            damping.
    Source: docs/theory/pendulum_damping.md.

    Example:
        >>> import numpy as np
        >>> from identification import fit_spin_down
        >>> time, step = np.arange(0.0, 12.0, 0.01), 2 * np.pi / 4096
        >>> angle = step * np.round(50.0 * (1 - np.exp(-time / 4)) / step)  # an encoder's readings
        >>> fit = fit_spin_down(time, angle, inertia_kg_m2=2e-4)
        >>> round(fit.values["rate_per_s"], 4), round(fit.values["c_Nms_per_rad"], 8)
        (0.25, 5e-05)
    """
    check_setting(setting)
    if inertia_kg_m2 is not None and not 0 < inertia_kg_m2 < np.inf:
        raise NotIdentifiable(f"spin-down: an inertia above 0 kg m² is needed, got {inertia_kg_m2:g}; leave it out")
    time_s = checked_times(time_s, any_order=True)
    whole = decline_of(time_s, angle_rad)
    start_s, data, theta = _settled(whole)
    dry = _with_friction(data, theta, setting)
    # with dominant friction the viscous fit is only a row of the table, on the same stretch
    viscous = (
        rounded_fit(data, theta[:3], setting) if dry.theta[3] < _DOMINANT_SHARE else plain_fit(dry.data, theta[:3])
    )
    left, travel = np.sqrt(dry.chi2_per_dof) * data.noise_rad, float(np.ptp(data.angle_rad))
    if left > _MAX_RESIDUAL_RATIO * travel:
        raise FitFailed(
            f"spin-down: a decay with dry friction leaves residuals of {left:.2g} rad for {travel:.3g} rad of travel, "
            f"the noise is {data.noise_rad:.2g} rad; check that the rotor is held still"
        )
    p, draws = _friction(data, viscous, dry, setting)
    found = p < FRICTION_P
    chosen = dry if found else viscous
    fit = _result(chosen, found, p, inertia_kg_m2, start_s, draws, (viscous, dry))
    fit.warnings.extend(_cut_short(whole, chosen, float(np.nanmax(time_s))))
    return fit


def _with_friction(data: RunDown, theta: np.ndarray, setting: Setting) -> FittedRunDown:
    """Fit viscous damping and dry friction; raise if friction stops the pendulum before viscous damping is visible."""
    part = cut(data, theta)
    first = fit_run_down(part, theta)
    if theta[3] > _DOMINANT_SHARE and not (first.converged and first.covariance[2, 2] < _MAX_LOG_RATE_STD**2):
        raise FitFailed(
            "spin-down: dry friction dominates: the pendulum stops before its viscous damping shows (χ²/dof "
            f"{first.cost / len(part.time_s):.3g}); clean or replace the bearing, or flick harder"
        )
    return rounded_fit(data, theta, setting)


def _settled(whole: RunDown) -> tuple[float, RunDown, np.ndarray]:
    """Return begin and samples of the run-down after the hand has released the pendulum, and a first fit of it."""
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
    raise NotIdentifiable(
        "no stretch of the record is a free run-down: the hand does not release the pendulum, or the rotor moves; "
        "record again with a rotor that is held still"
    )


def _noise(data: RunDown) -> tuple[float, float]:
    return data.noise_rad, data.step_rad


def first_fit(data: RunDown) -> np.ndarray:
    """Return θ0, v0, ln λ, h without start values: by the time of decay to 1/e, and fits over the resulting stretch."""
    t, angle = data.time_s, data.angle_rad
    left = np.abs(np.mean(angle[-5:]) - angle)
    tau = max(float(t[np.argmax(left < left[0] / np.e)]), 5 * float(np.median(np.diff(t))))
    theta = np.r_[angle[0], (np.mean(angle[-5:]) - angle[0]) / tau, -np.log(tau)]
    for _ in range(3):
        part = cut(data, theta)
        if len(part.time_s) < 20:
            raise NotIdentifiable(
                f"the pendulum runs down within {number_of(len(part.time_s), 'sample')}; flick it harder"
            )
        theta = fit_run_down(part, theta).theta
        if not -np.log(20 * (t[-1] + 1e-9)) < theta[2] < np.log(1e6):
            raise NotIdentifiable("the pendulum's speed does not fall; record longer")
    fits = [fit_run_down(cut(data, theta), np.r_[theta, 0.0])]
    stopped = from_stop(data)
    if stopped is not None:  # a start without friction does not converge to large friction
        fits.append(fit_run_down(cut(data, stopped), stopped))
    return min(fits, key=lambda m: m.cost / len(m.residual)).theta


def _friction(
    data: RunDown, viscous: FittedRunDown, dry: FittedRunDown, setting: Setting
) -> tuple[float, np.ndarray | None]:
    """Return friction_p, and samples of the likelihood of the integer readings if it is used for the values."""
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
    """Return the names of the values, and the function from (θ0, v0, ln λ, h) to the values."""
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
    curve = FittedCurve(
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
    """Return a warning if the record of the run-down ends long before the motion."""
    lasts, rate = float(chosen.data.time_s[-1]), float(np.exp(chosen.theta[2]))
    share = float(chosen.theta[3]) if len(chosen.theta) > 3 else 0.0
    if lasts >= min(_SUFFICIENT_TIME_CONSTANTS / rate, stop_time(rate, share)):
        return []
    end_s = float(whole.time_s[-1])
    pushed = record_end_s - end_s > 0.01 * (record_end_s - float(whole.time_s[0]))
    why = "a second push is seen there" if pushed else "the record ends there"
    return [
        f"the free run-down ends at {end_s:.4g} s after {lasts * rate:.2g} time constants ({why}); the intervals are "
        f"wider than with {_SUFFICIENT_TIME_CONSTANTS:g} time constants, which contain nearly all information"
    ]


def _model_table(viscous: FittedRunDown, dry: FittedRunDown, p: float, friction: bool) -> list[ModelChoice]:
    limit = dry.theta[3] + 1.645 * np.sqrt(dry.covariance[3, 3])
    why = f"friction share {dry.theta[3]:.2g} of the first torque, below {limit:.2g} at 95 %; p = {p:.2g}"
    verdict = f"p {'<' if friction else '≥'} {FRICTION_P:g}"
    return [
        ModelChoice("viscous damping", 3, viscous.cost + 2 * 3, not friction, f"{verdict} for additional friction"),
        ModelChoice("viscous damping and dry friction", 4, dry.cost + 2 * 4, friction, why),
    ]


def _warnings(chosen: FittedRunDown, dry: FittedRunDown, friction: bool, p: float) -> list[str]:
    warnings: list[str] = []
    if friction:
        warnings.append(
            f"the run-down is not purely viscous (p = {p:.1g}): dry friction takes {dry.theta[3]:.2g} ± "
            f"{np.sqrt(dry.covariance[3, 3]):.1g} of the first torque and is in the fit"
        )
    if chosen.inflation > 1.3:
        warnings.append(
            f"residuals exceed the encoder's noise or are correlated (χ²/dof {chosen.chi2_per_dof:.3g}): the rotor may "
            f"move; standard deviations are scaled up by {chosen.inflation:.2g}"
        )
    return warnings
