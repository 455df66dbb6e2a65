"""Nonlinear least squares: Levenberg–Marquardt, and separable problems with the linear unknowns eliminated.

A separable model is y = Φ(θ) c + noise. With the projector P on the columns of Φ, the residual (1 − P) y depends on θ
alone. Its Jacobian has Kaufman's form −(1 − P) (∂Φ/∂θ) c; the neglected term is proportional to the residual. The
derivative acts on the *fitted* signal Φ c and never on the data. Otherwise noise in the data would count as information
about θ, and the intervals would be too short.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from identification.errors import FitFailed
from identification.work import spend
from rig_basics.arrays import Array

_LEFT = 1e-4  # of χ²: what an undamped step of a hundredth of a standard deviation gains
_MANY, _SMALL_GAIN = 10, 0.1  # steps, and the gain of χ² by all of them, after which no further one is worth its time
_FIRST_DAMPING = 1e-2  # the first step is nearly that of Gauss and Newton
_MAX_DAMPING = 1e10
_FREE_REACH = 10.0  # standard deviations of the residuals: how far an unknown without a prior may be
_MAX_BEND_RATIO = 0.375  # of a step: a larger correction is not second order (Transtrum and Sethna 2012)
_MIN_PRIOR_STD = 1e-9  # far below the std with which a record determines an angle, a delay or a logarithm

Evaluate = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Minimum:
    """Result of an iteration.

    Attributes:
        theta: parameters θ, shape (p,).
        covariance: inverse of JᵀJ, shape (p, p); the residual's rows are in standard deviations.
        residual: shape (n,), priors last.
        jacobian: shape (n, p).
        converged: whether an undamped step would gain less than 1e-4 of χ², a hundredth of a standard deviation, or
            ten steps together gained less than a tenth, and an undamped step would not gain much more. χ² is that for
            noise as large as the residuals.
        iterations: number of evaluations.
    """

    theta: Array
    covariance: Array
    residual: Array
    jacobian: Array
    converged: bool
    iterations: int

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def per_reading(self) -> float:
        """Mean square of the residuals, for a comparison of fits of different stretches."""
        return self.cost / len(self.residual)

    @property
    def unit(self) -> float:
        """Cost of a step by a standard deviation, which grows with residuals above the noise."""
        return max(1.0, self.per_reading)

    @property
    def step(self) -> Array:
        """Undamped step of Gauss and Newton, shape (p,)."""
        return -self.covariance @ (self.jacobian.T @ self.residual)

    @property
    def left(self) -> float:
        """Reduction of the cost by that step if the model is linear."""
        return -float(self.residual @ self.jacobian @ self.step)


def minimise(
    evaluate: Evaluate,
    start: Array,
    max_iterations: int = 40,
    plateau: float | None = None,
    reach: Array | None = None,
) -> Minimum:
    """Minimise by Levenberg–Marquardt with a second-order correction of rejected steps.

    The damping λ holds each step near its start like a prior of the standard deviation reach / √λ. (Marquardt's scaling
    by the columns of the Jacobian holds strongly determined directions instead. It stops in a narrow valley whose weak
    direction is curved, as that of an instant at which the force on a pendulum changes its sign.) λ follows the ratio
    of the actual to the foreseen gain (Nielsen 1999). A rejected trial yields the curvature,
    r(θ + δ) − r − J δ ≈ ½ r″, and with the same damping the correcting step.

    Args:
        evaluate: θ to residual (n,) in standard deviations and Jacobian (n, p). Columns may differ in scale.
        start: start value of θ, shape (p,).
        max_iterations: limit of the number of evaluations.
        plateau: mean square of the residuals. Above it, the iteration ends if three consecutive steps gain less than a
            tenth: residuals of that size are a misfit of the model that further steps do not remove.
        reach: prior standard deviation of θ, whose rows the residual contains, shape (p,); inf, and None for all
            parameters, for no prior.
    Raises:
        FitFailed: residual or Jacobian are not finite at the start.
    """
    at = _linearised(evaluate, np.array(start, float))
    if at is None:
        raise FitFailed(f"the model gives no finite numbers at its start values {np.array2string(start, precision=4)}")
    costs, tried, damping, growth, used = [at.cost], [at.cost], _FIRST_DAMPING, 2.0, 1
    settled = at.left < _LEFT * at.unit
    while used < max_iterations and damping < _MAX_DAMPING and not settled:
        held = _reach(at, reach) / np.sqrt(damping)
        step = _held_step(at, at.residual, held)
        moved = at.jacobian @ step
        trial = _linearised(evaluate, at.theta + step)
        used += 1
        if trial is not None and trial.cost >= at.cost and used < max_iterations:
            bend = _held_step(at, trial.residual - at.residual - moved, held)
            if np.linalg.norm(bend / held) < _MAX_BEND_RATIO * np.linalg.norm(step / held):
                trial = _linearised(evaluate, at.theta + step + bend)
                used += 1
        if trial is not None and trial.cost < at.cost:
            ratio = (trial.cost - at.cost) / float((2 * at.residual + moved) @ moved)
            damping, growth, at = damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 2.0, trial
            costs.append(at.cost)
            if plateau is not None and len(costs) > 3 and costs[-1] > max(plateau * len(at.residual), 0.9 * costs[-4]):
                break
        else:
            damping, growth = damping * growth, growth * 2
        tried.append(at.cost)
        # the Jacobian foresees too much with an unknown that acts by its square, and with residuals above the noise
        idle = len(tried) > _MANY and tried[-_MANY - 1] - at.cost < _SMALL_GAIN * at.unit
        settled = at.left < (at.unit if idle else _LEFT) * at.unit
    return replace(at, converged=settled, iterations=used)


def _linearised(evaluate: Evaluate, theta: Array) -> Minimum | None:
    """Return the linear model about θ; None if it is not finite."""
    residual, jacobian = evaluate(theta)
    spend(jacobian.size)
    if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
        return None
    return Minimum(theta, inverse_normal(jacobian), residual, jacobian, False, 1)


def _reach(at: Minimum, prior_std: Array | None) -> Array:
    """Return how far each unknown may be from its value, shape (p,): the prior's standard deviation if it has one."""
    free = _FREE_REACH / _sizes(at.jacobian)
    return free if prior_std is None else np.where(np.isfinite(prior_std), prior_std, free)


