# pyright: strict
"""One release, linear in everything it shares with other tests, with everything that is its own eliminated.

At a fit's end the weighted residual is r(q, u) ≈ r* + S (q − q*) + A (u − u*), its prior rows for the release's own
unknowns u included. u is projected out with an orthonormal basis of A. What is left of S, its columns scaled to sizes
worth seeing, is U Σ Vᵀ. The rows −Uᵀ r(q0) hold all that the release says about q: they have unit covariance, and their
derivative by what was assumed is −Uᵀ S. Source: docs/theory/validation.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from identification.least_squares import Minimum
from identification.pendulums.release_problem import Release, Shape
from identification.pendulums.suspension_knowledge import BOW
from identification.pendulums.transient import TransientProblem
from identification.samples import correlation_inflation
from rig_configs.known import DRAG, FRICTION, INDEX, ZERO_A, ZERO_B, physical_numbers
from rig_configs.suspension_terms import TERMS

Array = NDArray[np.float64]

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
"""Of what tests share in a release's θ; parameters stand there by their logarithms."""

TORQUES = (16, 17)
"""Of dry friction in a release's θ, where it has one."""
_LAW = 0.1  # of a friction's torque: how well any law of it holds
_DRAWS = 60
_LEAST = 1.0  # standard deviations of a row for sizes worth seeing
# Steps of a number, of the index angle, of a bow, of the drag over the damping (s) and of the suspension's terms (1/m²,
# s/m): forward differences of motions that leave an unstable rest, where 0.1 µm of bow is 800 standard deviations at A
# and its square 4 % of a derivative. Rounding is 1e-9 of one.
_STEP, _TURN_RAD, _BOW_STEP_M, _DRAG_STEP_S = 1e-6, 1e-6, 1e-10, 1e-6
_TERM_STEPS: Mapping[str, float] = dict(zip(TERMS, (0.1, 0.1, 3e-5, 3e-5), strict=True))
_OPEN_NUMBERS = ("pendulums.a.mass_kg", "pendulums.a.length_m", "pendulums.b.mass_kg", "pendulums.b.length_m")
_NUMBER_STD, _FURTHEST = 0.02, 0.5  # shares of these numbers
_INDEPENDENT = 1e-9  # of the largest scaled column


@dataclass(frozen=True)
class Condensed:
    """What a release says about what it shares.

    Attributes:
        values: measured − predicted, in standard deviations, shape (m,).
        own: their covariance, shape (m, m).
        slopes: shared unknown → derivative of the values by what is assumed of it, shape (m,): by the logarithm of a
            parameter, by a number in its unit.
        misfit: of the readings with everything open.
        rubs: whether only dry friction made the release followed; its torques are then the last two rows.
    """

    values: Array
    own: Array
    slopes: Mapping[str, Array]
    misfit: Misfit
    rubs: bool = False


@dataclass(frozen=True)
class Misfit:
    """By how much a fit with everything open is off its readings beyond noise and rounding.

    Attributes:
        stretch: factor on the variance of what the release says.
        chi2_per_dof: of the readings.
    """

    stretch: float
    chi2_per_dof: float


@dataclass(frozen=True)
class Fitted:
    """A release's fit.

    Attributes:
        release, problem, shape: what was fitted, with dry friction of a shape.
        minimum: its end.
        horizons_s: last instants of the stretches over which it was fitted, growing.
        moved: number of the rig file → how far the release's knowledge has it above what the file says.
        misfit: of the fit with everything open, where this is another one.
    """

    release: Release
    problem: TransientProblem
    shape: Shape | None
    minimum: Minimum
    horizons_s: Sequence[float]
    moved: Mapping[str, float] = field(default_factory=dict[str, float])
    misfit: Misfit | None = None

    @property
    def end_s(self) -> float:
        """The last instant."""
        return self.horizons_s[-1]

    @property
    def readings(self) -> int:
        """How many block averages."""
        return sum(len(c.time_s) for c in self.problem.cut(self.end_s))

    def number_columns(self) -> dict[str, Array]:
        """Derivatives of the weighted readings, (n,), by numbers, index angle, bow, drag and friction; θ as it is."""
        n, minimum, knowledge = self.readings, self.minimum, self.release.knowledge
        values, found = physical_numbers(knowledge.physics), dict[str, Array]()
        weight = np.concatenate([c.weight for c in self.problem.cut(self.end_s)])
        measured = np.concatenate([c.value for c in self.problem.cut(self.end_s)])
        free = self.release.open_phase
        own, phase = np.split(minimum.theta, [len(minimum.theta) - free])
        phase = np.r_[phase, 0.0] if self.release.run.phase_absolute else phase
        cut = self.problem.cut(self.end_s)
        base = minimum.residual[:n]

        def change(release: Release, turn_rad: float, step: float) -> Array:
            by = phase.copy()
            by[-1] += turn_rad
            angle, _ = release.angles(own, cut, by, self.shape)
            return ((angle - measured) * weight - base) / step

        for name in knowledge.numbers:
            if name == "imbalance.mass_kg" and "rotor.mass_kg" in found:
                found[name] = found["rotor.mass_kg"]  # S_P is a parameter: both act through the total mass
                continue
            step = _STEP * values[name]
            # what was identified stays as it is: by_number of the knowledge is empty here
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


