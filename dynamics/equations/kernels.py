"""Compiled right-hand side of the motion.

State y = (x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4): disk centre in the space-fixed frame, pendulum angles relative to the
rotor. The rotor's phase ψ and its rates ω, α are given functions of time.

With e_i = (cos φ_i, sin φ_i), n_i = (sin φ_i, −cos φ_i), φ_i = ψ + θ_i, a free pendulum or ball obeys
    J_i θ̈_i = S_i n_i·(p̈ + g ŷ) − D_i α − c_i θ̇_i − d_i |θ̇_i| θ̇_i − F_i φ̇_i²,
    p̈ = q̈ + R_C (α (−sin ψ, cos ψ) − ω² (cos ψ, sin ψ)),
and loads the rotor with S_i (φ̇_i² e_i + φ̈_i n_i). D_i is J_i for a pendulum. F_i is the signed coefficient of dry
friction of forward sliding (an integrator of friction changes its sign or locks the pendulum), d_i the drag of the air
that rotates with the rotor. Substitution of the first equation in the second gives two equations
    (M_S 1 − Σ_free S_i²/J_i n_i n_iᵀ) q̈ = forces without q̈,
whose matrix is positive definite because S_i²/J_i ≤ M_i < M_S. A locked pendulum has θ̇ = 0, θ̈ = 0.
The rest position of the springs of a bent shaft is b e^{iψ}, b = B_X + i B_Y. A spring stretched by u pulls with
k u (1 + H u²), and a damper at the speed v resists with c v (1 + Q |v|). Each direction has its own H and Q.
The rates may be complex: a complex step then gives exact derivatives of every result of this function.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Numbers
from dynamics.compiled_code import compiled

# Order of the packed parameters (RotorParameters.packed)
MASS, K1, K2, C1, C2, SA, SB, SP, JA, JB, CA, CB, RC, DA, DB, FA, FB, GRAVITY, BX, BY = range(20)
HX, HY, QX, QY, AA, AB = range(20, 26)
PACKED = 26
DIMENSION = 8


@compiled
def size_of(x: complex) -> complex:
    """|x| of a float; for a complex number its analytic continuation from the real axis."""
    return x if x.real >= 0.0 else -x


@compiled(inline=True)
def _pendulum(  # twelve arguments: numba inlines the call, so a tuple of them would cost its construction
    theta: complex,
    rate: complex,
    psi: float,
    omega: float,
    alpha: float,
    free: float,
    s: complex,
    j: complex,
    c: complex,
    d: complex,
    f: complex,
    air: complex,
) -> tuple[complex, complex, complex, complex, complex, complex]:
    """Direction n, reduced mass, force on the rotor and θ̈, the last two without the terms of p̈ and gravity."""
    phi = psi + theta
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)
    speed = omega + rate * free
    bare = -free * (d * alpha + (c + air * size_of(rate)) * rate + f * speed * speed) / j
    turn = alpha + bare
    fx = s * (speed * speed * cos_phi + turn * sin_phi)
    fy = s * (speed * speed * sin_phi - turn * cos_phi)
    return sin_phi, -cos_phi, free * s * s / j, fx, fy, bare


@compiled
def rates(
    y: Numbers, psi: float, omega: float, alpha: float, p: Numbers, free_a: float, free_b: float, out: Numbers
) -> None:
    """Write dy/dt to out.

    Args:
        y, out: shape (8,), float or complex.
        psi, omega, alpha: rotor phase (rad), speed (rad/s), acceleration (rad/s²).
        p: packed parameters, shape (26,), float or complex.
        free_a, free_b: 1.0 for a released pendulum, 0.0 for a locked one.
    """
    nax, nay, ma, fax, fay, bare_a = _pendulum(
        y[2], y[6], psi, omega, alpha, free_a, p[SA], p[JA], p[CA], p[DA], p[FA], p[AA]
    )
    nbx, nby, mb, fbx, fby, bare_b = _pendulum(
        y[3], y[7], psi, omega, alpha, free_b, p[SB], p[JB], p[CB], p[DB], p[FB], p[AB]
    )
    cos_psi, sin_psi = np.cos(psi), np.sin(psi)
    w2 = omega * omega
    # acceleration of the pivot relative to the disk centre, gravity as an upward acceleration
    rx = -p[RC] * (alpha * sin_psi + w2 * cos_psi)
    ry = p[RC] * (alpha * cos_psi - w2 * sin_psi) + p[GRAVITY]
    # stretch of the springs from their rest position
    ux, uy = y[0] - (p[BX] * cos_psi - p[BY] * sin_psi), y[1] - (p[BX] * sin_psi + p[BY] * cos_psi)
    dot_a = nax * rx + nay * ry
    dot_b = nbx * rx + nby * ry
    fx = (
        -p[C1] * y[4] * (1.0 + p[QX] * size_of(y[4]))
        - p[K1] * ux * (1.0 + p[HX] * ux * ux)
        + fax
        + fbx
        + p[SP] * (w2 * cos_psi + alpha * sin_psi)
        + ma * dot_a * nax
        + mb * dot_b * nbx
    )
    fy = (
        -p[C2] * y[5] * (1.0 + p[QY] * size_of(y[5]))
        - p[K2] * uy * (1.0 + p[HY] * uy * uy)
        + fay
        + fby
        + p[SP] * (w2 * sin_psi - alpha * cos_psi)
        + ma * dot_a * nay
        + mb * dot_b * nby
        - p[MASS] * p[GRAVITY]
    )
    mxx = p[MASS] - ma * nax * nax - mb * nbx * nbx
    myy = p[MASS] - ma * nay * nay - mb * nby * nby
    mxy = -ma * nax * nay - mb * nbx * nby
    det = mxx * myy - mxy * mxy
    ax = (myy * fx - mxy * fy) / det
    ay = (mxx * fy - mxy * fx) / det
    out[0], out[1], out[2], out[3] = y[4], y[5], y[6] * free_a, y[7] * free_b
    out[4], out[5] = ax, ay
    out[6] = free_a * (p[SA] * (nax * ax + nay * ay + dot_a) / p[JA] + bare_a)
    out[7] = free_b * (p[SB] * (nbx * ax + nby * ay + dot_b) / p[JB] + bare_b)


@compiled
def jacobian(
    y: Array, psi: float, omega: float, alpha: float, p: Array, free_a: float, free_b: float, out: Array
) -> None:
    """Write ∂(dy/dt)/∂y, shape (8, 8), to out, by complex steps (exact to rounding)."""
    z = y.astype(np.complex128)
    f = np.empty(8, dtype=np.complex128)
    for j in range(8):
        z[j] = y[j] + 1e-100j
        rates(z, psi, omega, alpha, p, free_a, free_b, f)
        for i in range(8):
            out[i, j] = f[i].imag * 1e100
        z[j] = y[j]


@compiled
def rk4_step(
    y: Array,
    h: float,
    phase0: Array,
    phase1: Array,
    phase2: Array,
    p: Array,
    free_a: float,
    free_b: float,
    k1: Array,
    k2: Array,
    k3: Array,
    k4: Array,
    work: Array,
) -> None:
    """Advance y by h in place with one classical fourth-order step.

    Args:
        phase0, phase1, phase2: (ψ, ω, α) at the start, the middle and the end of the step.
        k1, k2, k3, k4, work: scratch, shape (8,).
    """
    rates(y, phase0[0], phase0[1], phase0[2], p, free_a, free_b, k1)
    for i in range(8):
        work[i] = y[i] + 0.5 * h * k1[i]
    rates(work, phase1[0], phase1[1], phase1[2], p, free_a, free_b, k2)
    for i in range(8):
        work[i] = y[i] + 0.5 * h * k2[i]
    rates(work, phase1[0], phase1[1], phase1[2], p, free_a, free_b, k3)
    for i in range(8):
        work[i] = y[i] + h * k3[i]
    rates(work, phase2[0], phase2[1], phase2[2], p, free_a, free_b, k4)
    for i in range(8):
        y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
