"""What a monodromy method is: the interface that every one of them meets, and the span it works over."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.periodic_matrix import PeriodicMatrix


class MonodromyMethod(Protocol):
    """One way from A(ψ) to the monodromy matrix; a module with these names is one."""

    @property
    def NAME(self) -> str:
        """What a user calls it."""
        ...

    @property
    def ORDER(self) -> int:
        """The error falls as steps^−ORDER."""
        ...

    def monodromy(self, matrix: PeriodicMatrix, steps: int) -> NDArray[np.floating]:
        """Fundamental matrix over half a revolution with the turn applied, D Φ(π), or over a whole one, Φ(2π).

        Args:
            matrix: A(ψ).
            steps: number of equal steps the span is cut into, at least 1.
        Returns:
            shape (n, n); may hold inf or NaN where the motion outgrows floating point or the steps are far too long.
        """
        ...


def span_rad(matrix: PeriodicMatrix) -> float:
    """Phase over which the monodromy matrix is taken: π with half-turn symmetry, else 2π."""
    return 2 * np.pi if matrix.turn is None else np.pi


def per_radian(matrix: PeriodicMatrix) -> NDArray[np.complexfloating]:
    """Fourier coefficients of A(ψ)/ω: the phase is the methods' independent variable. Contiguous, complex."""
    return np.ascontiguousarray(matrix.harmonics / matrix.speed_rad_s, np.complex128)


def turned(matrix: PeriodicMatrix, fundamental: NDArray[np.floating]) -> NDArray[np.floating]:
    """D Φ where half a revolution was covered, else Φ."""
    return fundamental if matrix.turn is None else matrix.turn[:, None] * fundamental
