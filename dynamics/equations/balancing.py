"""Balancing capability: regions in the plane of first mass moments, balanced angles, centre-of-gravity disk.

Notation: S_A, S_B, S_P are the first mass moments of pendulum A, pendulum B and the imbalance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from dynamics.equations.parameters import RigOrParameters, physics_of

PROPERLY_OVERSIZED = "properly oversized"
UNDERSIZED = "undersized"
IMPROPERLY_OVERSIZED = "improperly oversized"


@dataclass(frozen=True)
class _Slacks:
    """Slack of each side of the triangle S_A, S_B, S_P: sum of the other two minus the side, rounded once, kg m."""

    a: float  # S_B + S_P − S_A
    b: float  # S_A + S_P − S_B
    p: float  # S_A + S_B − S_P


def _slacks(a: float, b: float, s: float) -> _Slacks:
    """Slacks of the stored moments. A negative slack within one rounding of the sides is replaced by zero."""
    rounding = math.ulp(max(a, b, s))

    def slack(*sides: float) -> float:
        value = math.fsum(sides)  # rounded once, so it has the sign of the exact sum
        return 0.0 if -rounding <= value < 0 else value

    return _Slacks(slack(b, s, -a), slack(a, s, -b), slack(a, b, -s))


def balancing_region(a_kg_m: float, b_kg_m: float, imbalance_kg_m: float) -> str:
    """Region of a pendulum set for an imbalance.

    Args:
        a_kg_m, b_kg_m, imbalance_kg_m: first mass moments S_A, S_B, S_P, kg m, not negative.
    Returns:
        "properly oversized" (|S_A − S_B| ≤ S_P ≤ S_A + S_B: full balance exists, borders included),
        "undersized" (S_A + S_B < S_P) or "improperly oversized" (|S_A − S_B| > S_P).
    """
    slack = _slacks(a_kg_m, b_kg_m, imbalance_kg_m)
    if slack.p < 0:
        return UNDERSIZED
    return IMPROPERLY_OVERSIZED if min(slack.a, slack.b) < 0 else PROPERLY_OVERSIZED


@dataclass(frozen=True)
class BalancingMargins:
    """Distance of an imbalance from the borders of a pendulum set's region.

    Attributes:
        region: result of balancing_region.
        least_kg_m, most_kg_m: |S_A − S_B| and S_A + S_B. Imbalances between them can be balanced, borders included.
        may_grow_kg_m, may_shrink_kg_m: largest increase and decrease of S_P within the region. None if no change in
            this direction leaves the region.
    """

    region: str
    least_kg_m: float
    most_kg_m: float
    may_grow_kg_m: float | None
    may_shrink_kg_m: float | None


def balancing_margins(a_kg_m: float, b_kg_m: float, imbalance_kg_m: float) -> BalancingMargins:
    """Region of a pendulum set, and how much the imbalance may increase or decrease within it.

    Args:
        a_kg_m, b_kg_m, imbalance_kg_m: as for balancing_region.
    """
    region, slack = balancing_region(a_kg_m, b_kg_m, imbalance_kg_m), _slacks(a_kg_m, b_kg_m, imbalance_kg_m)
    least, grow, shrink = abs(a_kg_m - b_kg_m), None, None
    if region == UNDERSIZED:
        shrink = -slack.p
    elif region == IMPROPERLY_OVERSIZED:
        grow = -min(slack.a, slack.b)
    else:
        grow = slack.p
        shrink = min(slack.a, slack.b) if least > 0 else None
    return BalancingMargins(region, least, a_kg_m + b_kg_m, grow, shrink)


def _half_angle(numerator: tuple[float, float], denominator: tuple[float, float]) -> float:
    """2 atan sqrt(numerator/denominator) of two products. Separate roots avoid underflow and overflow."""
    root = [math.sqrt(first) * math.sqrt(second) for first, second in (numerator, denominator)]
    return 2 * math.atan2(*root)


def _triangle_angles(a: float, b: float, s: float) -> tuple[float, float] | None:
    """Angles of the triangle with sides S_A, S_B, S_P between S_P and S_A and between S_P and S_B, rad.

    tan²(α/2) = (S_B + S_P − S_A)(S_A + S_B − S_P) / ((S_A + S_P − S_B)(S_A + S_B + S_P)), from slacks of the stored
    moments that are rounded once. On the borders the cosine formula would lose half the digits.

    Returns:
        None if the sides form no triangle. For S_P = 0 and S_A = S_B the limit S_P → 0: (π/2, π/2).
    """
    slack = _slacks(a, b, s)
    if min(slack.a, slack.b, slack.p) < 0:
        return None
    if s == 0:
        return math.pi / 2, math.pi / 2
    whole = a + b + s
    return _half_angle((slack.a, slack.p), (slack.b, whole)), _half_angle((slack.b, slack.p), (slack.a, whole))


def closing_angles(a_kg_m: float, b_kg_m: float, target_kg_m: complex) -> list[tuple[float, float]]:
    """Angles (θ3, θ4) in [0, 2π) with S_A e^{iθ3} + S_B e^{iθ4} = target: two mirror images, or an empty list.

    Args:
        target_kg_m: first moment that the pendulums must produce, kg m; −S_P for a plain imbalance.
    """
    triangle = _triangle_angles(a_kg_m, b_kg_m, abs(target_kg_m))
    if triangle is None or (a_kg_m == 0 and b_kg_m == 0):
        return []
    alpha, beta = triangle
    direction = math.atan2(target_kg_m.imag, target_kg_m.real)
    turn = 2 * math.pi
    return [
        ((direction - alpha) % turn, (direction + beta) % turn),
        ((direction + alpha) % turn, (direction - beta) % turn),
    ]


def balanced_angles(rig: RigOrParameters) -> list[tuple[float, float]]:
    """Type I without pivot shift: the angles (θ3, θ4) with S_A e^{iθ3} + S_B e^{iθ4} = −S_P.

    Returns:
        Two mirror images in [0, 2π), the one with θ3 ≤ π first. Empty if the set is not properly oversized.

    Example:
        >>> import numpy as np
        >>> from dynamics import balanced_angles
        >>> from rig_configs import load_rig
        >>> np.degrees(balanced_angles(load_rig("virtual").physics)).round(2)
        array([[108.28, 251.72],
               [251.72, 108.28]])
    """
    parameters = physics_of(rig)
    a, b = parameters.a.first_moment_kg_m, parameters.b.first_moment_kg_m
    return closing_angles(a, b, complex(-parameters.imbalance_moment_kg_m, 0.0))


@dataclass(frozen=True)
class GravityDisk:
    """Positions of the rotor's centre of gravity reachable by the pendulums ("CG circle"), in rotor-fixed coordinates.

    Attributes:
        centre_m: distance of the ring's centre from the rotor axis, along the imbalance: S_P/M_S, m.
        outer_m, inner_m: radii (S_A + S_B)/M_S and |S_A − S_B|/M_S, m. Positions inside the inner radius cannot be
            reached.
    """

    centre_m: float
    outer_m: float
    inner_m: float

    @property
    def holds_axis(self) -> bool:
        """Whether the rotor axis lies in the ring. This is the condition of full balance."""
        return self.inner_m <= self.centre_m <= self.outer_m


def gravity_disk(rig: RigOrParameters) -> GravityDisk:
    """Ring of reachable positions of the centre of gravity of rotor, imbalance and pendulums."""
    parameters = physics_of(rig)
    a, b = parameters.a.first_moment_kg_m, parameters.b.first_moment_kg_m
    mass = parameters.total_mass_kg
    return GravityDisk(parameters.imbalance_moment_kg_m / mass, (a + b) / mass, abs(a - b) / mass)
