"""Contact of a ball with its channel: Hertz's ellipse, approach, pressure, and the resulting rolling resistance.

Source: K. L. Johnson, Contact Mechanics (1985), (4.24)–(4.27) for the ellipse, section 9.2 for elastic hysteresis,
section 6.2 for the onset of yielding; docs/theory/start_ups.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import scipy
from scipy.special import ellipe, ellipk

from dynamics.errors import OutsideDomain

YIELDS_AT = 1.6
"""Ratio of peak pressure to yield stress at which the material below the surface yields (circular contact)."""
_NEARLY_CIRCULAR = 1e-3
"""Relative difference of the gaps' curvatures below which the ratio of the half axes is their ratio to the power −2/3.

The error of that power grows with the third power of the difference; it is 3e-12 at this limit.
"""


@dataclass(frozen=True)
class Material:
    """Material properties used by the contact.

    Attributes:
        youngs_Pa: Young's modulus, Pa.
        poisson: Poisson's ratio.
        yield_Pa: yield stress, Pa.
    """

    youngs_Pa: float
    poisson: float
    yield_Pa: float

    @property
    def plane_compliance_per_Pa(self) -> float:
        """(1 − ν²)/E, 1/Pa."""
        return (1 - self.poisson**2) / self.youngs_Pa


@dataclass(frozen=True)
class Contact:
    """An elastic contact.

    Attributes:
        approach_m: approach of ball and wall, the sum of both indentations, m.
        half_axes_m: half axes of the ellipse, the larger first, m.
        peak_pressure_Pa: pressure at the centre, Pa.
    """

    approach_m: float
    half_axes_m: tuple[float, float]
    peak_pressure_Pa: float


def hertz_contact(
    force_N: float,
    ball_radius_m: float,
    ball: Material,
    wall: Material,
    path_radius_m: float = math.inf,
    groove_radius_m: float = math.inf,
) -> Contact:
    """Contact of a ball that is pressed on the inner wall of a channel.

    With the gaps' curvatures A = ½ (1/r − 1/R_1) ≤ B = ½ (1/r − 1/R_2) and 1/E* = (1 − ν_1²)/E_1 + (1 − ν_2²)/E_2 the
    ellipse has half axes a ≥ b with e² = 1 − b²/a² (K, E complete elliptic integrals of e):
        B/A = (E a²/b² − K)/(K − E),   a³ = 3 F (K − E)/(2π e² E* A),   p_0 = 3 F/(2π a b),   δ = p_0 b K/E*.
    For a plane: δ = a²/r, a³ = 3 F r/(4 E*).

    Args:
        force_N: contact force, N.
        ball_radius_m: radius of the ball, m.
        ball, wall: materials.
        path_radius_m: radius of the wall along the ball's path, concave towards the ball, m; inf for a straight path.
        groove_radius_m: radius of the wall across the path, m; inf for a cylindrical wall.
    Raises:
        OutsideDomain: a force or radius is not above 0, or the wall's curvature exceeds the ball's.
    """
    if not (force_N > 0 and math.isfinite(force_N) and ball_radius_m > 0):
        raise OutsideDomain(
            f"a contact needs a force and a ball radius above 0, got {force_N!r} N and {ball_radius_m!r} m"
        )
    if not min(path_radius_m, groove_radius_m) > ball_radius_m:
        raise OutsideDomain(
            f"a ball of {ball_radius_m:g} m touches a wall of {min(path_radius_m, groove_radius_m):g} m along more "
            "than a spot: expected path_radius_m and groove_radius_m above the ball's"
        )
    stiff = 1 / (ball.plane_compliance_per_Pa + wall.plane_compliance_per_Pa)
    gaps = [0.5 * (1 / ball_radius_m - 1 / radius) for radius in (path_radius_m, groove_radius_m)]
    flatter, steeper = min(gaps), max(gaps)
    ratio = _axes_ratio(steeper / flatter)
    e2 = 1 - ratio**2
    k, shape = float(ellipk(e2)), _shape(ratio)
    larger = (1.5 * force_N * shape / (math.pi * stiff * flatter)) ** (1 / 3)
    smaller = ratio * larger
    pressure = 1.5 * force_N / (math.pi * larger * smaller)
    return Contact(pressure * smaller * k / stiff, (larger, smaller), pressure)


def _shape(ratio: float) -> float:
    """(K − E)/e²; π/4 for a circle."""
    e2 = 1 - ratio**2
    return math.pi / 4 * (1 + 3 * e2 / 8) if e2 < 1e-6 else (float(ellipk(e2)) - float(ellipe(e2))) / e2


def _axes_ratio(curvatures: float) -> float:
    """Ratio of the smaller to the larger half axis for a ratio (at least 1) of the gaps' curvatures."""

    def off(log_ratio: float) -> float:
        ratio = math.exp(log_ratio)
        e2 = 1 - ratio**2
        k, e = float(ellipk(e2)), float(ellipe(e2))
        return math.log((e / ratio**2 - k) / (k - e) / curvatures)

    if curvatures - 1 < _NEARLY_CIRCULAR:
        return curvatures ** (-2 / 3)
    return math.exp(float(scipy.optimize.brentq(off, -12.0, -1e-6, xtol=1e-13)))


def plastic_depth(force_N: float, ball_radius_m: float, yield_Pa: float) -> float:
    """Depth of the dent of a ball in fully yielding metal, m. The mean pressure is three yield stresses.

    Args:
        force_N, ball_radius_m: contact force, N, and radius of the ball, m.
        yield_Pa: yield stress of the softer material, Pa.
    """
    return force_N / (6 * math.pi * ball_radius_m * yield_Pa)


def hysteresis_resistance(contact: Contact, loss: float) -> float:
    """Coefficient of rolling resistance as a length, m, from elastic hysteresis.

    Args:
        contact: a circular contact.
        loss: lost fraction of the elastic work; a few per cent in metals below yielding.
    """
    return 3 / 16 * loss * contact.half_axes_m[0]
