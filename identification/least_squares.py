"""Nonlinear least squares: Levenberg–Marquardt, and separable problems with the linear unknowns eliminated.

A separable model is y = Φ(θ) c + noise. With P the projector on Φ's columns the residual (1 − P) y depends on θ
alone. Its Jacobian is taken in Kaufman's form −(1 − P) (∂Φ/∂θ) c: the dropped term is proportional to the residual.
The derivative acts on the *fitted* signal Φ c and never on the data; otherwise noise in the data counts as
information about θ and the intervals come out too short.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.errors import FitFailed

_LITTLE = 3e-3  # of χ²
_MOST_BENT = 0.375  # of a step: a larger bend is none of second order (Transtrum and Sethna 2012)
_SURELY = 1e-9  # a prior's least std: far below what any record tells of an angle, a delay or a logarithm

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Minimum:
    """Where an iteration ended.

    Attributes:
        theta: shape (p,).
        covariance: inverse of JᵀJ, shape (p, p); the residual's rows are in standard deviations.
        residual: shape (n,), priors last.
        jacobian: shape (n, p).
        converged: whether the last step was below 1e-3 standard deviations in every direction of θ, or several
            steps in a row gained nothing, or had nothing to gain.
        iterations: evaluations used.
    """

    theta: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    converged: bool
    iterations: int

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)


def minimise(evaluate: Evaluate, start: np.ndarray, max_iterations: int = 40, plateau: float | None = None) -> Minimum:
    """Levenberg–Marquardt with Marquardt's scaling, along the valley's curve where the straight step δ is refused.

    The refused trial shows the bending, r(θ + δ) − r − J δ ≈ ½ r″, and with the same damping the step that undoes it.

    Args:
        evaluate: θ to residual (n,) in standard deviations and Jacobian (n, p). Columns may differ in scale.
        start: shape (p,).
        plateau: mean square of the residuals above which three steps in a row that together gain less than a
            tenth end the iteration: what is left there is no noise, and more steps do not change that.
    Raises:
        FitFailed: the model gives no finite numbers at the start.
    """
    theta = np.array(start, float)
    residual, jacobian = evaluate(theta)
    if not _finite(residual, jacobian):
        raise FitFailed(f"the model gives no finite numbers at its start values {np.array2string(theta, precision=4)}")
    damping, converged, used, idle = 1e-4, False, 1, 0
    costs = [float(residual @ residual)]
    while used < max_iterations and not converged:
        scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian)) + 1e-300
        scaled = jacobian / scale
        normal, gradient = scaled.T @ scaled, scaled.T @ residual
        damped = normal + damping * np.eye(len(theta))
        step = -np.linalg.solve(damped, gradient)
        # length of the step in standard deviations, which grow with residuals above the noise
        unit = max(1.0, costs[-1] / len(residual))
        foreseen = -float((2 * gradient + normal @ step) @ step)
        trial = evaluate(theta + step / scale)
        used += 1
        if foreseen > _LITTLE * unit and _finite(*trial) and trial[0] @ trial[0] >= costs[-1]:
            bend = -np.linalg.solve(damped, scaled.T @ (trial[0] - residual - scaled @ step))
            if used < max_iterations and np.linalg.norm(bend) < _MOST_BENT * np.linalg.norm(step):
                step = step + bend
                trial = evaluate(theta + step / scale)
                used += 1
        better = _finite(*trial) and trial[0] @ trial[0] < costs[-1]
        gained = costs[-1] - float(trial[0] @ trial[0]) if better else foreseen
        # a step that is too long is refused although much is to be gained: a shorter one is next
        idle = idle + 1 if gained < _LITTLE * unit else 0
        converged = bool(step @ normal @ step < 1e-6 * unit and damping < 0.1)
        converged |= idle >= 4  # along a valley that the data do not see
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


def _finite(residual: np.ndarray, jacobian: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian)))


def inverse_normal(jacobian: np.ndarray) -> np.ndarray:
    """(JᵀJ)⁻¹ with columns scaled first; directions without information get a huge variance, not an error."""
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale = np.maximum(scale, 1e-100)  # whose square's inverse a double still holds
    values, vectors = np.linalg.eigh((jacobian / scale).T @ (jacobian / scale))
    inverse = (vectors / np.maximum(values, 1e-15)) @ vectors.T
    inverse = inverse / np.outer(scale, scale)
    return 0.5 * (inverse + inverse.T)


@dataclass(frozen=True)
class Block:
    """One independent part of a separable model: its own data and its own linear unknowns.

    Attributes:
        data: y / σ, shape (n,).
        basis: Φ / σ, shape (n, k).
        tangent: c ↦ (∂Φ/∂θ_j) c / σ as columns, shape (n, p).
    """

    data: np.ndarray
    basis: np.ndarray
    tangent: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Solution:
    """A solved separable problem.

    Attributes:
        minimum: θ with its covariance, priors included.
        coefficients: one array (k,) per block.
        residuals: per block (y − Φ c) / σ, shape (n,).
        coefficient_covariances: per block, covariance of (θ, c), shape (p + k, p + k).
        chi2_per_dof: reduced χ² of the data.
    """

    minimum: Minimum
    coefficients: list[np.ndarray]
    residuals: list[np.ndarray]
    coefficient_covariances: list[np.ndarray]
    chi2_per_dof: float


Model = Callable[[np.ndarray], Sequence[Block]]


def solve_separable(
    model: Model, start: np.ndarray, prior: np.ndarray, prior_std: np.ndarray, max_iterations: int = 40
) -> Solution:
    """Least squares over θ and every block's c.

    Args:
        model: θ to blocks.
        start: θ to begin with, shape (p,).
        prior, prior_std: independent Gaussian knowledge of θ, shape (p,); std inf where there is none, 0 where θ is
            known (two sensors on one clock).
    """
    known = np.isfinite(prior_std)
    prior_std = np.maximum(prior_std, _SURELY)
    rows = np.eye(len(start))[known] / prior_std[known, None]

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals, jacobians = [], []
        for block in model(theta):
            q, c = _projected(block)
            residual = block.data - block.basis @ c
            tangent = block.tangent(c)
            residuals.append(residual)
            jacobians.append(q @ (q.T @ tangent) - tangent)
        residuals.append(rows @ (theta - np.where(known, prior, 0.0)))
        return np.concatenate(residuals), np.concatenate([*jacobians, rows])

    minimum = minimise(evaluate, start, max_iterations)
    return _solution(model, minimum)


def linear_unknowns(block: Block) -> np.ndarray:
    """The block's c that fits best, shape (k,)."""
    return _projected(block)[1]


