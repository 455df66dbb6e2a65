"""How far eigenvalues may be off when the matrix is: first and second order, and clusters where that fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance

_ROUNDING = np.finfo(float).eps
_COARSE, _BY_CHANCE = 1e-4, 1 / 16
_SEPARATE = 0.25  # a coupling below this share of the gap leaves an eigenvalue on its own


def eigenvalues_with_bounds(
    matrix: NDArray[np.floating], change: NDArray[np.floating], roundings: float
) -> tuple[NDArray[np.complexfloating], NDArray[np.floating]]:
    """Eigenvalues of a matrix with a bound on the error of each.

    In the basis of the eigenvectors X the error matrix is G = X⁻¹ E X; an eigenvalue moves by G_ii at first and
    Σ_j G_ij G_ji/(σ_i − σ_j) at second order. Where a neighbour is nearer than the coupling to it (nearly defective
    pairs), the k-th root of the coupling times the gaps takes over, as in a Jordan block. What rounding did is the
    same in all units (sums and products of floating point numbers do not see a factor), so it is judged in those
    that balance the matrix.

    Args:
        matrix: shape (n, n), finite.
        change: error matrix known with its sign (difference of two resolutions), shape (n, n).
        roundings: rounding errors gathered on the way, in units of eps of the balanced matrix.
    Returns:
        Eigenvalues, shape (n,), largest modulus first, and bounds, shape (n,).
    """
    unit = balancing_units(np.abs(matrix))
    matrix, change = matrix * unit / unit[:, None], change * unit / unit[:, None]
    norm = float(np.linalg.norm(matrix))
    spread = roundings * _ROUNDING * (np.abs(matrix) + norm / len(matrix))
    values, right = np.linalg.eig(matrix)
    order = np.argsort(-np.abs(values), kind="stable")
    values, right = values[order], right[:, order]
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        return values, np.full(len(values), _whole_spectrum(matrix, np.abs(change) + spread))
    # eig itself leaves an error of a few roundings of the matrix's norm, in every direction
    coupling = np.abs(left @ change @ right) + np.abs(left) @ spread @ np.abs(right)
    coupling += 2 * _ROUNDING * norm * np.outer(np.linalg.norm(left, axis=1), np.linalg.norm(right, axis=0))
    if not np.all(np.isfinite(coupling)):
        return values, np.full(len(values), _whole_spectrum(matrix, np.abs(change) + spread))
    return values, np.array([_moved(values, coupling, i) for i in range(len(values))]) + _by_chance(coupling)


def balancing_units(size: NDArray[np.floating]) -> NDArray[np.floating]:
    """Units of the states, powers of two, in which rows and columns of a matrix are of like size, shape (n,).

    Args:
        size: absolute values of the matrix, shape (n, n); its diagonal does not count.
    """
    apart = size * (1.0 - np.eye(len(size)))
    _, (unit, _) = matrix_balance(apart, permute=False, separate=True)
    return unit


def _by_chance(coupling: NDArray[np.floating]) -> NDArray[np.floating]:
    """What an eigenvalue may be off by that two coarse resolutions agree on by chance, shape (n,).

    The one entry of G says little while the others are so large that the method's order does not show yet.
    """
    mutual = np.sqrt(coupling * coupling.T) * (1.0 - np.eye(len(coupling)))
    largest = mutual.max(axis=1, initial=0.0)
    return np.where(largest > _COARSE, _BY_CHANCE * largest, 0.0)


def _moved(values: NDArray[np.complexfloating], coupling: NDArray[np.floating], i: int) -> float:
    """Bound on the move of one eigenvalue."""
    others = np.flatnonzero(np.arange(len(values)) != i)
    gaps = np.abs(values[others] - values[i])
    mutual = coupling[i, others] * coupling[others, i]
    left = gaps - coupling[i, i] - np.diag(coupling)[others]  # when first-order moves have brought them nearer
    if np.all((mutual <= (_SEPARATE * left) ** 2) & ((left > 0) | (mutual == 0))):
        second = np.divide(mutual, left, out=np.zeros_like(mutual), where=left > 0)
        return float(coupling[i, i] + 2 * second.sum())
    strength = float(np.max(np.append(np.sqrt(mutual), coupling[i, i])))
    product, nearest = strength, np.sort(gaps)
    for k, gap in enumerate(nearest):
        bound = 2 * (k + 1) * product ** (1 / (k + 1))
        if bound < 2 * gap:
            return bound
        product *= max(float(gap), _ROUNDING * strength)
    return 2 * len(values) * product ** (1 / len(values))


def _whole_spectrum(matrix: NDArray[np.floating], error: NDArray[np.floating]) -> float:
    """Elsner's bound, for any matrix: (‖A‖ + ‖A + E‖)^(1 − 1/n) ‖E‖^(1/n)."""
    n, norm = len(matrix), float(np.linalg.norm(matrix))
    size = float(np.linalg.norm(error)) + _ROUNDING * norm
    return (2 * norm + size) ** (1 - 1 / n) * size ** (1 / n)
