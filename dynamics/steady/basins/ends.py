"""The stable motions at one speed, resting and slipping, each with its attracting region."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.arrays import Array
from dynamics.errors import OutsideDomain
from dynamics.steady.basins.regions import Region, attracting_region, mirrored
from dynamics.steady.basins.slipping_orbits import SlippingOrbit
from dynamics.steady.basins.turning import RevolutionMap
from dynamics.steady.steady_motions import steady_states

_MIRRORED = 1e-8  # in the units of the state: distance below which two states are mirror images
NEAR_RAD = 5e-3
"""Deviation in every component, in its unit, below which a release has settled."""


@dataclass(frozen=True)
class End:
    """A stable motion at which releases end.

    Attributes:
        name: "I", "II", "III", "one" or "slipping".
        mirror: 0, or 1 for the second of two mirror images. States of one type that are not mirror images are numbered.
        theta_rad: mean angles of A and B; None for slipping.
        amplitude_m: root mean square distance of the disk centre from the centre of its orbit.
        multiplier: largest modulus over one revolution; of a slipping orbit, transverse to it.
        start: state at ψ = 0, shape (8,).
        region: attracting region of a steady state; None for slipping.
        slipping: the slipping orbit; None for a steady state.
    """

    name: str
    mirror: int
    theta_rad: tuple[float, float] | None
    amplitude_m: float
    multiplier: float
    start: Array
    region: Region | None
    slipping: SlippingOrbit | None = None

    @property
    def words(self) -> str:
        """Name of the end with its angles or its rates of slip."""
        if self.theta_rad is not None:
            a, b = (math.degrees(angle) for angle in self.theta_rad)
            return f"{self.name}: A at {a:.1f}°, B at {b:.1f}°"
        assert self.slipping is not None
        a, b = (round(rate, 9) + 0.0 for rate in self.slipping.turns_per_revolution)  # no −0
        return f"slipping: A {a:.4g}, B {b:.4g} turns per revolution"


def steady_ends(turning: RevolutionMap) -> list[End]:
    """Compute all stable steady states at the rig's speed.

    Raises:
        OutsideDomain: the rig has no imbalance, so that its balanced pendulums may be at any angle.
        NotConverged: as for dynamics.steady.steady_motions.steady_states.
    """
    ends = list[End]()
    for state in steady_states(turning.parameters, turning.speed_rad_s, 1e-6):
        if state.any_angle:
            raise OutsideDomain("without an imbalance the pendulums rest at any angle: expected S_P above 0")
        if not state.stable:
            continue
        start = state.start.astype(np.float64)
        region = _as_mirror_image(turning, state.type, start, ends) or attracting_region(turning, start)
        if region is not None:
            number = _numbered(state.type, state.theta_rad, ends)
            ends.append(
                End(state.type, number, state.theta_rad, state.amplitude_m, state.multiplier_max, start, region)
            )
    return ends


def _numbered(kind: str, theta_rad: tuple[float, float], ends: Sequence[End]) -> int:
    """0 or 1 for two mirror images, by the side of A; the next number if that one is used."""
    wanted, taken = mirror_image(kind, theta_rad), {end.mirror for end in ends if end.name == kind}
    while wanted in taken:
        wanted += 1
    return wanted


def mirror_image(kind: str, theta_rad: tuple[float, float]) -> int:
    """0 for a balanced state with A less than half a turn from the imbalance, otherwise 1; 0 for other types."""
    return int(kind == "I" and theta_rad[0] % (2 * math.pi) > math.pi)


def with_slipping(steady: Sequence[End], slipping: Sequence[SlippingOrbit]) -> list[End]:
    """Steady ends, followed by slipping ends."""
    return [
        *steady,
        *(
            End("slipping", i, None, orbit.amplitude_m, orbit.multiplier_across, orbit.points[0], None, orbit)
            for i, orbit in enumerate(slipping)
        ),
    ]


def _as_mirror_image(turning: RevolutionMap, kind: str, start: Array, ends: Sequence[End]) -> Region | None:
    """Region of a state that is the mirror image of another one with A and B exchanged, if these are equal."""
    if turning.parameters.a != turning.parameters.b:
        return None
    for end in ends:
        if end.region is not None and end.name == kind:
            away = start - end.start[[0, 1, 3, 2, 4, 5, 7, 6]]
            away[2:4] = (away[2:4] + math.pi) % (2 * math.pi) - math.pi
            if np.all(np.abs(away / turning.units) < _MIRRORED):
                return mirrored(end.region)
    return None


def packed(ends: Sequence[End], turning: RevolutionMap) -> tuple[Any, ...]:
    """Argument `ends` of dynamics.steady.basins.pursuit."""
    points, forms, first, lead, sheets = list[Array](), list[Array](), [0], list[int](), list[int]()
    maps, straight, near, radius = list[Array](), list[float](), list[float](), list[float]()
    for end in ends:
        if end.region is not None:
            points.append(end.start[None, :])
            forms.append(end.region.form[None])
            lead.append(-1)
            sheets.append(1)
            maps.append(end.region.turn_map)
            straight.append(end.region.straight)
            near.append(end.region.near(turning.units, NEAR_RAD))
        else:
            assert end.slipping is not None
            orbit = end.slipping
            points.append(orbit.points)
            forms.append(orbit.forms)
            lead.append(orbit.lead)
            sheets.append(orbit.sheets)
            maps.append(np.eye(8))
            straight.append(-1.0)
            near.append(orbit.near)
        first.append(first[-1] + len(points[-1]))
        radius.append(end.amplitude_m)
    return (
        np.concatenate([np.zeros((0, 8)), *points]),
        np.concatenate([np.zeros((0, 8, 8)), *forms]),
        np.array(first, np.int64),
        np.array(lead, np.int64),
        np.array(sheets, np.int64),
        np.array(maps, np.float64).reshape(-1, 8, 8),
        np.array(straight, np.float64),
        np.array(near, np.float64),
        np.array(radius, np.float64),
    )
