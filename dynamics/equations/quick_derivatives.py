"""Derivatives of the accelerations by the state, in closed form: one eighth of the cost of complex steps."""

from __future__ import annotations

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
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
from dynamics.equations.sine_cosine import real_sine_cosine


@compiled(contract=True, part=True)
def _pendulum_row(
    i: int, y: Array, p: Array, free: float, sine: float, cosine: float, px: float, py: float, out: Array
) -> None:
    """Write the derivatives of θ̈ of one pendulum, shape (8,), to row 2 + i of out.

    Args:
        i: 0 for A, 1 for B.
        y, p: state and packed parameters.
        free: 1.0 for a released pendulum, 0.0 for a locked one.
        sine, cosine: of the pendulum's angle.
        px, py: acceleration of the pivot, with gravity.
        out: derivatives; those of the disk are in rows 0 and 1.
    """
    share = free / p[JA + i] * p[SA + i]
    for j in range(8):
        out[2 + i, j] = share * (sine * out[0, j] - cosine * out[1, j])
    out[2 + i, 2 + i] += share * (cosine * px + sine * py)
    loss = p[CA + i] + 2.0 * p[AA + i] * abs(y[6 + i])
    out[2 + i, 6 + i] -= free / p[JA + i] * loss


@compiled(contract=True)
def rate_derivatives(y: Array, psi: float, omega: float, p: Array, free_a: float, free_b: float, out: Array) -> None:
    """Write the derivatives of the accelerations of dynamics.equations.kernels by the state, shape (4, 8), to out.

    Args:
        y: state, shape (8,).
        psi, omega: rotor phase (rad) and constant speed (rad/s).
        p: packed parameters; dry friction is neglected.
        free_a, free_b: 1.0 for a released pendulum, 0.0 for a locked one.

    With W the inverse of the disk's 2 × 2 mass matrix, a change f' of the forces and M' of the matrix changes the
    disk's acceleration a by W (f' − M' a).
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
        _pendulum_row(i, y, p, free_a if i == 0 else free_b, sines[i], cosines[i], ax + rx, ay + ry, out)
