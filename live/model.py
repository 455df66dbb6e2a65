"""Curves of the model for the page: 1× over speed with locked pendulums, and the steady states at a speed."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dynamics import locked_orbit, steady_states
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import DynamicsError
from rig_basics.arrays import Array, Complex
from rig_basics.units import RPM
from rig_configs import IdentifiedParameters
from rig_configs.schema import Rig

_Value = TypeVar("_Value", complex, Array)
_ACCURACY = 1e-4
_MAX_KEPT = 2000  # speeds whose steady states are kept
_MIN_RPM = 20.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Predicted:
    """One steady motion in the sensors' axes.

    Attributes:
        type: I, II, III; "locked" with locked pendulums.
        theta_deg: angles of both pendulums, 0 … 360.
        orbit_mm: complex order-1 amplitudes of x and y: x = Re(x e^{iψ}), y alike.
        amplitude_mm: rms distance of the disk centre from the orbit's middle.
    """

    type: str
    theta_deg: tuple[float, float]
    orbit_mm: tuple[complex, complex]
    amplitude_mm: float


class LiveModel:
    """Predictions of the model for the page.

    Args:
        rig: rig with identified parameters applied, if they exist.
        identified: these parameters, for effects that are not in a rig file: bow, angle of the axes.
        source: origin of the numbers, for a reader.
    """

    def __init__(self, rig: Rig, identified: IdentifiedParameters | None = None, source: str = "rig file") -> None:
        self.physics: RotorParameters = rig.physics if identified is None else identified.with_effects(rig.physics)
        self.source: str = source
        self._top_rpm = rig.limits.speed_rpm
        known = None if identified is None else identified.axis_angle_deg
        self._turn_rad = math.radians(rig.roles.mounted_deg[0] if known is None else known[0])
        self._states: dict[int, list[Predicted]] = {}

    def bode(self, points: int = 600) -> tuple[Array, Complex, Complex]:
        """Return complex order-1 amplitudes of x and y in mm over rpm, pendulums locked at 0° and 180°; (points,)."""
        rpm = np.linspace(_MIN_RPM, self._top_rpm, points)
        rows = [self._shown(*self._locked(speed, (0.0, math.pi))) for speed in rpm]
        table = np.array(rows, np.complex128)
        return rpm, table[:, 0], table[:, 1]

    def locked(self, rpm: float, theta_rad: tuple[float, float]) -> Predicted | None:
        """Return the motion at a speed with pendulums locked at given angles; None if no solution exists."""
        x, y = self._shown(*self._locked(rpm, theta_rad))
        if not math.isfinite(abs(x) + abs(y)):
            return None
        a, b = (math.degrees(angle) % 360 for angle in theta_rad)
        return Predicted("locked", (a, b), (x, y), math.sqrt((abs(x) ** 2 + abs(y) ** 2) / 2))

    def steady(self, rpm: float) -> list[Predicted] | None:
        """Return the computed stable steady states near a speed; None before they are computed."""
        return self._states.get(round(rpm))

    def compute_states(self, rpm: float) -> None:
        """Compute the stable steady states at a speed, to the nearest rpm, which takes a tenth of a second."""
        key = round(rpm)
        if key in self._states or key < _MIN_RPM:
            return
        try:
            found = [s for s in steady_states(self.physics, key * RPM, _ACCURACY) if s.stable]
        except (DynamicsError, np.linalg.LinAlgError) as error:
            _log.info("steady states at %d rpm, the page displays none: %s", key, error)
            found = []
        if len(self._states) >= _MAX_KEPT:
            self._states.pop(next(iter(self._states)))
        self._states[key] = [
            Predicted(
                s.type,
                (math.degrees(s.theta_rad[0]) % 360, math.degrees(s.theta_rad[1]) % 360),
                self._shown(complex(s.x_m), complex(s.y_m)),
                1e3 * s.amplitude_m,
            )
            for s in found
        ]

    def _locked(self, rpm: float, theta_rad: tuple[float, float]) -> tuple[complex, complex]:
        try:
            return locked_orbit(self.physics, max(rpm, 1e-3) * RPM, *theta_rad)
        except DynamicsError:  # usual: no solution at this speed, the curve has a gap
            return complex(math.nan), complex(math.nan)

    def _shown(self, x_m: complex, y_m: complex) -> tuple[complex, complex]:
        """Convert x = Re(X e^{iψ}), y = Im(Y e^{iψ}) of the stiffness axes, m, to real parts of the sensors', mm."""
        return self._turned(x_m, -1j * y_m)

    def shown(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        """Convert displacements along the stiffness axes, m, shape (n,), to those of the sensors, mm."""
        return self._turned(x_m, y_m)

    def _turned(self, x: _Value, y: _Value) -> tuple[_Value, _Value]:
        c, s = 1e3 * math.cos(self._turn_rad), 1e3 * math.sin(self._turn_rad)
        return x * c + y * s, y * c - x * s
