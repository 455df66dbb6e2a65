"""Orbits: ellipse of one order with its forward and backward part."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rig_basics.arrays import Array, Complex
from rig_basics.tabular import Column, Tabular


@dataclass(frozen=True)
class OrbitEllipse(Tabular):
    """Orbit x = Re(X e^{ikψ}), y = Re(Y e^{ikψ}) of sensors at right angles, in the sense of the rotor's rotation.

    Attributes:
        forward_m, backward_m: x + i y = forward e^{ikψ} + backward e^{−ikψ}, complex, m.
        std_m: standard deviation of either semi-axis, m.
    """

    forward_m: complex
    backward_m: complex
    std_m: float = 0.0

    @property
    def major_m(self) -> float:
        """Major semi-axis, m."""
        return abs(self.forward_m) + abs(self.backward_m)

    @property
    def minor_m(self) -> float:
        """Minor semi-axis, m; negative for a backward orbit."""
        return abs(self.forward_m) - abs(self.backward_m)

    @property
    def inclination_rad(self) -> float:
        """Angle of the major axis from x towards y, −π/2 … π/2."""
        angle = 0.5 * (np.angle(self.forward_m) + np.angle(self.backward_m))
        return float((angle + 0.5 * math.pi) % math.pi - 0.5 * math.pi)

    @property
    def precession(self) -> str:
        """ "forward", "backward", or "straight" if the minor axis is within two deviations of 0."""
        if abs(self.minor_m) <= 2 * self.std_m or self.minor_m == 0.0:
            return "straight"
        return "forward" if self.minor_m > 0 else "backward"

    def columns(self) -> Mapping[str, Column]:
        """Return one row: semi-axes, inclination and sense."""
        names = "major_m", "minor_m", "std_m", "inclination_rad", "precession"
        return {name: [getattr(self, name)] for name in names}

    def points(self, phase_rad: Array) -> tuple[Array, Array]:
        """Return x and y of the orbit, m, at phases kψ, shapes (n,)."""
        turn = np.exp(1j * phase_rad)
        whole = self.forward_m * turn + self.backward_m * np.conj(turn)
        return whole.real, whole.imag


def orbit_ellipse(x: complex, y: complex, x_std: float = 0.0, y_std: float = 0.0) -> OrbitEllipse:
    """Return the ellipse of two order vectors.

    Args:
        x, y: complex amplitudes along two axes at right angles, y a quarter turn ahead in the rotor's sense, m.
        x_std, y_std: standard deviations of their real and imaginary parts, m.
    Source: docs/theory/order_tracking.md.
    """
    forward, backward = forward_backward(np.array([x]), np.array([y]))
    return OrbitEllipse(complex(forward[0]), complex(backward[0]), math.sqrt(0.5 * (x_std**2 + y_std**2)))


def forward_backward(x: Complex, y: Complex) -> tuple[Complex, Complex]:
    """Return forward and backward parts of order vectors along x and y, (n,): x + i y = R₊ e^{iψ} + R₋ e^{−iψ}."""
    return 0.5 * (x + 1j * y), np.asarray(0.5 * np.conj(x - 1j * y), np.complex128)


def turned(x: Complex, y: Complex, angle_rad: float) -> tuple[Complex, Complex]:
    """Return order vectors along axes turned by an angle from x towards y (virtual sensors), shapes (n,)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return c * x + s * y, c * y - s * x
