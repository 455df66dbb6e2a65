"""Pendulum damping from the full coupled motion after a flick on a resting rotor or after a release at speed.

The pendulums excite the disk, and its reaction on them is of the order of one per cent. The encoder angles are
therefore fitted with the nonlinear model. Suspension, imbalance, start state and encoder zeros are free within their
prior uncertainties. The stated uncertainty includes these, and the effect of the encoders' rounding on slow pendulums.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import chdtri

from identification.curve import FittedCurve
from identification.fit_result import FitResult
from identification.least_squares import Minimum, minimise
from identification.pendulums.friction import Friction
from identification.pendulums.open_friction import DAMPING, Alone, OpenFriction, alone
from identification.pendulums.opening_locks import Opening
from identification.pendulums.quantiser import rounding_errors
from identification.samples import Averages, correlation_inflation
from identification.setting import ModelChoice, Setting


class Predict(Protocol):
    """(θ, last instant, whether derivatives are computed) ↦ both angles at every block up to it, and derivatives."""

    def __call__(self, theta: np.ndarray, end_s: float, slopes: bool = True, /) -> tuple[np.ndarray, np.ndarray]:
        """Return shapes (n,), one encoder after the other, and (n, p), which is not valid without derivatives."""
        ...


class _Evaluation(Protocol):
    """(θ, whether the Jacobian is computed) ↦ residual and Jacobian."""

    def __call__(self, theta: np.ndarray, slopes: bool = True, /) -> tuple[np.ndarray, np.ndarray]:
        """Return shapes (n,) and (n, p)."""
        ...


NOT_SEPARATED = (
    "{}: the {} does not separate viscous damping from dry friction: with both the fit does not converge; {}"
)
"""Message with the fields log, test and advice."""
_DRAWS = {"fast": 0, "balanced": 100, "reference": 400}
_JITTERS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)  # steps
_MAX_LEFT = float(chdtri(4, 1e-3))  # reduction of χ² by the four unknowns of friction that chance seldom exceeds
_WARNING_RATIO = 1.5  # ratio of standard deviations with and without friction that causes a warning
_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")


@dataclass(frozen=True)
class TransientFit(FitResult):
    """Estimate of a pendulum transient.

    Attributes:
        values: c3_Nms_per_rad, c4_Nms_per_rad.
        covariance: covariance of the values, shape (2, 2).
        intervals: 95 % intervals by name, c ± 1.96 standard deviations without negative values.
        curves: measured and fitted angles of both pendulums.
        chi2_per_dof: χ²/dof against the encoder's white noise.
        horizon_s: length of the fitted stretch, s.
        start_angles_rad: θ3, θ4 at the begin of the stretch, rad.
        model, model_table: smallest adequate model, and the compared models.
        warnings: limitations of the result, as sentences.
        friction: dry friction in the fit in addition to viscous damping; None if the readings do not show any.
        settled: whether the iteration converged. Values of a fit that did not converge must not be quoted.
        open_friction: damping and free friction for the joint estimate of several tests
            (identification.pendulums.open_friction); None if friction was not considered.
        undecided: warning that friction too small to be found has widened the intervals; "" if it has not.
        by_number: known number → derivative of ln c3, ln c4 by it, shape (2,), of the fit without free friction.
        number_std: known number that is free in the fit → its standard uncertainty, whose part is in the covariance.
        openings: instants at which the locks opened, of a release.
    """

    values: dict[str, float]
    covariance: np.ndarray
    intervals: dict[str, tuple[float, float]]
    curves: list[FittedCurve]
    chi2_per_dof: float
    horizon_s: float
    start_angles_rad: tuple[float, float]
    model: str
    model_table: list[ModelChoice]
    warnings: list[str]
    friction: Friction | None = None
    settled: bool = True
    open_friction: OpenFriction | None = None
    undecided: str = ""
    by_number: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    number_std: Mapping[str, float] = field(default_factory=dict[str, float])
    openings: tuple[Opening, ...] = ()

    @property
    def slopes(self) -> dict[str, np.ndarray]:
        """Known number → derivative of c3, c4 by it, shape (2,)."""
        if self.open_friction is not None:
            return {number: slope[DAMPING] for number, slope in self.open_friction.by_number.items()}
        c = np.array(list(self.values.values()))
        return {number: c * slope for number, slope in self.by_number.items()}


@dataclass(frozen=True)
class EncoderReadings:
    """One encoder's samples of a transient and their block averages.

    Attributes:
        time_s, angle_rad: time and angle of each sample, shape (n,).
        averages: averages over blocks of samples.
        step_rad: quantisation step of the encoder, rad; 0 if the angle is not quantised.
    """

    time_s: np.ndarray
    angle_rad: np.ndarray
    averages: Averages
    step_rad: float

    def between(self, start_s: float, end_s: float) -> EncoderReadings:
        """Return the blocks whose begin and mean time lie in a span, with their samples."""
        count = self.averages.count
        begins = self.time_s[np.r_[0, np.cumsum(count)[:-1]].astype(np.int64)]
        keep = (begins >= start_s) & (self.averages.time_s <= end_s)
        inside = np.repeat(keep, count)
        return EncoderReadings(self.time_s[inside], self.angle_rad[inside], self.averages.where(keep), self.step_rad)

    def rounding(self, curve_rad: np.ndarray, moves: np.ndarray, slopes_rad: np.ndarray, seed: int) -> np.ndarray:
        """Return the errors of the block averages by quantisation of curves, in their standard deviations.

        Args:
            curve_rad: curve at the blocks' mean times, shape (blocks,).
            moves: parameters of each draw minus those of the curve, shape (draws, p).
            slopes_rad: derivatives of the curve by the parameters, shape (p, blocks).
            seed: seed of the random numbers.
        Returns:
            Shape (draws, blocks).
        """
        blocks = self.averages
        if len(moves) > len(slopes_rad) + 1:  # the spline of a sum is the sum of splines, so each slope has one
            each = CubicSpline(blocks.time_s, np.vstack([curve_rad, slopes_rad]), axis=1)(self.time_s)
            samples = moves @ each[1:]
            samples += each[0]
        else:
            samples = CubicSpline(blocks.time_s, curve_rad + moves @ slopes_rad, axis=1)(self.time_s)
        errors = rounding_errors(samples, self.step_rad, self._jitter(samples[0]), seed)
        first = np.r_[0, np.cumsum(blocks.count)[:-1]].astype(np.int64)
        return np.add.reduceat(errors, first, axis=1) / blocks.count * blocks.weight

    def _jitter(self, curve_rad: np.ndarray) -> float:
        """Return the noise before the rounding, rad, for which readings of this curve flicker like those of the record.

        A pendulum that creeps through a step shows its jitter only there, so the noise of a moving encoder does not
        represent it.
        """
        wanted = float(np.var(np.diff(self.angle_rad, 3)))
        unit = np.random.default_rng(5).standard_normal(len(curve_rad)) * self.step_rad
        seen = [
            float(np.var(np.diff(np.round((curve_rad + j * unit) / self.step_rad) * self.step_rad, 3)))
            for j in _JITTERS
        ]
        return float(np.interp(wanted, np.maximum.accumulate(seen), _JITTERS)) * self.step_rad


@dataclass(frozen=True)
class OpenedFit:
    """Fit in c3, c4 instead of their logarithms.

    The torque is linear in damping and friction, so that the linear model holds further than a motion can be followed:
    to damping below 0, as by a test that hardly determines it, and past friction below 0, which drives a pendulum at
    rest to either side.

    Attributes:
        minimum: last point of the search; θ as of the problem, Jacobian and covariance by c3, c4 instead of their
            logarithms.
        values: c3, c4 and the other unknowns at the end of the linear model's step from there, shape (p,).
    """

    minimum: Minimum
    values: np.ndarray


@dataclass(frozen=True)
class TransientProblem:
    """Nonlinear least-squares problem of one transient; θ begins with ln c3, ln c4.

    Attributes:
        readings: readings of both encoders from the transient's start on.
        predict: (θ, last instant) ↦ both angles at every block up to it, one array after the other, shape (n,), and
            their derivatives (n, p).
        prior, prior_std: mean and standard deviation of independent Gaussian priors of θ, shape (p,); standard
            deviation inf for no prior.
    """

    readings: tuple[EncoderReadings, EncoderReadings]
    predict: Predict
    prior: np.ndarray
    prior_std: np.ndarray

    def cut(self, end_s: float) -> tuple[Averages, Averages]:
        """Return the data up to an instant."""
        first, second = (r.averages.between(-np.inf, end_s) for r in self.readings)
        return first, second

    def solve(self, start: np.ndarray, end_s: float, iterations: int = 25, plateau: float | None = None) -> Minimum:
        """Minimise the residuals of the data up to `end_s`.

        Args:
            start: start value of θ.
            end_s: last instant of the data, s.
            iterations: largest number of iterations.
            plateau: χ² per reading above which the iteration ends at steps of little gain, because the model is wrong.
        """
        return minimise(self._evaluation(end_s), start, iterations, plateau, self.prior_std)

    def opened(self, theta: np.ndarray, end_s: float) -> OpenedFit | None:
        """Return the fit with friction of any sign, from a fit without; None if the search ends where the linear model
        foresees more than chance.

        Args:
            theta: minimum of the fit without, extended by friction of 0.
            end_s: last instant of the data, s.
        """
        evaluate, unit = self._evaluation(end_s), np.ones(len(theta))
        unit[:2] = np.exp(theta[:2])

        def with_logarithms(at: np.ndarray) -> np.ndarray:
            return np.r_[np.log(at[:2]), at[2:]]

        def by_damping(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            if np.min(at[:2]) <= 0:
                return np.full(1, np.inf), np.zeros((1, len(at)))
            residual, jacobian = evaluate(with_logarithms(at))
            return residual, jacobian / np.r_[at[:2], np.ones(len(at) - 2)]

        found = minimise(by_damping, np.r_[unit[:2], theta[2:]], reach=self.prior_std * unit)
        if found.left > _MAX_LEFT * found.unit:
            return None
        return OpenedFit(replace(found, theta=with_logarithms(found.theta)), found.theta + found.step)

    def _evaluation(self, end_s: float) -> _Evaluation:
        """Return the function from θ to residual and Jacobian, prior rows last; inf if the motion is not finite."""
        data = self.cut(end_s)
        measured = np.concatenate([d.value for d in data])
        weight = np.concatenate([d.weight for d in data])
        known = np.isfinite(self.prior_std)
        rows = np.eye(len(self.prior))[known] / self.prior_std[known, None]

        def evaluate(theta: np.ndarray, slopes: bool = True, /) -> tuple[np.ndarray, np.ndarray]:
            angle, jacobian = self.predict(theta, end_s, slopes)
            residual = np.r_[(angle - measured) * weight, rows @ (theta - np.where(known, self.prior, 0.0))]
            if not (np.all(np.isfinite(angle)) and np.all(np.isfinite(jacobian))):
                return np.full(len(residual), np.inf), np.zeros((len(residual), len(theta)))
            return residual, np.concatenate([jacobian * weight[:, None], rows]) if slopes else jacobian

        return evaluate

    def residual(self, theta: np.ndarray, end_s: float) -> np.ndarray:
        """Return residuals at θ in standard deviations, prior rows last; inf if the motion is not finite."""
        return self._evaluation(end_s)(theta, False)[0]

    def angles(self, theta: np.ndarray, end_s: float) -> np.ndarray:
        """Return both angles at every block up to an instant, rad, shape (n,)."""
        return self.predict(theta, end_s, False)[0]

    def chi2_per_dof(self, minimum: Minimum, end_s: float) -> float:
        """Return χ²/dof of the data without the prior rows."""
        n = sum(len(d.time_s) for d in self.cut(end_s))
        data = minimum.residual[:n]
        return float(data @ data) / max(1, n - 6)

    def misfit(self, minimum: Minimum, end_s: float, draws: int = 12) -> float:
        """Return χ²/dof over that of noise and of the encoders' rounding of this curve; 1 for a correct model."""
        rounding = self.rounding(minimum, end_s, draws)
        level = 1.0 if rounding is None else max(1.0, float(np.mean(rounding**2)))
        return self.chi2_per_dof(minimum, end_s) / level

    def rounding(self, minimum: Minimum, end_s: float, draws: int) -> np.ndarray | None:
        """Return rounding errors of all block averages in their standard deviations, for curves near the fitted one.

        Returns:
            Shape (draws, n), or None if an encoder is not quantised or no draws are requested.
        """
        parts = [r.between(-np.inf, end_s) for r in self.readings]
        if draws == 0 or not all(p.step_rad > 0 for p in parts):
            return None
        sizes = [len(p.averages.time_s) for p in parts]
        weight = np.concatenate([p.averages.weight for p in parts])
        curve = np.concatenate([p.averages.value for p in parts]) + minimum.residual[: sum(sizes)] / weight
        moves = np.random.default_rng(3).standard_normal((draws, len(minimum.theta))) @ _root(minimum.covariance).T
        slopes = minimum.jacobian[: sum(sizes)].T / weight
        own = (slice(0, sizes[0]), slice(sizes[0], sum(sizes)))
        return np.hstack(
            [p.rounding(curve[s], moves, slopes[:, s], 4 + i) for i, (p, s) in enumerate(zip(parts, own, strict=True))]
        )

    def covariance(
        self, minimum: Minimum, end_s: float, setting: Setting, wanted: Sequence[int] = (0, 1)
    ) -> np.ndarray:
        """Return the covariance of components of θ by priors and rounding, stretched by the misfit.

        Args:
            minimum: minimum of the problem for data up to `end_s`.
            end_s: last instant of the data, s.
            setting: determines the number of rounding draws.
            wanted: m indices in θ, by default those of ln c3, ln c4.
        Returns:
            Shape (m, m).
        """
        own_columns = list(wanted)
        sizes = [len(c.time_s) for c in self.cut(end_s)]
        n = sum(sizes)
        own = (slice(0, sizes[0]), slice(sizes[0], n))
        together = max(correlation_inflation(minimum.residual[part]) for part in own)
        covariance, white, level = minimum.covariance[np.ix_(own_columns, own_columns)], 1.0, 1.0
        errors = self.rounding(minimum, end_s, _DRAWS[setting])
        if errors is not None:
            wrong = errors @ (minimum.jacobian[:n] @ minimum.covariance[:, own_columns])
            white = max(correlation_inflation(e[part]) for e in errors[:10] for part in own)
            level = max(1.0, float(np.mean(errors**2)))
            priors = minimum.jacobian[n:] @ minimum.covariance[:, own_columns]
            covariance = wrong.T @ wrong / len(wrong) + priors.T @ priors
        chi2 = self.chi2_per_dof(minimum, end_s) / level
        return covariance * max(1.0, together / white) ** 2 * max(1.0, chi2 / (1 + 3 * np.sqrt(2 / n)))

    def result(
        self, minimum: Minimum, end_s: float, label: str, angles_at: int, setting: Setting, table: list[ModelChoice]
    ) -> TransientFit:
        """Return the reported result of a minimum.

        Args:
            minimum: minimum of the problem for data up to `end_s`.
            end_s: last instant of the data, s.
            label: name of the test for curves and warnings.
            angles_at: index of θ3 in θ, followed by θ4.
            setting: determines the number of rounding draws.
            table: compared models.
        """
        chi2, misfit = self.chi2_per_dof(minimum, end_s), self.misfit(minimum, end_s)
        curves, at = list[FittedCurve](), 0
        for name, channel in zip("AB", self.cut(end_s), strict=True):
            own = minimum.residual[at : at + len(channel.time_s)]
            at += len(own)
            fitted = channel.value + own / channel.weight
            curves.append(FittedCurve(f"{label}: {name}", "rad", channel.time_s, channel.value, fitted))
        c = np.exp(minimum.theta[:2])
        covariance = self.covariance(minimum, end_s, setting)
        start = (float(minimum.theta[angles_at]), float(minimum.theta[angles_at + 1]))
        warnings: list[str] = []
        if misfit > 1.3:
            warnings.append(
                f"{label}: residuals exceed the encoder noise: χ²/dof {chi2:.3g}, {misfit:.3g} times that of noise and "
                "rounding; standard deviations are scaled up"
            )
        model = next((row.name for row in table if row.chosen), "coupled motion of disk and pendulums")
        return TransientFit(
            dict(zip(_NAMES, c.tolist(), strict=True)),
            covariance * np.outer(c, c),
            intervals_of(c, covariance * np.outer(c, c)),
            curves,
            chi2,
            end_s - self.readings[0].averages.time_s[0],
            start,
            model,
            table,
            warnings,
            settled=minimum.converged,
        )


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return R with R Rᵀ equal to a covariance of any scales; directions lost by rounding have no spread."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.clip(values, 0.0, None))


