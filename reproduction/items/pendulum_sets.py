"""Pendulum sets of section 3.1: the isotropic rig with other masses, and the start of releases."""

from __future__ import annotations

import math
from dataclasses import replace

from dynamics import Pendulum
from dynamics.equations.parameters import RotorParameters
from reproduction.workspace import ISOTROPIC, Workspace

ZETA = 0.1
FROM_RAD = (math.radians(0.2), math.pi - math.radians(0.1))
"""Start angles near 0° and 180°, within the locks' play."""


def with_moments(p: RotorParameters, a_kg_m: float, b_kg_m: float) -> RotorParameters:
    """Return a rig with other pendulum masses and the same lengths; its stiffness keeps the natural frequency."""
    changed = replace(p, a=_of(p.a, a_kg_m), b=_of(p.b, b_kg_m))
    share = changed.total_mass_kg / p.total_mass_kg
    return replace(changed, k1_N_per_m=share * p.k1_N_per_m, k2_N_per_m=share * p.k2_N_per_m)


def _of(pendulum: Pendulum, moment_kg_m: float) -> Pendulum:
    mass = moment_kg_m / pendulum.length_m
    damping = pendulum.damping_Nms_per_rad * mass / pendulum.mass_kg  # keeps the decay rate of its rotation
    return replace(pendulum, mass_kg=mass, damping_Nms_per_rad=damping)


def without_pendulums(p: RotorParameters) -> RotorParameters:
    """Return a rig without pendulums, with the same total mass, springs and dampers."""
    gone = p.a.mass_kg + p.b.mass_kg
    return replace(p, rotor_mass_kg=p.rotor_mass_kg + gone, a=Pendulum.absent(), b=Pendulum.absent())


def isotropic_rig(work: Workspace, zeta: float = ZETA) -> RotorParameters:
    """Return the isotropic rig with a damping ratio."""
    return work.physics(ISOTROPIC, [f"suspension.zeta1={zeta}", f"suspension.zeta2={zeta}"])
