"""Type of a steady state from the positions of the pendulums."""

from __future__ import annotations

import cmath
import math
from typing import Protocol

BALANCED_SHARE = 0.15
"""Share of S_P, including a bow's moment: a smaller residual means that the pendulums balance it (Type I)."""


class _Pendulum(Protocol):
    @property
    def first_moment_kg_m(self) -> float: ...


class Moments(Protocol):
    """First mass moments of a rig: of its imbalance and of its pendulums, kg m."""

    @property
    def imbalance_moment_kg_m(self) -> float:
        """First moment of the imbalance, S_P, kg m."""
        ...

    @property
    def a(self) -> _Pendulum:
        """Pendulum A."""
        ...

    @property
    def b(self) -> _Pendulum:
        """Pendulum B."""
        ...


def state_type(theta_rad: tuple[float, float], moments: Moments, bow_kg_m: complex = 0j) -> str:
    """Return the type: "I" if the pendulums balance S_P to 15 %, otherwise "II" (opposed) or "III" (together).

    Args:
        theta_rad: θ3 and θ4 from the imbalance's direction, rad.
        moments: first moments of the rig.
        bow_kg_m: first moment equivalent to a bent shaft at this speed; it is balanced together with S_P.
    """
    whole = moments.imbalance_moment_kg_m + bow_kg_m
    pendulums = zip((moments.a, moments.b), theta_rad, strict=True)
    residual = abs(whole + sum(p.first_moment_kg_m * cmath.exp(1j * theta) for p, theta in pendulums))
    if residual < BALANCED_SHARE * abs(whole):
        return "I"
    return "II" if math.cos(theta_rad[0] - theta_rad[1]) < 0 else "III"
