# pyright: strict
"""The two numbers over which a map is made: KEY=A:B:N, and what a rig is at a pair of values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics import RotorParameters, balanced_angles
from dynamics.stability.map_plane import INVERSE, ROOT, SAME, Coordinate, Plane, RigPlane, SpeedStiffnessPlane
from rig_configs import IdentifiedParameters, RigFileError, load_rig
from rig_configs.physical_keys import need_physical_key, with_physical

SPEED_RATIO, SPEED_RPM, STIFFNESS_RATIO = "speed_ratio", "speed_rpm", "stiffness_ratio"
_NAMES = {
    SPEED_RATIO: "speed ratio Ω = ω/ω_n1",
    SPEED_RPM: "speed, rpm",
    STIFFNESS_RATIO: "stiffness ratio K = k2/k1",
}
_SPEEDS = (SPEED_RATIO, SPEED_RPM)
_ROOTS = (STIFFNESS_RATIO, "suspension.k1_N_per_m", "suspension.k2_N_per_m")
_EXAMPLE = "for example speed_ratio=0.3:7:400 or pendulums.a.damping_Nms_per_rad=1e-4:1e-2:100:log"
_MOST = 10_000_000


@dataclass(frozen=True)
class MapAxis:
    """One number, or several that change alike.

    Attributes:
        keys: dotted keys of the rig file, or speed_ratio, speed_rpm, stiffness_ratio.
        values: shape (n,), rising.
        logarithmic: spaced evenly in the logarithm.
    """

    keys: tuple[str, ...]
    values: NDArray[np.floating]
    logarithmic: bool

    @property
    def name(self) -> str:
        """For an axis of a figure."""
        return " = ".join(_NAMES.get(key, key) for key in self.keys)

    @property
    def is_speed(self) -> bool:
        """Whether it says how fast the rotor turns."""
        return self.keys[0] in _SPEEDS

    @property
    def span(self) -> tuple[float, float]:
        """First and last value."""
        return float(self.values[0]), float(self.values[-1])

    @property
    def coordinate(self) -> Coordinate:
        """In which the half-turn matrix is smooth."""
        return INVERSE if self.is_speed else ROOT if self.keys[0] in _ROOTS else SAME


def read_axis(option: str, text: str) -> MapAxis:
    """KEY=A:B:N or KEY=A:B:N:log; several keys that change alike are joined by +.

    Raises:
        RigFileError: says what was expected.
    """
    keys, equals, numbers = text.partition("=")
    parts = numbers.split(":")
    wanted = f"rig map: {option} expected KEY=A:B:N or KEY=A:B:N:log, {_EXAMPLE}; got {text!r}"
    logarithmic = len(parts) == 4 and parts[-1] == "log"
    if not equals or len(parts) != (4 if logarithmic else 3):
        raise RigFileError(wanted)
    try:
        low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
    except ValueError:
        raise RigFileError(wanted) from None
    first, *others = names = [key.strip() for key in keys.split("+")]
    for key in names:
        if key not in _NAMES:
            need_physical_key(key)
    if others and any(key in _NAMES for key in names):
        raise RigFileError(f"rig map: {option}: {keys} cannot change alike; only numbers of the rig file can")
    least = 0.0 if first in _NAMES or first in _ROOTS or logarithmic else -math.inf
    if not (least < low <= high < math.inf and 1 <= count <= _MOST) or (count > 1 and low == high):
        above = "0 < A < B" if least == 0.0 else "A < B, both finite,"
        raise RigFileError(f"rig map: {option} expected {above} and N from 1 to ten million, got {text!r}")
    values = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
    return MapAxis(tuple(names), values, logarithmic)


def plane_over(
    rig: str,
    known: IdentifiedParameters | None,
    settings: Sequence[str],
    axes: tuple[MapAxis, MapAxis],
    speed_rad_s: float | None,
) -> Plane:
    """The plane that two axes span, every rig in it checked by what a rig file may hold.

    Args:
        rig: file or name.
        known: identified parameters laid over it, or None.
        settings: laid over both.
        speed_rad_s: the rotor's where neither axis says it.
    Raises:
        RigFileError: a value that no rig has, a number on both axes, or no speed.
    """
    x, y = axes
    both = sorted({*x.keys} & {*y.keys}) or [key for key in _SPEEDS if x.is_speed and y.is_speed]
    if both:
        raise RigFileError(f"rig map: {both[0]} stands on both axes; give two different numbers")
    if not (x.is_speed or y.is_speed) and speed_rad_s is None:
        raise RigFileError("rig map: neither axis is a speed; give one of --point, --speed-ratio, --speed-rpm")
    for axis in axes:
        for value in {*axis.span}:
            load_rig(rig, known, [*settings, *(f"{key}={value!r}" for key in axis.keys if key not in _NAMES)])
    physics = load_rig(rig, known, settings).physics
    if (x.keys, y.keys) == ((SPEED_RATIO,), (STIFFNESS_RATIO,)) and (angles := balanced_angles(physics)):
        return SpeedStiffnessPlane(physics, angles[0])

    def at(one_x: float, one_y: float) -> tuple[RotorParameters, float]:
        changed, speed = physics, speed_rad_s
        for axis, value in sorted(zip(axes, (one_x, one_y), strict=True), key=lambda pair: pair[0].keys[0] in _NAMES):
            for key in axis.keys:
                if key == STIFFNESS_RATIO:
                    changed = with_physical(changed, "suspension.k2_N_per_m", value * changed.k1_N_per_m)
                elif key not in _NAMES:
                    changed = with_physical(changed, key, value)
        for axis, value in zip(axes, (one_x, one_y), strict=True):
            if axis.is_speed:
                speed = changed.speed_rad_s(value) if axis.keys[0] == SPEED_RATIO else value * math.pi / 30
        assert speed is not None
        return changed, speed

    return RigPlane(at, x.coordinate, y.coordinate)
