# pyright: strict, reportMissingParameterType=false, reportUnknownParameterType=false, reportUnknownVariableType=false
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportMissingTypeArgument=false
# pyright: reportUntypedFunctionDecorator=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.
"""A release followed revolution by revolution until a stable motion has caught it: the compiled part.

Two runs go side by side: the release itself, and one that starts a stated error beside it and takes coarser steps. As
long as they stay close, the release's own error is far smaller still; once they have come apart, the end is chance.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dynamics.equations.quick_rates import quick_rates
from dynamics.motions.explicit_steps import explicit_step

END, CAUGHT, SETTLED, APART, RADIUS, TURNS_A, TURNS_B = range(7)
FACTS = 7
_TAU = 2 * math.pi


@njit(cache=True, error_model="numpy")
def steps_needed(y, omega, pace, step_rad):
    """Steps of the next revolution: step_rad of the fastest oscillation each.

    Args:
        pace: the fastest rate of suspension and damping, rad/s.
    """
    fastest = max(pace, omega + max(abs(y[6]), abs(y[7])))
    return max(4, math.ceil(_TAU * fastest / (omega * step_rad)))


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def advance(y, omega, steps, system, k, end, phase, orbit):
    """One revolution of the rotor from ψ = 0, in place.

    Args:
        y: shape (8,), angles counted on.
        orbit: mean x, y and mean x² + y² on the way, shape (3,).
    """
    p, free_a, free_b = system[0], system[1], system[2]
    h = _TAU / omega / steps
    orbit[:] = 0.0
    quick_rates(y, 0.0, omega, 0.0, p, free_a, free_b, k, 0)
    for s in range(steps):
        explicit_step(y, s * h, h, 1, 1, system, k, end, phase)
        y[:] = end
        k[0, :] = k[12, :]
        orbit[0] += y[0]
        orbit[1] += y[1]
        orbit[2] += y[0] * y[0] + y[1] * y[1]
    orbit /= steps


@njit(cache=True, error_model="numpy")
def within(angle):
    """The same angle in −π … π."""
    return angle - _TAU * math.floor(angle / _TAU + 0.5)


@njit(cache=True, error_model="numpy")
def _form(away, form):
    found = 0.0
    for i in range(8):
        row = 0.0
        for j in range(8):
            row += form[i, j] * away[j]
        found += away[i] * row
    return found


@njit(cache=True, error_model="numpy")
def deviation(y, number, ends, away):
    """Deviation of a state from an end's nearest point into away; its quadratic form, 1 on the region's rim.

    Args:
        ends: (points (r, 8), forms (r, 8, 8), first row of each end (n + 1,), lead (n,), sheets (n,), …). Of an end
            with lead −1 the rows are its points; of another they lie along a closed curve, evenly over the angle of
            the lead pendulum, which turns `sheets` times.
    """
    points, forms, first, lead, sheets = ends[0], ends[1], ends[2], ends[3], ends[4]
    best, trial = np.inf, np.empty(8)
    if lead[number] < 0:
        for row in range(first[number], first[number + 1]):
            for i in range(8):
                trial[i] = y[i] - points[row, i]
            trial[2], trial[3] = within(trial[2]), within(trial[3])
            value = _form(trial, forms[row])
            if value < best:
                best = value
                away[:] = trial
        return best
    rows, angle = first[number + 1] - first[number], 2 + lead[number]
    along = y[angle] - _TAU * math.floor(y[angle] / _TAU)
    for sheet in range(sheets[number]):
        place = (along + sheet * _TAU) / (_TAU * sheets[number]) * rows
        low = math.floor(place)
        share = place - low
        this, then = first[number] + low % rows, first[number] + (low + 1) % rows
        for i in range(8):
            change = points[then, i] - points[this, i]
            if i in (2, 3):
                change = within(change)
            trial[i] = y[i] - points[this, i] - share * change
        trial[2], trial[3] = within(trial[2]), within(trial[3])
        trial[angle] = 0.0
        value = _form(trial, forms[this if share < 0.5 else then])
        if value < best:
            best = value
            away[:] = trial
    return best


@njit(cache=True, error_model="numpy")
def _distance(away, scale):
    largest = 0.0
    for i in range(8):
        largest = max(largest, abs(away[i]) / scale[i])
    return largest


@njit(cache=True, error_model="numpy")
def _caught_by(y, ends, share, away):
    """The end whose region's inner part holds the state, −1 for none."""
    for number in range(len(ends[3])):
        if deviation(y, number, ends, away) <= share:
            return number
    return -1


