"""Simulation of a release, revolution by revolution, until it enters the region of a stable motion: compiled part.

Two runs are computed: the release, and a neighbour at the stated error with coarser steps. While they stay close, the
release's own error is much smaller than their distance. Once they separate, the end is not determined.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics.arrays import Array, Indices, RealSystem
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import rates
from dynamics.motions.explicit_steps import explicit_step

END, CAUGHT, SETTLED, APART, RADIUS, TURNS_A, TURNS_B = range(7)
FACTS = 7
_TAU = 2 * math.pi


@compiled(part=True)
def steps_needed(y: Array, omega: float, pace: float, step_rad: float) -> int:
    """Number of steps of the next revolution, step_rad of the fastest oscillation each.

    Args:
        pace: fastest rate of suspension and damping, rad/s.
    """
    fastest = max(pace, omega + max(abs(y[6]), abs(y[7])))
    return max(4, math.ceil(_TAU * fastest / (omega * step_rad)))


@compiled(contract=True, part=True)
def advance(
    y: Array, omega: float, steps: int, system: RealSystem, k: Array, end: Array, phase: Array, orbit: Array
) -> None:
    """Advance the state by one revolution of the rotor from ψ = 0, in place.

    Args:
        y: shape (8,), angles not reduced.
        orbit: mean x, y, x² + y² and angles of A and B at the ends of the steps, shape (5,).
    """
    p, free_a, free_b = system[0], system[1], system[2]
    h = _TAU / omega / steps
    orbit[:] = 0.0
    rates(y, 0.0, omega, 0.0, p, free_a, free_b, k[0])
    for s in range(steps):
        explicit_step(y, s * h, h, 1, 1, system, k, end, phase)
        y[:] = end
        k[0, :] = k[12, :]
        orbit[0] += y[0]
        orbit[1] += y[1]
        orbit[2] += y[0] * y[0] + y[1] * y[1]
        orbit[3] += y[2]
        orbit[4] += y[3]
    orbit /= steps


@compiled(part=True)
def within(angle: float) -> float:
    """The angle reduced to −π … π."""
    return angle - _TAU * math.floor(angle / _TAU + 0.5)


@compiled(part=True)
def _form(away: Array, form: Array) -> float:
    found = 0.0
    for i in range(8):
        row = 0.0
        for j in range(8):
            row += form[i, j] * away[j]
        found += away[i] * row
    return found


@compiled
def deviation(
    y: Array,
    number: int,
    ends: tuple[Array, Array, Indices, Indices, Indices, Array, Array, Array, Array]
    | tuple[Array, Array, Indices, Indices, Indices],
    away: Array,
) -> float:
    """Write the deviation of a state from an end's nearest point to away; returns its form, 1 on the region's rim.

    Args:
        ends: (points (r, 8), forms (r, 8, 8), first row of each end (n + 1,), lead (n,), sheets (n,), …). The rows of
            an end with lead −1 are its points. Otherwise they lie along a closed curve, evenly spaced over the angle of
            the lead pendulum, which makes `sheets` turns.
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


@compiled(part=True)
def _distance(away: Array, scale: Array) -> float:
    largest = 0.0
    for i in range(8):
        largest = max(largest, abs(away[i]) / scale[i])
    return largest


@compiled(part=True)
def _caught_by(
    y: Array,
    ends: tuple[Array, Array, Indices, Indices, Indices, Array, Array, Array, Array],
    share: float,
    away: Array,
) -> int:
    """Number of the end whose inner region contains the state, or −1."""
    for number in range(len(ends[3])):
        if deviation(y, number, ends, away) <= share:
            return number
    return -1


@compiled(nogil=True)
def pursue(
    y: Array,
    neighbour: Array,
    turns: int,
    motion: tuple[float, float, tuple[float, float], RealSystem],
    ends: tuple[Array, Array, Indices, Indices, Indices, Array, Array, Array, Array],
    units: Array,
    limits: tuple[float, float, int],
    facts: Array,
) -> None:
    """Simulate one release. Its final state is written to y.

    Args:
        y, neighbour: states at ψ = 0 of the release and of its neighbour, shape (8,).
        turns: number of revolutions, at least 1.
        motion: (ω, fastest rate, step lengths of both, system), as for steps_needed and advance.
        ends: as for deviation, and (turn maps (n, 8, 8), values below which these hold (n,), values at which an end
            counts as near (n,), its own mean radius (n,)).
        units: units of the distance of the two states, shape (8,).
        limits: (fraction of a region that catches, distance at which the two are separated, additional revolutions).
        facts: results, shape (FACTS,): number of the end or −1, revolutions until caught and until settled (NaN:
            never), largest distance of the two before that, rms radius in the last revolution, turns of A and B.
    """
    work = (np.zeros((16, 8)), np.empty(8), np.empty(3))
    orbit, begin_a, begin_b = np.zeros(5), y[2], y[3]
    facts[CAUGHT], facts[SETTLED], facts[APART] = np.nan, np.nan, 0.0
    number, done = _chase(y, neighbour, turns, motion, ends, units, limits, facts, work, orbit)
    facts[END], facts[RADIUS] = number, _radius_of(orbit)
    if number >= 0:
        facts[CAUGHT] = done
        _settle(y, number, done, turns, motion, ends, limits, facts, work, orbit)
    facts[TURNS_A], facts[TURNS_B] = (y[2] - begin_a) / _TAU, (y[3] - begin_b) / _TAU


