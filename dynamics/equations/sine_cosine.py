"""Sine and cosine of one argument together, for the right-hand side of the motion (dynamics.equations.kernels).

Both come from one argument reduction and two polynomials: the library's two calls for each of three angles take longer
than all other operations of the right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from dynamics.compiled_code import compiled

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
