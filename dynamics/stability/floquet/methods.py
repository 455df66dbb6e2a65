"""Interface of the monodromy methods, and the phase span of the monodromy matrix."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.equations.periodic_matrix import PeriodicMatrix


class MonodromyMethod(Protocol):
    """Computation of the monodromy matrix from A(ψ). A module with these names implements it."""

    @property
    def NAME(self) -> str:
        """Name of the method for users."""
        ...

    @property
    def ORDER(self) -> int:
        """Order: the error decreases as steps^−ORDER."""
        ...

    def monodromy(self, matrix: PeriodicMatrix, steps: int) -> Array:
        """Fundamental matrix over half a revolution with the turn applied, D Φ(π), or over a whole one, Φ(2π).

        Args:
            matrix: A(ψ).
            steps: number of equal steps of the span, at least 1.
        Returns:
            shape (n, n). It may contain inf or NaN if the motion overflows or the steps are far too long.
        """
        ...


def span_rad(matrix: PeriodicMatrix) -> float:
    """Phase span of the monodromy matrix: π with half-turn symmetry, otherwise 2π, rad."""
    return 2 * np.pi if matrix.turn is None else np.pi


def per_radian(matrix: PeriodicMatrix) -> Complex:
    """Fourier coefficients of A(ψ)/ω, with the phase as the independent variable. Contiguous, complex."""
    return np.ascontiguousarray(matrix.harmonics / matrix.speed_rad_s, np.complex128)


def turned(matrix: PeriodicMatrix, fundamental: Array) -> Array:
    """D Φ if the span is half a revolution, otherwise Φ."""
    return fundamental if matrix.turn is None else matrix.turn[:, None] * fundamental
