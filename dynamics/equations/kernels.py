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
The rates may be complex: a complex step then gives exact derivatives of every result of this function. The terms are
grouped by pendulum, and sine and cosine come together from dynamics.equations.sine_cosine: half the time.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Numbers
from dynamics.compiled_code import compiled
from dynamics.equations.sine_cosine import real_sine_cosine, sine_cosine

# Order of the packed parameters (RotorParameters.packed)
MASS, K1, K2, C1, C2, SA, SB, SP, JA, JB, CA, CB, RC, DA, DB, FA, FB, GRAVITY, BX, BY = range(20)
HX, HY, QX, QY, AA, AB = range(20, 26)
PACKED = 26
DIMENSION = 8


@compiled(part=True)
def size_of(x: complex) -> complex:
    """|x| of a float; for a complex number its analytic continuation from the real axis."""
    return x if x.real >= 0.0 else -x


@compiled(contract=True)
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
    out[0], out[1], out[2], out[3] = y[4], y[5], y[6] * free_a, y[7] * free_b
    out[4], out[5] = ax, ay
    out[6] = share_a * p[SA] * (sin_a * px - cos_a * py) + own_a
    out[7] = share_b * p[SB] * (sin_b * px - cos_b * py) + own_b


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
