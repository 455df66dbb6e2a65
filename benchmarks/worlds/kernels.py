# pyright: reportMissingParameterType=false, reportUnknownParameterType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# Compiled functions: numba takes their types from the arguments, and their docstrings state them.
"""The world's equations, compiled; derived in benchmarks.worlds.motion."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, error_model="numpy")
def _slope(y, psi, w, alpha, p, mode, out):
    """out = ẏ; mode: per pendulum 0 where it stands still relative to the rotor, ±1 where it moves that way."""
    u = y[0] - p[10] * math.cos(psi + p[11])
    v = y[1] - p[10] * math.sin(psi + p[11])
    sin, cos = math.sin(psi), math.cos(psi)
    xx, xy, yy = p[0], 0.0, p[0]
    fx = p[5] * (w * w * cos + alpha * sin) - p[1] * u * (1 + p[6] * u * u) - p[3] * y[4] * (1 + p[8] * abs(y[4]))
    fy = p[5] * (w * w * sin - alpha * cos) - p[2] * v * (1 + p[7] * v * v) - p[4] * y[5] * (1 + p[9] * abs(y[5]))
    s0, c0, t0 = _pull(y, 0, psi, w, p, mode)
    s1, c1, t1 = _pull(y, 1, psi, w, p, mode)
    for i in range(2):
        s, c, torque = (s0, c0, t0) if i == 0 else (s1, c1, t1)
        mass, arm = p[12 + 6 * i], p[13 + 6 * i]
        rate = w + y[6 + i]
        fx += mass * arm * rate * rate * c
        fy += mass * arm * rate * rate * s
        if mode[i] == 0:
            fx += mass * arm * alpha * s
            fy -= mass * arm * alpha * c
        else:
            xx -= mass * s * s
            xy += mass * s * c
            yy -= mass * c * c
            fx += torque / arm * s
            fy -= torque / arm * c
    determinant = xx * yy - xy * xy
    out[0], out[1], out[2], out[3] = y[4], y[5], y[6], y[7]
    out[4] = (yy * fx - xy * fy) / determinant
    out[5] = (xx * fy - xy * fx) / determinant
    out[6] = 0.0 if mode[0] == 0 else ((out[4] * s0 - out[5] * c0) + t0 / (p[12] * p[13])) / p[13] - alpha
    out[7] = 0.0 if mode[1] == 0 else ((out[4] * s1 - out[5] * c1) + t1 / (p[18] * p[19])) / p[19] - alpha


@njit(cache=True, error_model="numpy")
def _pull(y, i, psi, w, p, mode):
    """sin φ, cos φ and the torque on pendulum i without the disk's acceleration, N m."""
    rate = y[6 + i]
    j = 12 + 6 * i
    torque = -(p[j + 2] + p[j + 3] * abs(rate)) * rate - mode[i] * _limit(y, i, w, p)
    return math.sin(psi + y[2 + i]), math.cos(psi + y[2 + i]), torque


@njit(cache=True, error_model="numpy")
def _limit(y, i, w, p):
    """The most that dry friction can hold, N m."""
    j = 12 + 6 * i
    return p[j + 4] + p[j + 5] * (w + y[6 + i]) ** 2


@njit(cache=True, error_model="numpy")
def _step(y, t, h, row, p, mode, scratch, out):
    """One step of Runge's fourth-order method from y at t; out = the state at t + h."""
    k1, k2, k3, k4, mid = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    s = t - row[0]
    psi, w, alpha = row[1] + s * (row[2] + 0.5 * row[3] * s), row[2] + row[3] * s, row[3]
    _slope(y, psi, w, alpha, p, mode, k1)
    s += 0.5 * h
    psi, w = row[1] + s * (row[2] + 0.5 * row[3] * s), row[2] + row[3] * s
    for j in range(8):
        mid[j] = y[j] + 0.5 * h * k1[j]
    _slope(mid, psi, w, alpha, p, mode, k2)
    for j in range(8):
        mid[j] = y[j] + 0.5 * h * k2[j]
    _slope(mid, psi, w, alpha, p, mode, k3)
    s += 0.5 * h
    psi, w = row[1] + s * (row[2] + 0.5 * row[3] * s), row[2] + row[3] * s
    for j in range(8):
        mid[j] = y[j] + h * k3[j]
    _slope(mid, psi, w, alpha, p, mode, k4)
    for j in range(8):
        out[j] = y[j] + h / 6 * (k1[j] + 2 * (k2[j] + k3[j]) + k4[j])


