"""Plane over two numbers of a rig: the rig at each pair of values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from analysis.maps.axes import NAMES, SPEED_RATIO, SPEEDS, STIFFNESS_RATIO, MapAxis
from dynamics import RotorParameters, balanced_angles
from dynamics.stability.map_plane import Plane, RigPlane, SpeedStiffnessPlane
from rig_basics.units import RPM
from rig_configs import Rig, RigFileError
from rig_configs.physical_numbers import PHYSICAL_NUMBERS


def plane_over(rig_with: Callable[[list[str]], Rig], axes: tuple[MapAxis, MapAxis], speed_rad_s: float | None) -> Plane:
    """Return the plane over two axes. The rigs at its ends are checked against the limits of a rig file.

    Args:
        rig_with: returns the rig with further settings applied.
        axes: both numbers with their values.
        speed_rad_s: speed of the rotor if neither axis is a speed.
    Raises:
        RigFileError: an impossible value, a number on both axes, or a missing speed.
    """
    x, y = axes
    both = sorted({*x.keys} & {*y.keys}) or [key for key in SPEEDS if x.is_speed and y.is_speed]
    if both:
        raise RigFileError(f"map: {both[0]} is on both axes; give two different numbers")
    if not (x.is_speed or y.is_speed) and speed_rad_s is None:
        raise RigFileError("map: neither axis is a speed; give a point, a speed ratio or a speed in rpm")
    for axis in axes:
        for value in {*axis.span}:
            rig_with([f"{key}={value!r}" for key in axis.keys if key not in NAMES])
    physics = rig_with([]).physics
    if (x.keys, y.keys) == ((SPEED_RATIO,), (STIFFNESS_RATIO,)) and (angles := balanced_angles(physics)):
        return SpeedStiffnessPlane(physics, angles[0])

    def at(one_x: float, one_y: float) -> tuple[RotorParameters, float]:
        changed, speed = physics, speed_rad_s
        for axis, value in sorted(zip(axes, (one_x, one_y), strict=True), key=lambda pair: pair[0].keys[0] in NAMES):
            for key in axis.keys:
                if key == STIFFNESS_RATIO:
                    changed = replace(changed, k2_N_per_m=value * changed.k1_N_per_m)
                elif key not in NAMES:
                    changed = PHYSICAL_NUMBERS[key].changed(changed, value)
        for axis, value in zip(axes, (one_x, one_y), strict=True):
            if axis.is_speed:
                speed = changed.speed_rad_s(value) if axis.keys[0] == SPEED_RATIO else value * RPM
        assert speed is not None
        return changed, speed

    return RigPlane(at, x.coordinate, y.coordinate, (x.key, y.key))
