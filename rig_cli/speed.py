# pyright: strict
"""The speed of a command: a point's, or a number."""

from __future__ import annotations

import math

from rig_configs import Rig, RigFileError


def chosen_speed(
    command: str, rig: Rig, point: str | None, speed_rpm: float | None, speed_ratio: float | None
) -> float:
    """Return the requested speed, rad/s.

    Args:
        command: "rig predict", for messages.
        point: of the rig file; or
        speed_rpm: in rpm; or
        speed_ratio: over the first natural frequency.
    Raises:
        RigFileError: none or several were given, the point does not exist, or the speed is not above 0.
    """
    if sum(x is not None for x in (point, speed_rpm, speed_ratio)) != 1:
        raise RigFileError(f"{command}: give one of --point, --speed-rpm, --speed-ratio")
    if point is not None:
        if point not in rig.points:
            raise RigFileError(f"{command}: no point {point!r} in {rig.name}; known: {', '.join(rig.points)}")
        return rig.physics.speed_rad_s(rig.points[point].speed_ratio)
    speed = speed_rpm * math.pi / 30 if speed_rpm is not None else rig.physics.speed_rad_s(speed_ratio or 0.0)
    if not 0 < speed < math.inf:
        raise RigFileError(f"{command}: expected a speed above 0, got {speed:g} rad/s")
    return speed
