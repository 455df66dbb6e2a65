"""Radau IIA collocation with five stages (order 9): for stiff matrices of any stiffness.

The stage values solve Y_i − h Σ_j a_ij A(ψ_j) Y_j = y, one linear system a step. The last stage is the end of the step.
The method is L-stable: a mode with a rate of −10¹³ /s vanishes and does not limit the step. Rows are scaled to size one
before elimination, so that the row of a fast pendulum does not dominate the others.
Source: Hairer, Wanner, Solving Ordinary Differential Equations II (Springer 1996), section IV.5.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Legendre, legendre

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.stability.floquet.methods import per_radian, span_rad, turned

NAME = "implicit"
STAGES = 5
ORDER = 2 * STAGES - 1


def _radau_coefficients(stages: int) -> tuple[Array, Array]:
    """Nodes c on (0, 1] (roots of P_s − P_{s−1}, shifted) and a_ij = ∫_0^{c_i} ℓ_j, ℓ_j the Lagrange polynomials."""
    nodes = np.sort(np.real((Legendre.basis(stages) - Legendre.basis(stages - 1)).roots())).astype(float)
    nodes[-1] = 1.0
    values = legendre.legvander(nodes, stages - 1)
    integrals = np.column_stack([Legendre.basis(k).integ(lbnd=-1)(nodes) for k in range(stages)]).astype(float)
    return (nodes + 1) / 2, np.linalg.solve(values.T, integrals.T).T / 2


_NODES, _STEPS = _radau_coefficients(STAGES)


@compiled
def _fundamental(series: Complex, span: float, steps: int) -> Array:
    n = series.shape[1]
    h = span / steps
    y, a = np.eye(n), np.empty((n, n))
    system, right = np.empty((STAGES * n, STAGES * n)), np.empty((STAGES * n, n))
    for step in range(steps):
        for j in range(STAGES):
            evaluate(series, (step + _NODES[j]) * h, a)
            for i in range(STAGES):
                f = h * _STEPS[i, j]
                for r in range(n):
                    for c in range(n):
                        one = 1.0 if i == j and r == c else 0.0
                        system[i * n + r, j * n + c] = one - f * a[r, c]
        for row in range(STAGES * n):
            size = 0.0
            for c in range(STAGES * n):
                size = max(size, abs(system[row, c]))
            for c in range(STAGES * n):
                system[row, c] /= size
            for c in range(n):
                right[row, c] = y[row % n, c] / size
        y[:, :] = np.linalg.solve(system, right)[(STAGES - 1) * n :]
    return y


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod."""
    try:
        fundamental = _fundamental(per_radian(matrix), span_rad(matrix), steps)
    except np.linalg.LinAlgError:  # usual: 1/h is an eigenvalue at this step; another number of steps succeeds
        fundamental = np.full((matrix.dimension, matrix.dimension), np.nan)
    return turned(matrix, fundamental)
