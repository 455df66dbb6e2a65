"""Right-hand side of dynamics.equations.kernels in half the time, for the integrator's innermost loop.

The equations are the same, grouped by pendulum. Sine and cosine come from one argument reduction and two polynomials:
the library's two calls for each of three angles take longer than all other operations. Tests compare both functions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from dynamics.arrays import Numbers
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import (
    AA,
    AB,
    BX,
    BY,
    C1,
    C2,
    CA,
    CB,
    DA,
    DB,
    FA,
    FB,
    GRAVITY,
    HX,
    HY,
    JA,
    JB,
    K1,
    K2,
    MASS,
    QX,
    QY,
    RC,
    SA,
    SB,
    SP,
    size_of,
)

# π/2 in two parts, the first with 33 bits so that its product with a count of quarter turns below 2²⁰ is exact
_QUARTER, _QUARTER_REST = 1.57079632673412561417, 6.07710050630396597660e-11
# Minimax polynomials of sin and cos on ±π/4 (FreeBSD msun, k_sin.c and k_cos.c), errors below 2⁻⁵⁸
_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


@compiled(contract=True)
def real_sine_cosine(x: float) -> tuple[float, float]:
    """(sin x, cos x) of a float, to the accuracy of x."""
    turns = np.floor(x * 0.63661977236758134308 + 0.5)
    r = (x - turns * _QUARTER) - turns * _QUARTER_REST
    z = r * r
    s = r + r * z * (_S1 + z * (_S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * _S6)))))
    c = 1.0 - (0.5 * z - z * z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * _C6))))))
    quarter = np.int64(turns)
    odd = (quarter & 1) != 0
    sine, cosine = (c, s) if odd else (s, c)
    return (-sine if (quarter & 2) != 0 else sine), (-cosine if ((quarter + 1) & 2) != 0 else cosine)


def sine_cosine(x: complex) -> tuple[complex, complex]:
    """(sin x, cos x): by `real_sine_cosine` for a float, by the library for a complex number."""
    return np.sin(x), np.cos(x)


@overload(sine_cosine)
def _sine_cosine(x: Any) -> Callable[[Any], tuple[complex, complex]]:
    """Implementation for a type of x. numba requires the same signature, annotations included, of both functions."""

    def by_library(x: Any) -> tuple[complex, complex]:
        return np.sin(x), np.cos(x)

    def by_polynomials(x: Any) -> tuple[complex, complex]:
        return real_sine_cosine(x)

    return by_library if isinstance(x, types.Complex) else by_polynomials


@compiled(contract=True)
def quick_rates(
    y: Numbers, psi: float, omega: float, alpha: float, p: Numbers, free_a: float, free_b: float, out: Numbers, row: int
) -> None:
    """Write dy/dt to out[row], out of shape (n, 8). Other arguments as for dynamics.equations.kernels.rates."""
    sin_a, cos_a = sine_cosine(psi + y[2])
    sin_b, cos_b = sine_cosine(psi + y[3])
    sin_r, cos_r = real_sine_cosine(psi)
    w2, wa, wb = omega * omega, omega + y[6] * free_a, omega + y[7] * free_b
    # acceleration of the pivot relative to the disk centre, gravity as an upward acceleration
    rx = -p[RC] * (alpha * sin_r + w2 * cos_r)
    ry = p[RC] * (alpha * cos_r - w2 * sin_r) + p[GRAVITY]
    share_a, share_b = free_a / p[JA], free_b / p[JB]
    own_a = -share_a * (p[DA] * alpha + (p[CA] + p[AA] * size_of(y[6])) * y[6] + p[FA] * wa * wa)
    own_b = -share_b * (p[DB] * alpha + (p[CB] + p[AB] * size_of(y[7])) * y[7] + p[FB] * wb * wb)
    mass_a, mass_b = share_a * p[SA] * p[SA], share_b * p[SB] * p[SB]
    # force of each pendulum along its arm and along n = (sin φ, −cos φ)
    along_a, along_b = p[SA] * wa * wa, p[SB] * wb * wb
    across_a = p[SA] * (alpha + own_a) + mass_a * (sin_a * rx - cos_a * ry)
    across_b = p[SB] * (alpha + own_b) + mass_b * (sin_b * rx - cos_b * ry)
    # stretch of the springs from their rest position
    ux, uy = y[0] - (p[BX] * cos_r - p[BY] * sin_r), y[1] - (p[BX] * sin_r + p[BY] * cos_r)
    fx = p[SP] * (w2 * cos_r + alpha * sin_r)
    fx -= p[C1] * y[4] * (1.0 + p[QX] * size_of(y[4])) + p[K1] * ux * (1.0 + p[HX] * ux * ux)
    fy = p[SP] * (w2 * sin_r - alpha * cos_r) - p[MASS] * p[GRAVITY]
    fy -= p[C2] * y[5] * (1.0 + p[QY] * size_of(y[5])) + p[K2] * uy * (1.0 + p[HY] * uy * uy)
    fx += along_a * cos_a + across_a * sin_a + along_b * cos_b + across_b * sin_b
    fy += along_a * sin_a - across_a * cos_a + along_b * sin_b - across_b * cos_b
    mxx = p[MASS] - mass_a * sin_a * sin_a - mass_b * sin_b * sin_b
    myy = p[MASS] - mass_a * cos_a * cos_a - mass_b * cos_b * cos_b
    mxy = mass_a * sin_a * cos_a + mass_b * sin_b * cos_b
    whole = 1.0 / (mxx * myy - mxy * mxy)
    ax, ay = (myy * fx - mxy * fy) * whole, (mxx * fy - mxy * fx) * whole
    px, py = ax + rx, ay + ry
    out[row, 0], out[row, 1], out[row, 2], out[row, 3] = y[4], y[5], y[6] * free_a, y[7] * free_b
    out[row, 4], out[row, 5] = ax, ay
    out[row, 6] = share_a * p[SA] * (sin_a * px - cos_a * py) + own_a
    out[row, 7] = share_b * p[SB] * (sin_b * px - cos_b * py) + own_b
