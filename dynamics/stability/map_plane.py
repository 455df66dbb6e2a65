"""Planes of stability maps: two parameters of a rig, and the rig at a pair of their values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import DynamicsError, NoBalancedState, NotConverged
from dynamics.stability.floquet import floquet_multipliers
from dynamics.stability.map_rigs import MapRigs


@dataclass(frozen=True)
class Coordinate:
    """Function of a parameter in which the half-turn matrix is smooth.

    Attributes:
        of: coordinates from values.
        back: values from coordinates.
    """

    of: Callable[[Array], Array]
    back: Callable[[Array], Array]


SAME = Coordinate(lambda value: value, lambda at: at)
INVERSE = Coordinate(lambda value: 1.0 / value, lambda at: 1.0 / at)  # for a speed: modes turn by ω_n/ω per radian
ROOT = Coordinate(np.sqrt, np.square)  # for a stiffness: the phase of its mode is proportional to the root


RigOverPlane: TypeAlias = Callable[[float, float], tuple[RotorParameters, float]]
"""Function from a pair of values to the rig and its speed in rad/s."""


class Plane(Protocol):
    """Two parameters x and y of a rig, with all others fixed."""

    @property
    def names(self) -> tuple[str, str]:
        """Names of x and y, with their units."""
        ...

    @property
    def x(self) -> Coordinate:
        """Coordinate of x."""
        ...

    @property
    def y(self) -> Coordinate:
        """Coordinate of y."""
        ...

    def rigs(self, x: Array, y: Array) -> MapRigs | None:
        """Properties of many points, shape (points,) each. Angles are NaN where the balanced state does not exist.

        None if a pendulum is absent, which the computation of many points does not support.
        """
        ...

    def speeds_rad_s(self, x: Array, y: Array) -> Array:
        """Running speeds ω of many points, rad/s, shape (points,)."""
        ...

    def rig_at(self, x: float, y: float) -> tuple[RotorParameters, float]:
        """Rig and speed (rad/s) at one point, independent of whether a balanced state exists."""
        ...

    def one(self, x: float, y: float) -> tuple[RotorParameters, tuple[float, float], float]:
        """Rig, balanced angles (rad) and speed (rad/s) at one point.

        Raises:
            NoBalancedState: the balanced state does not exist.
        """
        ...


@dataclass(frozen=True)
class SpeedStiffnessPlane:
    """x: speed ratio Ω = ω/ω_n1; y: stiffness ratio K = k2/k1. k1 and the damping ratios are constant.

    Attributes:
        parameters: the rig.
        angles: θ3, θ4 of its balanced state, rad.
    """

    parameters: RotorParameters
    angles: tuple[float, float]
    x: Coordinate = INVERSE
    y: Coordinate = ROOT
    names: tuple[str, str] = ("speed_ratio", "stiffness_ratio")

    def rigs(self, x: Array, y: Array) -> MapRigs | None:
        """See Plane."""
        p = self.parameters
        if not (p.a.present and p.b.present):
            return None
        packed, n = p.packed(), len(x)
        k = np.array([np.full(n, p.k1_N_per_m), p.k1_N_per_m * y])
        c = 2 * np.array([[p.zeta1], [p.zeta2]]) * np.sqrt(k * p.total_mass_kg)
        alike = (packed[5:7], packed[8:10], packed[10:12], np.array(self.angles))
        moment, inertia, loss, theta = (np.repeat(pair[:, None], n, 1) for pair in alike)
        return MapRigs(np.full(n, p.total_mass_kg), k, c, moment, inertia, loss, theta, self.speeds_rad_s(x, y))

    def speeds_rad_s(self, x: Array, y: Array) -> Array:
        """See Plane."""
        return x * self.parameters.natural_frequencies_rad_s[0] + 0.0 * y

    def rig_at(self, x: float, y: float) -> tuple[RotorParameters, float]:
        """See Plane."""
        p = self.parameters
        return dataclasses.replace(p, k2_N_per_m=y * p.k1_N_per_m), x * p.natural_frequencies_rad_s[0]

    def one(self, x: float, y: float) -> tuple[RotorParameters, tuple[float, float], float]:
        """See Plane."""
        rig, speed = self.rig_at(x, y)
        return rig, self.angles, speed


@dataclass(frozen=True)
class RigPlane:
    """Plane of any two parameters.

    Attributes:
        at: rig and running speed, rad/s, at a pair of values.
        x, y, names: see Plane.
    """

    at: RigOverPlane
    x: Coordinate = SAME
    y: Coordinate = SAME
    names: tuple[str, str] = ("x", "y")

    def rigs(self, x: Array, y: Array) -> MapRigs | None:
        """See Plane."""
        rigs: list[RotorParameters] = []
        angles: list[tuple[float, float]] = []
        speeds: list[float] = []
        for one_x, one_y in zip(x.tolist(), y.tolist(), strict=True):
            rig, speed = self.at(one_x, one_y)
            if not (rig.a.present and rig.b.present):
                return None
            found = balanced_angles(rig)
            if found and (rig.gravity_m_per_s2 or rig.pivot_shift_m or rig.bow_m):
                type_one(rig, *found[0], speed)  # raises the error with the reason
            rigs.append(rig)
            angles.append(found[0] if found else (np.nan, np.nan))
            speeds.append(speed)
        return MapRigs.of(rigs, angles, speeds)

    def speeds_rad_s(self, x: Array, y: Array) -> Array:
        """See Plane."""
        return np.array([self.at(a, b)[1] for a, b in zip(x.tolist(), y.tolist(), strict=True)])

    def rig_at(self, x: float, y: float) -> tuple[RotorParameters, float]:
        """See Plane."""
        return self.at(x, y)

    def one(self, x: float, y: float) -> tuple[RotorParameters, tuple[float, float], float]:
        """See Plane."""
        rig, speed = self.at(x, y)
        found = balanced_angles(rig)
        if not found:
            raise NoBalancedState(f"no balanced state at x = {x:.6g}, y = {y:.6g}")
        return rig, found[0], speed


def multiplier_at(plane: Plane, x: float, y: float, accuracy: float) -> tuple[float, float]:
    """Largest multiplier at one point by the first successful method, with its bound; NaN without a balanced state.

    Raises:
        NotConverged: no method succeeds, even with a low accuracy.
    """
    try:
        matrix = type_one(*_spread(plane.one(x, y)))
    except NoBalancedState:  # usual: a point outside the balancing region
        return np.nan, np.nan
    last: DynamicsError | None = None
    for looser in (1.0, 1e2, 1e4, 1e6):
        try:
            answer = floquet_multipliers(matrix, min(looser * accuracy, 0.1))
        except NotConverged as refusal:
            last = refusal
        else:
            return answer.largest, answer.error_estimate
    raise NotConverged(f"stability map at {x:.6g}, {y:.6g}: {last}; leave this point out") from last


def _spread(
    point: tuple[RotorParameters, tuple[float, float], float],
) -> tuple[RotorParameters, float, float, float]:
    rig, angles, speed = point
    return rig, *angles, speed
