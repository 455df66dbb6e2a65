"""Steady states along one parameter of a rig: branches, and the values at which the set of stable types changes.

Each value is solved separately by `steady_states`. A branch joins the states of one type with the nearest angles. A
break point is a value at which the set of stable types changes. It is bracketed between two values and bisected. The
cause may be a multiplier that crosses 1, or a motion that ceases to exist, so it is not the root of a function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dynamics.arrays import Array, Flags
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.integrate import locked_orbit
from dynamics.steady.steady_motions import steady_states
from dynamics.steady.steady_state import SteadyState
from rig_basics.tabular import Column, Tabular

RigAt: TypeAlias = Callable[[float], tuple[RotorParameters, float]]
"""Function from a value to the rig and its speed in rad/s."""

UNRESOLVED = "?"
"""Marker for the stable types at a value whose states could not be evaluated."""
_WIDTH = 1e-6  # relative width of a break point's bracket
_SPAN_SHARE = 1e-9  # smallest width relative to the whole range, for break points near 0
_CLOSER = (0.004, 0.02, 0.08, 0.25)  # distances of additional values, relative to the distance of the given values
_CLOSE = 5.0
_MAX_BREAKS = 20  # between two values
_COLUMNS = {"value": "values", "stable": "stable", "multiplier_max": "multiplier_max", "amplitude_m": "amplitude_m"}


@dataclass(frozen=True)
class Branch:
    """States of one type along the parameter.

    Attributes:
        type: "I", "II", "III" or "one".
        values: parameter values at which it exists, ascending, shape (n,).
        theta_rad: θ3, θ4, without jumps, shape (n, 2).
        amplitude_m: as SteadyState.amplitude_m, shape (n,).
        multiplier_max: largest modulus over one revolution, shape (n,).
        stable: whether the state is stable, shape (n,).
    """

    type: str
    values: Array
    theta_rad: Array
    amplitude_m: Array
    multiplier_max: Array
    stable: Flags


@dataclass(frozen=True)
class BreakPoint:
    """A value at which the set of stable types changes.

    Attributes:
        value: value of the parameter, accurate to `error`.
        error: half the width of the last bracket.
        before, after: stable types below and above it; ("?",) if they could not be evaluated.
    """

    value: float
    error: float
    before: tuple[str, ...]
    after: tuple[str, ...]


@dataclass(frozen=True)
class SteadyBranches(Tabular):
    """Steady states along one parameter.

    Attributes:
        values: the given values and additional ones near each break point, ascending, shape (n,).
        branches: sorted by type and first value.
        break_points: ascending.
        locked_amplitude_m: rms radius with the pendulums locked at 0° and 180°, shape (n,); NaN if it does not exist.
        unresolved: value and the state that could not be evaluated there.
    """

    values: Array
    branches: tuple[Branch, ...]
    break_points: tuple[BreakPoint, ...]
    locked_amplitude_m: Array
    unresolved: tuple[tuple[float, str], ...]

    @property
    def heading(self) -> str:
        """The break points."""
        breaks = (f"{_words(b.before)} → {_words(b.after)} at {b.value:.6g}" for b in self.break_points)
        return f"SteadyBranches: {'; '.join(breaks) or 'no break points'}"

    @property
    def remarks(self) -> Sequence[str]:
        """The states that could not be evaluated."""
        return [f"at {value:.6g}: {state}" for value, state in self.unresolved]

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each state of each branch."""
        rows = [(number, b, i) for number, b in enumerate(self.branches) for i in range(len(b.values))]
        return {
            "branch": [number for number, _, _ in rows],
            "type": [b.type for _, b, _ in rows],
            **{name: [getattr(b, of)[i] for _, b, i in rows] for name, of in _COLUMNS.items()},
            "theta3_rad": [b.theta_rad[i, 0] for _, b, i in rows],
            "theta4_rad": [b.theta_rad[i, 1] for _, b, i in rows],
        }

    def stable_branches(self) -> list[Branch]:
        """The stable parts of all branches, without gaps."""
        found = list[Branch]()
        for b in self.branches:
            edges = np.flatnonzero(np.diff(b.stable.astype(int))) + 1
            for part in np.split(np.arange(len(b.values)), edges):
                if b.stable[part[0]]:
                    found.append(_part(b, part))
        return found


