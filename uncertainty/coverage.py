"""Coverage factors, coverage intervals of a sample, and the numerical tolerance for a number of digits."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit

from rig_basics.texts import number_of
from uncertainty.errors import BadInput

Interval = tuple[float, float]
IntervalKind = Literal["symmetric", "shortest"]
"""Probabilistically symmetric (equal probability below and above), or shortest coverage interval."""


def check_level(level: float) -> None:
    """Check that a coverage probability lies between 0 and 1.

    Raises:
        BadInput: the level is 0 or less, or 1 or more.
    """
    if not 0.0 < level < 1.0:
        raise BadInput(f"the coverage probability is {level}; it must lie between 0 and 1, e.g. 0.95")


def coverage_factor(level: float, degrees_of_freedom: float = math.inf) -> float:
    """Return the factor k of the two-sided interval ± k u of a Student distribution.

    Infinite degrees of freedom give the normal factor. Degrees of freedom that are not whole are used without rounding,
    which JCGM 100, G.4.1 allows as an alternative to rounding down.

    Raises:
        BadInput: the level or the degrees of freedom are outside their domain.
    Source: JCGM 100, G.3.

    Example:
        >>> from uncertainty import coverage_factor
        >>> round(coverage_factor(0.95, degrees_of_freedom=2), 3), round(coverage_factor(0.95), 3)
        (4.303, 1.96)
    """
    check_level(level)
    if not degrees_of_freedom > 0:
        raise BadInput(f"degrees of freedom are {degrees_of_freedom}; they must be above 0")
    upper_tail = 0.5 * (1.0 - level)
    if math.isinf(degrees_of_freedom):
        return -float(ndtri(upper_tail))
    return -float(stdtrit(degrees_of_freedom, upper_tail))


def ellipsoid_factor(level: float, dimension: int) -> float:
    """Return the factor k of the ellipsoid (y − y₀)ᵀ V⁻¹ (y − y₀) ≤ k² that contains a normal vector at this level.

    Raises:
        BadInput: the level or the dimension is outside its domain.
    Source: JCGM 102, 6.5.2 and 6.5.3.
    """
    check_level(level)
    if dimension < 1:
        raise BadInput(f"the dimension is {dimension}; it must be at least 1")
    return math.sqrt(float(chdtri(dimension, 1.0 - level)))


def numerical_tolerance(std: float, digits: int) -> float:
    """Return δ, half a unit in the last significant digit of a standard uncertainty; 0 for an uncertainty of 0.

    Args:
        std: standard uncertainty, at least 0.
        digits: number of significant digits, at least 1.

    Raises:
        BadInput: `digits` is below 1, or `std` is negative or not finite.
    Source: JCGM 101, 7.9.2.
    """
    if digits < 1 or not (math.isfinite(std) and std >= 0):
        raise BadInput(f"digits is {digits} and std is {std}; at least 1 digit and a finite std ≥ 0 are needed")
    if std == 0:
        return 0.0
    _, exponent = f"{std:.{digits - 1}e}".split("e")  # the number is rounded first: 0.0996 with two digits is 0.10
    return 0.5 * 10.0 ** (int(exponent) - digits + 1)


def symmetric_interval(ordered: NDArray[np.float64], level: float) -> Interval:
    """Return the probabilistically symmetric coverage interval of a sample.

    Args:
        ordered: values in ascending order, shape (trials,).
        level: coverage probability.

    Raises:
        BadInput: the sample has too few values for this level.
    Source: JCGM 101, 7.7.2.
    """
    covered = _covered(ordered, level)
    low = (len(ordered) - covered + 1) // 2 - 1
    return float(ordered[low]), float(ordered[low + covered])


def shortest_interval(ordered: NDArray[np.float64], level: float) -> Interval:
    """Return the shortest coverage interval of a sample; the first one of several that are equally short.

    Args:
        ordered: values in ascending order, shape (trials,).
        level: coverage probability.

    Raises:
        BadInput: the sample has too few values for this level.
    Source: JCGM 101, 7.7.3 and 5.3.4.
    """
    covered = _covered(ordered, level)
    low = int(np.argmin(ordered[covered:] - ordered[:-covered]))
    return float(ordered[low]), float(ordered[low + covered])


def end_errors(ordered: NDArray[np.float64], level: float) -> Interval:
    """Return the numerical errors of both ends of the symmetric interval, two standard deviations each.

    The rank of the value next to a quantile has a binomial distribution for any distribution of the values. The values
    at two standard deviations of the rank give the error. The error is infinite if the sample has no values at these
    ranks.
    """
    n = len(ordered)
    reach = 2.0 * math.sqrt(n * 0.25 * (1.0 - level) * (1.0 + level))
    errors: list[float] = []
    for tail in (0.5 * (1.0 - level), 0.5 * (1.0 + level)):
        first, last = math.floor(n * tail - reach), math.ceil(n * tail + reach)
        inside = first >= 0 and last < n
        errors.append(0.5 * float(ordered[last] - ordered[first]) if inside else math.inf)
    return errors[0], errors[1]


def _covered(ordered: NDArray[np.float64], level: float) -> int:
    """Return the number q of steps between ordered values in an interval (JCGM 101, 7.7)."""
    check_level(level)
    n = len(ordered)
    covered = math.floor(level * n + 0.5)
    if not 0 < covered < n:
        raise BadInput(
            f"{number_of(n, 'value does', 'values do')} not reach a coverage probability of {level}; more "
            f"than {math.ceil(0.5 / (1 - level))} are "
            "needed"
        )
    return covered
