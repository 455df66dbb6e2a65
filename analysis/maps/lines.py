# pyright: strict
"""The line that one number of a rig spans: what a rig is, and how fast it turns, at a value."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from analysis.maps.axes import NAMES, SPEED_RATIO, STIFFNESS_RATIO, MapAxis
from dynamics import RotorParameters
from dynamics.steady.branches import SteadyBranches, steady_branches
from rig_configs import Rig, RigFileError
from rig_configs.physical_keys import with_physical


@dataclass(frozen=True)
class RigLine:
    """A rig along one axis.

    Attributes:
        physics: the rig where nothing is changed.
        axis: the number, its first and last value.
        speed_rad_s, speed_ratio: of the rotor where the axis is no speed; one of them. A speed ratio is that of the
            changed rig: a heavier or stiffer one turns at another speed.
    """

    physics: RotorParameters
    axis: MapAxis
    speed_rad_s: float | None = None
    speed_ratio: float | None = None

    def at(self, value: float) -> tuple[RotorParameters, float]:
        """The rig and its speed in rad/s at a value of the axis."""
        changed = self.physics
        for key in self.axis.keys:
            if key == STIFFNESS_RATIO:
                changed = with_physical(changed, "suspension.k2_N_per_m", value * changed.k1_N_per_m)
            elif key not in NAMES:
                changed = with_physical(changed, key, value)
        if self.axis.is_speed:
            return changed, changed.speed_rad_s(value) if self.axis.keys[0] == SPEED_RATIO else value * math.pi / 30
        if self.speed_rad_s is not None:
            return changed, self.speed_rad_s
        assert self.speed_ratio is not None
        return changed, changed.speed_rad_s(self.speed_ratio)

    def branches(self, accuracy: float = 1e-9, tell: Callable[[float], None] | None = None) -> SteadyBranches:
        """Steady states at the axis's values.

        Raises:
            DynamicsError: as `steady_branches`.
        """
        return steady_branches(self.at, self.axis.values, accuracy, tell)


def line_over(
    rig_with: Callable[[list[str]], Rig],
    axis: MapAxis,
    speed_rad_s: float | None,
    speed_ratio: float | None,
    effects: Callable[[RotorParameters], RotorParameters] = lambda physics: physics,
) -> RigLine:
    """The line along an axis, the rigs at its ends checked by what a rig file may hold.

    Args:
        rig_with: the rig, with further settings laid over all else.
        speed_rad_s, speed_ratio: the rotor's where the axis is no speed; one of them.
        effects: what was found beside a rig file's numbers, laid over its physics.
    Raises:
        RigFileError: a value that no rig has, no speed, or two.
    """
    given: Sequence[float] = [one for one in (speed_rad_s, speed_ratio) if one is not None]
    if axis.is_speed and given:
        raise RigFileError("rig predict: --sweep goes over the speed; leave out --point, --speed-rpm, --speed-ratio")
    if not axis.is_speed and len(given) != 1:
        raise RigFileError("rig predict: --sweep needs one of --point, --speed-rpm, --speed-ratio beside it")
    if axis.count < 2:
        raise RigFileError(f"rig predict: --sweep expected N of 2 or more values, got {axis.text!r}")
    for value in axis.span:
        rig_with([f"{key}={value!r}" for key in axis.keys if key not in NAMES])
    return RigLine(effects(rig_with([]).physics), axis, speed_rad_s, speed_ratio)
