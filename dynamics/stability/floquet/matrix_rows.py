"""Largest multipliers along rows of a map, from interpolated half-turn matrices."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex, Indices
from dynamics.compiled_code import compiled
from dynamics.stability.floquet.lanes import EPS, largest, sensitive
from dynamics.stability.floquet.quick_eigenvalues import eigenvalues

_SIDE = 4  # number of points whose sums are computed together


@compiled(contract=True, part=True)
def _four_matrices(row: Array, weights: Array, start: int, out: Array) -> None:
    """Write weighted sums of a row's matrices, shape (nodes, n²), at four points to out (4, n²)."""
    last = weights.shape[0] - 1
    a, b, c, d = start, min(start + 1, last), min(start + 2, last), min(start + 3, last)
    out[:] = 0.0
    for j in range(weights.shape[1]):
        wa, wb, wc, wd = weights[a, j], weights[b, j], weights[c, j], weights[d, j]
        for q in range(row.shape[1]):
            value = row[j, q]
            out[0, q] += wa * value
            out[1, q] += wb * value
            out[2, q] += wc * value
            out[3, q] += wd * value


@compiled(contract=True, part=True)
def weighted_sum(nodes: Array, weights: Array, out: Array) -> None:
    """Write the weighted sum of rows of nodes, shape (rows, n), to out (n,)."""
    out[:] = 0.0
    for j in range(nodes.shape[0]):
        weight = weights[j]
        for q in range(nodes.shape[1]):
            out[q] += weight * nodes[j, q]


@compiled(nogil=True)
def multipliers_of_rows(
    nodes: Array, weights_v: Array, weights_u: Array, error: float, found: Array, errors: Array
) -> None:
    """Compute the largest multipliers over a revolution along rows.

    Args:
        nodes: matrices of the nodes, shape (n_v, n_u, n²).
        weights_v: weights of the rows of nodes in each row of points, shape (rows, n_v).
        weights_u: weights of the columns of nodes at each column of points, shape (columns, n_u).
        error: bound on the Frobenius norm of an interpolated matrix's error.
        found, errors: shape (rows, columns), filled; NaN where the eigenvalues did not converge.
    """
    n_v, n_u, entries = nodes.shape
    side: float = np.sqrt(entries)
    flat, row = nodes.reshape(n_v, n_u * entries), np.empty(n_u * entries)
    columns, n = weights_u.shape[0], int(np.round(side))
    matrices, a, values = np.empty((_SIDE, entries)), np.empty((n, n)), np.empty(n, np.complex128)
    for line in range(weights_v.shape[0]):
        weighted_sum(flat, weights_v[line], row)
        for start in range(0, columns, _SIDE):
            _four_matrices(row.reshape(n_u, entries), weights_u, start, matrices)
            for i in range(start, min(start + _SIDE, columns)):
                a[:] = matrices[i - start].reshape(n, n)
                norm = np.sqrt(np.sum(a * a))
                found[line, i] = errors[line, i] = np.nan
                if not eigenvalues(a, values):
                    continue
                best, gap = largest(values)
                modulus = abs(values[best])
                bound = sensitive(4 * EPS * norm + error, norm, gap)
                found[line, i] = modulus * modulus
                errors[line, i] = (2 * modulus + bound) * bound


@compiled(nogil=True)
def eigenvalues_at(nodes: Array, weights_v: Array, row_of: Indices, weights_u: Array, values: Complex) -> None:
    """Compute eigenvalues of interpolated matrices at scattered points, in order of their rows.

    Args:
        nodes: matrices of the nodes, shape (n_v, n_u, n²).
        weights_v: weights of the rows of nodes in each row of points, shape (rows, n_v).
        row_of: row of each point, ascending, shape (points,).
        weights_u: weights of the columns of nodes at each point, shape (points, n_u).
        values: shape (points, n), filled; NaN where the eigenvalues did not converge.
    """
    n_v, n_u, entries = nodes.shape
    side: float = np.sqrt(entries)
    flat, row = nodes.reshape(n_v, n_u * entries), np.empty(n_u * entries)
    n, last = int(np.round(side)), -1
    flat_matrix, found = np.empty(entries), np.empty(n, np.complex128)
    for point in range(len(row_of)):
        if row_of[point] != last:
            last = row_of[point]
            weighted_sum(flat, weights_v[last], row)
        weighted_sum(row.reshape(n_u, entries), weights_u[point], flat_matrix)
        if eigenvalues(flat_matrix.reshape(n, n), found):
            values[point] = found
        else:
            values[point] = np.nan


@compiled(part=True)
def _chebyshev_weights(share: float, weights: Array) -> None:
    """Values of the Lagrange polynomials of the Chebyshev points of the first kind at −1 … 1 (barycentric formula)."""
    n, total = len(weights), 0.0
    if n == 1:
        weights[0] = 1.0
        return
    for k in range(n):
        angle = np.pi * (k + 0.5) / n
        off = share - np.cos(angle)
        if off == 0.0:
            weights[:] = 0.0
            weights[k] = 1.0
            return
        weights[k] = (1.0 - 2.0 * (k % 2)) * np.sin(angle) / off
        total += weights[k]
    for k in range(n):
        weights[k] /= total


@compiled(nogil=True)
def largest_eigenvalue_there(nodes: Array, share_u: float, share_v: float) -> complex:
    """Eigenvalue of largest modulus of the interpolated matrix at one point; NaN if the iteration did not converge.

    Args:
        nodes: matrices of the nodes, shape (n_v, n_u, n²).
        share_u, share_v: position of the point in the rectangle, −1 … 1 along each side.
    """
    n_v, n_u, entries = nodes.shape
    side: float = np.sqrt(entries)
    weights_v, weights_u = np.empty(n_v), np.empty(n_u)
    _chebyshev_weights(share_u, weights_u)
    _chebyshev_weights(share_v, weights_v)
    row, matrix = np.empty(n_u * entries), np.empty(entries)
    weighted_sum(nodes.reshape(n_v, n_u * entries), weights_v, row)
    weighted_sum(row.reshape(n_u, entries), weights_u, matrix)
    n = int(np.round(side))
    values = np.empty(n, np.complex128)
    if not eigenvalues(matrix.reshape(n, n), values):
        return complex(np.nan, np.nan)
    best, _ = largest(values)
    return values[best]
