"""Linear model of one release in the unknowns it shares with other tests; the unknowns of its own are eliminated.

At the end of a fit the weighted residual is r(q, u) ≈ r* + S (q − q*) + A (u − u*), including the prior rows for the
release's own unknowns u. The unknowns u are eliminated by projection with an orthonormal basis of A. With its columns
scaled by the smallest relevant errors, the remainder of S is U Σ Vᵀ. The rows −Uᵀ r(q0) contain all information of the
release about q. They have unit covariance, and their derivative by the assumed q0 is −Uᵀ S.
Source: docs/theory/validation.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.least_squares import Minimum
from identification.pendulums.release_problem import TORQUES, RecordedRelease, Shape
from identification.pendulums.transient import TransientProblem
from identification.samples import correlation_inflation
from rig_basics.arrays import Array
from rig_configs.known import BOW, DRAG, FRICTION, INDEX, ZERO_A, ZERO_B, physical_numbers
from rig_configs.suspension_terms import TERMS

PLACES: Mapping[str, int] = {
    "c3_Nms_per_rad": 0,
    "c4_Nms_per_rad": 1,
    "k1_N_per_m": 11,
    "k2_N_per_m": 12,
    "zeta1": 13,
    "zeta2": 14,
    "SP_kg_m": 15,
    ZERO_A: 4,
    ZERO_B: 5,
}
"""Indices of the shared unknowns in a release's θ; parameters are in it as their logarithms."""

_FRICTION_LAW_STD = 0.1  # relative standard deviation of a friction torque by errors of any friction law
_DRAWS = 60
_MIN_ROW_SIZE = 1.0  # smallest size of a row in standard deviations, for the smallest relevant errors
# Steps of a number, of the index angle, of a bow, of the drag over the damping (s) and of the suspension's terms (1/m²,
# s/m). These are forward differences of motions from an unstable equilibrium, where 0.1 µm of bow is 800 standard
# deviations at A, and its square term 4 % of a derivative. The rounding error is 1e-9 of a derivative.
_STEP, _TURN_RAD, _BOW_STEP_M, _DRAG_STEP_S = 1e-6, 1e-6, 1e-10, 1e-6
_TERM_STEPS: Mapping[str, float] = dict(zip(TERMS, (0.1, 0.1, 3e-5, 3e-5), strict=True))
_OPEN_NUMBERS = ("pendulums.a.mass_kg", "pendulums.a.length_m", "pendulums.b.mass_kg", "pendulums.b.length_m")
_NUMBER_STD, _FURTHEST = 0.02, 0.5  # relative prior standard deviation and largest relative change of these numbers
_INDEPENDENT = 1e-9  # smallest singular value of independent columns, over the largest one


@dataclass(frozen=True)
class Condensed:
    """Information of a release on the shared unknowns.

    Attributes:
        values: measured − predicted, in standard deviations, shape (m,).
        own: covariance of the values, shape (m, m).
        slopes: shared unknown → derivative of the values by its assumed value, shape (m,): by the logarithm of a
            parameter, by a number in its unit.
        misfit: misfit of the readings with all parameters free.
        has_friction: whether the release is followed only with dry friction, whose torques are then the last two rows.
    """

    values: Array
    own: Array
    slopes: Mapping[str, Array]
    misfit: Misfit
    has_friction: bool = False


@dataclass(frozen=True)
class Misfit:
    """Residuals of a fit with all parameters free in excess of noise and rounding.

    Attributes:
        stretch: factor on the variance of the release's rows.
        chi2_per_dof: χ²/dof of the readings.
    """

    stretch: float
    chi2_per_dof: float


