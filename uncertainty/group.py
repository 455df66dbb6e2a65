"""Group of correlated sources of error with one covariance matrix and joint degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig_basics.texts import number_of
from uncertainty.errors import BadInput
from uncertainty.source import ErrorSource, Kind, check_standing

JointDistribution = Literal["normal", "t"]

_ROUNDING = 1e-9  # largest asymmetry and negative eigenvalue of a correlation matrix that count as rounding


@dataclass(frozen=True, eq=False)
class Group:
    """Correlated errors with expectation zero; one term of a budget.

    Attributes:
        name: name of the group, unique among the sources of a budget.
        members: names of the n errors.
        units: units of the n errors, for display.
        covariance: shape (n, n), in the products of `units`; a singular matrix is allowed.
        kind: "A" or "B".
        distribution: "normal" or multivariate "t", whose scale matrix is `covariance` (JCGM 102, 5.3.2).
        degrees_of_freedom: degrees of freedom of the covariance matrix as one estimate.

    Raises:
        BadInput: shapes do not match, or `covariance` is not a covariance matrix.
    """

    name: str
    members: tuple[str, ...]
    units: tuple[str, ...]
    covariance: NDArray[np.float64]
    kind: Kind = "A"
    distribution: JointDistribution = "normal"
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        check_standing(self.name, self.kind, self.degrees_of_freedom)
        covariance = np.array(self.covariance, dtype=np.float64)
        n = len(self.members)
        if n == 0 or len(set(self.members)) != n or len(self.units) != n or covariance.shape != (n, n):
            raise BadInput(
                f"group {self.name!r}: {number_of(n, 'member')} (they need unique names), {len(self.units)} "
                f"units and a covariance "
                f"of shape {covariance.shape} do not match"
            )
        if self.distribution not in get_args(JointDistribution):
            raise BadInput(f"group {self.name!r}: distribution is {self.distribution!r}; it must be normal or t")
        correlation_factor(covariance, f"group {self.name!r}")
        covariance.setflags(write=False)
        object.__setattr__(self, "members", tuple(self.members))
        object.__setattr__(self, "units", tuple(self.units))
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def of_observations(cls, name: str, members: Sequence[str], units: Sequence[str], observations: ArrayLike) -> Group:
        """Create a type A group from the means of quantities that were observed together.

        Args:
            name: name of the group.
            members: names of the quantities.
            units: units of the quantities.
            observations: shape (n, quantities), n ≥ 2 simultaneous observations.

        Raises:
            BadInput: there are fewer than two observations, shapes do not match, or a value is not finite.
        Source: JCGM 100, 5.2.3: covariance of means s(q, r)/n, with n − 1 degrees of freedom.

        Example:
            >>> from uncertainty import Group
            >>> group = Group.of_observations("scale", ["x", "y"], ["mm", "mm"], [[1.0, 2.0], [1.1, 2.2], [1.2, 2.4]])
            >>> group.std.round(4), group.degrees_of_freedom
            (array([0.0577, 0.1155]), 2.0)
        """
        values = np.asarray(observations, dtype=np.float64)
        if values.ndim != 2 or len(values) < 2 or not bool(np.all(np.isfinite(values))):
            raise BadInput(
                f"group {name!r}: observations have shape {values.shape}; at least 2 rows of finite values are needed"
            )
        n = len(values)
        scatter = values - np.mean(values, axis=0)
        return cls(name, tuple(members), tuple(units), scatter.T @ scatter / (n * (n - 1)), "A", "t", float(n - 1))

    @property
    def width(self) -> int:
        """Number of columns of this group in a table of errors."""
        return len(self.members)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard uncertainties of the members, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def factor(self) -> NDArray[np.float64]:
        """Factor F of the covariance F Fᵀ, shape (n, n)."""
        return self.std[:, None] * correlation_factor(self.covariance, f"group {self.name!r}")

    def draw(self, generator: np.random.Generator, size: int) -> NDArray[np.float64]:
        """Return random errors with expectation zero, shape (size, n), in the members' units.

        All members of one draw of "t" use the same chi-square number. Their covariance is ν/(ν − 2) times that of the
        group.
        """
        errors = generator.standard_normal((size, self.width)) @ self.factor.T
        if self.distribution == "t" and math.isfinite(self.degrees_of_freedom):
            nu = self.degrees_of_freedom
            errors /= np.sqrt(generator.chisquare(nu, size) / nu)[:, None]
        return np.asarray(errors, dtype=np.float64)


Input = ErrorSource | Group
"""A source of error: one column of a table of errors, or several correlated columns."""


def correlation_of(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlation matrix of a covariance matrix; off-diagonal 0 for a constant."""
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0, std, 1.0)
    matrix = np.clip(covariance / scale[:, None] / scale[None, :], -1.0, 1.0)
    np.fill_diagonal(matrix, 1.0)
    return matrix


def correlation_factor(covariance: NDArray[np.float64], owner: str) -> NDArray[np.float64]:
    """Return the factor F of the correlation matrix F Fᵀ of a covariance matrix, shape (n, n), which may be singular.

    Args:
        covariance: shape (n, n).
        owner: name of the covariance for error messages.

    Raises:
        BadInput: the covariance is not finite, not symmetric, or not positive semidefinite within rounding.
    """
    if not bool(np.all(np.isfinite(covariance))) or bool(np.any(np.diag(covariance) < 0)):
        raise BadInput(f"{owner}: the covariance has values that are not finite or variances below 0")
    std = np.sqrt(np.diag(covariance))
    if bool(np.any(covariance[std == 0])):
        raise BadInput(f"{owner}: a member of variance 0 has a covariance other than 0")
    scale = np.where(std > 0, std, 1.0)
    correlation = covariance / scale[:, None] / scale[None, :]
    if float(np.max(np.abs(correlation - correlation.T))) > _ROUNDING:
        raise BadInput(f"{owner}: the covariance is not symmetric")
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    if float(values[0]) < -_ROUNDING * len(values):
        raise BadInput(
            f"{owner}: the covariance is not positive semidefinite; the correlation matrix has the eigenvalue "
            f"{float(values[0]):.3g}"
        )
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)
