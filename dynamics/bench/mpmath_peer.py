"""Largest multiplier of one matrix with thirty digits: the reference on systems without heyoka.

Taylor series of the linear equations in the rotor's phase: with B(ψ) = A(ψ)/ω = Σ_j B_j (ψ − ψ0)^j about the start of
each step, Y_{n+1} = Σ_j B_j Y_{n−j}/(n + 1). A matrix takes seconds. The code is independent of
dynamics.stability.floquet.
"""

from __future__ import annotations

from typing import Any

import mpmath as untyped_mpmath
import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array
from dynamics.equations.linearised import PeriodicMatrix

mpmath: Any = untyped_mpmath  # mpmath has no annotations
DIGITS = 30
_ORDER = 40
_REACH, _LONGEST = 1.0, 0.4  # bounds on ‖B‖ times the step and on the step itself, rad: the rest is below 1e-20
_MAX_STEPS = 80


def largest_multiplier(matrix: PeriodicMatrix) -> float | None:
    """Largest modulus over one revolution, correct to the last digit of a double.

    Args:
        matrix: A(ψ), in units in which its entries have similar size (dynamics.stability.floquet.multipliers.balanced).
    Returns:
        None if the matrix would take more than a minute (stiff equations or low speed).
    """
    half = matrix.turn is not None
    size = float(np.linalg.norm(np.sum(np.abs(matrix.harmonics), axis=0), 2)) / matrix.speed_rad_s
    steps = int(np.ceil((1 if half else 2) * np.pi * max(size / _REACH, 1 / _LONGEST)))
    if steps > _MAX_STEPS:
        return None
    with mpmath.workdps(DIGITS + 10):
        h = (1 if half else 2) * mpmath.pi / steps
        y: NDArray[Any] = _numbers(np.eye(matrix.dimension))
        harmonics = [(_numbers(x.real), _numbers(x.imag)) for x in matrix.harmonics]
        for step in range(steps):
            y = _advanced(y, _coefficients(harmonics, matrix.speed_rad_s, step * h), h)
        if matrix.turn is not None:
            y = _numbers(matrix.turn)[:, None] * y
        values = mpmath.eig(mpmath.matrix(y.tolist()), left=False, right=False)
        return float(max(abs(v) for v in values) ** (2 if half else 1))


def _numbers(values: Array) -> NDArray[Any]:
    """The array with mpmath numbers as entries."""
    return np.vectorize(mpmath.mpf, otypes=[object])(values)


def _coefficients(harmonics: list[tuple[NDArray[Any], NDArray[Any]]], speed: float, phase: Any) -> list[NDArray[Any]]:
    """Coefficients B_j of B(phase + s) = Σ B_j s^j, from the real and imaginary parts of the harmonics."""
    found: list[NDArray[Any]] = []
    for j in range(_ORDER):
        total = 0 * harmonics[0][0]
        for k, (real, imaginary) in enumerate(harmonics):
            factor = mpmath.expj(k * phase) * mpmath.mpc(0, k) ** j / mpmath.factorial(j)
            total = total + (real * factor.real - imaginary * factor.imag)
        found.append(total / mpmath.mpf(speed))
    return found


def _advanced(y: NDArray[Any], b: list[NDArray[Any]], h: Any) -> NDArray[Any]:
    terms = [y]
    for n in range(_ORDER):
        terms.append(sum((b[j] @ terms[n - j] for j in range(1, n + 1)), b[0] @ terms[n]) / (n + 1))
    total = terms[-1]
    for term in reversed(terms[:-1]):
        total = total * h + term
    return total
