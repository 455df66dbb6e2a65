"""One independent source of error: its standard uncertainty, distribution and degrees of freedom."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uncertainty.errors import BadInput

Kind = Literal["A", "B"]
"""Evaluation of the standard uncertainty: by statistics of a series of observations (A), or by other means (B)."""
Distribution = Literal["normal", "rectangular", "triangular", "arcsine", "t"]

_HALF_WIDTH = {"rectangular": math.sqrt(3.0), "triangular": math.sqrt(6.0), "arcsine": math.sqrt(2.0)}
"""Ratio of half-width to standard deviation of a distribution (JCGM 100, 4.3.7 and 4.3.9; JCGM 101, 6.4.6)."""


@dataclass(frozen=True)
class ErrorSource:
    """An independent source of error with expectation zero.

    Attributes:
        name: name, unique among the sources of a budget.
        std: standard uncertainty in the unit of the source, at least 0.
        unit: unit of the source, for display; values are not converted.
        kind: "A" for a series of observations, "B" for other information.
        distribution: distribution of the errors from `draw`. "t" has the scale `std`, as JCGM 101, 6.4.9 assigns it to
            the mean of readings. Its draws have the standard deviation std × sqrt(ν/(ν − 2)), which is infinite for
            ν ≤ 2.
        degrees_of_freedom: degrees of freedom ν of the estimate `std`; infinite if `std` is taken as exact.

    Raises:
        BadInput: a field is outside its domain.
    """

    name: str
    std: float
    unit: str = ""
    kind: Kind = "B"
    distribution: Distribution = "normal"
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        check_standing(self.name, self.kind, self.degrees_of_freedom)
        if not (math.isfinite(self.std) and self.std >= 0):
            raise BadInput(f"source {self.name!r}: std is {self.std}; it must be finite and at least 0")
        if self.distribution not in get_args(Distribution):
            raise BadInput(
                f"source {self.name!r}: distribution is {self.distribution!r}; it must be one of "
                f"{', '.join(get_args(Distribution))}"
            )

    @classmethod
    def of_readings(cls, name: str, readings: ArrayLike, unit: str = "") -> ErrorSource:
        """Create a type A source from the mean of independent readings: s/√n with n − 1 degrees of freedom.

        Args:
            name: name of the source.
            readings: readings of one quantity, shape (n,), n ≥ 2, in `unit`.
            unit: unit of the readings.

        Raises:
            BadInput: there are fewer than two readings, or a reading is not finite.
        Source: JCGM 100, 4.2.3; the distribution by JCGM 101, 6.4.9.

        Example:
            >>> from uncertainty import ErrorSource
            >>> mass = ErrorSource.of_readings("mass", [7.01, 7.03, 7.02], "kg")
            >>> round(mass.std, 5), mass.degrees_of_freedom
            (0.00577, 2.0)
        """
        values = np.asarray(readings, dtype=np.float64)
        if values.ndim != 1 or len(values) < 2 or not bool(np.all(np.isfinite(values))):
            raise BadInput(f"source {name!r}: readings have shape {values.shape}; at least 2 finite values are needed")
        n = len(values)
        return cls(name, float(np.std(values, ddof=1)) / math.sqrt(n), unit, "A", "t", float(n - 1))

    @classmethod
    def of_half_width(
        cls,
        name: str,
        half_width: float,
        unit: str = "",
        distribution: Distribution = "rectangular",
        degrees_of_freedom: float = math.inf,
    ) -> ErrorSource:
        """Create a type B source from a bounded error of known half-width.

        Args:
            name: name of the source.
            half_width: largest magnitude of the error, in `unit`.
            unit: unit of the half-width.
            distribution: "rectangular", "triangular" or "arcsine".
            degrees_of_freedom: degrees of freedom of the half-width as an estimate; see `reliability_degrees`.

        Raises:
            BadInput: the distribution has no half-width, or the half-width is negative or not finite.
        Source: JCGM 100, 4.3.7 and 4.3.9; JCGM 101, 6.4.2, 6.4.5 and 6.4.6.
        """
        if distribution not in _HALF_WIDTH:
            raise BadInput(
                f"source {name!r}: a {distribution} distribution has no half-width; it must be one of "
                f"{', '.join(_HALF_WIDTH)}"
            )
        return cls(name, half_width / _HALF_WIDTH[distribution], unit, "B", distribution, degrees_of_freedom)

    @property
    def width(self) -> int:
        """Number of columns of this source in a table of errors, which is 1."""
        return 1

    @property
    def factor(self) -> NDArray[np.float64]:
        """Factor F of the covariance F Fᵀ, shape (1, 1): the standard uncertainty."""
        return np.array([[self.std]])

    def draw(self, generator: np.random.Generator, size: int) -> NDArray[np.float64]:
        """Return random errors with expectation zero, shape (size,), in the unit of the source.

        Their standard deviation is `std`. For "t" see the class.
        """
        if self.distribution == "rectangular":
            shape = generator.uniform(-_HALF_WIDTH["rectangular"], _HALF_WIDTH["rectangular"], size)
        elif self.distribution == "triangular":
            shape = _HALF_WIDTH["triangular"] * (generator.random(size) - generator.random(size))
        elif self.distribution == "arcsine":
            shape = _HALF_WIDTH["arcsine"] * np.cos(math.pi * generator.random(size))
        elif self.distribution == "t" and math.isfinite(self.degrees_of_freedom):
            shape = generator.standard_t(self.degrees_of_freedom, size)
        else:
            shape = generator.standard_normal(size)
        return np.asarray(self.std * shape, dtype=np.float64)


def reliability_degrees(relative: float) -> float:
    """Return the degrees of freedom of a standard uncertainty whose own relative standard uncertainty is given.

    Args:
        relative: relative standard uncertainty of the standard uncertainty; 0 for an exact value.

    Raises:
        BadInput: `relative` is negative or not finite.
    Source: JCGM 100, G.4.2: ν = 1/(2 r²).
    """
    if not (math.isfinite(relative) and relative >= 0):
        raise BadInput(f"the relative uncertainty of a standard uncertainty is {relative}; it must be at least 0")
    return 0.5 / relative / relative if relative > 0 else math.inf


def check_standing(name: str, kind: str, degrees_of_freedom: float) -> None:
    """Check the fields that sources and groups have in common.

    Raises:
        BadInput: the name is empty, the kind is unknown, or the degrees of freedom are not positive.
    """
    if not name:
        raise BadInput("a source of error needs a name; it is empty")
    if kind not in get_args(Kind):
        raise BadInput(f"source {name!r}: kind is {kind!r}; it must be A or B")
    if not degrees_of_freedom > 0:
        raise BadInput(f"source {name!r}: degrees_of_freedom is {degrees_of_freedom}; it must be above 0")
