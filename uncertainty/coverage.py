# pyright: strict
"""Coverage factors, coverage intervals of a sample, and the numerical tolerance of a number of digits."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit  # pyright: ignore[reportMissingTypeStubs]

from uncertainty.errors import BadInput

Interval = tuple[float, float]
IntervalKind = Literal["symmetric", "shortest"]
"""Probabilistically symmetric, with as much probability below as above; or the shortest of all."""


def check_level(level: float) -> None:
    """A coverage probability lies inside 0 … 1.

    Raises:
        BadInput: it does not.
    """
    if not 0.0 < level < 1.0:
        raise BadInput(f"the coverage probability is {level}; it must lie between 0 and 1, e.g. 0.95")


def coverage_factor(level: float, degrees_of_freedom: float = math.inf) -> float:
    """Factor k of the two-sided interval ± k u of a Student distribution; the normal one for infinite degrees.

    Degrees of freedom need not be whole: the distribution is evaluated at them as they are (JCGM 100, G.4.1 allows
    that beside rounding down).

    Raises:
        BadInput: the level or the degrees of freedom are outside their domain.
    Source: JCGM 100, G.3.
    """
    check_level(level)
    if not degrees_of_freedom > 0:
        raise BadInput(f"degrees of freedom are {degrees_of_freedom}; they must be above 0")
    upper_tail = 0.5 * (1.0 - level)
    if math.isinf(degrees_of_freedom):
        return -float(ndtri(upper_tail))
    return -float(stdtrit(degrees_of_freedom, upper_tail))


def ellipsoid_factor(level: float, dimension: int) -> float:
    """Factor k of the ellipsoid (y − y₀)ᵀ V⁻¹ (y − y₀) ≤ k² that holds a normal vector at this probability.

    Raises:
        BadInput: the level or the dimension is outside its domain.
    Source: JCGM 102, 6.5.2 and 6.5.3.
    """
    check_level(level)
    if dimension < 1:
        raise BadInput(f"the dimension is {dimension}; it must be at least 1")
    return math.sqrt(float(chdtri(dimension, 1.0 - level)))


def numerical_tolerance(std: float, digits: int) -> float:
    """Half a unit in the last of so many significant digits of a standard uncertainty, δ; 0 for 0.

    Raises:
        BadInput: fewer digits than 1, or an uncertainty that is negative or not finite.
    Source: JCGM 101, 7.9.2.
    """
    if digits < 1 or not (math.isfinite(std) and std >= 0):
        raise BadInput(f"digits is {digits} and std is {std}; at least 1 digit and a finite std ≥ 0 are needed")
    if std == 0:
        return 0.0
    _, exponent = f"{std:.{digits - 1}e}".split("e")  # rounded first: 0.0996 with two digits is 0.10
    return 0.5 * 10.0 ** (int(exponent) - digits + 1)


def symmetric_interval(ordered: NDArray[np.float64], level: float) -> Interval:
    """Probabilistically symmetric coverage interval of a sample.

    Args:
        ordered: shape (trials,), not decreasing.
        level: coverage probability.

    Raises:
        BadInput: too few values for this level.
    Source: JCGM 101, 7.7.2.
    """
    covered = _covered(ordered, level)
    low = (len(ordered) - covered + 1) // 2 - 1
    return float(ordered[low]), float(ordered[low + covered])


def shortest_interval(ordered: NDArray[np.float64], level: float) -> Interval:
    """Shortest coverage interval of a sample; the first one of several that are equally short.

    Args:
        ordered: shape (trials,), not decreasing.
        level: coverage probability.

    Raises:
        BadInput: too few values for this level.
    Source: JCGM 101, 7.7.3 and 5.3.4.
    """
    covered = _covered(ordered, level)
    low = int(np.argmin(ordered[covered:] - ordered[:-covered]))
    return float(ordered[low]), float(ordered[low + covered])


def end_errors(ordered: NDArray[np.float64], level: float) -> Interval:
    """Numerical error of both ends of the symmetric interval that a finite sample leaves, two standard deviations.

    The rank of the value next to a quantile scatters like a binomial number, whatever the distribution; the values
    two standard deviations of the rank away give the error. Infinite where the sample has no values so far out.
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
    """How many steps between ordered values an interval has, q of JCGM 101, 7.7."""
    check_level(level)
    n = len(ordered)
    covered = math.floor(level * n + 0.5)
    if not 0 < covered < n:
        raise BadInput(
            f"{n} values do not reach a coverage probability of {level}; more than {math.ceil(0.5 / (1 - level))} are "
            "needed"
        )
    return covered
