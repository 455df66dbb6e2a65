"""Both balanced positions of a pair of pendulums with individual pivots and torques.

In the rotating frame, with D = k − M_S ω² + iωc, the fixed first moment F and the pivots R_i e^{iψ} from the axis,
    D z = ω² (F + S_A e^{iθ3} + S_B e^{iθ4}),     S_i ω² Im(conj(z + R_i) e^{iθ_i}) = τ_i.
z is eliminated. Newton's method finds θ3 and θ4 from the two positions without imperfections, which are increased in
steps. With τ = 0 and R_A = R_B the pivot is at rest in both positions, so that |z| = |R| in both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import NoBalancedState, NotConverged, OutsideDomain
from dynamics.steady.singular_points import dynamic_stiffness
from dynamics.steady.steady_motions import check_request

_STEPS = 16
_ROUNDS = 30
_ARRIVED = 1e-13
_MAX_STEP_RAD = 0.5  # largest Newton step on the branch


@dataclass(frozen=True)
class Imperfections:
    """Imperfections of a rig.

    Attributes:
        pivot_a_m, pivot_b_m: position of each pendulum's pivot in the rotor's frame, x along the imbalance, m. The
            imbalance caused by it is assumed to be compensated.
        torque_a_Nm, torque_b_Nm: constant torque on each pendulum in the direction of rotation, N m: dry friction at
            rest, or drag of air that does not rotate with the rotor.
    """

    pivot_a_m: complex = 0j
    pivot_b_m: complex = 0j
    torque_a_Nm: float = 0.0
    torque_b_Nm: float = 0.0


@dataclass(frozen=True)
class BalancedPosition:
    """One of the two balanced positions.

    Attributes:
        theta_rad: θ3, θ4, in [0, 2π).
        z_m: disk centre in the rotor's frame, m. Its modulus is the radius of the residual whirl.
    """

    theta_rad: tuple[float, float]
    z_m: complex


def mirrored_positions(
    rig: RigOrParameters, speed_rad_s: float, imperfections: Imperfections
) -> tuple[BalancedPosition, BalancedPosition]:
    """Compute both balanced positions and the residual whirl.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one; isotropic, without gravity, bow and pivot shift.
        speed_rad_s: speed of the rotor, rad/s.
    Returns:
        The position with θ3 ≤ π without imperfections, and its mirror image.
    Raises:
        OutsideDomain: another rig or speed, or numbers that are not finite.
        NoBalancedState: the pendulums cannot balance the rig, or there is a single position.
        NotConverged: the imperfections are so large that a position is lost while they are increased.
    Source: docs/theory/steady_states.md.
    """
    p = physics_of(rig)
    check_request(p, speed_rad_s, 1e-8)
    if not p.is_isotropic or p.gravity_m_per_s2 or p.bow_m or p.pivot_shift_m:
        raise OutsideDomain(
            "mirrored positions: expected an isotropic rig without gravity, bow and pivot shift (give pivots as "
            "imperfections)"
        )
    numbers = (imperfections.pivot_a_m, imperfections.pivot_b_m, imperfections.torque_a_Nm, imperfections.torque_b_Nm)
    if not all(math.isfinite(abs(number)) for number in numbers):
        raise OutsideDomain(f"imperfections: expected finite numbers, got {imperfections}")
    angles = balanced_angles(p)
    if len(angles) < 2 or p.forcing_moment_kg_m == 0:
        raise NoBalancedState("mirrored positions: expected properly oversized pendulums and an imbalance")
    first, second = (_followed(p, speed_rad_s, np.array(pair), imperfections) for pair in angles)
    return first, second


def _followed(p: RotorParameters, speed: float, theta: Array, whole: Imperfections) -> BalancedPosition:
    """Continue from the balanced angles to the whole imperfection."""
    z = 0j
    for share in np.linspace(0, 1, _STEPS + 1)[1:].tolist():
        part = replace(
            whole,
            pivot_a_m=share * whole.pivot_a_m,
            pivot_b_m=share * whole.pivot_b_m,
            torque_a_Nm=share * whole.torque_a_Nm,
            torque_b_Nm=share * whole.torque_b_Nm,
        )
        theta, z = _newton(p, speed, theta, part)
    a, b = (float(angle) % (2 * math.pi) for angle in theta)
    return BalancedPosition((a, b), z)


def _newton(p: RotorParameters, speed: float, theta: Array, part: Imperfections) -> tuple[Array, complex]:
    stiffness, square = dynamic_stiffness(p, speed), speed**2
    moments = np.array([p.a.first_moment_kg_m, p.b.first_moment_kg_m])
    pivots = np.array([part.pivot_a_m, part.pivot_b_m])
    wanted = np.array([part.torque_a_Nm, part.torque_b_Nm]) / (moments * square)
    z, step = 0j, np.zeros(2)
    for _ in range(_ROUNDS):
        arms = np.exp(1j * theta)
        z = complex(square * (p.forcing_moment_kg_m + moments @ arms) / stiffness)
        off = np.imag(np.conj(z + pivots) * arms) - wanted
        moved = square * 1j * moments * arms / stiffness  # dz by θ_j
        slope = np.imag(np.conj(moved)[None, :] * arms[:, None]) + np.diag(np.real(np.conj(z + pivots) * arms))
        try:
            step = np.linalg.solve(slope, off)
        except np.linalg.LinAlgError:  # usual: at the border of the region
            break
        if not np.all(np.abs(step) < _MAX_STEP_RAD):
            break
        theta = theta - step
        if float(np.max(np.abs(step))) < _ARRIVED:
            return theta, complex(square * (p.forcing_moment_kg_m + moments @ np.exp(1j * theta)) / stiffness)
    if float(np.max(np.abs(step))) < 1e2 * _ARRIVED:
        return theta, z
    raise NotConverged(f"the balanced position is lost while the imperfections are increased to {part}")