def _held_step(at: Minimum, residual: Array, std: Array) -> Array:
    """Return the step that reduces residuals best, with a prior of 0 and the given standard deviations, shape (p,)."""
    size = _sizes(at.jacobian)
    scaled = at.jacobian / size
    held = scaled.T @ scaled + np.diag((std * size) ** -2.0)
    return -cast(Array, np.linalg.solve(held, scaled.T @ residual)) / size


def _sizes(jacobian: Array) -> Array:
    """Return the lengths of the columns, shape (p,), at least 1e-100, whose inverse square is a double."""
    return np.maximum(np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian)), 1e-100)


def inverse_normal(jacobian: Array) -> Array:
    """Return (JᵀJ)⁻¹, computed from scaled columns. Directions without information get a huge variance."""
    scale = _sizes(jacobian)
    values, vectors = np.linalg.eigh((jacobian / scale).T @ (jacobian / scale))
    inverse = (vectors / np.maximum(values, 1e-15)) @ vectors.T
    inverse = inverse / np.outer(scale, scale)
    return 0.5 * (inverse + inverse.T)


@dataclass(frozen=True)
class SeparableBlock:
    """Independent part of a separable model with its own data and its own linear unknowns c.

    Attributes:
        data: y / σ, shape (n,).
        basis: Φ / σ, shape (n, k).
        tangent: function c ↦ (∂Φ/∂θ_j) c / σ as columns, shape (n, p).
    """

    data: Array
    basis: Array
    tangent: Callable[[Array], Array]


