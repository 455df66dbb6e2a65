# pyright: strict
"""The frame of a map that was asked for: its axes, and over speed and stiffness ratio the rig's own points."""

from __future__ import annotations

from analysis.figures.stability_map import MapFrame, MapPoint
from analysis.maps.axes import SPEED_RATIO, STIFFNESS_RATIO
from analysis.maps.question import MapQuestion


def frame_of(question: MapQuestion) -> MapFrame:
    """Axes as they were asked for; points and the rig's line where they are speed ratio and stiffness ratio."""
    names, logarithmic = (question.x.name, question.y.name), (question.x.logarithmic, question.y.logarithmic)
    if (question.x.keys, question.y.keys) != ((SPEED_RATIO,), (STIFFNESS_RATIO,)):
        return MapFrame(names, logarithmic)
    rig = question.loaded()
    points = [MapPoint(name, point.speed_ratio, point.expected) for name, point in rig.points.items()]
    return MapFrame(names, logarithmic, points, rig.physics.k2_N_per_m / rig.physics.k1_N_per_m)


def what_if(question: MapQuestion) -> str:
    """What was laid over the rig file, for the end of a title."""
    return f"; {', '.join(question.settings)}" if question.settings else ""