@njit(cache=True, error_model="numpy")
def _let_slide(y, t, row, p, mode, scratch):
    """Set in motion what friction does not hold."""
    s = t - row[0]
    psi, w, alpha = row[1] + s * (row[2] + 0.5 * row[3] * s), row[2] + row[3] * s, row[3]
    for i in range(2):
        if mode[i] == 0:
            j = 12 + 6 * i
            _slope(y, psi, w, alpha, p, mode, scratch[0])
            phi = psi + y[2 + i]
            push = p[j] * p[j + 1] * (scratch[0, 4] * math.sin(phi) - scratch[0, 5] * math.cos(phi))
            push -= p[j] * p[j + 1] ** 2 * alpha
            if abs(push) > _limit(y, i, w, p) or _limit(y, i, w, p) == 0.0:
                mode[i] = 1.0 if push >= 0 else -1.0


@njit(cache=True, error_model="numpy")
def _stopping(before, after, mode, p):
    """Which dry pendulum turns back first within a step, and after which share of it; −1 where none does."""
    first, share = -1, 1.0
    for i in range(2):
        dry = p[16 + 6 * i] > 0 or p[17 + 6 * i] > 0
        if dry and mode[i] * after[6 + i] < 0:
            begin = max(mode[i] * before[6 + i], 0.0)
            at = begin / (begin - mode[i] * after[6 + i])
            if at <= share:
                first, share = i, at
    return first, share


@njit(cache=True, error_model="numpy")
def integrated(
    times: NDArray[np.float64],
    start: NDArray[np.float64],
    rows: NDArray[np.float64],
    p: NDArray[np.float64],
    free: bool,
    longest: float,
) -> NDArray[np.float64]:
    """States at the times, shape (n, 8); see motion.moved, rows and p as Turning and Mechanics pack them."""
    out = np.empty((times.shape[0], 8))
    scratch, y, new, mode = np.empty((5, 8)), start.copy(), np.empty(8), np.zeros(2)
    k = 0
    while k + 1 < rows.shape[0] and rows[k + 1, 0] <= times[0] + 1e-12:
        k += 1
    for i in range(2):
        if free and y[6 + i] != 0.0:
            mode[i] = 1.0 if y[6 + i] > 0 else -1.0
    if free:
        _let_slide(y, times[0], rows[k], p, mode, scratch)
    out[0] = y
    for n in range(1, times.shape[0]):
        while k + 1 < rows.shape[0] and rows[k + 1, 0] <= times[n - 1] + 1e-12:
            k += 1
        gap = times[n] - times[n - 1]
        steps = max(1, math.ceil(gap / longest - 1e-9))
        for m in range(steps):
            _whole_step(y, times[n - 1] + m * (gap / steps), gap / steps, rows[k], p, mode, free, scratch, new)
        out[n] = y
    return out


@njit(cache=True, error_model="numpy")
def _whole_step(y, t, h, row, p, mode, free, scratch, new):
    """y a step on; at a stop the step is divided."""
    left, stops = h, 0
    while left > 0:
        _step(y, t, left, row, p, mode, scratch, new)
        which, share = _stopping(y, new, mode, p)
        if which < 0:
            y[:] = new
            break
        for _ in range(2):  # the straight line again, over the stretch up to the stop
            _step(y, t, share * left, row, p, mode, scratch, new)
            began, ends = y[6 + which], new[6 + which]
            if began not in (ends, 0.0):
                share = min(1.0, max(0.0, share * began / (began - ends)))
        _step(y, t, share * left, row, p, mode, scratch, new)
        y[:] = new
        y[6 + which], mode[which] = 0.0, 0.0
        t, left = t + share * left, left - share * left
        stops += 1
        if stops < 8:
            _let_slide(y, t, row, p, mode, scratch)
    if free and (mode[0] == 0.0 or mode[1] == 0.0):
        _let_slide(y, t + left, row, p, mode, scratch)