def condensed(fitted: Fitted, assumed: Mapping[str, float], worth: Mapping[str, float]) -> Condensed:
    """A fit as rows.

    Args:
        fitted: with everything open.
        assumed: logarithm of each identified parameter, and each zero; what is not in it is the release's own.
        worth: size of an error of each shared unknown that is worth seeing, in the unit of its slope.
    """
    minimum, n = fitted.minimum, fitted.readings
    rubs = fitted.shape is not None and FRICTION[0] in assumed
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
    rows, sizes, _ = np.linalg.svd(left * np.array([worth.get(name, 0.0) for name in names]), full_matrices=False)
    rows = rows[:, sizes > _LEAST]
    slopes = -rows.T @ all_columns
    own, misfit = _own(fitted, rows)
    found = Condensed(-rows.T @ at_assumed, own, dict(zip(names, slopes.T, strict=True)), misfit)
    return _with_torque(found, fitted) if rubs else found


def _with_torque(found: Condensed, fitted: Fitted) -> Condensed:
    """Two rows more: the torques of A and B that the release was followed with, held against none.

    A law of friction, M or F φ̇², is no better than a tenth; a release shows its torque to a thousandth of that. The
    rows of everything else have the torque as the release's own.
    """
    at, count = list(TORQUES), len(found.values)
    torque, std = fitted.minimum.theta[at], np.sqrt(np.diag(fitted.minimum.covariance)[at] * found.misfit.stretch)
    std = np.hypot(std, _LAW * np.max(np.abs(torque)))
    own = np.eye(count + 2)
    own[:count, :count] = found.own
    slopes = {name: np.r_[slope, 0.0, 0.0] for name, slope in found.slopes.items()}
    slopes |= {name: np.r_[np.zeros(count), -np.eye(2)[i] / std] for i, name in enumerate(FRICTION)}
    return Condensed(np.r_[found.values, torque / std], own, slopes, found.misfit, True)


def _basis(columns: Array) -> Array:
    """Orthonormal, of what columns of any scale span, shape (n, k)."""
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    turned, sizes, _ = np.linalg.svd(columns / np.where(scale > 0, scale, 1.0), full_matrices=False)
    return turned[:, sizes > _INDEPENDENT * sizes[0]]


def _own(fitted: Fitted, rows: Array) -> tuple[Array, Misfit]:
    """Covariance of the rows by noise, rounding and priors, stretched by the misfit.

    Rounding is white on moving pendulums; near standstill it is not, which draws show. A hundred draws' own scatter
    would distort a full covariance, so each row's variance is taken where chance does not explain it.
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
    release: Release,
    problem: TransientProblem,
    shape: Shape | None,
    horizons_s: Sequence[float],
    solve: Callable[[TransientProblem, Array], Minimum],
    start: Array,
) -> Fitted:
    """A fit that has the pendulums' masses and lengths open beside all else.

    Args:
        problem: of the release, without them.
        solve: (problem, θ to start from) ↦ its minimum over the whole. θ ends with relative changes of the numbers.
    """
    values, known, p = physical_numbers(release.knowledge.physics), release.knowledge, len(problem.prior)

    def at(shares: Array) -> Release:
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
    shares, rows = found.theta[p:], len(found.residual) - k  # what is known of the numbers stands last
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
    return Fitted(there, fixed, shape, own, horizons_s, moved)


def opened(problem: TransientProblem, std: Mapping[str, float]) -> TransientProblem:
    """The problem with knowledge of some unknowns as wide as given.

    Args:
        std: by name in PLACES, in the unit of θ.
    """
    wide = problem.prior_std.copy()
    for name, value in std.items():
        wide[PLACES[name]] = value
    return replace(problem, prior_std=wide)
