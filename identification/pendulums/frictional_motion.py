"""Free motion with dry friction and its derivatives: sliding, sticking and the transitions between them.

A sliding pendulum has the friction torque −sign(θ̇) (M_i + F_i φ̇_i²) in addition to its viscous torque. M_i is
independent of the speed (a seal, a preload); F_i φ̇² is proportional to the contact force M R φ̇². A sticking pendulum
(θ̇ = 0) remains at rest while the holding torque S n·(p̈ + g ŷ) − D α is below M_i + F_i ω². Within a mode the motion and
the variational equation Ṡ = (∂f/∂y) S + ∂f/∂p are smooth. At an instant t* at which θ̇_i passes zero the rates jump from
f⁻ to f⁺, and

    S⁺ = S⁻ + (f⁺ − f⁻) S⁻[θ̇_i] / f⁻[θ̈_i],

because a change of the parameters moves the instant by −S⁻[θ̇_i]/f⁻[θ̈_i]. At the end of sticking the rates do not jump.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from dynamics.equations.kernels import AA, C1, C2, CA, DA, FA, JA, K1, K2, MASS, SA
from dynamics.equations.sine_cosine import real_sine_cosine
from dynamics.equations.speed_history import phase_at
from identification.pendulums.variational import WHOLE, copy_rows, disk_forces, follow, solve_disk
from rig_basics.arrays import Array

COLUMNS = 19
"""Number of columns of the derivatives: those of identification.pendulums.variational, then M_A, M_B, F_A, F_B."""
_MAX_ZERO_RATE_RAD_S = 1e-9  # rates below count as zero
_LEAST_SLIDE_S = 1e-9
_PAST = 1e-3  # extension of a step beyond the end of sticking, as a share of the step
_MOST_SWITCHES = 40_000


@compiled(contract=True, part=True)
def _rates(
    y: Array, phase: Array, p: Array, torque: Array, mode: NDArray[np.int64], f: Array, own: Array, whole: Array
) -> None:
    """Write the rates into f (8,) and the input of `_linearised` into own (2, 8) and whole (13,).

    own, by pendulum: cos φ, sin φ, S²/J, bare acceleration, turning rate, derivative of the bare acceleration by the
    rate, e·p̈, holding torque. whole: the inverse of 𝐌 (xx, yy, xy), the imbalance's force over S_P, and `suspension`.
    """
    psi, omega, alpha = phase[0], phase[1], phase[2]
    rx, ry, fx, fy = disk_forces(y, psi, omega, alpha, p, whole)
    mxx, myy, mxy = p[MASS], p[MASS], 0.0
    for i in range(2):
        inertia, free = p[JA + i], 1.0 if mode[i] != 0 else 0.0
        sine, cosine = real_sine_cosine(psi + y[2 + i])
        rate = y[6 + i] * free
        speed = omega + rate
        dry = mode[i] * (torque[i] + p[FA + i] * speed * speed)
        air = p[AA + i] * abs(rate)
        bare = -free * (p[DA + i] * alpha + (p[CA + i] + air) * rate + dry) / inertia
        m = free * p[SA + i] * p[SA + i] / inertia
        across = p[SA + i] * (alpha + bare) + m * (sine * rx - cosine * ry)
        fx += p[SA + i] * speed * speed * cosine + across * sine
        fy += p[SA + i] * speed * speed * sine - across * cosine
        mxx -= m * sine * sine
        myy -= m * cosine * cosine
        mxy += m * sine * cosine
        own[i, 0], own[i, 1], own[i, 2], own[i, 3], own[i, 4] = cosine, sine, m, bare, speed
        own[i, 5] = -free * (p[CA + i] + 2.0 * air + 2.0 * mode[i] * p[FA + i] * speed) / inertia
    solve_disk(mxx, myy, mxy, fx, fy, f, whole)
    px, py = f[4] + rx, f[5] + ry
    f[0], f[1] = y[4], y[5]
    for i in range(2):
        free, along_n = 1.0 if mode[i] != 0 else 0.0, own[i, 1] * px - own[i, 0] * py
        f[2 + i] = free * y[6 + i]
        f[6 + i] = free * p[SA + i] / p[JA + i] * along_n + own[i, 3]
        own[i, 6], own[i, 7] = own[i, 0] * px + own[i, 1] * py, p[SA + i] * along_n - p[DA + i] * alpha


@compiled(contract=True, part=True)
def _linearised(
    y: Array, phase: Array, p: Array, mode: NDArray[np.int64], own: Array, whole: Array, g: Array, d: Array
) -> None:
    """Write ∂(ẍ, ÿ, θ̈3, θ̈4)/∂(state, parameters, friction) into d (4, 19) from the output of `_rates`; g is scratch."""
    alpha = phase[2]
    for c in range(COLUMNS):
        g[0, c], g[1, c] = 0.0, 0.0
    g[0, 0], g[1, 1], g[0, 4], g[1, 5] = (-p[K1] * whole[9], -p[K2] * whole[10], -p[C1] * whole[11], -p[C2] * whole[12])
    g[0, 8], g[1, 9], g[0, 10], g[1, 11] = -whole[5], -whole[6], -whole[7], -whole[8]
    g[0, 14], g[1, 14] = whole[3], whole[4]
    for i in range(2):
        cosine, sine, m, bare, speed, slope = own[i, 0], own[i, 1], own[i, 2], own[i, 3], own[i, 4], own[i, 5]
        first, inertia, free = p[SA + i], p[JA + i], 1.0 if mode[i] != 0 else 0.0
        along_n = (own[i, 7] + p[DA + i] * alpha) / first if first != 0.0 else 0.0
        along, across = first * (alpha + bare) + m * along_n, -first * speed * speed + m * own[i, 6]
        g[0, 2 + i] = along * cosine + across * sine
        g[1, 2 + i] = along * sine - across * cosine
        g[0, 6 + i] = first * (2.0 * speed * cosine + slope * sine)
        g[1, 6 + i] = first * (2.0 * speed * sine - slope * cosine)
        by = -free * first / inertia
        for column, of in ((12 + i, y[6 + i]), (15 + i, float(mode[i])), (17 + i, mode[i] * speed * speed)):
            g[0, column], g[1, column] = by * of * sine, -by * of * cosine
    for c in range(COLUMNS):
        d[0, c] = whole[0] * g[0, c] + whole[2] * g[1, c]
        d[1, c] = whole[2] * g[0, c] + whole[1] * g[1, c]
    for i in range(2):
        if mode[i] == 0:
            for c in range(COLUMNS):
                d[2 + i, c] = 0.0
            continue
        share = p[SA + i] / p[JA + i]
        for c in range(COLUMNS):
            d[2 + i, c] = share * (own[i, 1] * d[0, c] - own[i, 0] * d[1, c])
        d[2 + i, 2 + i] += share * own[i, 6]
        d[2 + i, 6 + i] += own[i, 5]
        d[2 + i, 12 + i] -= y[6 + i] / p[JA + i]
        d[2 + i, 15 + i] -= mode[i] / p[JA + i]
        d[2 + i, 17 + i] -= mode[i] * own[i, 4] ** 2 / p[JA + i]


@compiled(contract=True, part=True)
def _step(
    y: Array,
    t: float,
    h: float,
    segment: int,
    knots: Array,
    coefficients: Array,
    p: Array,
    torque: Array,
    mode: NDArray[np.int64],
    k: Array,
    wy: Array,
    phase: Array,
    own: Array,
    whole: Array,
    out: Array,
) -> int:
    """Make one classical Runge–Kutta step of the state from its rates k[0] into out; return the segment at its end."""
    segment = phase_at(t + 0.5 * h, segment, knots, coefficients, phase[1])
    segment = phase_at(t + h, segment, knots, coefficients, phase[2])
    for stage in range(1, 4):
        part, at = (h, 2) if stage == 3 else (0.5 * h, 1)
        for r in range(8):
            wy[r] = y[r] + part * k[stage - 1, r]
        _rates(wy, phase[at], p, torque, mode, k[stage], own, whole)
    for r in range(8):
        out[r] = y[r] + h / 6.0 * (k[0, r] + 2.0 * k[1, r] + 2.0 * k[2, r] + k[3, r])
    return segment


@compiled(contract=True, part=True)
def _over(
    y: Array, phase: Array, p: Array, torque: Array, mode: NDArray[np.int64], i: int, f: Array, own: Array, whole: Array
) -> tuple[float, float]:
    """Return the holding torque of pendulum i, and its excess over the friction, which is negative while it sticks."""
    mine = mode[i]
    mode[i] = 0
    _rates(y, phase, p, torque, mode, f, own, whole)
    mode[i] = mine
    return own[i, 7], abs(own[i, 7]) - max(0.0, torque[i] + p[FA + i] * phase[1] * phase[1])


@compiled(contract=True, part=True)
def _begun(
    y: Array,
    phase: Array,
    p: Array,
    torque: Array,
    mode: NDArray[np.int64],
    held: Array,
    f: Array,
    own: Array,
    whole: Array,
) -> None:
    """Write the initial mode of each pendulum into mode, the excess torque of those at rest into held, rates into f."""
    for i in range(2):
        mode[i] = 0 if abs(y[6 + i]) <= _MAX_ZERO_RATE_RAD_S else (1 if y[6 + i] > 0 else -1)
    for _ in range(4):  # a pendulum that begins to slide changes the holding torque of the other
        for i in range(2):
            if abs(y[6 + i]) <= _MAX_ZERO_RATE_RAD_S:
                needed, held[i] = _over(y, phase, p, torque, mode, i, f, own, whole)
                mode[i] = 0 if held[i] <= 0.0 else (1 if needed > 0 else -1)
    _rates(y, phase, p, torque, mode, f, own, whole)


@compiled(nogil=True)
def frictional_rates(start: Array, phase: Array, p: Array, torque: Array) -> Array:
    """Return the initial ẏ (8,) of `frictional_motion`, with sticking or sliding pendulums.

    Args:
        start, p, torque: as for `frictional_motion`.
        phase: ψ, ω, α at the start.
    """
    f = np.empty(8)
    _begun(start, phase, p, torque, np.zeros(2, np.int64), np.zeros(2), f, np.empty((2, 8)), np.empty(WHOLE))
    return f


@compiled(part=True)
def _ending(y: Array, out: Array, mode: NDArray[np.int64], i: int, acceleration: float, h: float) -> float:
    """Return the share of a step after which sliding ends, by the parabola through the rates; 2 if it does not end."""
    r0, r1 = y[6 + i], out[6 + i]
    if mode[i] == 0 or not (mode[i] * r1 < -_MAX_ZERO_RATE_RAD_S and mode[i] * r0 > -_MAX_ZERO_RATE_RAD_S):
        return 2.0
    a0 = acceleration * h
    root, part = a0 * a0 - 4.0 * (r1 - r0 - a0) * r0, r0 / (r0 - r1)
    if root >= 0.0 and a0 != 0.0:
        trial = -2.0 * r0 / (a0 - np.sqrt(root)) if a0 < 0.0 else -2.0 * r0 / (a0 + np.sqrt(root))
        part = trial if 0.0 < trial < 1.0 else part
    return max(part, 0.0)


@compiled(contract=True, part=True)
def _follow_alone(
    y: Array,
    slope: Array,
    end: Array,
    end_slope: Array,
    t: float,
    h: float,
    segment: int,
    system: tuple[Array, Array, Array, Array, NDArray[np.int64]],
    middle: tuple[Array, Array, Array, Array, Array, Array],
    columns: tuple[Array, Array, Array, Array, Array, Array],
) -> None:
    """Make a step of the derivatives over one step of the motion, whose middle is on the cubic through its ends.

    Args:
        y, slope, end, end_slope: states and rates at the ends of the step, shapes (8,).
        t, h, segment: begin and length of the step, s; hint for `phase_at`.
        system: knots, coefficients, p, torque, mode.
        middle: scratch: state, rates, phase, own, whole, g.
        columns: u, v, d, bent, rates, moved of `follow`; d[0] and d[2] belong to the ends, d[1] is written.
    """
    knots, coefficients, p, torque, mode = system
    wy, f, phase, own, whole, g = middle
    u, v, d, bent, rates, moved = columns
    phase_at(t + 0.5 * h, segment, knots, coefficients, phase)
    for r in range(8):
        wy[r] = 0.5 * (y[r] + end[r]) + 0.125 * h * (slope[r] - end_slope[r])
    _rates(wy, phase, p, torque, mode, f, own, whole)
    _linearised(wy, phase, p, mode, own, whole, g, d[1])
    follow(u, v, 0.5 * h, d, bent, rates, moved)


@compiled(contract=True, nogil=True)
def frictional_motion(  # noqa: PLR0912, PLR0915 - one loop: in parts it took 1.25 to 2.2 times as long
    start: Array,
    start_s: float,
    times: Array,
    step: float,
    knots: Array,
    coefficients: Array,
    p: Array,
    torque: Array,
    slopes: bool = True,
) -> tuple[Array, Array]:
    """Integrate the motion of two free pendulums with dry friction.

    Two smooth steps of the motion are one step of the derivatives (identification.pendulums.variational). A step at the
    end of sliding or sticking is a separate step of the derivatives.

    Args:
        start, start_s, times, step, knots, coefficients, p: as for identification.pendulums.variational.free_motion.
            The friction F_i in p may have any sign, since a fit's trial may be negative.
        torque: M_A, M_B, N m, shape (2,).
        slopes: whether derivatives are computed.
    Returns:
        States (n, 8) and derivatives (n, 8, 19), or (0, 8, 19) without derivatives. The rows after the largest number
        of transitions are NaN.
    """
    n = len(times)
    states, derivatives = np.empty((n, 8)), np.empty((n if slopes else 0, 8, COLUMNS))
    for row in range(n):
        for r in range(8):
            states[row, r] = np.nan
            for c in range(COLUMNS if slopes else 0):
                derivatives[row, r, c] = np.nan
    y, s = start.copy(), np.zeros((8, COLUMNS))
    u, v = s[:4], s[4:]
    for i in range(8):
        s[i, i] = 1.0
    k, wy, phase, at, out = np.empty((4, 8)), np.empty(8), np.empty((3, 3)), np.empty(3), np.empty(8)
    own, whole, g, d = np.empty((2, 8)), np.empty(WHOLE), np.empty((2, COLUMNS)), np.empty((3, 4, COLUMNS))
    bent, rates, moved = np.empty((4, 4, COLUMNS)), np.empty((4, 4, COLUMNS)), np.empty((4, COLUMNS))
    f, last_y, last_f, waiting = np.empty(8), np.empty(8), np.empty(8), 0.0  # s; pending step of the derivatives
    mode, held, kept = np.zeros(2, np.int64), np.zeros(2), np.array((-np.inf, -np.inf))
    system, middle, columns = (
        (knots, coefficients, p, torque, mode),
        (wy, k[1], phase[1], own, whole, g),
        (u, v, d, bent, rates, moved),
    )
    segment, t, switches = phase_at(start_s, 0, knots, coefficients, at), start_s, 0
    _begun(y, at, p, torque, mode, held, k[0], own, whole)
    _linearised(y, at, p, mode, own, whole, g, d[0])
    for row in range(n):
        while times[row] - t > 1e-12:
            steps = max(1.0, np.ceil((times[row] - t) / step - 1e-9))
            if waiting == 0.0:
                steps = 2.0 * np.ceil(0.5 * steps)
            h = (times[row] - t) / steps
            segment = _step(y, t, h, segment, knots, coefficients, p, torque, mode, k, wy, phase, own, whole, out)
            ends, loose, share = -1, -1, 1.0
            for i in range(2):  # the first end of sliding
                part = _ending(y, out, mode, i, k[0, 6 + i], h)
                if part < share:
                    ends, share = i, part
            for i in range(2):  # the first end of sticking, by linear interpolation of the excess torque
                if mode[i] == 0:
                    _, after = _over(out, phase[2], p, torque, mode, i, f, own, whole)
                    if after > 0.0 and held[i] < 0.0 and held[i] / (held[i] - after) < share:
                        loose, ends, share = i, -1, min(1.0, held[i] / (held[i] - after) + _PAST)
            if ends >= 0:
                for _ in range(6):  # secant iteration of the instant
                    segment = _step(
                        y, t, share * h, segment, knots, coefficients, p, torque, mode, k, wy, phase, own, whole, out
                    )
                    slope = k[3, 6 + ends]
                    if abs(out[6 + ends]) <= _MAX_ZERO_RATE_RAD_S or slope == 0.0:
                        break
                    share = min(1.0, max(0.0, share - out[6 + ends] / (slope * h)))
            elif loose >= 0:
                segment = _step(
                    y, t, share * h, segment, knots, coefficients, p, torque, mode, k, wy, phase, own, whole, out
                )
            switching = ends >= 0 or loose >= 0
            if waiting > 0.0 and (switching or abs(waiting - h) > 1e-6 * h):  # the pending step is made separately
                if slopes:
                    _follow_alone(last_y, last_f, y, k[0], t - waiting, waiting, segment, system, middle, columns)
                copy_rows(d[2], d[0])
                waiting = 0.0
            t += share * h
            segment = phase_at(t, segment, knots, coefficients, at)
            _rates(out, at, p, torque, mode, f, own, whole)
            if slopes:
                _linearised(out, at, p, mode, own, whole, g, d[2])
            if switching:
                if slopes:
                    _follow_alone(y, k[0], out, f, t - share * h, share * h, segment, system, middle, columns)
                copy_rows(d[2], d[0])
            elif waiting > 0.0:
                if slopes:
                    follow(u, v, h, d, bent, rates, moved)
                copy_rows(d[2], d[0])
                waiting = 0.0
            else:
                copy_rows(d[2], d[1])
                waiting = h
                for r in range(8):
                    last_y[r], last_f[r] = y[r], k[0, r]
            for r in range(8):
                y[r], k[0, r] = out[r], f[r]
            if ends >= 0:
                switches += 1
                if switches > _MOST_SWITCHES:
                    return states, derivatives
                came = mode[ends]
                y[6 + ends] = 0.0
                needed, over = _over(y, at, p, torque, mode, ends, k[1], own, whole)
                grips = torque[ends] + p[FA + ends] * at[1] * at[1] > 0.0
                # a slide that ends where it began is at a peak of the torque that just moves it: it sticks for a step
                if grips and share * h <= _LEAST_SLIDE_S:
                    kept[ends] = t + 0.5 * h
                mode[ends] = 0 if over <= 0.0 or t < kept[ends] else (1 if needed > 0 else -1)
                # without friction, or with negative friction, the motion passes zero; else it only touches zero
                if mode[ends] == came and not grips:
                    mode[ends] = -came
                y[6 + ends] = mode[ends] * 2.0 * _MAX_ZERO_RATE_RAD_S
                _rates(y, at, p, torque, mode, k[0], own, whole)
                if f[6 + ends] != 0.0:
                    for c in range(COLUMNS):
                        jump = v[2 + ends, c] / f[6 + ends]
                        for r in range(8):
                            s[r, c] += (k[0, r] - f[r]) * jump
            slides = False
            for i in range(2):
                held[i] = 0.0
                if mode[i] == 0 and t >= kept[i]:
                    needed, held[i] = _over(y, at, p, torque, mode, i, k[1], own, whole)
                    if held[i] > 0.0:
                        if waiting > 0.0:  # the pending step of the derivatives is in the old mode
                            if slopes:
                                _follow_alone(
                                    last_y, last_f, y, k[0], t - waiting, waiting, segment, system, middle, columns
                                )
                            waiting = 0.0
                        mode[i], slides = 1 if needed > 0 else -1, True
                        y[6 + i] = mode[i] * 2.0 * _MAX_ZERO_RATE_RAD_S
            if ends >= 0 or slides:
                _rates(y, at, p, torque, mode, k[0], own, whole)
                _linearised(y, at, p, mode, own, whole, g, d[0])
        if waiting > 0.0:
            if slopes:
                _follow_alone(last_y, last_f, y, k[0], t - waiting, waiting, segment, system, middle, columns)
            copy_rows(d[2], d[0])
            waiting = 0.0
        for r in range(8):
            states[row, r] = y[r]
        if slopes:
            copy_rows(s, derivatives[row])
    return states, derivatives
