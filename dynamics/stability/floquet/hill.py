"""Hill's method: the exponents as eigenvalues of one matrix in the frequency domain, without integration.

With y = e^{μψ} p(ψ), p = Σ_k p_k e^{ikψ}, the equation (in the phase) becomes μ p_k = Σ_j B_{k−j} p_j − ik p_k, where
A(ψ)/ω = Σ_k B_k e^{ikψ}. With half-turn symmetry p(ψ + π) = D p(ψ) can be required: component i then has even orders
if D_ii = 1 and odd orders if D_ii = −1. Shifted copies of an exponent (μ + ik) have the same p(0). Of all eigenpairs
with independent p(0), those with the smallest weight at the ends of the truncated series are used.
Source: B. Deconinck, J. N. Kutz, Journal of Computational Physics 219 (2006) 296; J. Zhou, T. Hagiwara, M. Araki,
Systems & Control Letters 53 (2004) 315 (convergence of the truncation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Complex
from dynamics.equations.periodic_matrix import PeriodicMatrix
from dynamics.stability.floquet.methods import per_radian, span_rad

NAME = "hill"
ORDER = 8  # a lower bound: the error decreases faster than any power
_INDEPENDENT = 1e-6


def _cut_matrix(matrix: PeriodicMatrix, orders: int) -> tuple[Complex, NDArray[np.intp]]:
    """Hill's matrix with orders −orders … orders, and its flat indices k n + i."""
    series, n = per_radian(matrix), matrix.dimension
    waves = np.arange(-orders, orders + 1)
    whole = np.zeros((len(waves), n, len(waves), n), complex)
    for k in range(len(series)):
        for i in range(len(waves) - k):
            if k == 0:
                whole[i, :, i] = series[0].real
            else:
                whole[i + k, :, i] = series[k] / 2
                whole[i, :, i + k] = np.conj(series[k]) / 2
    for i, wave in enumerate(waves):
        whole[i, :, i] -= 1j * wave * np.eye(n)
    parity = np.ones((len(waves), n), bool) if matrix.turn is None else np.outer((-1.0) ** waves, matrix.turn) > 0
    kept = np.flatnonzero(parity.ravel())
    return whole.reshape(len(waves) * n, -1)[np.ix_(kept, kept)], kept


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod. A step is one order of the Fourier series of p."""
    n = matrix.dimension
    orders = max(steps, len(matrix.harmonics))
    cut, kept = _cut_matrix(matrix, orders)
    exponents, vectors = np.linalg.eig(cut)
    wave, state = kept // n - orders, kept % n
    ends = np.sum(np.abs(vectors[np.abs(wave) > 0.75 * orders]) ** 2, axis=0)
    starts = np.array([vectors[state == i].sum(axis=0) for i in range(n)])
    basis, chosen = np.zeros((n, 0), complex), list[int]()
    for candidate in np.argsort(ends):
        start = starts[:, candidate]
        rest = start - basis @ (basis.conj().T @ start)
        if np.linalg.norm(rest) > _INDEPENDENT * max(np.linalg.norm(start), 1e-300):
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            chosen.append(int(candidate))
        if len(chosen) == n:
            break
    if len(chosen) < n:
        return np.full((n, n), np.nan)
    start = starts[:, chosen]
    return np.linalg.solve(start.T, (start * np.exp(exponents[chosen] * span_rad(matrix))).T).T.real