def with_open_friction(fit: TransientFit, found: OpenFriction, label: str) -> TransientFit:
    """Return a fit with values and intervals for free friction.

    Args:
        fit: fit of the transient.
        found: damping and free friction.
        label: name of the test for the warning.
    """
    free: Alone = alone(found)
    wider, warning = float(np.max(np.sqrt(np.diag(free.covariance)) / free.known_std)), ""
    if wider > _WARNING_RATIO:
        limits = (
            f"{name} below {a:.2g} and {b:.2g} {unit}"
            for name, unit, (a, b) in (
                ("a torque", "N m", free.torque_Nm),
                ("with the contact force", "kg m²", free.contact_kg_m2),
            )
        )
        warning = (
            f"{label}: by itself it does not exclude dry friction of A and B ({', '.join(limits)}, 95 %), which makes "
            f"c3 and c4 {wider:.2g} times less certain than viscous damping alone would be, as their intervals state; "
            "a spin-down and releases at two speeds (rig test RIG point A, then B) together decide"
        )
    return replace(
        fit,
        values=dict(zip(_NAMES, free.damping.tolist(), strict=True)),
        covariance=free.covariance,
        intervals=intervals_of(free.damping, free.covariance),
        warnings=[*fit.warnings, warning] if warning else fit.warnings,
        open_friction=found,
        undecided=warning,
    )


def intervals_of(c: np.ndarray, covariance: np.ndarray) -> dict[str, tuple[float, float]]:
    """Return 95 % intervals of c3, c4; damping is not negative."""
    reach = 1.96 * np.sqrt(np.diag(covariance))
    low, high = np.maximum([c - reach, c + reach], 0.0).tolist()
    return dict(zip(_NAMES, zip(low, high, strict=True), strict=True))
