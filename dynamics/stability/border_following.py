"""A border followed from one of its points: each step is predicted from the previous points and corrected on a circle.

In a unit square, e(x, y) = max|μ| − 1 is continuous but has kinks where one multiplier overtakes another. On a circle
of radius s about a point of the border, e changes sign where the border leaves the circle. The direction is bracketed
between a stable direction (on the left) and an unstable one. If the border turns by more than a few degrees, or is not
near its chord at the middle, the step is halved, down to 10⁻⁶. At that step the border may turn a corner. Therefore
neither a thin band nor the tip of a tongue is lost, independent of the grid.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass

from dynamics.errors import NotConverged

LONGEST, SHORTEST = 0.01, 1e-6  # step lengths
_TURN = math.radians(3.0)  # largest turn within a step
_ASIDE = 2.0 * _TURN  # half-width of the search about the predicted direction
_SCAN = math.radians(7.0)
_WIDEST = math.radians(175.0)
_MAX_STEPS = 20_000
_ROUNDS, _NARROW = 80, 1e-13  # of the location of a point; accuracy relative to the square
_SLOPE = 1e-7  # of the square: distance for the first direction
Excess = Callable[[complex], float]
"""e at x + i y in the unit square; NaN outside it and where the balanced state does not exist."""


@dataclass(frozen=True)
class FollowedBorder:
    """Points of a border in order, x + i y.

    Attributes:
        points: points; the stable side is on the left.
        closed: whether the last point is the first one.
    """

    points: list[complex]
    closed: bool


def follow(excess: Excess, start: complex) -> FollowedBorder:
    """Follow the whole border through a point.

    Args:
        start: point on the border, e = 0 to rounding.
    Raises:
        NotConverged: the border does not end.
    """
    onward = _one_way(excess, start, _direction(excess, start))
    if onward.closed:
        return onward
    back = _one_way(lambda at: -excess(at), start, _direction(excess, start) + math.pi)
    return FollowedBorder([*reversed(back.points[1:]), *onward.points], False)


def _direction(excess: Excess, at: complex) -> float:
    """Direction along the border with the stable side on the left, rad."""
    best, found = -math.inf, 0.0
    count = 64  # number of directions; the excess changes most along the border's normal
    around = [excess(at + _SLOPE * cmath.rect(1.0, 2 * math.pi * k / count)) for k in range(count)]
    for k in range(count):
        left, right = around[(k + count // 4) % count], around[(k - count // 4) % count]
        if right - left > best:
            best, found = right - left, 2 * math.pi * k / count
    return found


def _one_way(excess: Excess, start: complex, direction: float) -> FollowedBorder:
    """Follow the border in a direction until it returns to the start, leaves the square or ends within it."""
    points, step, before, curvature = [start], LONGEST / 8, 0.0, 0.0
    chord = direction
    for _ in range(_MAX_STEPS):
        at, ahead = points[-1], chord + curvature * (step + before) / 2
        if len(points) > 4 and abs(at - start) < 0.9 * step and abs(_folded(ahead - direction)) < 0.5:
            return FollowedBorder([*points, start], True)
        if not _inside(at + step * cmath.rect(1.0, ahead)):
            end = _leaving(excess, at, ahead, step)
            if end is not None:
                return FollowedBorder([*points, end], False)
        found = _on_circle(excess, at, ahead, step, _ASIDE)
        turn = math.inf if found is None else _folded(found - chord)
        halfway = None if found is None else _on_circle(excess, at, found, step / 2, _TURN)
        if (abs(turn) > _TURN or halfway is None) and step > SHORTEST:
            step, curvature = max(step / 2, SHORTEST), 0.0
            continue
        if found is None:  # a corner
            found, turn = _around(excess, at, chord, step), 0.0
            if found is None:
                return FollowedBorder(points, False)
        if halfway is not None:
            points.append(at + step / 2 * cmath.rect(1.0, halfway))
        points.append(at + step * cmath.rect(1.0, found))
        curvature = 2 * turn / (step + before) if before else 0.0
        chord, before = found, step
        if abs(turn) < _TURN / 2:
            step = min(1.5 * step, LONGEST)
    raise NotConverged(f"a border of stability does not end within {_MAX_STEPS} steps from {start:.6g} of the range")


def _on_circle(excess: Excess, at: complex, direction: float, step: float, aside: float) -> float | None:
    """Direction in which the border leaves a circle, rad. None if it is not within `aside` of the prediction."""

    def off(angle: float) -> float:
        return excess(at + step * cmath.rect(1.0, angle))

    right, left = off(direction - aside), off(direction + aside)
    if not (right >= 0.0 > left):
        return None
    if right == 0.0:
        return direction - aside
    return _root(off, direction - aside, direction + aside, _NARROW / step)


def _around(excess: Excess, at: complex, direction: float, step: float) -> float | None:
    """Direction in which the border leaves a circle, searched with increasing distance from the prediction, rad."""
    for k in range(int(_WIDEST / _SCAN) + 1):
        for side in (1, -1):
            found = _on_circle(excess, at, direction + side * k * _SCAN, step, 0.6 * _SCAN)
            if found is not None:
                return found
    return None


def _leaving(excess: Excess, at: complex, direction: float, step: float) -> complex | None:
    """Point at which the border leaves the square within a step; None if it is not found."""
    way = cmath.rect(1.0, direction)
    across, upwards = _until_a_side(at.real, way.real), _until_a_side(at.imag, way.imag)
    length, upright = min(across, upwards), across <= upwards
    exit_point = at + length * way
    wide = max(2.0 * step * math.tan(_ASIDE), 1e-12)

    def point(along: float) -> complex:
        along = min(max(along, 0.0), 1.0)
        return complex(round(exit_point.real), along) if upright else complex(along, round(exit_point.imag))

    middle = exit_point.imag if upright else exit_point.real
    to_the_left = math.copysign(wide, way.real if upright else -way.imag)
    if not (excess(point(middle - to_the_left)) >= 0.0 > excess(point(middle + to_the_left))):
        return None
    return point(_root(lambda along: excess(point(along)), middle - to_the_left, middle + to_the_left, _NARROW))


def _until_a_side(place: float, rate: float) -> float:
    """Distance at which a coordinate reaches 0 or 1."""
    return ((1.0 if rate > 0 else 0.0) - place) / rate if rate else math.inf


def _root(function: Callable[[float], float], low: float, high: float, narrow: float) -> float:
    """Root between two points whose values have different signs: Illinois method with a bisection every fourth time.

    The iteration ends if the next point is within `narrow` of the last one.
    """
    at_low, at_high = function(low), function(high)
    for turn in range(_ROUNDS):
        if at_high == 0.0 or abs(high - low) <= narrow:
            break
        inner = (low * at_high - high * at_low) / (at_high - at_low)
        middle = (low + high) / 2 if turn % 4 == 3 else inner
        if abs(middle - high) <= narrow:
            return middle
        value = function(middle)
        if (value > 0) == (at_high > 0):
            at_low /= 2
        else:
            low, at_low = high, at_high
        high, at_high = middle, value
    return high


def _inside(at: complex) -> bool:
    return 0.0 <= at.real <= 1.0 and 0.0 <= at.imag <= 1.0


def _folded(angle: float) -> float:
    """The angle in −π … π, rad."""
    return math.remainder(angle, 2 * math.pi)
