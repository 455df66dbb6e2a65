"""Share of a plane that the borders leave undecided."""

from __future__ import annotations

from dataclasses import replace

import pytest

from analysis.maps.axes import MapAxis
from analysis.maps.shares import unresolved_share
from dynamics import RotorParameters, balanced_angles
from dynamics.stability.borders import Borders
from dynamics.stability.map_plane import RigPlane, SpeedStiffnessPlane
from rig_configs import load_rig

PHYSICS = load_rig("virtual").physics
PLANE = SpeedStiffnessPlane(PHYSICS, balanced_angles(PHYSICS)[0])  # u = 1/Ω, v = √K


def without(*bare: tuple[tuple[float, float], tuple[float, float]]) -> Borders:
    return Borders((), 0.5, (0.1, 0.1), 0, bare)


@pytest.mark.parametrize("logarithmic", [False, True])
def test_rectangles_count_by_the_axes(logarithmic: bool) -> None:
    axes = MapAxis(("speed_ratio",), 1.0, 4.0, 5, logarithmic), MapAxis(("stiffness_ratio",), 1.0, 16.0, 5)
    across = 0.5 if logarithmic else 1 / 3  # Ω from 1 to 2
    lost = unresolved_share(PLANE, without(((0.5, 1.0), (1.0, 2.0)), ((0.25, 0.5), (3.0, 4.0))), axes)
    assert lost == pytest.approx(across * 3 / 15 + (1 - across) * 7 / 15)
    assert unresolved_share(PLANE, without(), axes) == 0.0


def test_where_no_balanced_state_exists_nothing_is_unresolved() -> None:
    def at(speed_ratio: float, radius_m: float) -> tuple[RotorParameters, float]:
        return replace(PHYSICS, imbalance_radius_m=radius_m), PHYSICS.speed_rad_s(speed_ratio)

    axes = MapAxis(("speed_ratio",), 1.0, 3.0, 5), MapAxis(("imbalance.radius_m",), 0.01, 0.2, 5)
    high, low = ((1.0, 3.0), (0.15, 0.2)), ((1.0, 3.0), (0.01, 0.02))
    assert unresolved_share(RigPlane(at), without(high), axes) == 0.0
    assert unresolved_share(RigPlane(at), without(low), axes) == pytest.approx(1 / 19)
