"""The free motion with dry friction and its derivatives: slides, sticks and the instants between them.

A pendulum that slides feels −sign(θ̇) (M_i + F_i φ̇_i²) besides its viscous torque: M_i is a torque that is there at any
speed (a seal, a preload), F_i φ̇² one that goes with the contact force M R φ̇². One that sticks (θ̇ = 0) stays while the
torque that holds it, S n·(p̈ + g ŷ) − D α, is below M_i + F_i ω². Within a mode the motion and the variational equation
Ṡ = (∂f/∂y) S + ∂f/∂p are smooth. At an instant t* at which θ̇_i passes zero the rates jump from f⁻ to f⁺, and

    S⁺ = S⁻ + (f⁺ − f⁻) S⁻[θ̇_i] / f⁻[θ̈_i],

because a change of the parameters moves the instant by −S⁻[θ̇_i]/f⁻[θ̈_i]. Where a stick ends the rates do not jump.
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import numpy as np
from numba import njit

from dynamics.kernels import C1, C2, CA, DA, FA, GRAVITY, JA, K1, K2, MASS, RC, SA, SP
from dynamics.quick_rates import real_sine_cosine
from dynamics.speed_history import phase_at

COLUMNS = 19
"""Columns of the derivatives: those of identification.pendulums.variational, then M_A, M_B, F_A, F_B."""
_ENOUGH = 1e-9  # rad/s: a rate that is zero
_LEAST_SLIDE_S = 1e-9
_PAST = 1e-3  # of a step: past the instant at which a stick can no longer hold
_MOST_SWITCHES = 40_000


@njit(cache=True, nogil=True, error_model="numpy")
def _slope(y, s, phase, p, torque, mode, f, ds, work, g, d):  # noqa: PLR0912, PLR0915 - one evaluation, written out
    """Rates f (8,) and ds (8, 19); work (2, 8) takes what `_needed` reads of the last call."""
    psi, omega, alpha = phase[0], phase[1], phase[2]
    sin_r, cos_r = real_sine_cosine(psi)
    w2 = omega * omega
    rx = -p[RC] * (alpha * sin_r + w2 * cos_r)
    ry = p[RC] * (alpha * cos_r - w2 * sin_r) + p[GRAVITY]
    drive_x, drive_y = w2 * cos_r + alpha * sin_r, w2 * sin_r - alpha * cos_r
    fx = p[SP] * drive_x - p[C1] * y[4] - p[K1] * y[0]
    fy = p[SP] * drive_y - p[C2] * y[5] - p[K2] * y[1] - p[MASS] * p[GRAVITY]
    mxx, myy, mxy = p[MASS], p[MASS], 0.0
    g[:] = 0.0
    g[0, 0], g[1, 1], g[0, 4], g[1, 5] = -p[K1], -p[K2], -p[C1], -p[C2]
    g[0, 8], g[1, 9], g[0, 10], g[1, 11] = -y[0], -y[1], -y[4], -y[5]
    g[0, 14], g[1, 14] = drive_x, drive_y
    for i in range(2):
        inertia, free = p[JA + i], 1.0 if mode[i] != 0 else 0.0
        sine, cosine = real_sine_cosine(psi + y[2 + i])
        rate = y[6 + i] * free
        speed = omega + rate
        dry = mode[i] * (torque[i] + p[FA + i] * speed * speed)
        bare = -free * (p[DA + i] * alpha + p[CA + i] * rate + dry) / inertia
        m = free * p[SA + i] * p[SA + i] / inertia
        across = p[SA + i] * (alpha + bare) + m * (sine * rx - cosine * ry)
        fx += p[SA + i] * speed * speed * cosine + across * sine
        fy += p[SA + i] * speed * speed * sine - across * cosine
        mxx -= m * sine * sine
        myy -= m * cosine * cosine
        mxy += m * sine * cosine
        work[i, 0], work[i, 1], work[i, 2], work[i, 3], work[i, 4] = cosine, sine, m, bare, speed
        work[i, 5] = -free * (p[CA + i] + 2.0 * mode[i] * p[FA + i] * speed) / inertia
    share = 1.0 / (mxx * myy - mxy * mxy)
    axx, ayy, axy = myy * share, mxx * share, -mxy * share
    f[4], f[5] = axx * fx + axy * fy, axy * fx + ayy * fy
    px, py = f[4] + rx, f[5] + ry
    f[0], f[1] = y[4], y[5]
    for i in range(2):
        cosine, sine, m, bare, speed, slope = work[i, 0], work[i, 1], work[i, 2], work[i, 3], work[i, 4], work[i, 5]
        first, inertia, free = p[SA + i], p[JA + i], 1.0 if mode[i] != 0 else 0.0
        along_n, along_e = sine * px - cosine * py, cosine * px + sine * py
        f[2 + i] = free * y[6 + i]
        f[6 + i] = free * first / inertia * along_n + bare
        work[i, 6], work[i, 7] = along_e, first * along_n - p[DA + i] * alpha  # the torque that holds it
        along, across = first * (alpha + bare) + m * along_n, -first * speed * speed + m * along_e
        g[0, 2 + i] = along * cosine + across * sine
        g[1, 2 + i] = along * sine - across * cosine
        g[0, 6 + i] = first * (2.0 * speed * cosine + slope * sine)
        g[1, 6 + i] = first * (2.0 * speed * sine - slope * cosine)
        by = -free * first / inertia
        for column, of in ((12 + i, y[6 + i]), (15 + i, float(mode[i])), (17 + i, mode[i] * speed * speed)):
            g[0, column], g[1, column] = by * of * sine, -by * of * cosine
    for c in range(COLUMNS):
        d[0, c] = axx * g[0, c] + axy * g[1, c]
        d[1, c] = axy * g[0, c] + ayy * g[1, c]
        for i in range(2):
            if mode[i] == 0:
                d[2 + i, c] = 0.0
            else:
                d[2 + i, c] = p[SA + i] / p[JA + i] * (work[i, 1] * d[0, c] - work[i, 0] * d[1, c])
    for i in range(2):
        if mode[i] != 0:
            d[2 + i, 2 + i] += p[SA + i] / p[JA + i] * work[i, 6]
            d[2 + i, 6 + i] += work[i, 5]
            d[2 + i, 12 + i] -= y[6 + i] / p[JA + i]
            d[2 + i, 15 + i] -= mode[i] / p[JA + i]
            d[2 + i, 17 + i] -= mode[i] * work[i, 4] ** 2 / p[JA + i]
    for c in range(COLUMNS):
        ds[0, c], ds[1, c], ds[2, c], ds[3, c] = s[4, c], s[5, c], s[6, c], s[7, c]
    for i in range(4):
        for c in range(COLUMNS):
            total = 0.0
            for j in range(8):
                total += d[i, j] * s[j, c]
            ds[4 + i, c] = total
        for c in range(8, COLUMNS):
            ds[4 + i, c] += d[i, c]


@njit(cache=True, nogil=True, error_model="numpy")
def _step(y, s, t, h, segment, knots, coefficients, p, torque, mode, k, ks, wy, ws, phase, work, g, d, out, out_s):
    """One classical Runge–Kutta step of state and derivatives into out, out_s; returns the segment at its end."""
    segment = phase_at(t, segment, knots, coefficients, phase[0])
    segment = phase_at(t + 0.5 * h, segment, knots, coefficients, phase[1])
    segment = phase_at(t + h, segment, knots, coefficients, phase[2])
    _slope(y, s, phase[0], p, torque, mode, k[0], ks[0], work, g, d)
    for stage in range(1, 4):
        part = h if stage == 3 else 0.5 * h
        for r in range(8):
            wy[r] = y[r] + part * k[stage - 1, r]
            for c in range(COLUMNS):
                ws[r, c] = s[r, c] + part * ks[stage - 1, r, c]
        _slope(wy, ws, phase[2] if stage == 3 else phase[1], p, torque, mode, k[stage], ks[stage], work, g, d)
    for r in range(8):
        out[r] = y[r] + h / 6.0 * (k[0, r] + 2.0 * k[1, r] + 2.0 * k[2, r] + k[3, r])
        for c in range(COLUMNS):
            out_s[r, c] = s[r, c] + h / 6.0 * (ks[0, r, c] + 2.0 * ks[1, r, c] + 2.0 * ks[2, r, c] + ks[3, r, c])
    return segment


@njit(cache=True, nogil=True, error_model="numpy")
def _excess(y, phase, p, torque, mode, i, f, ds, s, work, g, d):
    """By how much the torque that holds pendulum i exceeds its friction, N m, with the sign of the torque."""
    own = mode[i]
    mode[i] = 0
    _slope(y, s, phase, p, torque, mode, f, ds, work, g, d)
    mode[i] = own
    needed, limit = work[i, 7], max(0.0, torque[i] + p[FA + i] * phase[1] * phase[1])
    work[i, 3] = abs(needed) - limit  # below 0 by what it still holds
    if needed > limit:
        return needed - limit
    return needed + limit if needed < -limit else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _crossed(before, after, mode, i):
    """Whether a slide has come to its end within a step."""
    return mode[i] != 0 and mode[i] * after[6 + i] < -_ENOUGH and mode[i] * before[6 + i] > -_ENOUGH


@njit(cache=True, nogil=True, error_model="numpy")
def frictional_motion(  # noqa: PLR0912, PLR0915 - the one loop in which slides and sticks follow each other
    start, start_s, times, step, knots, coefficients, p, torque
):
    """Both pendulums free from a state on, with dry friction.

    Args:
        start, start_s, times, step, knots, coefficients, p: as for identification.pendulums.variational.free_motion;
            p's friction counts, F_i of any sign (a fit's trial may pass below zero).
        torque: M_A, M_B, N m, shape (2,).
    Returns:
        States (n, 8) and derivatives (n, 8, 19); NaN from where switches became too many to follow.
    """
    n = len(times)
    states, derivatives = np.full((n, 8), np.nan), np.full((n, 8, COLUMNS), np.nan)
    y, s = start.copy(), np.zeros((8, COLUMNS))
    for i in range(8):
        s[i, i] = 1.0
    k, ks, wy, ws = np.empty((4, 8)), np.empty((4, 8, COLUMNS)), np.empty(8), np.empty((8, COLUMNS))
    phase, work, g, d = np.empty((3, 3)), np.empty((2, 8)), np.empty((2, COLUMNS)), np.empty((4, COLUMNS))
    out, out_s, at = np.empty(8), np.empty((8, COLUMNS)), np.empty(3)
    f, ds, mode, held = np.empty(8), np.empty((8, COLUMNS)), np.zeros(2, np.int64), np.zeros(2)
    segment, t, switches = phase_at(start_s, 0, knots, coefficients, at), start_s, 0
    for i in range(2):
        mode[i] = 0 if abs(y[6 + i]) <= _ENOUGH else (1 if y[6 + i] > 0 else -1)
    for i in range(2):
        if mode[i] == 0:
            over = _excess(y, at, p, torque, mode, i, f, ds, s, work, g, d)
            mode[i] = 0 if over == 0.0 else (1 if over > 0 else -1)
            held[i] = work[i, 3]
    for row in range(n):
        while times[row] - t > 1e-12:
            steps = max(1.0, np.ceil((times[row] - t) / step - 1e-9))
            h = (times[row] - t) / steps
            segment = _step(
                y, s, t, h, segment, knots, coefficients, p, torque, mode, k, ks, wy, ws, phase, work, g, d, out, out_s
            )
            first, share = -1, 1.0
            for i in range(2):  # the first slide to end, by the parabola through the rates
                if _crossed(y, out, mode, i):
                    r0, r1, a0 = y[6 + i], out[6 + i], k[0, 6 + i] * h
                    bend = r1 - r0 - a0
                    root = a0 * a0 - 4.0 * bend * r0
                    part = r0 / (r0 - r1)
                    if root >= 0.0 and a0 != 0.0:
                        trial = -2.0 * r0 / (a0 - np.sqrt(root)) if a0 < 0.0 else -2.0 * r0 / (a0 + np.sqrt(root))
                        part = trial if 0.0 < trial < 1.0 else part
                    if part < share:
                        first, share = i, max(part, 0.0)
            loose = -1
            for i in range(2):  # the first stick to end, by the line through what it still holds
                if mode[i] == 0:
                    _excess(out, phase[2], p, torque, mode, i, f, ds, s, work, g, d)
                    after = work[i, 3]
                    if after > 0.0 and held[i] < 0.0 and held[i] / (held[i] - after) < share:
                        loose, share = i, min(1.0, held[i] / (held[i] - after) + _PAST)
            if loose >= 0:
                first = -1
            if first >= 0:
                for _ in range(6):  # secant on the instant itself
                    segment = _step(
                        y, s, t, share * h, segment, knots, coefficients, p, torque, mode, k, ks, wy, ws, phase, work,
                        g, d, out, out_s,
                    )  # fmt: skip
                    slope = k[3, 6 + first]
                    if abs(out[6 + first]) <= _ENOUGH or slope == 0.0:
                        break
                    share = min(1.0, max(0.0, share - out[6 + first] / (slope * h)))
            if loose >= 0:
                segment = _step(
                    y, s, t, share * h, segment, knots, coefficients, p, torque, mode, k, ks, wy, ws, phase, work, g, d,
                    out, out_s,
                )  # fmt: skip
            # a slide that ends where it began, at a peak of the torque that just moves it: it sticks for a step
            hardly = first >= 0 and share * h <= _LEAST_SLIDE_S
            t += share * h
            for r in range(8):
                y[r] = out[r]
                for c in range(COLUMNS):
                    s[r, c] = out_s[r, c]
            segment = phase_at(t, segment, knots, coefficients, at)
            if first >= 0:
                switches += 1
                if switches > _MOST_SWITCHES:
                    return states, derivatives
                _slope(y, s, at, p, torque, mode, f, ds, work, g, d)
                for r in range(8):
                    wy[r] = f[r]
                came = mode[first]
                y[6 + first] = 0.0
                over = _excess(y, at, p, torque, mode, first, f, ds, s, work, g, d)
                mode[first] = 0 if over == 0.0 or hardly else (1 if over > 0 else -1)
                if mode[first] == came and torque[first] + p[FA + first] * at[1] * at[1] < 0.0:
                    mode[first] = -came  # a friction below zero: it goes on the way it went; else it has only touched
                y[6 + first] = mode[first] * 2.0 * _ENOUGH
                _slope(y, s, at, p, torque, mode, f, ds, work, g, d)
                if wy[6 + first] != 0.0:
                    for c in range(COLUMNS):
                        ws[0, c] = s[6 + first, c] / wy[6 + first]
                    for r in range(8):
                        for c in range(COLUMNS):
                            s[r, c] += (f[r] - wy[r]) * ws[0, c]
            for i in range(2):
                held[i] = 0.0
                if mode[i] == 0 and not (hardly and i == first):
                    over = _excess(y, at, p, torque, mode, i, f, ds, s, work, g, d)
                    held[i] = work[i, 3]
                    if over != 0.0:
                        mode[i] = 1 if over > 0 else -1
                        y[6 + i] = mode[i] * 2.0 * _ENOUGH
        states[row], derivatives[row] = y, s
    return states, derivatives
