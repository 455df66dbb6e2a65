"""Correction of the averaged solution: the integrated equation of motion minus its solution averaged over a cycle.

    q̈ + 2 ζ ω q̇ + d2 |q̇| q̇ + ω² (1 + κ q²) q = 0,    κ = 8 η/(3 A²),  d2 = 3π S/(4 A).

The averaged solution is of first order in κ a² and d2 a. The missing terms (the third harmonic, the second order of the
frequency) are some micrometres at a few millimetres. This equals the noise of one sample and exceeds that of all
samples by far. The correction is computed at the fitted parameters and subtracted from the block means; the fit is then
repeated.
"""

from __future__ import annotations

import numpy as np

from dynamics.compiled_code import compiled
from identification.ring_down.backbone import REFERENCE_M, Rates
from rig_basics.arrays import Array, Complex

_STEPS_PER_CYCLE = 128


def exact_motion(rates: Rates, start: complex, scale: float, time_s: Array) -> Array:
    """Integrate the motion of a mode: displacement, velocity and acceleration, shape (3, n).

    Args:
        rates: parameters of the mode.
        start: complex amplitude of the averaged solution at time 0: displacement Re(start), velocity Re(rate · start).
        scale: amplitude of the mode over that of `start`, for a sensor that measures a part of the motion.
        time_s: shape (n,), s, ascending, at most a few blocks before 0.
    """
    level = abs(start) * scale / REFERENCE_M
    root = float(np.sqrt(1 - rates.zeta**2))
    # rate of the averaged solution at time 0
    rate = rates.omega * complex(-rates.zeta - rates.drag * level, root * (1 + rates.hardening * level**2))
    cubic = 8 / 3 * rates.hardening * (scale / REFERENCE_M) ** 2
    drag = 0.75 * np.pi * rates.drag * scale / REFERENCE_M
    step = 2 * np.pi / rates.omega / _STEPS_PER_CYCLE
    first = (start.real, (rate * start).real)
    return _integrated(rates.omega, rates.zeta, cubic, drag, first[0], first[1], np.ascontiguousarray(time_s), step)


def lacking(rates: Rates, start: complex, scale: float, time_s: Array, spread_s2: Array, wave: Complex) -> Array:
    """Block means of the exact motion minus those of the averaged one, shape (n,), m.

    Args:
        rates, start, scale, time_s: as in exact_motion.
        spread_s2: variance of the sample times of each block, shape (n,).
        wave: block means of e^P, shape (n,).
    """
    exact = exact_motion(rates, start, scale, time_s)
    return exact[0] + 0.5 * spread_s2 * exact[2] - (start * wave).real


@compiled(nogil=True)
def _integrated(
    omega: float, zeta: float, cubic: float, drag: float, q: float, v: float, time_s: Array, step: float
) -> Array:  # pragma: no cover
    """Fourth-order Runge–Kutta integration, with a whole number of steps between two times."""
    out = np.empty((3, len(time_s)))
    now, stiff, damp = 0.0, omega * omega, 2 * zeta * omega
    for i in range(len(time_s)):
        gap = time_s[i] - now
        count = max(1, int(np.ceil(abs(gap) / step)))
        h = gap / count
        for _ in range(count):
            a1 = -damp * v - drag * abs(v) * v - stiff * (1 + cubic * q * q) * q
            q2, v2 = q + 0.5 * h * v, v + 0.5 * h * a1
            a2 = -damp * v2 - drag * abs(v2) * v2 - stiff * (1 + cubic * q2 * q2) * q2
            q3, v3 = q + 0.5 * h * v2, v + 0.5 * h * a2
            a3 = -damp * v3 - drag * abs(v3) * v3 - stiff * (1 + cubic * q3 * q3) * q3
            q4, v4 = q + h * v3, v + h * a3
            a4 = -damp * v4 - drag * abs(v4) * v4 - stiff * (1 + cubic * q4 * q4) * q4
            q, v = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        now = time_s[i]
        out[0, i], out[1, i] = q, v
        out[2, i] = -damp * v - drag * abs(v) * v - stiff * (1 + cubic * q * q) * q
    return out
