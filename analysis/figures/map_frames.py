"""Frame of a map: its axes, and over speed ratio and stiffness ratio the rig's own points."""

from __future__ import annotations

from analysis.figures.stability_map import MapFrame, MapPoint
from analysis.maps.axes import SPEED_RATIO, STIFFNESS_RATIO
from analysis.maps.question import MapQuestion


def frame_of(question: MapQuestion) -> MapFrame:
    """Return the axes of a question; over speed ratio and stiffness ratio also the rig's points and line."""
    names, logarithmic = (question.x.name, question.y.name), (question.x.logarithmic, question.y.logarithmic)
    if (question.x.keys, question.y.keys) != ((SPEED_RATIO,), (STIFFNESS_RATIO,)):
        return MapFrame(names, logarithmic)
    rig = question.loaded()
    points = [MapPoint(name, point.speed_ratio, point.expected) for name, point in rig.points.items()]
    return MapFrame(names, logarithmic, points, rig.physics.k2_N_per_m / rig.physics.k1_N_per_m)


def what_if(question: MapQuestion) -> str:
    """Return the settings applied to the rig file, for the end of a title."""
    return f"; {', '.join(question.settings)}" if question.settings else ""