@compiled(part=True)
def _radius_of(orbit: Array) -> float:
    return math.sqrt(max(0.0, orbit[2] - orbit[0] * orbit[0] - orbit[1] * orbit[1]))


@compiled(part=True)
def _chase(
    y: Array,
    neighbour: Array,
    turns: int,
    motion: tuple[float, float, tuple[float, float], RealSystem],
    ends: tuple[Array, Array, Indices, Indices, Indices, Array, Array, Array, Array],
    units: Array,
    limits: tuple[float, float, int],
    facts: Array,
    work: tuple[Array, Array, Array],
    orbit: Array,
) -> tuple[int, int]:
    """Simulate release and neighbour until both are in the region of an end: (its number or −1, revolutions)."""
    omega, pace, steps_rad, system = motion
    share, apart = limits[0], limits[1]
    gap, other = np.empty(8), np.zeros(5)
    done = 0
    while True:
        number = _caught_by(y, ends, share, gap)
        if number >= 0 and (facts[APART] > apart or deviation(neighbour, number, ends, gap) <= 1.0):
            return number, done
        if done >= turns:
            return -1, done
        advance(y, omega, steps_needed(y, omega, pace, steps_rad[0]), system, work[0], work[1], work[2], orbit)
        if facts[APART] <= apart:
            steps = steps_needed(neighbour, omega, pace, steps_rad[1])
            advance(neighbour, omega, steps, system, work[0], work[1], work[2], other)
            for i in range(8):
                gap[i] = y[i] - neighbour[i]
            facts[APART] = max(facts[APART], _distance(gap, units))
            if not facts[APART] <= apart:
                facts[APART] = np.inf
        done += 1


@compiled(part=True)
def _settle(
    y: Array,
    number: int,
    done: int,
    turns: int,
    motion: tuple[float, float, tuple[float, float], RealSystem],
    ends: tuple[Array, Array, Indices, Indices, Indices, Array, Array, Array, Array],
    limits: tuple[float, float, int],
    facts: Array,
    work: tuple[Array, Array, Array],
    orbit: Array,
) -> None:
    """Continue a caught release in coarse steps until it is near its end and the simulated time is over."""
    omega, pace, steps_rad, system = motion
    straight, near, last = ends[6][number], ends[7][number], turns + limits[2]
    away = np.empty(8)
    value = deviation(y, number, ends, away)
    while near < value and straight < value and done < last:
        advance(y, omega, steps_needed(y, omega, pace, steps_rad[1]), system, work[0], work[1], work[2], orbit)
        done += 1
        if done == turns:
            facts[RADIUS] = _radius_of(orbit)
        value = deviation(y, number, ends, away)
    if value <= near:
        facts[SETTLED] = done
    if ends[3][number] >= 0 or straight < 0.0:  # slipping: its own mean; that of one revolution fluctuates
        if done < turns:
            facts[RADIUS] = ends[8][number]
        return
    if near < value and straight < value:
        return
    early = done < turns
    _glide(y, away, value, number, done, turns, last, ends, facts)
    if early:  # the last revolution, from the state reached by the turn map
        advance(y, omega, steps_needed(y, omega, pace, steps_rad[1]), system, work[0], work[1], work[2], orbit)
        facts[RADIUS] = _radius_of(orbit)


@compiled(part=True)
def _glide(
    y: Array,
    away: Array,
    value: float,
    number: int,
    done: int,
    turns: int,
    last: int,
    ends: tuple[Array, Array, Indices, Indices, Indices, Array, Array, Array, Array],
    facts: Array,
) -> None:
    """Continue by the turn map. The state a revolution before the end of the time is written to y."""
    turn_map, near, form = ends[5][number], ends[7][number], ends[1][ends[2][number]]
    base, then, shown = y - away, np.empty(8), max(done, turns - 1)
    while done < shown or (near < value and done < last):
        for i in range(8):
            then[i] = 0.0
            for j in range(8):
                then[i] += turn_map[i, j] * away[j]
        away[:] = then
        done += 1
        if near < value:
            value = _form(away, form)
            if value <= near:
                facts[SETTLED] = done
        if done <= shown:
            y[:] = base + away
