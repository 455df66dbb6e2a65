# pyright: strict
"""Orbits: the ellipse of one order, its forward and its backward part."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class OrbitEllipse:
    """The orbit x = Re(X e^{ikψ}), y = Re(Y e^{ikψ}), x and y at right angles, counted as the rotor turns.

    Attributes:
        forward_m, backward_m: x + i y = forward e^{ikψ} + backward e^{−ikψ}, complex, m.
        std_m: standard deviation of either semi-axis.
    """

    forward_m: complex
    backward_m: complex
    std_m: float = 0.0

    @property
    def major_m(self) -> float:
        """Semi-axis, m."""
        return abs(self.forward_m) + abs(self.backward_m)

    @property
    def minor_m(self) -> float:
        """Semi-axis, m; negative where the orbit is backward."""
        return abs(self.forward_m) - abs(self.backward_m)

    @property
    def inclination_rad(self) -> float:
        """Of the major axis from x towards y, −π/2 … π/2."""
        angle = 0.5 * (np.angle(self.forward_m) + np.angle(self.backward_m))
        return float((angle + 0.5 * math.pi) % math.pi - 0.5 * math.pi)

    @property
    def precession(self) -> str:
        """ "forward", "backward", or "straight" where the minor axis is within two deviations of nothing."""
        if abs(self.minor_m) <= 2 * self.std_m or self.minor_m == 0.0:
            return "straight"
        return "forward" if self.minor_m > 0 else "backward"

    def points(self, phase_rad: Array) -> tuple[Array, Array]:
        """The orbit's x and y, m, at phases kψ, shapes (n,)."""
        turn = np.exp(1j * phase_rad)
        whole = self.forward_m * turn + self.backward_m * np.conj(turn)
        return whole.real, whole.imag


def orbit_ellipse(x: complex, y: complex, x_std: float = 0.0, y_std: float = 0.0) -> OrbitEllipse:
    """The ellipse of two order vectors.

    Args:
        x, y: complex amplitudes along two axes at right angles, y a quarter turn ahead in the rotor's sense, m.
        x_std, y_std: standard deviations of their parts, m.
    Source: docs/theory/order_tracking.md.
    """
    forward, backward = forward_backward(np.array([x]), np.array([y]))
    return OrbitEllipse(complex(forward[0]), complex(backward[0]), math.sqrt(0.5 * (x_std**2 + y_std**2)))


def forward_backward(x: Complex, y: Complex) -> tuple[Complex, Complex]:
    """Forward and backward parts of order vectors along x and y, shapes (n,): x + i y = R₊ e^{iψ} + R₋ e^{−iψ}."""
    return 0.5 * (x + 1j * y), np.asarray(0.5 * np.conj(x - 1j * y), np.complex128)


def turned(x: Complex, y: Complex, angle_rad: float) -> tuple[Complex, Complex]:
    """Order vectors along axes that are turned by an angle from x towards y (virtual sensors), shapes (n,)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return c * x + s * y, c * y - s * x
