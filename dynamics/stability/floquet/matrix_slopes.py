"""The eigenvalue of largest modulus of interpolated matrices, and its derivatives by both coordinates.

With M v = λ v and wᵀ M = λ wᵀ a simple eigenvalue changes by dλ = wᵀ dM v / wᵀ v. The vectors are computed by inverse
iteration: the inverse of a matrix shifted by λ, up to rounding, multiplies v by about 10¹³ and all else by less.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.stability.floquet.lanes import EPS, largest
from dynamics.stability.floquet.matrix_rows import weighted_sum
from dynamics.stability.floquet.quick_eigenvalues import eigenvalues

_SHIFT = 64 * EPS  # relative to the matrix's norm
_ITERATIONS = 2


@compiled(part=True)
def _vector(shifted: Complex) -> Complex:
    """Inverse iteration from a vector without any symmetry, shape (n,)."""
    n = shifted.shape[0]
    vector = np.empty(n, np.complex128)
    for i in range(n):
        vector[i] = complex(np.cos(1.0 + 2.0 * i), np.sin(3.0 * i * i))
    for _ in range(_ITERATIONS):
        vector = np.linalg.solve(shifted, vector)
        size = np.sqrt(np.sum(np.abs(vector) ** 2))
        vector = vector / size
    return vector


@compiled(nogil=True)
def largest_with_slopes(
    nodes: Array, weights_v: Array, slopes_v: Array, weights_u: Array, slopes_u: Array, found: Complex
) -> None:
    """Compute eigenvalues of largest modulus at scattered points, with their derivatives.

    Args:
        nodes: matrices of the nodes, shape (n_v, n_u, n²).
        weights_v, slopes_v: weights of the rows of nodes at each point, and their derivatives, shape (points, n_v).
        weights_u, slopes_u: weights of the columns of nodes, and their derivatives, shape (points, n_u).
        found: λ, ∂λ/∂u and ∂λ/∂v, shape (points, 3), filled; NaN where the eigenvalues did not converge. Of a pair
            the one with Im λ ≥ 0.
    """
    n_v, n_u, entries = nodes.shape
    side: float = np.sqrt(entries)
    n = int(np.round(side))
    flat = nodes.reshape(n_v, n_u * entries)
    row, row_slope = np.empty(n_u * entries), np.empty(n_u * entries)
    matrix, along_u, along_v = np.empty(entries), np.empty(entries), np.empty(entries)
    values = np.empty(n, np.complex128)
    for point in range(len(found)):
        weighted_sum(flat, weights_v[point], row)
        weighted_sum(flat, slopes_v[point], row_slope)
        weighted_sum(row.reshape(n_u, entries), weights_u[point], matrix)
        weighted_sum(row.reshape(n_u, entries), slopes_u[point], along_u)
        weighted_sum(row_slope.reshape(n_u, entries), weights_u[point], along_v)
        found[point] = np.nan
        if not eigenvalues(matrix.copy().reshape(n, n), values):
            continue
        best, _ = largest(values)
        value = values[best]
        if value.imag < 0:
            value = np.conj(value)
        shifted = matrix.reshape(n, n).astype(np.complex128)
        norm = np.sqrt(np.sum(matrix * matrix))
        for i in range(n):
            shifted[i, i] -= value + _SHIFT * norm
        right = _vector(shifted)
        left = _vector(np.ascontiguousarray(shifted.T))
        scale = np.sum(left * right)
        found[point, 0] = value
        for which, slope in enumerate((along_u, along_v)):
            moved = 0.0j
            for i in range(n):
                for j in range(n):
                    moved += left[i] * slope[i * n + j] * right[j]
            found[point, 1 + which] = moved / scale
