"""Nonlinear least squares: Levenberg–Marquardt, and separable problems with the linear unknowns eliminated.

A separable model is y = Φ(θ) c + noise. With the projector P on the columns of Φ, the residual (1 − P) y depends on θ
alone. Its Jacobian has Kaufman's form −(1 − P) (∂Φ/∂θ) c; the neglected term is proportional to the residual. The
derivative acts on the *fitted* signal Φ c and never on the data. Otherwise noise in the data would count as information
about θ, and the intervals would be too short.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from identification.errors import FitFailed
from identification.work import spend
from rig_basics.arrays import Array

_MIN_GAIN = 3e-3  # of χ²
_MANY, _SMALL_GAIN = 10, 0.1  # steps, and the gain of χ² by all of them, after which no further one is worth its time
_FIRST_DAMPING = 1e-4  # of Marquardt's scaling: the first step is nearly that of Gauss and Newton
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
        converged: whether the last step was below 1e-3 standard deviations in every direction of θ, or several
            consecutive steps had no gain, or many had next to none and could not have one of a standard deviation.
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


def minimise(
    evaluate: Evaluate,
    start: Array,
    max_iterations: int = 40,
    plateau: float | None = None,
    reach: Array | None = None,
) -> Minimum:
    """Minimise by Levenberg–Marquardt with a second-order correction of rejected steps.

    A rejected trial yields the curvature, r(θ + δ) − r − J δ ≈ ½ r″, and with the same damping the correcting step.

    The damping λ holds each step near its start like a prior of the standard deviation reach / √λ. Marquardt's scaling
    by the columns of the Jacobian holds strongly determined directions instead. It stops in a narrow valley whose
    weak direction is curved, as that of an instant at which the force on a pendulum changes its sign.

    Args:
        evaluate: θ to residual (n,) in standard deviations and Jacobian (n, p). Columns may differ in scale.
        start: start value of θ, shape (p,).
        max_iterations: limit of the number of evaluations.
        plateau: mean square of the residuals. Above it, the iteration ends if three consecutive steps gain less than a
            tenth: residuals of that size are a misfit of the model that further steps do not remove.
        reach: prior standard deviation of θ, whose rows the residual contains, shape (p,). Where it is inf, and for
            all parameters if it is None, Marquardt's scaling applies.
    Raises:
        FitFailed: residual or Jacobian are not finite at the start.
    """
    evaluate = _counted(evaluate)
    theta = np.array(start, float)
    residual, jacobian = evaluate(theta)
    if not _finite(residual, jacobian):
        raise FitFailed(f"the model gives no finite numbers at its start values {np.array2string(theta, precision=4)}")
    damping, converged, used, idle = (_FIRST_DAMPING if reach is None else 1.0), False, 1, 0
    costs = [float(residual @ residual)]
    steps: list[tuple[float, float]] = []  # χ² before each step, and its foreseen gain
    while used < max_iterations and not converged:
        scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian)) + 1e-300
        scaled = jacobian / scale
        normal, gradient = scaled.T @ scaled, scaled.T @ residual
        metric = np.ones(len(theta)) if reach is None else _metric(reach * scale)
        damped = cast(Array, normal + damping * np.diag(metric))
        step = -cast(Array, np.linalg.solve(damped, gradient))
        # the step's length is in standard deviations, which grow with residuals above the noise
        unit = max(1.0, costs[-1] / len(residual))
        foreseen = -float((2 * gradient + normal @ step) @ step)
        trial = evaluate(theta + step / scale)
        used += 1
        if foreseen > _MIN_GAIN * unit and _finite(*trial) and trial[0] @ trial[0] >= costs[-1]:
            bend = -cast(Array, np.linalg.solve(damped, scaled.T @ (trial[0] - residual - scaled @ step)))
            if used < max_iterations and np.linalg.norm(bend) < _MAX_BEND_RATIO * np.linalg.norm(step):
                step = step + bend
                trial = evaluate(theta + step / scale)
                used += 1
        better = _finite(*trial) and trial[0] @ trial[0] < costs[-1]
        gained = costs[-1] - float(trial[0] @ trial[0]) if better else foreseen
        # a rejected step with a large predicted gain is too long and not idle: a shorter one follows
        idle = idle + 1 if gained < _MIN_GAIN * unit else 0
        converged = bool(step @ normal @ step < 1e-6 * unit and damping < 0.1)
        converged |= idle >= 4  # the data do not determine the direction of the steps
        steps.append((costs[-1], foreseen))
        many = steps[-_MANY:]
        converged |= (
            reach is not None
            and len(many) == _MANY
            and many[0][0] - costs[-1] < _SMALL_GAIN * unit
            and max(gain for _, gain in many) < unit  # as where an unknown acts by its square only
        )
        if better:
            theta, (residual, jacobian) = theta + step / scale, trial
            damping = max(damping / 10, 1e-10)
            costs.append(float(residual @ residual))
            if plateau is not None and len(costs) > 3 and costs[-1] > max(plateau * len(residual), 0.9 * costs[-4]):
                break
        else:
            damping *= 10
            if damping > 1e10:
                break
    return Minimum(theta, inverse_normal(jacobian), residual, jacobian, converged, used)


def _metric(reach: Array) -> Array:
    """Return the weight of each squared step in the damping, for `reach` in standard deviations of the residuals."""
    return np.where(np.isfinite(reach), reach, _FIRST_DAMPING**-0.5) ** -2.0


def _counted(evaluate: Evaluate) -> Evaluate:
    """Count every evaluation as work."""

    def counted(theta: Array) -> tuple[Array, Array]:
        residual, jacobian = evaluate(theta)
        spend(jacobian.size)
        return residual, jacobian

    return counted


def _finite(residual: Array, jacobian: Array) -> bool:
    return bool(np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian)))


def inverse_normal(jacobian: Array) -> Array:
    """Return (JᵀJ)⁻¹, computed from scaled columns. Directions without information get a huge variance."""
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale = np.maximum(scale, 1e-100)  # the inverse of its square is a finite double
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