@dataclass(frozen=True)
class FittedRelease:
    """Fit of a release.

    Attributes:
        release, problem, shape: release, its least-squares problem and the shape of its dry friction.
        minimum: minimum of the problem.
        horizons_s: ends of the growing stretches of the fit, s.
        moved: number of the rig file → its value in the release minus that in the file.
        misfit: misfit of the fit with all parameters free, if this is another fit.
    """

    release: RecordedRelease
    problem: TransientProblem
    shape: Shape | None
    minimum: Minimum
    horizons_s: Sequence[float]
    moved: Mapping[str, float] = field(default_factory=dict[str, float])
    misfit: Misfit | None = None

    @property
    def end_s(self) -> float:
        """End of the fitted stretch, s."""
        return self.horizons_s[-1]

    @property
    def readings(self) -> int:
        """Number of block averages."""
        return sum(len(c.time_s) for c in self.problem.cut(self.end_s))

    def number_columns(self) -> dict[str, Array]:
        """Return derivatives of the weighted readings by numbers, index angle, bow, drag and friction at constant θ.

        They are forward differences of whole motions. The steps are small: 0.1 µm of bow at A is 800 standard
        deviations, its square 4 % of the derivative. Larger steps leave a false derivative along R → λR, S_P → λS_P,
        b → λb, c → λ²c, which moves no angle.

        Returns:
            Name → derivative, shape (n,).
        """
        n, minimum, knowledge = self.readings, self.minimum, self.release.knowledge
        values, found = physical_numbers(knowledge.physics), dict[str, Array]()
        weight = np.concatenate([c.weight for c in self.problem.cut(self.end_s)])
        measured = np.concatenate([c.value for c in self.problem.cut(self.end_s)])
        free = self.release.open_phase
        own, phase = np.split(minimum.theta, [len(minimum.theta) - free])
        phase = np.r_[phase, 0.0] if self.release.run.phase_absolute else phase
        cut = self.problem.cut(self.end_s)
        base = minimum.residual[:n]

        def change(release: RecordedRelease, turn_rad: float, step: float) -> Array:
            by = phase.copy()
            by[-1] += turn_rad
            angle, _ = release.angles(own, cut, by, self.shape)
            return ((angle - measured) * weight - base) / step

        for name in knowledge.numbers:
            if name == "imbalance.mass_kg" and "rotor.mass_kg" in found:
                found[name] = found["rotor.mass_kg"]  # S_P is a parameter: both act through the total mass
                continue
            step = _STEP * values[name]
            # identified parameters do not change: by_number of the prior knowledge is empty here
            found[name] = change(self.release.laid_over(knowledge.moved(name, step)), 0.0, step)
        for name in BOW:
            found[name] = change(self.release.laid_over(knowledge.moved(name, _BOW_STEP_M)), 0.0, _BOW_STEP_M)
        for name in knowledge.terms:
            step = _TERM_STEPS[name]
            found[name] = change(self.release.laid_over(knowledge.moved(name, step)), 0.0, step)
        if self.release.run.phase_absolute:
            found[INDEX] = change(self.release, _TURN_RAD, _TURN_RAD)
        for name, pendulum in zip(DRAG, (knowledge.physics.a, knowledge.physics.b), strict=True):
            step = _DRAG_STEP_S * pendulum.damping_Nms_per_rad
            found[name] = change(self.release.laid_over(knowledge.moved(name, step)), 0.0, step)
        if self.shape is None:  # an open torque is the release's own
            found |= zip(FRICTION, self.release.torque_columns(minimum, self.end_s).T, strict=True)
        return {name: column for name, column in found.items() if np.all(np.isfinite(column))}


def condensed(fitted: FittedRelease, assumed: Mapping[str, float], relevant: Mapping[str, float]) -> Condensed:
    """Return the rows of a fit.

    Args:
        fitted: fit with all parameters free.
        assumed: logarithm of each identified parameter, and each zero. All other unknowns are the release's own.
        relevant: smallest relevant error of each shared unknown, in the unit of its slope.
    """
    minimum, n = fitted.minimum, fitted.readings
    has_friction = fitted.shape is not None and FRICTION[0] in assumed
    places = {name: at for name, at in PLACES.items() if name in assumed}
    shared_at = list(places.values())
    prior_of = np.flatnonzero(np.isfinite(fitted.problem.prior_std))
    kept = np.r_[np.ones(n, bool), ~np.isin(prior_of, shared_at)]
    jacobian, residual = minimum.jacobian[kept], minimum.residual[kept]
    basis = _basis(np.delete(jacobian, shared_at, axis=1))
    columns = {name: jacobian[:, at] for name, at in places.items()}
    for name, column in fitted.number_columns().items():
        columns[name] = np.r_[column, np.zeros(len(residual) - n)]
    names = list(columns)
    all_columns = np.column_stack([columns[name] for name in names])
    off = np.array(
        [
            assumed[name] - minimum.theta[places[name]] if name in places else -fitted.moved.get(name, 0.0)
            for name in names
        ]
    )
    at_assumed = residual + all_columns @ off
    left = all_columns - basis @ (basis.T @ all_columns)
    rows, sizes, _ = np.linalg.svd(left * np.array([relevant.get(name, 0.0) for name in names]), full_matrices=False)
    rows = rows[:, sizes > _MIN_ROW_SIZE]
    slopes = -rows.T @ all_columns
    own, misfit = _own(fitted, rows)
    found = Condensed(-rows.T @ at_assumed, own, dict(zip(names, slopes.T, strict=True)), misfit)
    return _with_torque(found, fitted) if has_friction else found


