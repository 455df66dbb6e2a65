"""Physical parameters of rotor, pendulums and suspension, and derived quantities."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from dynamics.arrays import Array
from dynamics.errors import OutsideDomain

_MIN_VALUE, _MAX_VALUE = 1e-15, 1e15  # SI; bounds of all parameters, far outside any rig
_MIN_ROTOR_MASS_RATIO = 1e-3  # rotor mass over the pendulums' mass


@dataclass(frozen=True)
class Pendulum:
    """A point mass on a massless arm about the rotor axis, or a ball that rolls in a channel of the rotor.

    A ball of radius r whose centre runs on a circle of radius R rolls on the channel's outer wall without slipping. It
    rotates at ω − θ̇ R/r, so its own inertia κ m r² adds κ m R² to the inertia against θ̈ and subtracts κ m r R from
    the inertia against ω̇ (dynamics.derivation).

    Attributes:
        mass_kg: mass, kg; 0 for an absent pendulum.
        length_m: distance of the mass from its pivot, or of a ball's centre from the channel's centre, m.
        damping_Nms_per_rad: viscous torque per speed relative to the rotor (c3 or c4), N m s/rad.
        drag_Nms2_per_rad2: air torque divided by the square of the speed relative to the rotor; the air rotates with
            the rotor. N m s²/rad².
        friction_arm_m: dry friction torque per contact force M R φ̇², m: μ times the radius of the pivot pin, or a
            ball's coefficient of rolling resistance (a length) times R/r.
        ball_radius_m: radius r of a rolling ball, m; 0 for a pendulum.
        ball_inertia_ratio: κ = I/(m r²): 0.4 for a sphere, 0.5 for a cylinder.
    """

    mass_kg: float
    length_m: float
    damping_Nms_per_rad: float
    friction_arm_m: float = 0.0
    ball_radius_m: float = 0.0
    ball_inertia_ratio: float = 0.4
    drag_Nms2_per_rad2: float = 0.0

    @classmethod
    def absent(cls) -> Pendulum:
        """Pendulum with mass 0."""
        return cls(0.0, 1.0, 0.0)

    @property
    def present(self) -> bool:
        """Whether the mass is above 0."""
        return self.mass_kg > 0

    @property
    def first_moment_kg_m(self) -> float:
        """S = M R, kg m."""
        return self.mass_kg * self.length_m

    @property
    def inertia_kg_m2(self) -> float:
        """Inertia J against θ̈: M R², for a ball M R² (1 + κ), kg m²."""
        rolling = self.ball_inertia_ratio if self.ball_radius_m > 0 else 0.0
        return self.mass_kg * self.length_m**2 * (1.0 + rolling)

    @property
    def drive_inertia_kg_m2(self) -> float:
        """Inertia against ω̇: M R², for a ball M R² (1 − κ r/R), kg m²."""
        return self.mass_kg * self.length_m * (self.length_m - self.ball_inertia_ratio * self.ball_radius_m)


def rolling_arm(resistance_m: float, circle_m: float, ball_radius_m: float) -> float:
    """Friction arm of a ball that rolls in a channel, m: torque about the rotor axis per contact force.

    The rolling moment b N acts on the ball, which rotates R/r times as fast as it orbits: b R/r by virtual work.

    Args:
        resistance_m: coefficient of rolling resistance b, m.
        circle_m: radius R of the circle of the ball's centre, m.
        ball_radius_m: r, m.
    Source: docs/theory/start_ups.md.
    """
    return resistance_m * circle_m / ball_radius_m


@dataclass(frozen=True)
class RotorParameters:
    """All parameters of the equations of motion (SI).

    Attributes:
        rotor_mass_kg: disk with column, kg.
        imbalance_mass_kg, imbalance_radius_m: brass weight and its distance from the axis, kg, m.
        a, b: the two pendulums.
        k1_N_per_m, k2_N_per_m: stiffness along x and y, N/m.
        zeta1, zeta2: damping ratios along x and y, c / (2 sqrt(k M_S)).
        pivot_shift_m: shift R_C of the pendulums' pivot along the imbalance direction, m.
        pivot_shift_compensated: whether brass weights balance the imbalance (M_A + M_B) R_C caused by the shift, as in
            the rig's procedure.
        gravity_m_per_s2: gravity within the disk plane, along −y (a horizontal shaft), m/s²; 0 for a vertical shaft.
        bow_x_m, bow_y_m: bow of a bent shaft: rest position of the springs in the rotor's frame, x along the
            imbalance, m; 0 for a straight shaft.
        hardening_per_m2: H along x and y, 1/m²: a spring stretched by u pulls with k u (1 + H u²). It softens if H is
            negative.
        damping_growth_s_per_m: Q along x and y, s/m: the damping force at speed v is c v (1 + Q |v|).
    Raises:
        OutsideDomain: a value is not finite; a length, a stiffness or the rotor's mass is not positive; a mass, damping
            or friction is negative.

    Example:
        >>> from dynamics import Pendulum, RotorParameters
        >>> ball = Pendulum(mass_kg=0.075, length_m=0.054, damping_Nms_per_rad=1e-3)
        >>> rig = RotorParameters(7.0, 0.12, 0.02, ball, ball, 2600.0, 38e3, zeta1=0.02, zeta2=0.02)
        >>> [round(speed, 2) for speed in rig.natural_frequencies_rad_s]
        [18.91, 72.3]
        >>> rig.with_values(k1_N_per_m=2700.0).k1_N_per_m
        2700.0
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
    pivot_shift_compensated: bool = True
    gravity_m_per_s2: float = 0.0
    bow_x_m: float = 0.0
    bow_y_m: float = 0.0
    hardening_per_m2: tuple[float, float] = (0.0, 0.0)
    damping_growth_s_per_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        positive = {
            "rotor_mass_kg": self.rotor_mass_kg,
            "k1_N_per_m": self.k1_N_per_m,
            "k2_N_per_m": self.k2_N_per_m,
            "a.length_m": self.a.length_m,
            "b.length_m": self.b.length_m,
        }
        not_negative = {
            "a.mass_kg": self.a.mass_kg,
            "b.mass_kg": self.b.mass_kg,
            "a.friction_arm_m": self.a.friction_arm_m,
            "b.friction_arm_m": self.b.friction_arm_m,
            "a.ball_radius_m": self.a.ball_radius_m,
            "b.ball_radius_m": self.b.ball_radius_m,
            "a.ball_inertia_ratio": self.a.ball_inertia_ratio,
            "b.ball_inertia_ratio": self.b.ball_inertia_ratio,
            "gravity_m_per_s2": self.gravity_m_per_s2,
            "imbalance_mass_kg": self.imbalance_mass_kg,
            "imbalance_radius_m": self.imbalance_radius_m,
            "zeta1": self.zeta1,
            "zeta2": self.zeta2,
            "a.damping_Nms_per_rad": self.a.damping_Nms_per_rad,
            "b.damping_Nms_per_rad": self.b.damping_Nms_per_rad,
            "pivot_shift_m": self.pivot_shift_m,
            "a.drag_Nms2_per_rad2": self.a.drag_Nms2_per_rad2,
            "b.drag_Nms2_per_rad2": self.b.drag_Nms2_per_rad2,
        }
        masses = {"a.mass_kg": self.a.mass_kg, "b.mass_kg": self.b.mass_kg}
        given: dict[str, object] = {**positive, **not_negative}
        for name, value in given.items():
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
                raise OutsideDomain(f"{name} must be a number, got {value!r}")
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0):
                raise OutsideDomain(f"{name} must be finite and above 0, got {value!r}")
            if not _MIN_VALUE <= value <= _MAX_VALUE:  # outside, squares and quotients exceed the range of a double
                raise OutsideDomain(f"{name} must lie in {_MIN_VALUE:g} … {_MAX_VALUE:g}, got {value!r}")
        self._check_rotor_mass()
        self._check_bow_and_terms()
        for name, value in masses.items():
            if 0 < value < _MIN_VALUE:
                raise OutsideDomain(f"{name} must be 0 (no pendulum) or at least {_MIN_VALUE:g}, got {value!r}")
        for name, p in (("a", self.a), ("b", self.b)):
            if p.ball_radius_m >= p.length_m:
                raise OutsideDomain(
                    f"{name}.ball_radius_m must be below the circle of the ball's centre, {name}.length_m = "
                    f"{p.length_m:g}, got {p.ball_radius_m!r}"
                )
        for name, value in not_negative.items():
            if not (math.isfinite(value) and value >= 0):
                raise OutsideDomain(f"{name} must be finite and not negative, got {value!r}")
            if value > _MAX_VALUE:
                raise OutsideDomain(f"{name} must be at most {_MAX_VALUE:g}, got {value!r}")

    def _check_bow_and_terms(self) -> None:
        terms = {"hardening_per_m2": self.hardening_per_m2, "damping_growth_s_per_m": self.damping_growth_s_per_m}
        named = [("bow_x_m", self.bow_x_m), ("bow_y_m", self.bow_y_m)]
        for name, value in named + [(name, value) for name, pair in terms.items() for value in pair]:
            if not (math.isfinite(value) and abs(value) <= _MAX_VALUE):
                raise OutsideDomain(f"{name} must be finite and at most {_MAX_VALUE:g}, got {value!r}")

    def _check_rotor_mass(self) -> None:
        if self.rotor_mass_kg < _MIN_ROTOR_MASS_RATIO * (self.a.mass_kg + self.b.mass_kg):
            total = self.a.mass_kg + self.b.mass_kg
            raise OutsideDomain(
                f"rotor_mass_kg must be at least {_MIN_ROTOR_MASS_RATIO:g} of the pendulums' {total:.6g} "
                f"kg, got {self.rotor_mass_kg!r}: without a rotor the equations of motion are singular"
            )

    @property
    def total_mass_kg(self) -> float:
        """M_S: mass of all parts that move with the disk centre, kg."""
        return self.rotor_mass_kg + self.imbalance_mass_kg + self.a.mass_kg + self.b.mass_kg

    @property
    def imbalance_moment_kg_m(self) -> float:
        """First mass moment S_P of the imbalance, kg m."""
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
    def has_friction(self) -> bool:
        """Whether a pendulum with mass has dry friction."""
        return any(q.present and q.friction_arm_m > 0 for q in (self.a, self.b))

    @property
    def bow_m(self) -> complex:
        """Bow b: the rest position of the springs is b e^{iψ}, m."""
        return complex(self.bow_x_m, self.bow_y_m)

    @property
    def is_isotropic(self) -> bool:
        """Whether stiffness and damping are equal in all directions, at any amplitude."""
        return self.k1_N_per_m == self.k2_N_per_m and self.zeta1 == self.zeta2 and self.suspension_is_linear

    @property
    def suspension_is_linear(self) -> bool:
        """Whether stiffness and damping of the suspension are independent of the amplitude."""
        return not any((*self.hardening_per_m2, *self.damping_growth_s_per_m))

    def speed_rad_s(self, speed_ratio: float) -> float:
        """Running speed at a speed ratio Ω = ω/ω_n1, rad/s."""
        return speed_ratio * self.natural_frequencies_rad_s[0]

    def with_values(self, **values: float) -> RotorParameters:
        """Copy with some identified parameters replaced.

        Args:
            values: any of k1_N_per_m, k2_N_per_m, zeta1, zeta2, c3_Nms_per_rad, c4_Nms_per_rad, SP_kg_m.
                SP_kg_m changes the imbalance radius and keeps the imbalance mass, so M_S does not change.
        """
        own = {k: values.pop(k) for k in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2") if k in values}
        result = dataclasses.replace(self, **own)
        if "SP_kg_m" in values:
            radius = imbalance_radius(values.pop("SP_kg_m"), self.imbalance_mass_kg)
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
        """The seven parameters estimated by an identification, under their names in the file."""
        return {
            "k1_N_per_m": self.k1_N_per_m,
            "k2_N_per_m": self.k2_N_per_m,
            "zeta1": self.zeta1,
            "zeta2": self.zeta2,
            "c3_Nms_per_rad": self.a.damping_Nms_per_rad,
            "c4_Nms_per_rad": self.b.damping_Nms_per_rad,
            "SP_kg_m": self.imbalance_moment_kg_m,
        }

    @property
    def forcing_moment_kg_m(self) -> float:
        """S_P plus the moment of an uncompensated pivot shift, kg m."""
        shift = 0.0 if self.pivot_shift_compensated else (self.a.mass_kg + self.b.mass_kg) * self.pivot_shift_m
        return self.imbalance_moment_kg_m + shift

    def packed(self) -> Array:
        """Parameters in the order of the compiled kernels (dynamics.equations.kernels), shape (26,)."""
        a, b = self.a, self.b
        return np.array(
            [
                self.total_mass_kg,
                self.k1_N_per_m,
                self.k2_N_per_m,
                *self.damping_Ns_per_m,
                a.first_moment_kg_m,
                b.first_moment_kg_m,
                self.forcing_moment_kg_m,
                a.inertia_kg_m2 if a.present else 1.0,
                b.inertia_kg_m2 if b.present else 1.0,
                a.damping_Nms_per_rad,
                b.damping_Nms_per_rad,
                self.pivot_shift_m,
                a.drive_inertia_kg_m2,
                b.drive_inertia_kg_m2,
                a.friction_arm_m * a.first_moment_kg_m,
                b.friction_arm_m * b.first_moment_kg_m,
                self.gravity_m_per_s2,
                self.bow_x_m,
                self.bow_y_m,
                *self.hardening_per_m2,
                *self.damping_growth_s_per_m,
                a.drag_Nms2_per_rad2,
                b.drag_Nms2_per_rad2,
            ]
        )


def imbalance_radius(moment_kg_m: float, mass_kg: float) -> float:
    """P_3 = S_P/M_P, m. A given moment is set through the radius of the imbalance mass, so M_S does not change.

    Raises:
        OutsideDomain: a moment is given, but the mass is 0.
    """
    if mass_kg > 0:
        return moment_kg_m / mass_kg
    if moment_kg_m == 0:
        return 0.0
    raise OutsideDomain(
        f"S_P = {moment_kg_m:.6g} kg m can't be made by an imbalance mass of {mass_kg:g} kg: expected "
        "imbalance.mass_kg above 0, the mass on the rotor that produces it"
    )


class HasPhysics(Protocol):
    """A rig with the parameters of its rotor, as `rig_configs.Rig`."""

    @property
    def physics(self) -> RotorParameters:
        """Parameters of the rotor."""
        ...


RigOrParameters: TypeAlias = RotorParameters | HasPhysics
"""Argument of functions that accept a rig or its rotor's parameters (`physics_of`)."""


def physics_of(rig: RigOrParameters) -> RotorParameters:
    """Rotor parameters of a rig, or the argument itself if it is RotorParameters.

    Raises:
        OutsideDomain: the argument is not RotorParameters and has no such `.physics`.
    """
    found: object = getattr(rig, "physics", rig)
    if not isinstance(found, RotorParameters):
        raise OutsideDomain(f"expected RotorParameters or a rig with .physics, got {type(rig).__name__}")
    return found
