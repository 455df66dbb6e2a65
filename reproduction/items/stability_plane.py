"""The plane of chapter 4: its range, the rig's points on it, its borders."""

from __future__ import annotations

from analysis.figures.stability_map import MapFrame, MapPoint
from dynamics import balanced_angles
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.borders import Borders, stability_borders
from dynamics.stability.map_plane import SpeedStiffnessPlane
from reproduction.workspace import VIRTUAL
from rig_configs import load_rig

X_RANGE, Y_RANGE = (0.3, 7.0), (1.0, 16.0)
ON_LINE = 14.9


def frame_of_rig(p: RotorParameters) -> MapFrame:
    """Return the shipped rig's points, and a rig's own stiffness ratio."""
    rig = load_rig(VIRTUAL)
    points = [MapPoint(name, point.speed_ratio, point.expected) for name, point in rig.points.items()]
    return MapFrame(points=points, own=p.k2_N_per_m / p.k1_N_per_m)


def borders_of_plane(p: RotorParameters) -> Borders:
    """Return every border of the balanced state in the range."""
    return stability_borders(SpeedStiffnessPlane(p, balanced_angles(p)[0]), X_RANGE, Y_RANGE, spacing=1 / 800)