def _with_torque(found: Condensed, fitted: FittedRelease) -> Condensed:
    """Return the rows with two added: the friction torques of A and B, whose predicted values are 0.

    A friction law, M or F φ̇², has errors of a tenth, while a release determines its torque to a thousandth of that. In
    the other rows the torques are unknowns of the release's own.
    """
    at, count = list(TORQUES), len(found.values)
    torque, std = fitted.minimum.theta[at], np.sqrt(np.diag(fitted.minimum.covariance)[at] * found.misfit.stretch)
    std = np.hypot(std, _FRICTION_LAW_STD * np.max(np.abs(torque)))
    own = np.eye(count + 2)
    own[:count, :count] = found.own
    slopes = {name: np.r_[slope, 0.0, 0.0] for name, slope in found.slopes.items()}
    slopes |= {name: np.r_[np.zeros(count), -np.eye(2)[i] / std] for i, name in enumerate(FRICTION)}
    return Condensed(np.r_[found.values, torque / std], own, slopes, found.misfit, True)


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of the span of columns of any scale, shape (n, k)."""
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    turned, sizes, _ = np.linalg.svd(columns / np.where(scale > 0, scale, 1.0), full_matrices=False)
    return turned[:, sizes > _INDEPENDENT * sizes[0]]


def _own(fitted: FittedRelease, rows: Array) -> tuple[Array, Misfit]:
    """Return the covariance of the rows by noise, rounding and priors, stretched by the misfit, and the misfit.

    Rounding is white for moving pendulums but not near standstill, where random draws give its effect. The scatter of a
    hundred draws would distort a full covariance. Therefore only the variance of a row is used, and only if it exceeds
    1 by more than chance explains.
    """
    problem, minimum, end_s, n = fitted.problem, fitted.minimum, fitted.end_s, fitted.readings
    first = len(problem.cut(end_s)[0].time_s)
    parts = (slice(0, first), slice(first, n))
    together = max(correlation_inflation(minimum.residual[part]) for part in parts)
    variance, white, level = np.ones(rows.shape[1]), 1.0, 1.0
    errors = problem.rounding(minimum, end_s, _DRAWS)
    if errors is not None:
        drawn = np.mean((errors @ rows[:n]) ** 2, axis=0) + np.sum(rows[n:] ** 2, axis=0)
        variance = np.where(drawn > 1 + 3 * np.sqrt(2 / _DRAWS), drawn, 1.0)
        white = max(correlation_inflation(e[part]) for e in errors[:10] for part in parts)
        level = max(1.0, float(np.mean(errors**2)))
    misfit = fitted.misfit
    if misfit is None:
        chi2 = problem.chi2_per_dof(minimum, end_s)
        stretch = max(1.0, together / white) ** 2 * max(1.0, chi2 / level / (1 + 3 * np.sqrt(2 / n)))
        misfit = Misfit(stretch, chi2)
    return np.diag(variance * misfit.stretch), misfit


def fitted_with_numbers(
    release: RecordedRelease,
    problem: TransientProblem,
    shape: Shape | None,
    horizons_s: Sequence[float],
    solve: Callable[[TransientProblem, Array], Minimum],
    start: Array,
) -> FittedRelease:
    """Return a fit with free masses and lengths of the pendulums in addition to all other unknowns.

    Args:
        release: release to fit.
        problem: least-squares problem of the release without masses and lengths.
        shape: shape of the dry friction.
        horizons_s: ends of the growing stretches, s.
        solve: (problem, start value of θ) ↦ minimum over the whole stretch. θ ends with the numbers' relative changes.
        start: start value of θ without masses and lengths.
    """
    values, known, p = physical_numbers(release.knowledge.physics), release.knowledge, len(problem.prior)

    def at(shares: Array) -> RecordedRelease:
        moved = known
        for name, share in zip(_OPEN_NUMBERS, shares.tolist(), strict=True):
            moved = moved.moved(name, share * values[name])
        return release.laid_over(moved)

    def predict(theta: Array, last_s: float, slopes: bool = True, /) -> tuple[Array, Array]:
        own, shares = theta[:p], theta[p:]
        if np.max(np.abs(shares)) > _FURTHEST:
            return np.full(sum(len(c.time_s) for c in problem.cut(last_s)), np.nan), np.zeros((0, len(theta)))
        angle, slope = at(shares).problem(shape).predict(own, last_s, slopes)
        if not slopes:
            return angle, slope
        columns = [slope]
        for j in range(len(shares)):
            changed = at(shares + _STEP * np.eye(len(shares))[j]).problem(shape).angles(own, last_s)
            columns.append((changed - angle)[:, None] / _STEP)
        return angle, np.column_stack(columns)

    k = len(_OPEN_NUMBERS)
    wider = replace(
        problem,
        predict=predict,
        prior=np.r_[problem.prior, np.zeros(k)],
        prior_std=np.r_[problem.prior_std, np.full(k, _NUMBER_STD)],
    )
    found = solve(wider, np.r_[start, np.zeros(k)])
    shares, rows = found.theta[p:], len(found.residual) - k  # the prior rows of the numbers are last
    own = Minimum(
        found.theta[:p],
        found.covariance[:p, :p],
        found.residual[:rows],
        found.jacobian[:rows, :p],
        found.converged,
        found.iterations,
    )
    there = at(shares)
    fixed = replace(there.problem(shape), prior=problem.prior, prior_std=problem.prior_std)
    moved = {name: share * values[name] for name, share in zip(_OPEN_NUMBERS, shares.tolist(), strict=True)}
    return FittedRelease(there, fixed, shape, own, horizons_s, moved)


def opened(problem: TransientProblem, std: Mapping[str, float]) -> TransientProblem:
    """Return the problem with other prior standard deviations of some unknowns.

    Args:
        problem: least-squares problem of a release.
        std: standard deviation by name in PLACES, in the unit of θ.
    """
    wide = problem.prior_std.copy()
    for name, value in std.items():
        wide[PLACES[name]] = value
    return replace(problem, prior_std=wide)
