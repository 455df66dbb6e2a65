# pyright: strict
"""Contact of a ball with its channel: Hertz's ellipse, approach and pressure, and the rolling resistance it leaves.

Source: K. L. Johnson, Contact Mechanics (1985), (4.24)–(4.27) for the ellipse, section 9.2 for elastic hysteresis,
section 6.2 for where yielding begins; docs/theory/start_ups.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import brentq  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
from scipy.special import ellipe, ellipk  # pyright: ignore[reportMissingTypeStubs]

from dynamics.errors import OutsideDomain

YIELDS_AT = 1.6
"""Peak pressure over the yield stress from which material below the surface yields (circular contact)."""
_ROUND = 1e-9  # of the axes' ratio, below which the contact is a circle


@dataclass(frozen=True)
class Material:
    """What a contact needs of a material.

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
        approach_m: how far ball and wall come together: the indentation of both.
        half_axes_m: of the ellipse, the larger first.
        peak_pressure_Pa: in its middle.
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
    """Contact of a ball that is pressed from inside on the wall of a channel.

    Args:
        force_N: that presses, N.
        ball_radius_m: m.
        ball, wall: materials.
        path_radius_m: of the wall along the ball's path, hollow towards the ball, m; inf: straight.
        groove_radius_m: of the wall across it, m; inf: a cylinder's wall.
    Raises:
        OutsideDomain: a force or radius not above 0, or a wall that is more curved than the ball.
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
    less, more = min(gaps), max(gaps)
    ratio = _axes_ratio(more / less)
    e2 = 1 - ratio**2
    k, shape = float(ellipk(e2)), _shape(ratio)
    larger = (1.5 * force_N * shape / (math.pi * stiff * less)) ** (1 / 3)
    smaller = ratio * larger
    pressure = 1.5 * force_N / (math.pi * larger * smaller)
    return Contact(pressure * smaller * k / stiff, (larger, smaller), pressure)


def _shape(ratio: float) -> float:
    """(K − E)/e²; π/4 for a circle."""
    e2 = 1 - ratio**2
    return math.pi / 4 * (1 + 3 * e2 / 8) if e2 < 1e-6 else (float(ellipk(e2)) - float(ellipe(e2))) / e2


def _axes_ratio(curvatures: float) -> float:
    """Smaller over larger half axis for a ratio of the gaps' curvatures, at least 1."""

    def off(log_ratio: float) -> float:
        ratio = math.exp(log_ratio)
        e2 = 1 - ratio**2
        k, e = float(ellipk(e2)), float(ellipe(e2))
        return math.log((e / ratio**2 - k) / (k - e) / curvatures)

    if curvatures - 1 < _ROUND:
        return 1.0
    return math.exp(float(brentq(off, -12.0, -1e-6, xtol=1e-13)))  # pyright: ignore[reportArgumentType]


def plastic_depth(force_N: float, ball_radius_m: float, yield_Pa: float) -> float:
    """Depth of the dent of a ball in metal that yields all around, m: the mean pressure is three yield stresses.

    Args:
        force_N, ball_radius_m: N, m.
        yield_Pa: yield stress of the softer one, Pa.
    """
    return force_N / (6 * math.pi * ball_radius_m * yield_Pa)


def hysteresis_resistance(contact: Contact, loss: float) -> float:
    """Coefficient of rolling resistance as a length, m, of elastic material that gives back less than it takes.

    Args:
        contact: a round one.
        loss: share of the elastic work that is lost; a few per cent in metals below yielding.
    """
    return 3 / 16 * loss * contact.half_axes_m[0]