def steady_branches(
    at: RigAt, values: ArrayLike, accuracy: float = 1e-9, progress: Callable[[float], None] | None = None
) -> SteadyBranches:
    """Compute the steady states at each value, joined to branches, with break points to a millionth of their value.

    Args:
        at: function from a value to (rig, speed in rad/s).
        values: strictly ascending, shape (n,), n ≥ 2, in the parameter's unit. Two break points between neighbouring
            values that cancel each other are not found.
        accuracy: accuracy of the multipliers, as for `steady_states`. A state within it of 1 is not stable.
        progress: called with the completed share, 0 … 1.
    Raises:
        OutsideDomain: values not ascending, or a rig, speed or accuracy outside the domain.
    Source: docs/theory/steady_states.md.
    """
    given = np.asarray(values, np.float64)
    if given.ndim != 1 or len(given) < 2 or not np.all(np.isfinite(given)) or not np.all(np.diff(given) > 0):
        raise OutsideDomain(f"values: expected at least two, ascending and finite, got {values!r:.80}")
    solutions = _Solutions(at, accuracy)
    for i, value in enumerate(given.tolist()):
        solutions.types(value)
        if progress is not None:
            progress(0.8 * (i + 1) / len(given))
    least = _SPAN_SHARE * float(given[-1] - given[0])
    breaks = list[BreakPoint]()
    for low, high in zip(given[:-1].tolist(), given[1:].tolist(), strict=True):
        breaks += _breaks_between(solutions, low, high, least)
    breaks = _merged(breaks)
    every = np.unique([*given.tolist(), *_near_breaks(given, breaks)])
    found = [solutions.states(value) for value in every.tolist()]
    if progress is not None:
        progress(1.0)
    return SteadyBranches(
        every,
        tuple(_joined(every, found)),
        tuple(breaks),
        np.array([_locked_radius(*at(value)) for value in every.tolist()]),
        tuple(solutions.unresolved),
    )


def _near_breaks(given: Array, breaks: Sequence[BreakPoint]) -> list[float]:
    """Additional values on both sides of break points, increasingly dense: branches end there like square roots."""
    found = list[float]()
    for one in breaks:
        at = int(np.clip(np.searchsorted(given, one.value), 1, len(given) - 1))
        cell = float(given[at] - given[at - 1])
        steps = [2 * one.error, *(share * cell for share in _CLOSER)]
        found += [one.value + side * step for step in steps for side in (-1, 1)]
    apart = [min((abs(value - b.value) / b.error for b in breaks if b.error > 0), default=2.0) for value in found]
    return [v for v, off in zip(found, apart, strict=True) if given[0] < v < given[-1] and off > 1.0]


class _Solutions:
    """Steady states at parameter values. Each value is computed once."""

    def __init__(self, at: RigAt, accuracy: float) -> None:
        self.unresolved: list[tuple[float, str]] = []
        self._at, self._accuracy = at, accuracy
        self._found: dict[float, Sequence[SteadyState] | None] = {}

    def states(self, value: float) -> Sequence[SteadyState]:
        """All steady states; empty if they could not be evaluated."""
        if value not in self._found:
            rig, speed = self._at(value)
            try:
                found = steady_states(rig, speed, self._accuracy)
            except NotConverged as error:
                self._found[value] = None
                self.unresolved.append((value, str(error)))
            else:
                self._found[value] = found
                self.unresolved += [(value, line) for line in found.unresolved]
        return self._found[value] or ()

    def types(self, value: float) -> tuple[str, ...]:
        """Types of the stable states."""
        states = self.states(value)
        if self._found[value] is None:
            return (UNRESOLVED,)
        return tuple(sorted({s.type for s in states if s.draws}))


