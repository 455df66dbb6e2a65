"""Integration from step to step in compiled code: step control, knots of the speed history, samples, end of a mode.

One function is used by both methods. They differ only in the arithmetic of a step.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, RealSystem
from dynamics.compiled_code import compiled
from dynamics.equations.friction import needed_torque
from dynamics.equations.kernels import FA, rates
from dynamics.equations.phase_segments import phase_within, segment_of
from dynamics.motions.explicit_steps import evaluate, explicit_error, explicit_polynomial, explicit_step
from dynamics.motions.implicit_steps import guess_stages, implicit_polynomial, implicit_step, jacobian_at

# Results of `march`
REACHED, MODE_ENDS_A, MODE_ENDS_B, STEPS_SPENT, STORE_FULL, STEP_TOO_SMALL = range(6)
# Watched event of a pendulum: none, end of a slide forward or backward, end of sticking
UNWATCHED, WATCH_FORWARD, WATCH_BACKWARD, WATCH_STUCK = 0, 1, -1, 2

_CHECKS = 4  # instants per step at which the end of a mode is checked
_SLACK = 3.0  # speed, in tolerances, below which the sign of a slide that has just begun is not evaluated
_MAX_KNOT_ERROR = 0.05  # error of a step across a knot, in tolerances


@compiled(part=True)
def _margin(
    pendulum: int, watch: int, y: Array, t: float, first: int, last: int, system: RealSystem, work: Array, phase: Array
) -> float:
    """Distance of a pendulum from the end of its mode; positive within the mode."""
    if watch != WATCH_STUCK:
        return watch * y[6 + pendulum]
    p, free_a, free_b, knots, origins, cubics = system
    phase_within(t, first, last, knots, origins, cubics, phase)
    torque = needed_torque(pendulum, y, phase[0], phase[1], phase[2], p, free_a, free_b, work)
    return abs(p[FA + pendulum]) * phase[1] * phase[1] - abs(torque)


@compiled(part=True)
def _mode_end(
    pendulum: int,
    watch: int,
    slack: float,
    t: float,
    h: float,
    first: int,
    last: int,
    system: RealSystem,
    polynomial: Array,
    y: Array,
    work: Array,
    phase: Array,
) -> float:
    """Fraction of the step at which a pendulum's mode ends, located to rounding; 2.0 if it does not end.

    The speed of a slide that has just begun is below the error of its step. Its sign is not evaluated below slack.
    """
    low = 0.0
    for check in range(1, _CHECKS + 1):
        high = check / _CHECKS
        evaluate(polynomial, high, y)
        if _margin(pendulum, watch, y, t + high * h, first, last, system, work, phase) < -slack:
            for _ in range(60):
                middle = 0.5 * (low + high)
                if middle in (low, high):
                    break
                evaluate(polynomial, middle, y)
                if _margin(pendulum, watch, y, t + middle * h, first, last, system, work, phase) < 0.0:
                    high = middle
                else:
                    low = middle
            return high
        low = high
    return 2.0


@compiled(part=True)
def _landing(
    t: float, h: float, limit: float, segment: int, knots: Array, jumps: Array, tolerance: float
) -> tuple[float, int]:
    """(end of the step, segment there). The step ends at a knot if crossing it would exceed its tolerance."""
    end, last = min(t + h, limit), segment
    if limit - end < 0.05 * h:
        end = limit
    while last < len(knots) and knots[last] < end:
        width = end - t
        if width * width * (0.5 * jumps[last, 0] + width / 6.0 * jumps[last, 1]) > _MAX_KNOT_ERROR * tolerance:
            return knots[last], last
        last += 1
    return end, last


@compiled(part=True)
def _earliest_mode_end(
    watch: tuple[int, int],
    slack: float,
    t: float,
    h: float,
    first: int,
    last: int,
    system: RealSystem,
    polynomial: Array,
    weights: Array,
    work: Array,
    phase: Array,
    y: Array,
) -> tuple[int, float]:
    """(result of the march, fraction of the step at which a mode ends); (REACHED, 1) if neither mode ends."""
    ended, share = REACHED, 1.0
    for pendulum in range(2):
        if watch[pendulum] != UNWATCHED:
            own = slack * weights[6 + pendulum] if watch[pendulum] != WATCH_STUCK else 0.0
            at = _mode_end(pendulum, watch[pendulum], own, t, h, first, last, system, polynomial, y, work, phase)
            if at <= share:
                share, ended = at, MODE_ENDS_A + pendulum
    return ended, share


@compiled(part=True)
def _guess(y: Array, polynomial: Array, h: float, last_h: float, z: Array) -> None:
    """Initial stages of an implicit step: the last step's polynomial extrapolated, or zero."""
    if last_h > 0.0:
        guess_stages(polynomial, h / last_h, y, z)
    else:
        z.fill(0.0)


@compiled(part=True)
def _after_rejection(h: float, error: float, exponent: float) -> float:
    if 0.0 <= error < np.inf:
        return h * max(0.2, 0.9 * error**-exponent)
    return 0.2 * h


@compiled(part=True)
def _after_success(
    h: float, proposed: float, error: float, last_error: float, rejected: bool, exponent: float
) -> float:
    """Next step, from the error and its trend. A step shortened by a limit does not shorten the next one."""
    growth = 0.9 * max(error, 1e-10) ** (-0.75 * exponent) * max(last_error, 1e-4) ** (0.3 * exponent)
    grown = h * min(1.0 if rejected else 6.0, max(0.3, growth))
    return max(proposed, grown) if h < 0.999 * proposed else grown


