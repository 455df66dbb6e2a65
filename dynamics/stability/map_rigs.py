"""Points of a map in the form used by Type I: a few numbers each, many points at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array
from dynamics.equations.parameters import RotorParameters


@dataclass(frozen=True)
class MapRigs:
    """Rigs with both pendulums, each at a balanced state and a speed; arrays of shape (points,), pairs (2, points).

    Attributes:
        mass_kg: M_S.
        k_N_per_m, c_Ns_per_m: stiffness and damping along x and y.
        moment_kg_m, inertia_kg_m2, loss_Nms_per_rad, theta_rad: S, J, c and θ of pendulums A and B.
        speed_rad_s: ω.
    """

    mass_kg: Array
    k_N_per_m: Array
    c_Ns_per_m: Array
    moment_kg_m: Array
    inertia_kg_m2: Array
    loss_Nms_per_rad: Array
    theta_rad: Array
    speed_rad_s: Array

    @classmethod
    def of(
        cls, rigs: Sequence[RotorParameters], angles: Sequence[tuple[float, float]], speeds_rad_s: Sequence[float]
    ) -> MapRigs:
        """One point per rig.

        Args:
            rigs: rigs with both pendulums.
            angles: θ3, θ4 of each rig's balanced state, rad.
            speeds_rad_s: speed of each rig, rad/s.
        """
        packed = np.array([rig.packed() for rig in rigs])
        pairs = [np.ascontiguousarray(packed[:, i : i + 2].T) for i in (1, 3, 5, 8, 10)]
        k, c, moment, inertia, loss = pairs
        return cls(packed[:, 0], k, c, moment, inertia, loss, np.array(angles, float).T, np.array(speeds_rad_s, float))

    def at(self, points: NDArray[np.intp] | slice) -> MapRigs:
        """Selection of the points."""
        return MapRigs(**{f.name: getattr(self, f.name)[..., points] for f in dataclasses.fields(self)})

    def __len__(self) -> int:
        return len(self.speed_rad_s)

    @property
    def swings(self) -> Array:
        """Frequencies of both axes without pendulums per radian of phase, shape (2, points)."""
        return np.sqrt(self.k_N_per_m / self.mass_kg) / self.speed_rad_s

    @property
    def fades(self) -> Array:
        """Damping rates of both axes and of both pendulums per radian of phase, shape (4, points)."""
        rates = np.concatenate([self.c_Ns_per_m / self.mass_kg, self.loss_Nms_per_rad / self.inertia_kg_m2])
        return rates / self.speed_rad_s

    @property
    def units(self) -> Array:
        """Units of each point's eight states in which the blocks of its matrix are comparable, shape (points, 8).

        Unit of displacements: sqrt(J/M_S). Unit of their rates: that times the frequency if it is above the speed.
        """
        length = np.sqrt(self.inertia_kg_m2.mean(axis=0) / self.mass_kg)
        one = np.ones(len(self))
        return np.column_stack([length, length, one, one, *(length * np.maximum(1.0, self.swings)), one, one])

    @property
    def numbers(self) -> Array:
        """κ1, κ2, γ1, γ2, δ_A, δ_B; m/det, g/det, P_A, P_B, Q_A, Q_B and n_i S_i/J_i at ψ = 0, shape (points, 21).

        For their definition see dynamics.stability.floquet.lanes.
        """
        s, j = self.moment_kg_m, self.inertia_kg_m2
        arm = np.exp(1j * self.theta_rad)
        normal, mu = -1j * arm, s * s / j
        m, g = self.mass_kg - mu.sum(axis=0) / 2, -0.5 * np.sum(mu * arm**2, axis=0)
        det = (m - np.abs(g)) * (m + np.abs(g))

        def softened(vectors: NDArray[np.inexact]) -> list[Array]:
            return _parts((m * vectors + g * np.conj(vectors)) / det)

        delta = self.loss_Nms_per_rad / j / self.speed_rad_s
        rows = [*(self.k_N_per_m / self.speed_rad_s**2), *(self.c_Ns_per_m / self.speed_rad_s), *delta, m / det]
        rows += [*_parts((g / det)[None]), *softened(2 * s * arm), *softened(s * normal), *_parts(s / j * normal)]
        return np.column_stack(rows)


def _parts(vectors: NDArray[np.inexact]) -> list[Array]:
    """Real and imaginary part of each vector; the vectors have the shape (n, points)."""
    return [part for vector in vectors for part in (vector.real, vector.imag)]
