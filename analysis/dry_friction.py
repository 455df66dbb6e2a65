# pyright: strict
"""Dry friction of the pendulums as an identification has found it, and what it leaves open of a steady state.

With friction a pendulum rests anywhere in a band about its frictionless angle. A prediction states the frictionless
angle; the band is a standard uncertainty of type B of its own, evenly spread over the mean torques that friction can
hold, new at each point: nothing is common to where two points come to rest. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import RotorParameters
from dynamics.steady.held_band import HeldBand, held_band
from rig_configs import IdentifiedParameters

Array = NDArray[np.float64]

NAMES = ("coulomb_a_Nm", "coulomb_b_Nm", "contact_a_kg_m2", "contact_b_kg_m2")


@dataclass(frozen=True)
class DryFriction:
    """Torque M + F ω² against a pendulum's motion.

    Attributes:
        values: M_A, M_B (N m), F_A, F_B (kg m²), shape (4,).
        covariance: shape (4, 4).
    """

    values: Array
    covariance: Array

    @classmethod
    def of(cls, identified: IdentifiedParameters) -> DryFriction | None:
        """What parameters.toml keeps of it; None where no test has shown any."""
        kept: Mapping[str, Any] | None = identified.provenance.get("friction")
        if kept:
            return cls(np.array([float(kept["values"][n]) for n in NAMES]), np.array(kept["covariance"], np.float64))
        tests: list[Mapping[str, Any]] = identified.provenance.get("tests", [])
        found = [test for test in tests if test.get("friction")]
        if not found:
            return None
        values, std = found[-1]["friction"], found[-1].get("friction_std", {})
        return cls(
            np.array([float(values.get(n, 0.0)) for n in NAMES]),
            np.diag([float(std.get(n, 0.0)) ** 2 for n in NAMES]),
        )

    def torque_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """M + F ω² of A and B and its standard uncertainty, N m, shape (2,) each."""
        design = np.hstack([np.eye(2), speed_rad_s**2 * np.eye(2)])
        return design @ self.values, np.sqrt(np.diag(design @ self.covariance @ design.T))

    def band(self, physics: RotorParameters, speed_rad_s: float, theta_rad: tuple[float, float]) -> HeldBand:
        """Where the pendulums may rest; a torque's own uncertainty is in its root mean square."""
        value, std = self.torque_at(speed_rad_s)
        return held_band(physics, speed_rad_s, theta_rad, np.hypot(np.maximum(value, 0.0), std))


def seen_slopes(band: HeldBand, orbit: NDArray[np.complex128], beta_rad: float) -> Array:
    """Derivatives of θ3, θ4, order-1 amplitudes in sensor axes and rms radius by resting angles, shape (5, 2).

    Args:
        orbit: X, Y in stiffness axes about which they hold, m; an amplitude that is 0 has none.
        beta_rad: from the stiffness to the sensor x axis.
    """
    turn = np.array([[math.cos(beta_rad), math.sin(beta_rad)], [-math.sin(beta_rad), math.cos(beta_rad)]])
    seen, by = turn @ orbit, turn @ band.orbit_slopes
    size, out = np.abs(seen), np.zeros((5, 2))
    out[:2] = np.eye(2)
    along = np.real(np.conj(seen)[:, None] * by)
    out[2:4] = along / np.maximum(size, 1e-300)[:, None]
    out[4] = along.sum(axis=0) / (2 * max(math.sqrt(0.5 * float(size @ size)), 1e-300))
    return out
