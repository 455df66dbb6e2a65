"""Free motion together with its derivatives, in one pass.

With the state y = (x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4) and ẏ = f(y, p) the derivatives S = ∂y/∂(y0, p) obey
Ṡ = (∂f/∂y) S + ∂f/∂p. They use the sines and cosines of the motion and have longer steps. Fifteen columns therefore
cost as much as the motion, while finite differences cost fifteen times that.

In the notation of dynamics.equations.kernels: e' = −n, n' = e by the angle, and 𝐌(θ) q̈ = F(y) gives 𝐌 dq̈ = dF − d𝐌 q̈,
where a pendulum's angle enters as S_i (turn e − φ̇² n) + m_i ((n·p̈) e + (e·p̈) n), m_i = S_i²/J_i, and its rate as
S_i (2 φ̇ e + bare' n).
"""

from __future__ import annotations

import numpy as np

from dynamics.compiled_code import compiled
from dynamics.equations.kernels import (
    AA,
    BX,
    BY,
    C1,
    C2,
    CA,
    CB,
    DA,
    FA,
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
from dynamics.equations.sine_cosine import real_sine_cosine
from dynamics.equations.speed_history import phase_at
from rig_basics.arrays import Array

COLUMNS = 15
WHOLE = 13
PARAMETER_COLUMNS = (K1, K2, C1, C2, CA, CB, SP)
"""Packed parameters (dynamics.equations.kernels) of columns 8 … 14; columns 0 … 7 belong to the start state."""


@compiled(part=True)
def copy_rows(source: Array, target: Array) -> None:
    """Copy a matrix (r, c) into another of its shape. numba compiles an assignment of slices slowly."""
    for r in range(source.shape[0]):
        for c in range(source.shape[1]):
            target[r, c] = source[r, c]


@compiled(contract=True, part=True)
def suspension(y: Array, cos_r: float, sin_r: float, p: Array, whole: Array) -> None:
    """Write the factors of k1, k2, c1, c2 and their derivatives by stretch and speed into whole[5:13]."""
    ux, uy = y[0] - (p[BX] * cos_r - p[BY] * sin_r), y[1] - (p[BX] * sin_r + p[BY] * cos_r)
    hx, hy, qx, qy = p[HX] * ux * ux, p[HY] * uy * uy, p[QX] * abs(y[4]), p[QY] * abs(y[5])
    whole[5], whole[6], whole[7], whole[8] = ux * (1.0 + hx), uy * (1.0 + hy), y[4] * (1.0 + qx), y[5] * (1.0 + qy)
    whole[9], whole[10], whole[11], whole[12] = 1.0 + 3.0 * hx, 1.0 + 3.0 * hy, 1.0 + 2.0 * qx, 1.0 + 2.0 * qy


@compiled(contract=True, part=True)
def disk_forces(
    y: Array, psi: float, omega: float, alpha: float, p: Array, whole: Array
) -> tuple[float, float, float, float]:
    """Return the pivots' acceleration by the rotation and by gravity, and the force on the disk: rx, ry, fx, fy.

    Writes the imbalance's force over S_P into whole[3:5] and `suspension` into whole[5:13].
    """
    sin_r, cos_r = real_sine_cosine(psi)
    w2 = omega * omega
    whole[3], whole[4] = w2 * cos_r + alpha * sin_r, w2 * sin_r - alpha * cos_r
    suspension(y, cos_r, sin_r, p, whole)
    fx = p[SP] * whole[3] - p[C1] * whole[7] - p[K1] * whole[5]
    fy = p[SP] * whole[4] - p[C2] * whole[8] - p[K2] * whole[6] - p[MASS] * p[GRAVITY]
    return -p[RC] * whole[3], -p[RC] * whole[4] + p[GRAVITY], fx, fy


@compiled(contract=True, part=True)
def solve_disk(mxx: float, myy: float, mxy: float, fx: float, fy: float, f: Array, whole: Array) -> None:
    """Write the disk's acceleration into f[4:6] and the inverse of its mass matrix (xx, yy, xy) into whole[:3]."""
    share = 1.0 / (mxx * myy - mxy * mxy)
    whole[0], whole[1], whole[2] = myy * share, mxx * share, -mxy * share
    f[4], f[5] = whole[0] * fx + whole[2] * fy, whole[2] * fx + whole[1] * fy


@compiled(contract=True, part=True)
def _accelerations(
    y: Array, psi: float, omega: float, alpha: float, p: Array, f: Array, own: Array, whole: Array
) -> None:
    """Write the rates into f (8,) and the input of `_linearised` into own (2, 8) and whole (13,).

    own, by pendulum: cos φ, sin φ (e = (cos, sin), n = (sin, −cos)), S, S²/J, bare acceleration, its derivative by the
    rate, n·p̈, e·p̈. whole: the inverse of 𝐌 (xx, yy, xy), the imbalance's force over S_P, the factors of k1, k2, c1, c2,
    and the derivatives of these factors by the stretch and by the speed.
    """
    rx, ry, fx, fy = disk_forces(y, psi, omega, alpha, p, whole)
    mxx, myy, mxy = p[MASS], p[MASS], 0.0
    for i in range(2):
        s, j = p[SA + i], p[JA + i]
        sine, cosine = real_sine_cosine(psi + y[2 + i])
        rate, speed = y[6 + i], omega + y[6 + i]
        air = p[AA + i] * abs(rate)
        bare = -(p[DA + i] * alpha + (p[CA + i] + air) * rate + p[FA + i] * speed * speed) / j
        m = s * s / j
        across = s * (alpha + bare) + m * (sine * rx - cosine * ry)
        fx += s * speed * speed * cosine + across * sine
        fy += s * speed * speed * sine - across * cosine
        mxx -= m * sine * sine
        myy -= m * cosine * cosine
        mxy += m * sine * cosine
        own[i, 0], own[i, 1], own[i, 2], own[i, 3], own[i, 4] = cosine, sine, s, m, bare
        own[i, 5] = -(p[CA + i] + 2.0 * air + 2.0 * p[FA + i] * speed) / j
    solve_disk(mxx, myy, mxy, fx, fy, f, whole)
    px, py = f[4] + rx, f[5] + ry
    f[0], f[1], f[2], f[3] = y[4], y[5], y[6], y[7]
    for i in range(2):
        own[i, 6], own[i, 7] = own[i, 1] * px - own[i, 0] * py, own[i, 0] * px + own[i, 1] * py
        f[6 + i] = own[i, 2] / p[JA + i] * own[i, 6] + own[i, 4]


@compiled(contract=True, part=True)
def _linearised(y: Array, omega: float, alpha: float, p: Array, own: Array, whole: Array, g: Array, d: Array) -> None:
    """Write ∂(ẍ, ÿ, θ̈3, θ̈4)/∂(state, parameters) into d (4, 15) from the output of `_accelerations`; g is scratch."""
    for c in range(COLUMNS):
        g[0, c], g[1, c] = 0.0, 0.0
    g[0, 0], g[1, 1], g[0, 4], g[1, 5] = (-p[K1] * whole[9], -p[K2] * whole[10], -p[C1] * whole[11], -p[C2] * whole[12])
    g[0, 8], g[1, 9], g[0, 10], g[1, 11] = -whole[5], -whole[6], -whole[7], -whole[8]
    g[0, 14], g[1, 14] = whole[3], whole[4]
    for i in range(2):
        cosine, sine, s, m, bare, slope = own[i, 0], own[i, 1], own[i, 2], own[i, 3], own[i, 4], own[i, 5]
        speed = omega + y[6 + i]
        along, across = s * (alpha + bare) + m * own[i, 6], -s * speed * speed + m * own[i, 7]
        g[0, 2 + i] = along * cosine + across * sine
        g[1, 2 + i] = along * sine - across * cosine
        g[0, 6 + i] = s * (2.0 * speed * cosine + slope * sine)
        g[1, 6 + i] = s * (2.0 * speed * sine - slope * cosine)
        by_damping = -s * y[6 + i] / p[JA + i]
        g[0, 12 + i], g[1, 12 + i] = by_damping * sine, -by_damping * cosine
    for c in range(COLUMNS):
        d[0, c] = whole[0] * g[0, c] + whole[2] * g[1, c]
        d[1, c] = whole[2] * g[0, c] + whole[1] * g[1, c]
        for i in range(2):
            d[2 + i, c] = own[i, 2] / p[JA + i] * (own[i, 1] * d[0, c] - own[i, 0] * d[1, c])
    for i in range(2):
        d[2 + i, 2 + i] += own[i, 2] / p[JA + i] * own[i, 7]
        d[2 + i, 6 + i] += own[i, 5]
        d[2 + i, 12 + i] -= y[6 + i] / p[JA + i]


@compiled(contract=True, part=True)
def _bent(d: Array, u: Array, v: Array, out: Array) -> None:
    """Write the second time derivatives of S (4, c) into out, from ∂f/∂(y, p) in d (4, c), its angles u and rates v."""
    columns = d.shape[1]
    for i in range(4):
        row = out[i]
        a0, a1, a2, a3, a4, a5, a6, a7 = d[i, 0], d[i, 1], d[i, 2], d[i, 3], d[i, 4], d[i, 5], d[i, 6], d[i, 7]
        for c in range(columns):
            row[c] = (
                a0 * u[0, c]
                + a1 * u[1, c]
                + a2 * u[2, c]
                + a3 * u[3, c]
                + a4 * v[0, c]
                + a5 * v[1, c]
                + a6 * v[2, c]
                + a7 * v[3, c]
            )
        for c in range(8, columns):
            row[c] += d[i, c]


@compiled(contract=True, part=True)
def follow(u: Array, v: Array, h: float, d: Array, bent: Array, rates: Array, moved: Array) -> None:
    """Make one classical Runge–Kutta step of 2 h for the angles u and rates v of S, in place.

    Args:
        u, v: shapes (4, c): derivatives by the start state (8 columns) and by parameters.
        h: half of the step, s.
        d: ∂f/∂(y, p) at the begin, middle and end of the step, shape (3, 4, c).
        bent, rates, moved: scratch, shapes (4, 4, c), (4, 4, c), (4, c).
    """
    columns = u.shape[1]
    copy_rows(u, moved)
    copy_rows(v, rates[0])
    for stage in range(4):
        _bent(d[(stage + 1) // 2], moved, rates[stage], bent[stage])
        if stage == 3:
            break
        part = 2.0 * h if stage == 2 else h
        for r in range(4):
            for c in range(columns):
                moved[r, c] = u[r, c] + part * rates[stage, r, c]
                rates[stage + 1, r, c] = v[r, c] + part * bent[stage, r, c]
    for r in range(4):
        for c in range(columns):
            u[r, c] += h / 3.0 * (rates[0, r, c] + 2.0 * rates[1, r, c] + 2.0 * rates[2, r, c] + rates[3, r, c])
            v[r, c] += h / 3.0 * (bent[0, r, c] + 2.0 * bent[1, r, c] + 2.0 * bent[2, r, c] + bent[3, r, c])


@compiled(contract=True, nogil=True)
def free_motion(
    start: Array,
    start_s: float,
    times: Array,
    step: float,
    knots: Array,
    coefficients: Array,
    p: Array,
    slopes: bool = True,
) -> tuple[Array, Array]:
    """Integrate the motion of two free pendulums and its derivatives by classical Runge–Kutta steps.

    A step of the derivatives spans two of the motion; their relative error is 2e-4, a hundred times the motion's.

    Args:
        start, start_s, times: state (8,), its instant, and later instants of the output, ascending, s, shape (n,).
        step: longest step of the motion, s.
        knots, coefficients: arrays of a SpeedHistory.
        p: packed parameters without dry friction that could make a pendulum stick.
        slopes: whether derivatives are computed. Without them the motion is identical to the last bit at half the cost.
    Returns:
        States (n, 8) and derivatives (n, 8, 15), or (0, 8, 15) without, by the start state and PARAMETER_COLUMNS.
    """
    states, derivatives = np.empty((len(times), 8)), np.empty((len(times) if slopes else 0, 8, COLUMNS))
    y, s = start.copy(), np.zeros((8, COLUMNS))
    u, v = s[:4], s[4:]
    for i in range(8):
        s[i, i] = 1.0
    k, wy, phase = np.empty((4, 8)), np.empty(8), np.empty((3, 3))
    own, whole, g, d = np.empty((2, 8)), np.empty(WHOLE), np.empty((2, COLUMNS)), np.empty((3, 4, COLUMNS))
    bent, rates, moved = np.empty((4, 4, COLUMNS)), np.empty((4, 4, COLUMNS)), np.empty((4, COLUMNS))
    segment, t = phase_at(start_s, 0, knots, coefficients, phase[0]), start_s
    _accelerations(y, phase[0, 0], phase[0, 1], phase[0, 2], p, k[0], own, whole)
    _linearised(y, phase[0, 1], phase[0, 2], p, own, whole, g, d[0])
    for i in range(len(times)):
        pairs = int(np.ceil((times[i] - t) / (2.0 * step) - 1e-9))
        h = (times[i] - t) / max(1, 2 * pairs)
        for j in range(pairs):
            for half in range(2):
                begin = t + (2 * j + half) * h
                segment = phase_at(begin + 0.5 * h, segment, knots, coefficients, phase[1])
                segment = phase_at(begin + h, segment, knots, coefficients, phase[2])
                for stage in range(1, 4):
                    part, at = (h, 2) if stage == 3 else (0.5 * h, 1)
                    for r in range(8):
                        wy[r] = y[r] + part * k[stage - 1, r]
                    _accelerations(wy, phase[at, 0], phase[at, 1], phase[at, 2], p, k[stage], own, whole)
                for r in range(8):
                    y[r] += h / 6.0 * (k[0, r] + 2.0 * k[1, r] + 2.0 * k[2, r] + k[3, r])
                for r in range(3):
                    phase[0, r] = phase[2, r]
                _accelerations(y, phase[0, 0], phase[0, 1], phase[0, 2], p, k[0], own, whole)
                if slopes:
                    _linearised(y, phase[0, 1], phase[0, 2], p, own, whole, g, d[1 + half])
            if slopes:
                follow(u, v, h, d, bent, rates, moved)
                copy_rows(d[2], d[0])
        t = times[i]
        for r in range(8):
            states[i, r] = y[r]
        if slopes:
            copy_rows(s, derivatives[i])
    return states, derivatives
