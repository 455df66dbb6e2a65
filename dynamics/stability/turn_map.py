"""How neighbours of a motion move over whole revolutions of the rotor: derivatives of the once-a-revolution map.

The explicit steps of dynamics.motions.explicit_steps are taken with the state and, with the same coefficients, with all
its derivatives by the state before: K' = J (Y' + h Σ a K'), J the right-hand side's own derivatives in closed form.
That is the derivative of the very same arithmetic, exact to rounding, at an eighth of the price of complex steps.
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynamics.equations.kernels import (
    AA,
    BX,
    BY,
    C1,
    C2,
    CA,
    GRAVITY,
    HX,
    HY,
    JA,
    K1,
    K2,
    MASS,
    QX,
    QY,
    RC,
    SA,
    SP,
)
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.phase_segments import PhaseSegments, phase_within
from dynamics.equations.quick_rates import quick_rates, real_sine_cosine
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.explicit_steps import BEGIN, COLUMN, NODE, VALUE
from dynamics.motions.locked_motion import damping_rates

_STEP_RAD = 0.8  # of the fastest oscillation: an error of some 1e-6 a revolution
_STABLE_REACH = 4.0  # radians of the fastest decay a step may take
_MOST_STEPS = 4000  # a revolution; beyond it the motion is too stiff or too slow for explicit steps


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _rate_derivatives(y, psi, omega, p, free_a, free_b, out):
    """Derivatives of the accelerations of dynamics.equations.quick_rates by the state, shape (4, 8), into out.

    At constant speed, without dry friction. With W the inverse of the disk's 2 × 2 mass matrix, a change of the forces
    by f' and of the matrix by M' changes the disk's acceleration a by W (f' − M' a).
    """
    sin_a, cos_a = real_sine_cosine(psi + y[2])
    sin_b, cos_b = real_sine_cosine(psi + y[3])
    sin_r, cos_r = real_sine_cosine(psi)
    sines, cosines = (sin_a, sin_b), (cos_a, cos_b)
    w2 = omega * omega
    rx, ry = -p[RC] * w2 * cos_r, -p[RC] * w2 * sin_r + p[GRAVITY]
    ux, uy = y[0] - (p[BX] * cos_r - p[BY] * sin_r), y[1] - (p[BX] * sin_r + p[BY] * cos_r)
    hx, hy, qx, qy = p[HX] * ux * ux, p[HY] * uy * uy, p[QX] * abs(y[4]), p[QY] * abs(y[5])
    fx = p[SP] * w2 * cos_r - p[C1] * y[4] * (1.0 + qx) - p[K1] * ux * (1.0 + hx)
    fy = p[SP] * w2 * sin_r - p[C2] * y[5] * (1.0 + qy) - p[K2] * uy * (1.0 + hy) - p[MASS] * p[GRAVITY]
    k1, k2 = p[K1] * (1.0 + 3.0 * hx), p[K2] * (1.0 + 3.0 * hy)
    c1, c2 = p[C1] * (1.0 + 2.0 * qx), p[C2] * (1.0 + 2.0 * qy)
    mxx, myy, mxy = p[MASS], p[MASS], 0.0
    for i in range(2):
        free, s, sin, cos = (free_a if i == 0 else free_b), p[SA + i], sines[i], cosines[i]
        mass, speed = free * s * s / p[JA + i], omega + y[6 + i] * free
        along = s * speed * speed
        loss = p[CA + i] + p[AA + i] * abs(y[6 + i])
        across = -s * free / p[JA + i] * loss * y[6 + i] + mass * (sin * rx - cos * ry)
        fx += along * cos + across * sin
        fy += along * sin - across * cos
        mxx -= mass * sin * sin
        myy -= mass * cos * cos
        mxy += mass * sin * cos
    whole = 1.0 / (mxx * myy - mxy * mxy)
    wxx, wxy, wyy = myy * whole, -mxy * whole, mxx * whole
    ax, ay = wxx * fx + wxy * fy, wxy * fx + wyy * fy
    out[0, 0], out[1, 0] = -wxx * k1, -wxy * k1
    out[0, 1], out[1, 1] = -wxy * k2, -wyy * k2
    out[0, 4], out[1, 4] = -wxx * c1, -wxy * c1
    out[0, 5], out[1, 5] = -wxy * c2, -wyy * c2
    for i in range(2):
        free, s, sin, cos = (free_a if i == 0 else free_b), p[SA + i], sines[i], cosines[i]
        share, speed = free / p[JA + i], omega + y[6 + i] * free
        air = p[AA + i] * abs(y[6 + i])
        mass, drag = share * s * s, -share * (p[CA + i] + 2.0 * air)
        along = s * speed * speed
        across = -s * share * (p[CA + i] + air) * y[6 + i] + mass * (sin * rx - cos * ry)
        bent = mass * (cos * rx + sin * ry)
        gx = (bent - along) * sin + across * cos + mass * (2.0 * sin * cos * ax - (cos * cos - sin * sin) * ay)
        gy = along * cos + across * sin - bent * cos - mass * (2.0 * sin * cos * ay + (cos * cos - sin * sin) * ax)
        out[0, 2 + i], out[1, 2 + i] = wxx * gx + wxy * gy, wxy * gx + wyy * gy
        gx = 2.0 * s * speed * free * cos + s * drag * sin
        gy = 2.0 * s * speed * free * sin - s * drag * cos
        out[0, 6 + i], out[1, 6 + i] = wxx * gx + wxy * gy, wxy * gx + wyy * gy
    for i in range(2):
        share = (free_a if i == 0 else free_b) / p[JA + i] * p[SA + i]
        for j in range(8):
            out[2 + i, j] = share * (sines[i] * out[0, j] - cosines[i] * out[1, j])
        out[2 + i, 2 + i] += share * (cosines[i] * (ax + rx) + sines[i] * (ay + ry))
        loss = p[CA + i] + 2.0 * p[AA + i] * abs(y[6 + i])
        out[2 + i, 6 + i] -= (free_a if i == 0 else free_b) / p[JA + i] * loss


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})
def _derivatives(states, steps, period, system, out):
    """Derivatives (8, 8) of the state after a revolution by the state before it, for states (n, 8), into out."""
    p, free_a, free_b, knots, origins, cubics = system
    k, tangents, by_state = np.zeros((12, 8)), np.zeros((12, 8, 8)), np.zeros((4, 8))
    y, work, end, moved = np.empty(8), np.empty(8), np.empty((8, 8)), np.empty((8, 8))
    phase, h = np.empty(3), period / steps
    for n in range(len(states)):
        y[:] = states[n]
        end[:] = np.eye(8)
        for s in range(steps):
            for row in range(13):
                work[:] = y
                moved[:] = end
                for m in range(BEGIN[row], BEGIN[row + 1]):
                    a, j = h * VALUE[m], COLUMN[m]
                    for i in range(8):
                        work[i] += a * k[j, i]
                        for c in range(8):
                            moved[i, c] += a * tangents[j, i, c]
                if row == 12:
                    break
                phase_within((s + NODE[row]) * h, 1, 1, knots, origins, cubics, phase)
                quick_rates(work, phase[0], phase[1], phase[2], p, free_a, free_b, k, row)
                _rate_derivatives(work, phase[0], phase[1], p, free_a, free_b, by_state)
                for c in range(8):
                    tangents[row, 0, c], tangents[row, 1, c] = moved[4, c], moved[5, c]
                    tangents[row, 2, c], tangents[row, 3, c] = free_a * moved[6, c], free_b * moved[7, c]
                for i in range(4):
                    for c in range(8):
                        tangents[row, 4 + i, c] = 0.0
                    for m in range(8):
                        for c in range(8):
                            tangents[row, 4 + i, c] += by_state[i, m] * moved[m, c]
            y[:] = work
            end[:] = moved
        out[n] = end


def turn_derivatives(
    parameters: RotorParameters, speed_rad_s: float, states: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Derivatives of the state one revolution later, by the state.

    Args:
        parameters: without dry friction.
        states: at ψ = 0, shape (n, 8).
    Returns:
        Shape (n, 8, 8) in SI; None where explicit steps would be too many.
    """
    turning = float(np.max(np.abs(states[:, 6:]), initial=0.0))
    rate = max(speed_rad_s + turning, *parameters.natural_frequencies_rad_s) / _STEP_RAD
    rate = max(rate, max(damping_rates(parameters)) / _STABLE_REACH)
    period = 2 * math.pi / speed_rad_s
    if not rate * period < _MOST_STEPS:
        return None
    segments = PhaseSegments.of(SpeedHistory.constant(speed_rad_s))
    # one endless segment: the phase is linear everywhere
    system = (
        parameters.packed(), float(parameters.a.present), float(parameters.b.present),
        np.array([-np.inf, np.inf]), segments.origins, segments.cubics,
    )  # fmt: skip
    out = np.empty((len(states), 8, 8))
    _derivatives(np.ascontiguousarray(states), math.ceil(rate * period), period, system, out)
    return out
