"""Physical parameters of rotor, pendulums and suspension, and the quantities that follow from them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from dynamics.errors import OutsideDomain


@dataclass(frozen=True)
class Pendulum:
    """A point mass on a massless arm about the rotor axis.

    Attributes:
        mass_kg: mass, kg.
        length_m: distance of the mass from its pivot, m.
        damping_Nms_per_rad: viscous torque per speed relative to the rotor (c3 or c4), N m s/rad.
    """

    mass_kg: float
    length_m: float
    damping_Nms_per_rad: float

    @property
    def first_moment_kg_m(self) -> float:
        """S = M R, kg m."""
        return self.mass_kg * self.length_m

    @property
    def inertia_kg_m2(self) -> float:
        """J = M R², kg m²."""
        return self.mass_kg * self.length_m**2


@dataclass(frozen=True)
class RotorParameters:
    """All numbers the equations of motion need (SI).

    Attributes:
        rotor_mass_kg: disk with column, kg.
        imbalance_mass_kg, imbalance_radius_m: brass weight and its distance from the axis.
        a, b: the two pendulums.
        k1_N_per_m, k2_N_per_m: stiffness along x and y.
        zeta1, zeta2: damping ratios along x and y, c / (2 sqrt(k M_S)).
        pivot_shift_m: shift R_C of the pendulums' pivot along the imbalance direction, its static part balanced.
    Raises:
        OutsideDomain: a value that is not finite, or a mass, length or stiffness that is not positive.
    """

    rotor_mass_kg: float
    imbalance_mass_kg: float
    imbalance_radius_m: float
    a: Pendulum
    b: Pendulum
    k1_N_per_m: float
    k2_N_per_m: float
    zeta1: float
    zeta2: float
    pivot_shift_m: float = 0.0

    def __post_init__(self) -> None:
        positive = {
            "rotor_mass_kg": self.rotor_mass_kg,
            "k1_N_per_m": self.k1_N_per_m,
            "k2_N_per_m": self.k2_N_per_m,
            "a.mass_kg": self.a.mass_kg,
            "b.mass_kg": self.b.mass_kg,
            "a.length_m": self.a.length_m,
            "b.length_m": self.b.length_m,
        }
        not_negative = {
            "imbalance_mass_kg": self.imbalance_mass_kg,
            "imbalance_radius_m": self.imbalance_radius_m,
            "zeta1": self.zeta1,
            "zeta2": self.zeta2,
            "a.damping_Nms_per_rad": self.a.damping_Nms_per_rad,
            "b.damping_Nms_per_rad": self.b.damping_Nms_per_rad,
            "pivot_shift_m": self.pivot_shift_m,
        }
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0):
                raise OutsideDomain(f"{name} must be finite and above 0, got {value!r}")
        for name, value in not_negative.items():
            if not (math.isfinite(value) and value >= 0):
                raise OutsideDomain(f"{name} must be finite and not negative, got {value!r}")

    @property
    def total_mass_kg(self) -> float:
        """M_S: everything that moves with the disk centre, kg."""
        return self.rotor_mass_kg + self.imbalance_mass_kg + self.a.mass_kg + self.b.mass_kg

    @property
    def imbalance_moment_kg_m(self) -> float:
        """S_P, kg m."""
        return self.imbalance_mass_kg * self.imbalance_radius_m

    @property
    def natural_frequencies_rad_s(self) -> tuple[float, float]:
        """Undamped ω_n1, ω_n2, rad/s."""
        mass = self.total_mass_kg
        return math.sqrt(self.k1_N_per_m / mass), math.sqrt(self.k2_N_per_m / mass)

    @property
    def damping_Ns_per_m(self) -> tuple[float, float]:
        """c1, c2 = 2 ζ sqrt(k M_S), N s/m."""
        mass = self.total_mass_kg
        return (
            2 * self.zeta1 * math.sqrt(self.k1_N_per_m * mass),
            2 * self.zeta2 * math.sqrt(self.k2_N_per_m * mass),
        )

    @property
    def is_isotropic(self) -> bool:
        """Whether both directions have the same stiffness and damping."""
        return self.k1_N_per_m == self.k2_N_per_m and self.zeta1 == self.zeta2

    def speed_rad_s(self, speed_ratio: float) -> float:
        """Running speed at a speed ratio Ω = ω/ω_n1, rad/s."""
        return speed_ratio * self.natural_frequencies_rad_s[0]

    def with_values(self, **values: float) -> RotorParameters:
        """A copy with some identified parameters replaced.

        Args:
            values: any of k1_N_per_m, k2_N_per_m, zeta1, zeta2, c3_Nms_per_rad, c4_Nms_per_rad, SP_kg_m.
                SP_kg_m moves the imbalance radius and leaves its mass, so M_S stays.
        """
        own = {k: values.pop(k) for k in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2") if k in values}
        result = dataclasses.replace(self, **own)
        if "SP_kg_m" in values:
            radius = values.pop("SP_kg_m") / self.imbalance_mass_kg
            result = dataclasses.replace(result, imbalance_radius_m=radius)
        if "c3_Nms_per_rad" in values:
            a = dataclasses.replace(result.a, damping_Nms_per_rad=values.pop("c3_Nms_per_rad"))
            result = dataclasses.replace(result, a=a)
        if "c4_Nms_per_rad" in values:
            b = dataclasses.replace(result.b, damping_Nms_per_rad=values.pop("c4_Nms_per_rad"))
            result = dataclasses.replace(result, b=b)
        if values:
            raise TypeError(f"unknown parameter names: {sorted(values)}")
        return result

    def identified(self) -> dict[str, float]:
        """The seven numbers an identification finds, under their file names."""
        return {
            "k1_N_per_m": self.k1_N_per_m,
            "k2_N_per_m": self.k2_N_per_m,
            "zeta1": self.zeta1,
            "zeta2": self.zeta2,
            "c3_Nms_per_rad": self.a.damping_Nms_per_rad,
            "c4_Nms_per_rad": self.b.damping_Nms_per_rad,
            "SP_kg_m": self.imbalance_moment_kg_m,
        }

    def packed(self) -> np.ndarray:
        """The numbers in the order of the compiled kernels (see dynamics.kernels)."""
        c1, c2 = self.damping_Ns_per_m
        return np.array(
            [
                self.total_mass_kg,
                self.k1_N_per_m,
                self.k2_N_per_m,
                c1,
                c2,
                self.a.first_moment_kg_m,
                self.b.first_moment_kg_m,
                self.imbalance_moment_kg_m,
                self.a.inertia_kg_m2,
                self.b.inertia_kg_m2,
                self.a.damping_Nms_per_rad,
                self.b.damping_Nms_per_rad,
                self.pivot_shift_m,
            ]
        )
