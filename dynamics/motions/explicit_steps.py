"""One step of the explicit Runge–Kutta method 8(5,3) of Dormand and Prince, with its interpolant of degree 7.

Twelve stages give order 8; three more stages give a polynomial over the step. Two embedded formulas of order 5 and 3
give the error estimate |e5|² / sqrt(|e5|² + 0.01 |e3|²), which decreases with h⁸ (Hairer, Nørsett, Wanner, Solving
Ordinary Differential Equations I, II.10). The stages accept floats and complex numbers: with complex parameters or
states the same arithmetic computes derivatives.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Numbers, System
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import rates
from dynamics.equations.phase_segments import phase_within
from dynamics.motions.dormand_prince import DENSE_NODES, DENSE_STAGES, DENSE_STEPS, ERROR_3, ERROR_5, INTERPOLANT

# The tableau row by row without its zeros: stages 0–11, the end of the step (12), three stages for the interpolant.
BEGIN = np.concatenate((np.zeros(1, np.int64), np.cumsum(np.count_nonzero(DENSE_STEPS, axis=1))))
COLUMN = np.ascontiguousarray(np.nonzero(DENSE_STEPS)[1])  # numba does not cache code with a strided array
VALUE = DENSE_STEPS[np.nonzero(DENSE_STEPS)]
NODE, _E3, _E5, _DENSE = DENSE_NODES, ERROR_3, ERROR_5, INTERPOLANT

STAGES = DENSE_STAGES
POWERS = 8
ORDER = 8


@compiled(contract=True, part=True)
def _stages(
    begin: int,
    end: int,
    y: Numbers,
    t: float,
    h: float,
    first: int,
    last: int,
    system: System,
    k: Numbers,
    work: Numbers,
    phase: Array,
) -> None:
    """Compute stages begin … end − 1: write their rates to k and the last state to work."""
    p, free_a, free_b, knots, origins, cubics = system
    for row in range(begin, end):
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = 0.0 * y[0]
        for m in range(BEGIN[row], BEGIN[row + 1]):
            a, j = VALUE[m], COLUMN[m]
            a0 += a * k[j, 0]
            a1 += a * k[j, 1]
            a2 += a * k[j, 2]
            a3 += a * k[j, 3]
            a4 += a * k[j, 4]
            a5 += a * k[j, 5]
            a6 += a * k[j, 6]
            a7 += a * k[j, 7]
        work[0], work[1], work[2], work[3] = y[0] + h * a0, y[1] + h * a1, y[2] + h * a2, y[3] + h * a3
        work[4], work[5], work[6], work[7] = y[4] + h * a4, y[5] + h * a5, y[6] + h * a6, y[7] + h * a7
        phase_within(t + NODE[row] * h, first, last, knots, origins, cubics, phase)
        rates(work, phase[0], phase[1], phase[2], p, free_a, free_b, k[row])


@compiled(contract=True, part=True)
def explicit_step(
    y: Numbers, t: float, h: float, first: int, last: int, system: System, k: Numbers, end: Numbers, phase: Array
) -> None:
    """Write the state after one step to end and the rates there to k[12].

    Args:
        y, end: shape (8,), float or complex.
        first, last: phase segments that the step spans.
        system: (packed parameters, free_a, free_b, knots, origins, cubics).
        k: shape (16, 8); k[0] contains the rates at the start.
        phase: scratch, shape (3,).
    """
    _stages(1, 13, y, t, h, first, last, system, k, end, phase)


@compiled(contract=True, part=True)
def explicit_error(h: float, k: Array, scale: Array) -> float:
    """Estimated local error of the step: root mean square over scale, shape (8,)."""
    five = three = 0.0
    for i in range(8):
        e5 = e3 = 0.0
        for j in range(13):
            e5 += _E5[j] * k[j, i]
            e3 += _E3[j] * k[j, i]
        five += (e5 / scale[i]) ** 2
        three += (e3 / scale[i]) ** 2
    if five == 0.0 and three == 0.0:
        return 0.0
    return abs(h) * five / np.sqrt(8.0 * (five + 0.01 * three))


@compiled(contract=True, part=True)
def explicit_polynomial(
    y: Numbers,
    end: Numbers,
    t: float,
    h: float,
    first: int,
    last: int,
    system: System,
    k: Numbers,
    work: Numbers,
    phase: Array,
    coefficients: Numbers,
) -> None:
    """Write the motion over the step as powers of (time − t)/h to coefficients, shape (8 powers, 8)."""
    _stages(13, 16, y, t, h, first, last, system, k, work, phase)
    zero = 0.0 * y[0]
    f3 = f4 = f5 = f6 = zero
    for i in range(8):
        f3 = f4 = f5 = f6 = zero
        for j in range(16):
            f3 += _DENSE[0, j] * k[j, i]
            f4 += _DENSE[1, j] * k[j, i]
            f5 += _DENSE[2, j] * k[j, i]
            f6 += _DENSE[3, j] * k[j, i]
        f0 = end[i] - y[i]
        f1 = h * k[0, i] - f0
        f2 = 2.0 * f0 - h * (k[12, i] + k[0, i])
        f3, f4, f5, f6 = h * f3, h * f4, h * f5, h * f6
        # y + x (f0 + (1 − x) (f1 + x (f2 + (1 − x) (f3 + x (f4 + (1 − x) (f5 + x f6)))))) multiplied out
        coefficients[0, i] = y[i]
        coefficients[1, i] = f0 + f1
        coefficients[2, i] = f2 + f3 - f1
        coefficients[3, i] = f4 + f5 - f2 - 2.0 * f3
        coefficients[4, i] = f3 + f6 - 2.0 * f4 - 3.0 * f5
        coefficients[5, i] = f4 + 3.0 * f5 - 3.0 * f6
        coefficients[6, i] = 3.0 * f6 - f5
        coefficients[7, i] = -f6


@compiled(part=True)  # without contraction, so that all callers get identical bits
def evaluate(coefficients: Numbers, x: float, out: Numbers) -> None:
    """Write a step's polynomial at x = (time − t)/h to out, shape (8,)."""
    for i in range(8):
        value = coefficients[7, i]
        for power in range(6, -1, -1):
            value = value * x + coefficients[power, i]
        out[i] = value
