"""A matrix that is periodic in the rotor's phase, as a Fourier series: input of all Floquet methods."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.errors import OutsideDomain

_EPS = float(np.finfo(float).eps)


@compiled
def evaluate(series: Complex, phase: float, out: Array) -> None:
    """Write A(ψ) = Re Σ_k series[k] e^{ikψ} to out; series complex (m + 1, n, n), out (n, n)."""
    n = series.shape[1]
    for i in range(n):
        for j in range(n):
            out[i, j] = series[0, i, j].real
    for k in range(1, series.shape[0]):
        c, s = np.cos(k * phase), np.sin(k * phase)
        for i in range(n):
            for j in range(n):
                out[i, j] += c * series[k, i, j].real - s * series[k, i, j].imag


@dataclass(frozen=True)
class PeriodicMatrix:
    """A(ψ) of δẏ = A(ψ) δy along a motion, as a Fourier series in the rotor's phase.

    Attributes:
        harmonics: complex, shape (m + 1, n, n): A(ψ) = Re Σ_k harmonics[k] e^{ikψ}, SI (1/s and the state's units).
        speed_rad_s: ψ̇ = ω, above 0.
        turn: signs, shape (n,), of D = diag(turn) with A(ψ + π) = D A(ψ) D, so that half a revolution is sufficient.
            None if only the whole revolution is a period.
    Raises:
        OutsideDomain: the speed is not finite and above 0, or the harmonics are not finite or have a wrong shape.
    """

    harmonics: Complex
    speed_rad_s: float
    turn: Array | None

    def __post_init__(self) -> None:
        shape = self.harmonics.shape
        if len(shape) != 3 or shape[0] < 1 or shape[1] != shape[2] or shape[1] < 1:
            raise OutsideDomain(f"harmonics must have the shape (m + 1, n, n), got {shape}")
        if not (np.isfinite(self.speed_rad_s) and self.speed_rad_s > 0):
            raise OutsideDomain(f"speed_rad_s must be finite and above 0, got {self.speed_rad_s!r}")
        if not np.isfinite(self.harmonics).all():
            raise OutsideDomain("the matrix along the motion contains values that are not finite: check masses, speed")

    @property
    def constant(self) -> bool:
        """Whether the matrix is independent of the phase (autonomous equations)."""
        return len(self.harmonics) == 1

    @property
    def dimension(self) -> int:
        """Number of states n."""
        return self.harmonics.shape[1]

    def at(self, phase_rad: float) -> Array:
        """A(ψ), shape (n, n), 1/s."""
        wave = np.exp(1j * phase_rad * np.arange(len(self.harmonics)))
        return np.real(np.einsum("k,kij->ij", wave, self.harmonics))

    @functools.cached_property
    def seen_from_rotor(self) -> PeriodicMatrix | None:
        """The constant matrix in the frame that rotates with the rotor, or None if it is not constant in that frame.

        With y = R(ψ) y_r, R rotating (x, y) and (ẋ, ẏ) by ψ: A_r = Rᵀ A(ψ) R − ω G, G = dR/dψ at 0. After a whole
        revolution R is 1, so the multipliers are the same.
        """
        if self.constant or self.dimension not in (4, 6, 8):
            return None
        start = np.empty((self.dimension, self.dimension))
        if not _constant_on_rotor(np.ascontiguousarray(self.harmonics, np.complex128), start):
            return None
        start -= self.speed_rad_s * turning(self.dimension)
        return PeriodicMatrix(start.astype(complex)[None], self.speed_rad_s, None)


def turning(n: int) -> Array:
    """G: derivative of the rotation of (x, y) and (ẋ, ẏ) at angle zero, shape (n, n)."""
    g = np.zeros((n, n))
    for i in (0, n // 2):
        g[i, i + 1], g[i + 1, i] = -1.0, 1.0
    return g


@compiled(part=True)
def _turn_pairs(a: Array, c: float, s: float) -> None:
    """Replace a by Rᵀ a R; R rotates the pairs (0, 1) and (n/2, n/2 + 1) by an angle with cosine c and sine s."""
    n = a.shape[0]
    for first in (0, n // 2):
        for row in range(n):
            left, right = a[row, first], a[row, first + 1]
            a[row, first], a[row, first + 1] = c * left + s * right, c * right - s * left
    for first in (0, n // 2):
        for column in range(n):
            upper, lower = a[first, column], a[first + 1, column]
            a[first, column], a[first + 1, column] = c * upper + s * lower, c * lower - s * upper


@compiled(part=True)
def _turned_sizes(a: Array, c: float, s: float) -> None:
    """Replace a, a matrix of absolute values, by |R|ᵀ a |R|: bound on the sums of the terms of Rᵀ A R."""
    n = a.shape[0]
    for first in (0, n // 2):
        for row in range(n):
            left, right = a[row, first], a[row, first + 1]
            a[row, first], a[row, first + 1] = c * left + s * right, c * right + s * left
    for first in (0, n // 2):
        for column in range(n):
            upper, lower = a[first, column], a[first + 1, column]
            a[first, column], a[first + 1, column] = c * upper + s * lower, c * lower + s * upper


@compiled
def _constant_on_rotor(series: Complex, start: Array) -> bool:
    """Whether Rᵀ A(ψ) R is equal to A(0) within rounding at all phases. A(0) is written to start, shape (n, n)."""
    n, phases = start.shape[0], 2 * series.shape[0] + 1
    evaluate(series, 0.0, start)
    there, size = np.empty((n, n)), np.empty((n, n))
    for step in range(1, phases):
        phase = 2 * np.pi * step / phases
        c, s = np.cos(phase), np.sin(phase)
        evaluate(series, phase, there)
        for i in range(n):
            for j in range(n):
                size[i, j] = abs(there[i, j])
        _turn_pairs(there, c, s)
        _turned_sizes(size, abs(c), abs(s))
        for i in range(n):
            for j in range(n):
                if abs(there[i, j] - start[i, j]) > 16 * _EPS * (size[i, j] + abs(start[i, j])):
                    return False
    return True