@njit(cache=True, error_model="numpy", nogil=True)
def pursue(y, beside, omega, turns, pace, steps_rad, system, ends, units, limits, facts):
    """Follow one release; its end state is left in y.

    Args:
        y, beside: states at ψ = 0 of the release and of its neighbour, shape (8,).
        turns: revolutions to follow it, at least 1.
        steps_rad: lengths of the steps of both, as for steps_needed.
        ends: as for deviation, and (turn maps (n, 8, 8), values below which these hold (n,), values at which an end
            is near (n,), its own mean radius (n,)).
        units: of the distance between both, shape (8,).
        limits: (share of a region that catches, distance at which the two are apart, revolutions to go on for).
        facts: what was found, shape (FACTS,): number of the end or −1, revolutions until caught and until settled
            (nan: never), largest distance of both before that, rms radius in the last revolution, turns of A and B.
    """
    maps, straight, near, radius = ends[5], ends[6], ends[7], ends[8]
    share, apart, further = limits
    k, work, phase = np.zeros((16, 8)), np.empty(8), np.empty(3)
    orbit, other, away, gap = np.zeros(3), np.zeros(3), np.zeros(8), np.empty(8)
    begin_a, begin_b = y[2], y[3]
    facts[END], facts[CAUGHT], facts[SETTLED], facts[APART] = -1, np.nan, np.nan, 0.0
    number, done = -1, 0
    while done < turns:
        number = _caught_by(y, ends, share, away)
        if number >= 0 and (facts[APART] > apart or deviation(beside, number, ends, gap) <= 1.0):
            break
        number = -1
        advance(y, omega, steps_needed(y, omega, pace, steps_rad[0]), system, k, work, phase, orbit)
        if facts[APART] <= apart:
            advance(beside, omega, steps_needed(beside, omega, pace, steps_rad[1]), system, k, work, phase, other)
            for i in range(8):
                gap[i] = y[i] - beside[i]
            facts[APART] = max(facts[APART], _distance(gap, units))
            if not facts[APART] <= apart:
                facts[APART] = np.inf
        done += 1
    facts[RADIUS] = math.sqrt(max(0.0, orbit[2] - orbit[0] ** 2 - orbit[1] ** 2))
    facts[TURNS_A], facts[TURNS_B] = (y[2] - begin_a) / _TAU, (y[3] - begin_b) / _TAU
    facts[END] = number
    if number < 0:
        return
    facts[CAUGHT] = done
    value = deviation(y, number, ends, away)
    while value > near[number] and done < turns + further:
        if done == turns:
            facts[RADIUS] = math.sqrt(max(0.0, orbit[2] - orbit[0] ** 2 - orbit[1] ** 2))
        if value <= straight[number]:
            break
        advance(y, omega, steps_needed(y, omega, pace, steps_rad[0]), system, k, work, phase, orbit)
        done += 1
        value = deviation(y, number, ends, away)
    facts[TURNS_A], facts[TURNS_B] = (y[2] - begin_a) / _TAU, (y[3] - begin_b) / _TAU
    if value <= near[number]:
        facts[SETTLED] = done
    if ends[3][number] >= 0:
        if done < turns:
            facts[RADIUS] = radius[number]
        return
    if value > straight[number] and value > near[number]:
        return
    _glide(y, away, value, number, done, turns, further, near[number], maps[number], ends, facts)
    if done < turns:  # the last revolution, from where the turn map has come to
        advance(y, omega, steps_needed(y, omega, pace, steps_rad[0]), system, k, work, phase, orbit)
        facts[RADIUS] = math.sqrt(max(0.0, orbit[2] - orbit[0] ** 2 - orbit[1] ** 2))


@njit(cache=True, error_model="numpy")
def _glide(y, away, value, number, done, turns, further, near, turn_map, ends, facts):
    """The rest of the way by the turn map: the state one revolution before the end into y, and when it is near."""
    base, then, last = y - away, np.empty(8), done
    last = max(done, turns - 1)
    while done < last or (value > near and done < turns + further):
        for i in range(8):
            then[i] = 0.0
            for j in range(8):
                then[i] += turn_map[i, j] * away[j]
        away[:] = then
        done += 1
        if value > near:
            value = _form(away, ends[1][ends[2][number]])
            if value <= near:
                facts[SETTLED] = done
        if done <= last:
            y[:] = base + away
