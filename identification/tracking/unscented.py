"""Compiled unscented Kalman filter of the rig: no Python code runs between two readings.

State (10): x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4, ln c3, ln c4. The sigma points are at ± sqrt(n) columns of the covariance's
Cholesky factor with equal weights (the cubature set). All weights are positive, so a mean of angles needs no reference,
and a negative weight cannot make the covariance indefinite. The covariance update is Joseph's with the statistically
linearised reading H = Pxzᵀ P⁻¹, symmetrised. If a factorisation fails, the diagonal is increased until it succeeds. The
functions do not raise; the caller restarts the filter if the state is not finite.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from dynamics.equations.kernels import CA, CB, JA, JB, rates
from rig_basics.arrays import Array

STATES, READINGS, TALLY = 10, 4, 8
X, Y, THETA3, THETA4, LN_C3, LN_C4 = 0, 1, 2, 3, 8, 9
_LEAST_LN_C, _STIFFEST = -25.0, 2.0
_MOST_REPAIRS = 40


@compiled(contract=True, part=True)
def _factorise(p: Array, out: Array) -> bool:
    """Write the lower Cholesky factor of p (n, n) into out; return False if p is not positive definite."""
    for i in range(p.shape[0]):
        for j in range(i + 1):
            total = p[i, j]
            for k in range(j):
                total -= out[i, k] * out[j, k]
            if i != j:
                out[i, j] = total / out[j, j]
            elif total > 1e-14 * abs(p[i, i]) and total < np.inf:
                out[i, i] = math.sqrt(total)
            else:
                return False
    return True


@compiled(nogil=True, contract=True)
def cholesky(p: Array, out: Array) -> int:
    """Write the lower factor of a covariance (n, n) into out; repair a matrix that is not positive definite in place.

    Returns:
        Number of increases of the diagonal.
    """
    n = p.shape[0]
    for attempt in range(_MOST_REPAIRS):
        if _factorise(p, out):
            return attempt
        for i in range(n):
            p[i, i] = abs(p[i, i]) * (1.0 + 1e-12 * 10.0 ** min(attempt, 12)) + 1e-30 * 10.0 ** min(attempt, 24)
    for i in range(n):  # the correlations are dropped
        for j in range(n):
            if i != j:
                p[i, j] = out[i, j] = 0.0
        p[i, i] = abs(p[i, i]) if 0.0 < abs(p[i, i]) < np.inf else 1.0
        out[i, i] = math.sqrt(p[i, i])
    return _MOST_REPAIRS


@compiled(contract=True, part=True)
def _step(
    points: Array,
    k: Array,
    work: Array,
    h: float,
    steps: int,
    psi: float,
    speed: float,
    alpha: float,
    p: Array,
    free_a: float,
    free_b: float,
) -> None:
    """Move every sigma point by classical Runge–Kutta steps; a locked pendulum keeps its angle."""
    for i in range(points.shape[0]):
        y = points[i]
        if free_a == 0.0:
            y[6] = 0.0
        if free_b == 0.0:
            y[7] = 0.0
        # a distant sigma point may be too stiff for the step; its exact motion has no influence
        p[CA] = min(math.exp(max(y[LN_C3], _LEAST_LN_C)), _STIFFEST * p[JA] / h)
        p[CB] = min(math.exp(max(y[LN_C4], _LEAST_LN_C)), _STIFFEST * p[JB] / h)
        for s in range(steps):
            t = s * h
            a0 = psi + t * (speed + 0.5 * t * alpha)
            w0 = speed + t * alpha
            m = 0.5 * h
            a1, w1 = a0 + m * (w0 + 0.5 * m * alpha), w0 + m * alpha
            a2, w2 = a0 + h * (w0 + 0.5 * h * alpha), w0 + h * alpha
            rates(y, a0, w0, alpha, p, free_a, free_b, k[0])
            for j in range(8):
                work[j] = y[j] + m * k[0, j]
            rates(work, a1, w1, alpha, p, free_a, free_b, k[1])
            for j in range(8):
                work[j] = y[j] + m * k[1, j]
            rates(work, a1, w1, alpha, p, free_a, free_b, k[2])
            for j in range(8):
                work[j] = y[j] + h * k[2, j]
            rates(work, a2, w2, alpha, p, free_a, free_b, k[3])
            for j in range(8):
                y[j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])


@compiled(nogil=True, contract=True)
def move(points: Array, h: float, steps: int, phase: Array, p: Array, free: Array) -> None:
    """Move states (n, 10) over steps × h in place, without process noise, for use by another filter.

    Args:
        points: states, shape (n, 10), changed in place.
        h: Runge–Kutta step, s.
        steps: number of steps.
        phase, p, free: as for `predict`; p is not changed.
    """
    k, work = np.empty((4, 8)), np.empty(8)
    _step(points, k, work, h, steps, phase[0], phase[1], phase[2], p.copy(), free[0], free[1])


@compiled(contract=True, part=True)
def predict(
    mean: Array,
    cov: Array,
    h: float,
    steps: int,
    phase: Array,
    p: Array,
    free: Array,
    noise: Array,
    factor: Array,
    points: Array,
    k: Array,
    work: Array,
) -> int:
    """Move mean (10,) and cov (10, 10) over steps × h in place.

    Args:
        mean, cov: state and covariance, changed in place.
        h: Runge–Kutta step, s.
        steps: number of steps.
        phase: ψ, ω, α at the begin, shape (3,).
        p: packed parameters, shape (20,); the dampings are overwritten.
        free: 1.0 for a released pendulum, shape (2,).
        noise: growth of each variance per second, shape (10,).
        factor, points, k, work: scratch, shapes (10, 10), (20, 10), (4, 8), (8,).
    Returns:
        Number of repairs of the covariance.
    """
    n = STATES
    repairs = cholesky(cov, factor)
    root = math.sqrt(float(n))
    for i in range(n):
        for j in range(n):
            d = root * factor[j, i] if j >= i else 0.0
            points[i, j] = mean[j] + d
            points[n + i, j] = mean[j] - d
    _step(points, k, work, h, steps, phase[0], phase[1], phase[2], p, free[0], free[1])
    weight = 1.0 / (2 * n)
    for j in range(n):
        total = 0.0
        for i in range(2 * n):
            total += points[i, j]
        mean[j] = total * weight
    for i in range(2 * n):
        for j in range(n):
            points[i, j] -= mean[j]
    for a in range(n):
        for b in range(a + 1):
            total = 0.0
            for i in range(2 * n):
                total += points[i, a] * points[i, b]
            cov[a, b] = total * weight
            cov[b, a] = cov[a, b]
        cov[a, a] += noise[a] * h * steps
    return repairs


@compiled(contract=True, part=True)
def update(
    mean: Array,
    cov: Array,
    index: int,
    reading: float,
    late: float,
    variance: float,
    gate: float,
    still: float,
    work: Array,
) -> float:
    """Update the state by one scalar reading of one component.

    Sequential updates by readings with independent noise are exact. A reading of a component is linear, so its sigma
    points would give row `index` of the covariance itself.

    Args:
        mean, cov: state and covariance, changed in place.
        index: component that was read, 0 … 3.
        reading: value of the reading.
        late: delay of the reading after the state's instant, s. The component's rate extrapolates over it.
        variance: variance of the reading.
        gate: number of standard deviations of the innovation above which a reading is refused.
        still: speed relative to the rotor, rad/s. The damping of a pendulum is updated only if its speed exceeds this
            with three standard deviations. A negative value updates the damping always.
        work: scratch, shape (10,).
    Returns:
        The innovation over its standard deviation; NaN for a reading that is not finite.
    """
    n = STATES
    if not math.isfinite(reading):
        return np.nan
    total = cov[index, index] + variance
    innovation = reading - mean[index] - late * mean[index + 4]
    z = innovation / math.sqrt(total) if total > 0.0 else np.nan
    if not abs(z) <= gate:
        return z
    for i in range(n):
        work[i] = cov[i, index] / total
    # a still pendulum contains no information on its damping; its innovations only show the expected forces
    if still >= 0.0 and mean[6] ** 2 < still**2 + 9.0 * cov[6, 6]:
        work[LN_C3] = 0.0
    if still >= 0.0 and mean[7] ** 2 < still**2 + 9.0 * cov[7, 7]:
        work[LN_C4] = 0.0
    own = cov[index].copy()
    # Joseph: (1 − K H) P (1 − K H)ᵀ + K R Kᵀ, written out for H = unit row; valid for any gain K
    for i in range(n):
        for j in range(i + 1):
            value = cov[i, j] - work[i] * own[j] - work[j] * own[i] + work[i] * work[j] * (own[index] + variance)
            cov[i, j] = value
            cov[j, i] = value
    for i in range(n):
        mean[i] += work[i] * innovation
    return z


@compiled(nogil=True)
def filter_readings(
    mean: Array,
    cov: Array,
    times: Array,
    late: Array,
    indices: NDArray[np.int64],
    readings: Array,
    variances: Array,
    phases: Array,
    released: Array,
    p: Array,
    noise: Array,
    longest: float,
    gate: float,
    still: float,
    tally: Array,
    z: Array,
) -> None:
    """Process readings in time order.

    Args:
        mean, cov: state (10,) and covariance (10, 10), changed in place.
        times: tick of each reading, ascending, s, shape (n,).
        late: instant of each reading minus its tick, s, shape (n,).
        indices, readings, variances: component, value and variance of each reading, shape (n,).
        phases: ψ, ω, α at the previous reading's tick, shape (n, 3).
        released: 1.0 for a released pendulum, shape (n, 2).
        p: packed parameters (20,).
        noise: growth of the variances per second (10,).
        longest: longest Runge–Kutta step, s.
        gate, still: as for `update`.
        tally: instant of the state, number of refused readings, number of repairs, largest number of refusals in a row
            of any component, and that number of each component; shape (8,), changed in place.
        z: innovations over their standard deviations, shape (n,), output.
    """
    factor, points = np.zeros((STATES, STATES)), np.empty((2 * STATES, STATES))
    k, work = np.empty((4, 8)), np.empty(STATES)
    own = p.copy()
    for i in range(len(times)):
        span = times[i] - tally[0]
        if span > 1e-9:
            steps = max(1, math.ceil(span / longest - 1e-9))
            repairs = predict(
                mean, cov, span / steps, steps, phases[i], own, released[i], noise, factor, points, k, work
            )
            tally[2] += repairs
            tally[0] = times[i]
        z[i] = update(mean, cov, indices[i], readings[i], late[i], variances[i], gate, still, work)
        own_row = 4 + indices[i]
        if abs(z[i]) <= gate:
            tally[own_row] = 0.0
        else:
            tally[1] += 1.0
            tally[own_row] += 1.0 if math.isfinite(readings[i]) else 0.0
        tally[3] = max(tally[4], tally[5], tally[6], tally[7])