@compiled(part=True)
def _rates_here(y: Array, t: float, segment: int, system: RealSystem, phase: Array, k: Array) -> None:
    p, free_a, free_b, knots, origins, cubics = system
    phase_within(t, segment, segment, knots, origins, cubics, phase)
    rates(y, phase[0], phase[1], phase[2], p, free_a, free_b, k[0])


@compiled(nogil=True)
def march(  # noqa: PLR0912, PLR0915 - one function: in parts it took 1.04 to 1.2 times as long
    y: Array,
    t: float,
    limit: float,
    h: float,
    stiff: int | None,
    tolerance: float,
    weights: Array,
    system: RealSystem,
    jumps: Array,
    longest: float,
    watch: tuple[int, int],
    times: Array,
    done: int,
    out: Array,
    store: tuple[Array, Array],
    most_steps: int,
) -> tuple[int, float, float, int, int, int]:
    """Advance the state from t to limit within one mode.

    Args:
        y: state, shape (8,), advanced in place.
        h: first trial step, s.
        stiff: 1 for dynamics.motions.implicit_steps, None for explicit steps. numba compiles only the code of the
            selected method.
        tolerance, weights: permitted error of a step is tolerance × weights, shape (8,), in the root mean square.
        system: (packed parameters, free_a, free_b, knots, origins, cubics).
        jumps: jumps of the phase at the knots (PhaseSegments).
        longest: longest permitted step, s.
        watch: watched events of A and B.
        times, done, out: output instants, number of instants already written, their states, shape (n, 8).
        store: (starts and lengths, shape (m, 2), polynomials, shape (m, 8, 8)) of every step; not stored if m = 0.
        most_steps: number of steps after which the function returns.
    Returns:
        (result, t, next step, samples written, accepted steps, all steps).
    """
    knots, room = system[3], len(store[0])
    k, polynomial, end, work, scale, phase = (
        np.zeros((16, 8)),
        np.zeros((8, 8)),
        np.empty(8),
        np.empty(8),
        np.empty(8),
        np.empty(3),
    )
    z, j, lu, pivot = np.zeros((5, 8)), np.empty((8, 8)), np.empty((3, 8, 8), np.complex128), np.zeros((3, 8), np.int64)
    watched, exponent = watch[0] != UNWATCHED or watch[1] != UNWATCHED, 1.0 / 8.0 if stiff is None else 1.0 / 6.0
    segment = segment_of(t, 0, knots)
    _rates_here(y, t, segment, system, phase, k)
    accepted, tried, first_h = 0, 0, h
    last_error, last_h, rejected, fresh = 0.0, 0.0, True, True
    while t < limit:
        if tried >= most_steps:
            return STEPS_SPENT, t, h, done, accepted, tried
        if room > 0 and accepted >= room:
            return STORE_FULL, t, h, done, accepted, tried
        target, last = _landing(t, min(h, longest), limit, segment, knots, jumps, tolerance)
        step = target - t
        if not step > 1e-15 * abs(t) + 1e-300:
            return STEP_TOO_SMALL, t, h, done, accepted, tried
        tried += 1
        for i in range(8):
            scale[i] = tolerance * weights[i] + 1e-16 * abs(y[i])
        if stiff is None:
            explicit_step(y, t, step, segment, last, system, k, end, phase)
            error = explicit_error(step, k, scale)
        else:
            if fresh:
                jacobian_at(y, t, segment, last, system, phase, j)
            _guess(y, polynomial, step, last_h, z)
            error = implicit_step(y, t, step, segment, last, system, scale, k[0], j, lu, pivot, z, end, phase)
            fresh = False
        if not 0.0 <= error <= 1.0:
            h, rejected = _after_rejection(step, error, exponent), True
            continue
        if stiff is not None:
            implicit_polynomial(y, z, polynomial)
        elif watched or room > 0 or (done < len(times) and times[done] <= target):
            explicit_polynomial(y, end, t, step, segment, last, system, k, work, phase, polynomial)
        ended, reached = REACHED, target
        if watched:
            slack = _SLACK * tolerance if accepted == 0 else 0.0
            ended, share = _earliest_mode_end(
                watch, slack, t, step, segment, last, system, polynomial, weights, work, phase, scale
            )
            if share < 1e-6 and accepted == 0 and step > 1e-6 * abs(first_h):
                h, rejected = 0.2 * step, True  # the step is too long to resolve the slide that begins here
                continue
            if ended != REACHED:
                reached = t + share * step
                evaluate(polynomial, share, end)
        while done < len(times) and times[done] <= reached:
            evaluate(polynomial, (times[done] - t) / step, out[done])
            done += 1
        if room > 0:
            store[0][accepted, 0], store[0][accepted, 1] = t, step
            for power in range(8):
                for i in range(8):
                    store[1][accepted, power, i] = polynomial[power, i]
        accepted += 1
        for i in range(8):
            y[i] = end[i]
        t = reached
        if ended != REACHED:
            break
        h = _after_success(step, h, error, last_error, rejected, exponent)
        last_error, last_h, rejected, fresh = error, step, False, True
        left = segment
        segment = segment_of(t, segment, knots)
        if stiff is not None or segment != left:
            _rates_here(y, t, segment, system, phase, k)
        else:
            for i in range(8):
                k[0, i] = k[12, i]
    else:
        return REACHED, t, h, done, accepted, tried
    return ended, t, h, done, accepted, tried