def _projected(block: Block) -> tuple[np.ndarray, np.ndarray]:
    q, r = _orthonormal(block.basis)
    diagonal = np.abs(np.diag(r))
    ridge = np.where(diagonal > 1e-12 * diagonal.max(), 0.0, 1.0)  # a column that is not there
    return q, np.linalg.solve(r + np.diag(ridge * diagonal.max()), q.T @ block.data)


def _orthonormal(basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of a tall matrix: Cholesky of the Gram matrix, twice, which is as orthogonal and several times as quick.

    Householder's way where columns are too alike for it, or not finite.
    """
    scale = np.sqrt(np.einsum("ij,ij->j", basis, basis))
    try:
        if not (np.all(np.isfinite(scale)) and scale.min(initial=1.0) > 0):
            return np.linalg.qr(basis)
        q, r = basis / scale, np.diag(scale)
        for _ in range(2):
            factor = np.linalg.cholesky(q.T @ q).T
            if np.min(np.diag(factor)) < 1e-6:
                return np.linalg.qr(basis)
            q, r = q @ np.linalg.inv(factor), factor @ r
    except np.linalg.LinAlgError:
        return np.linalg.qr(basis)
    return q, r


def _solution(model: Model, minimum: Minimum) -> Solution:
    coefficients, residuals, joint = [], [], []
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
