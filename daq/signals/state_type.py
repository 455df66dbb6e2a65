# pyright: strict
"""The type of a steady state by where the pendulums stand."""

from __future__ import annotations

import cmath
import math
from typing import Protocol

BALANCED_SHARE = 0.15
"""Of S_P, a bow's moment included: below this rest the pendulums balance it (Type I)."""


class _Pendulum(Protocol):
    @property
    def first_moment_kg_m(self) -> float: ...


class Moments(Protocol):
    """The first mass moments of a rig: its imbalance's and its pendulums', kg m."""

    @property
    def imbalance_moment_kg_m(self) -> float:
        """S_P."""
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
    """Type by the angles: "I" when the pendulums balance S_P to 15 %, else "II" opposed or "III" together.

    Args:
        theta_rad: θ3 and θ4 from the imbalance's direction, rad.
        moments: of the rig.
        bow_kg_m: first moment that drives the rotor as a bent shaft does at this speed; balanced as S_P is.
    """
    whole = moments.imbalance_moment_kg_m + bow_kg_m
    pendulums = zip((moments.a, moments.b), theta_rad, strict=True)
    rest = abs(whole + sum(p.first_moment_kg_m * cmath.exp(1j * theta) for p, theta in pendulums))
    if rest < BALANCED_SHARE * abs(whole):
        return "I"
    return "II" if math.cos(theta_rad[0] - theta_rad[1]) < 0 else "III"
