"""Singular points in closed form: constant pendulum angles on a rotor with a circular whirl.

In the rotating frame, q = z e^{iψ} on an isotropic suspension gives
    D z = ω² (F + S_A e^{iθ3} + S_B e^{iθ4}),     D = k − M_S ω² + iωc,
    Im(conj(p) e^{iθ_i}) = 0 for each free pendulum, p = z + R_C its pivot,
with F the fixed first moment (S_P, the uncompensated part of a pivot shift, locked pendulums). So either p = 0, the
counterpart of Type I, or every free pendulum lies along p: p = ρ e^{iθ} with ρ real. Then, with the signed sum S_T
of the free moments along e^{iθ} (opposed: S_A − S_B, together: S_A + S_B),
    (D ρ − ω² S_T) e^{iθ} = ω² F + D R_C = G,
and the modulus gives ρ from |D|² ρ² − 2 ω² S_T Re(D) ρ + ω⁴ S_T² = |G|². Its discriminant
|D|²|G|² − (ω² S_T Im D)² vanishes where the pair of singular points is lost; for R_C = 0 that is the condition
|S_T sin φ_H| = S_P.

With k1 ≠ k2 or c1 ≠ c2 the same equations hold for the mean torque of pendulums at rest on the rotor, with
1/D = (1/D1 + 1/D2)/2: only the forward whirl has a mean torque. These points are starts of the search for periodic
orbits. A bow b adds D (k1/D1 + k2/D2) b/(2 ω²) to F, which represents its force on the forward whirl.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.equations.balancing import closing_angles
from dynamics.equations.parameters import RotorParameters


@dataclass(frozen=True)
class SingularPoint:
    """Constant pendulum angles at which the mean torque vanishes.

    Attributes:
        type: "I" (pivot at rest), "II" (pendulums opposed), "III" (together), "one" (a single free pendulum),
            "none" (no free pendulum).
        theta_rad: θ3, θ4, rad.
        z_m: rotating-frame position of the disk centre (its forward whirl if the suspension is anisotropic), m.
    """

    type: str
    theta_rad: tuple[float, float]
    z_m: complex


def bow_moment(parameters: RotorParameters, speed_rad_s: float) -> complex:
    """First moment whose rotating force excites the forward whirl like a bow, kg m."""
    p = parameters
    if p.bow_m == 0:
        return 0j
    mean = 0.5 * (p.k1_N_per_m + p.k2_N_per_m) * p.bow_m
    stiffness, own = dynamic_stiffness(p, speed_rad_s), p.total_mass_kg * speed_rad_s**2
    if p.k1_N_per_m == p.k2_N_per_m or stiffness == 0 or not math.isfinite(abs(stiffness)):
        return mean / speed_rad_s**2
    directions = zip((p.k1_N_per_m, p.k2_N_per_m), p.damping_Ns_per_m, strict=True)
    shares = sum(k / complex(k - own, speed_rad_s * c) for k, c in directions if k != own or c != 0)
    return 0.5 * p.bow_m * stiffness * shares / speed_rad_s**2


def dynamic_stiffness(parameters: RotorParameters, speed_rad_s: float) -> complex:
    """D of the forward whirl, N/m: harmonic mean of k − M_S ω² + iωc over both directions; 0 at undamped resonance."""
    own = parameters.total_mass_kg * speed_rad_s**2
    first, second = (
        complex(k - own, speed_rad_s * c)
        for k, c in zip((parameters.k1_N_per_m, parameters.k2_N_per_m), parameters.damping_Ns_per_m, strict=True)
    )
    if first == second:
        return first
    return 2 * first * second / (first + second) if first + second != 0 else complex(math.inf, 0)


def aligned_points(
    stiffness_N_per_m: complex, speed_rad_s: float, moment_kg_m: float, fixed_kg_m: complex, pivot_shift_m: float = 0.0
) -> list[tuple[float, complex]]:
    """Singular points with every free pendulum along the pivot's whirl.

    Args:
        stiffness_N_per_m: D.
        moment_kg_m: S_T, the signed sum of the free first moments.
        fixed_kg_m: F.
    Returns:
        Pairs of the angle θ in [0, 2π) and z; empty if the singular points do not exist.
    """
    d, square = stiffness_N_per_m, speed_rad_s**2
    drive = square * fixed_kg_m + d * pivot_shift_m
    size = abs(d)
    if size == 0 or not math.isfinite(size) or drive == 0:
        return []
    own = square * moment_kg_m
    left, right = abs(drive), abs(own * (d.imag / size))
    if left < right:
        return []
    root = math.sqrt(left - right) * math.sqrt(left + right)  # their product may exceed the range of a double
    found: list[tuple[float, complex]] = []
    for sign in (1.0, -1.0):
        rho = (own * (d.real / size) + sign * root) / size
        slope = d * rho - own
        if slope == 0 or not 0 < abs(drive / slope) < math.inf:
            continue  # the imbalance is too small to select an angle in double precision
        direction = drive / slope
        direction /= abs(direction)
        angle = math.atan2(direction.imag, direction.real) % (2 * math.pi)
        whirl = rho * direction if pivot_shift_m == 0 else square * (fixed_kg_m + moment_kg_m * direction) / d
        found.append((angle, whirl))
        if root == 0:
            break
    return found


def singular_points(
    parameters: RotorParameters,
    speed_rad_s: float,
    released: tuple[bool, bool] = (True, True),
    locked_at_rad: tuple[float, float] = (0.0, math.pi),
) -> list[SingularPoint]:
    """All singular points at a speed: exact on an isotropic suspension without gravity, otherwise a first guess.

    Args:
        released: which pendulums are free.
        locked_at_rad: angles of the locked pendulums.
    """
    p = parameters
    moments = (p.a.first_moment_kg_m, p.b.first_moment_kg_m)
    free = tuple(r and s > 0 for r, s in zip(released, moments, strict=True))
    stiffness = dynamic_stiffness(p, speed_rad_s)
    fixed = p.forcing_moment_kg_m + bow_moment(p, speed_rad_s)
    for is_free, moment, angle in zip(free, moments, locked_at_rad, strict=True):
        fixed += 0.0 if is_free else moment * complex(math.cos(angle), math.sin(angle))
    if not any(free):
        if stiffness == 0:
            return []  # undamped resonance: the amplitude is unbounded
        return [SingularPoint("none", locked_at_rad, speed_rad_s**2 * fixed / stiffness)]
    if not all(free):
        which = 0 if free[0] else 1
        points = aligned_points(stiffness, speed_rad_s, moments[which], fixed, p.pivot_shift_m)
        held = locked_at_rad[1 - which]
        return [SingularPoint("one", (t, held) if which == 0 else (held, t), z) for t, z in points]
    found = _resting_pivot(p, speed_rad_s, stiffness, fixed)
    for kind, gap, moment in (("II", math.pi, moments[0] - moments[1]), ("III", 0.0, moments[0] + moments[1])):
        for angle, z in aligned_points(stiffness, speed_rad_s, moment, fixed, p.pivot_shift_m):
            found.append(SingularPoint(kind, (angle, (angle + gap) % (2 * math.pi)), z))
    return found


def _resting_pivot(p: RotorParameters, speed: float, stiffness: complex, fixed: complex) -> list[SingularPoint]:
    """Type I and its counterpart p = 0: the pendulums have the moment −D R_C/ω² − F."""
    target = -stiffness * p.pivot_shift_m / speed**2 - fixed
    angles = closing_angles(p.a.first_moment_kg_m, p.b.first_moment_kg_m, target)
    alike = target == 0  # they balance each other at any angle: the mirror image is on the same circle
    alike = alike or (len(angles) == 2 and np.allclose(*np.exp(1j * np.array(angles)), atol=1e-15))
    unique = angles[:1] if alike else angles
    return [SingularPoint("I", pair, complex(-p.pivot_shift_m)) for pair in unique]