@dataclass(frozen=True)
class Solution:
    """Solution of a separable problem.

    Attributes:
        minimum: θ with its covariance, priors included.
        coefficients: c of each block, shape (k,).
        residuals: (y − Φ c) / σ of each block, shape (n,).
        coefficient_covariances: covariance of (θ, c) for each block, shape (p + k, p + k).
        chi2_per_dof: reduced χ² of the data.
    """

    minimum: Minimum
    coefficients: list[Array]
    residuals: list[Array]
    coefficient_covariances: list[Array]
    chi2_per_dof: float


Model = Callable[[Array], Sequence[SeparableBlock]]


def solve_separable(model: Model, start: Array, prior: Array, prior_std: Array, max_iterations: int = 40) -> Solution:
    """Solve for θ and the c of every block by least squares.

    Args:
        model: function from θ to blocks.
        start: start value of θ, shape (p,).
        prior, prior_std: independent Gaussian prior of θ, shape (p,). The std is inf for no prior and 0 for a known
            value (two sensors on one clock).
        max_iterations: limit of the number of evaluations.
    """
    known = np.isfinite(prior_std)
    prior_std = np.maximum(prior_std, _MIN_PRIOR_STD)
    rows = np.eye(len(start))[known] / prior_std[known, None]

    def evaluate(theta: Array) -> tuple[Array, Array]:
        residuals, jacobians = list[Array](), list[Array]()
        for block in model(theta):
            q, c = _projected(block)
            spend(block.basis.size)
            residual = block.data - block.basis @ c
            tangent = block.tangent(c)
            residuals.append(residual)
            jacobians.append(q @ (q.T @ tangent) - tangent)
        residuals.append(rows @ (theta - np.where(known, prior, 0.0)))
        return np.concatenate(residuals), np.concatenate([*jacobians, rows])

    minimum = minimise(evaluate, start, max_iterations)
    return _solution(model, minimum)


def linear_unknowns(block: SeparableBlock) -> Array:
    """Best-fitting c of a block, shape (k,)."""
    return _projected(block)[1]


def _projected(block: SeparableBlock) -> tuple[Array, Array]:
    q, r = _orthonormal(block.basis)
    diagonal = np.abs(np.diag(r))
    ridge = np.where(diagonal > 1e-12 * diagonal.max(), 0.0, 1.0)  # for a column that depends on the others
    return q, cast(Array, np.linalg.solve(r + np.diag(ridge * diagonal.max()), q.T @ block.data))


def _orthonormal(basis: Array) -> tuple[Array, Array]:
    """QR of a tall matrix by two Cholesky factorisations of the Gram matrix.

    The result is as orthogonal as Householder's and several times as fast. Householder's method is used if columns are
    nearly collinear or not finite.
    """
    scale = np.sqrt(np.einsum("ij,ij->j", basis, basis))
    try:
        if not (np.all(np.isfinite(scale)) and scale.min(initial=1.0) > 0):
            return np.linalg.qr(basis)
        q, r = basis / scale, np.diag(scale)
        for _ in range(2):
            factor = cast(Array, np.linalg.cholesky(q.T @ q)).T
            if np.min(np.diag(factor)) < 1e-6:
                return np.linalg.qr(basis)
            q, r = q @ cast(Array, np.linalg.inv(factor)), factor @ r
    except np.linalg.LinAlgError:  # usual: a dependent basis, for which QR is the exact form
        return np.linalg.qr(basis)
    return q, r


def _solution(model: Model, minimum: Minimum) -> Solution:
    coefficients, residuals, joint = list[Array](), list[Array](), list[Array]()
    count = unknowns = 0
    for block in model(minimum.theta):
        _, c = _projected(block)
        coefficients.append(c)
        residuals.append(block.data - block.basis @ c)
        inverse = inverse_normal(block.basis)
        shift = -inverse @ (block.basis.T @ block.tangent(c))  # dc/dθ
        cross = minimum.covariance @ shift.T
        own = inverse + shift @ cross
        joint.append(np.block([[minimum.covariance, cross], [cross.T, own]]))
        count += len(block.data)
        unknowns += len(c)
    chi2 = sum(float(r @ r) for r in residuals)
    dof = max(1, count - unknowns - len(minimum.theta))
    return Solution(minimum, coefficients, residuals, joint, chi2 / dof)