def _breaks_between(solutions: _Solutions, low: float, high: float, least: float) -> list[BreakPoint]:
    """Break points between two values in ascending order; several of them as far as bisection finds them."""
    found = list[BreakPoint]()
    while solutions.types(low) != solutions.types(high) and len(found) < _MAX_BREAKS:
        left, right = low, high
        width = max(_WIDTH * max(abs(low), abs(high)), least)
        while right - left > width:
            middle = 0.5 * (left + right)
            if not left < middle < right:
                break
            left, right = (middle, right) if solutions.types(middle) == solutions.types(low) else (left, middle)
        one = BreakPoint(0.5 * (left + right), 0.5 * (right - left), solutions.types(left), solutions.types(right))
        found.append(one)
        low = right
    return found


def _merged(breaks: Sequence[BreakPoint]) -> list[BreakPoint]:
    """Break points merged if a multiplier is 1 within its error between them."""
    found = list[BreakPoint]()
    for one in breaks:
        last = found[-1] if found else None
        if last is not None and one.value - last.value < _CLOSE * (one.error + last.error):
            found.pop()
            middle, half = 0.5 * (last.value + one.value), 0.5 * (one.value - last.value) + one.error
            found.append(BreakPoint(middle, half, last.before, one.after))
        else:
            found.append(one)
    return [one for one in found if one.before != one.after]


def _joined(values: Array, found: Sequence[Sequence[SteadyState]]) -> list[Branch]:
    """Branches through the states at all values."""
    open_ones: dict[str, list[list[tuple[int, SteadyState]]]] = {}
    done = list[list[tuple[int, SteadyState]]]()
    for i, states in enumerate(found):
        kinds = {*open_ones} | {s.type for s in states}
        for kind in sorted(kinds):
            own = [s for s in states if s.type == kind]
            old = open_ones.get(kind, [])
            far = np.array([[_apart(branch[-1][1], s) for s in own] for branch in old]).reshape(len(old), len(own))
            rows, columns = _nearest(far)
            for row, column in zip(rows, columns, strict=True):
                old[row].append((i, own[column]))
            done += [branch for row, branch in enumerate(old) if row not in rows]
            kept = [branch for row, branch in enumerate(old) if row in rows]
            open_ones[kind] = kept + [[(i, s)] for column, s in enumerate(own) if column not in columns]
    done += [branch for kind in open_ones.values() for branch in kind]
    return sorted((_branch(values, each) for each in done), key=lambda b: (b.type, b.values[0]))


def _nearest(far: Array) -> tuple[list[int], list[int]]:
    """Rows and columns that belong together: smallest sum of distances."""
    rows, columns = cast("tuple[Array, Array]", scipy.optimize.linear_sum_assignment(far))
    return rows.astype(int).tolist(), columns.astype(int).tolist()


def _branch(values: Array, members: Sequence[tuple[int, SteadyState]]) -> Branch:
    states = [s for _, s in members]
    return Branch(
        states[0].type,
        values[[i for i, _ in members]],
        np.unwrap(np.array([s.theta_rad for s in states]), axis=0),
        np.array([s.amplitude_m for s in states]),
        np.array([s.multiplier_max for s in states]),
        np.array([s.draws for s in states]),
    )


def _part(b: Branch, at: NDArray[np.int_]) -> Branch:
    theta = b.theta_rad[at]
    theta = theta - 2 * np.pi * np.floor(theta[0] / (2 * np.pi))
    return Branch(b.type, b.values[at], theta, b.amplitude_m[at], b.multiplier_max[at], b.stable[at])


def _words(types: Sequence[str]) -> str:
    return "+".join(types) or "nothing stable"


def _apart(one: SteadyState, other: SteadyState) -> float:
    """Distance of the angles of two states."""
    off = np.exp(1j * np.array(one.theta_rad)) - np.exp(1j * np.array(other.theta_rad))
    return float(np.max(np.abs(off)))


def _locked_radius(rig: RotorParameters, speed: float) -> float:
    """Rms radius of the orbit with locked pendulums, m; NaN if it does not exist."""
    try:
        x, y = locked_orbit(rig, speed, 0.0, math.pi)
    except (OutsideDomain, NotConverged):  # usual: an undamped resonance
        return math.nan
    return math.sqrt(0.5 * (abs(x) ** 2 + abs(y) ** 2))
