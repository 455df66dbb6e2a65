"""Line over one number of a rig: rig and speed at each value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from analysis.maps.axes import NAMES, SPEED_RATIO, STIFFNESS_RATIO, MapAxis
from dynamics import RotorParameters
from dynamics.steady.branches import SteadyBranches, steady_branches
from rig_basics.units import RPM
from rig_configs import Rig, RigFileError
from rig_configs.physical_numbers import PHYSICAL_NUMBERS


@dataclass(frozen=True)
class RigLine:
    """Rigs along one axis.

    Attributes:
        physics: parameters of the unchanged rig.
        axis: number with its first and last value.
        speed_rad_s, speed_ratio: speed of the rotor if the axis is not a speed; one of the two. A speed ratio refers
            to the changed rig: a heavier or stiffer rig turns at another speed.
    """

    physics: RotorParameters
    axis: MapAxis
    speed_rad_s: float | None = None
    speed_ratio: float | None = None

    def at(self, value: float) -> tuple[RotorParameters, float]:
        """Return the rig and its speed in rad/s at a value of the axis."""
        changed = self.physics
        for key in self.axis.keys:
            if key == STIFFNESS_RATIO:
                changed = replace(changed, k2_N_per_m=value * changed.k1_N_per_m)
            elif key not in NAMES:
                changed = PHYSICAL_NUMBERS[key].changed(changed, value)
        if self.axis.is_speed:
            return changed, changed.speed_rad_s(value) if self.axis.keys[0] == SPEED_RATIO else value * RPM
        if self.speed_rad_s is not None:
            return changed, self.speed_rad_s
        assert self.speed_ratio is not None
        return changed, changed.speed_rad_s(self.speed_ratio)

    def branches(self, accuracy: float = 1e-9, progress: Callable[[float], None] | None = None) -> SteadyBranches:
        """Return the steady states at the axis's values.

        Raises:
            DynamicsError: as `steady_branches`.
        """
        return steady_branches(self.at, self.axis.values, accuracy, progress)


def line_over(
    rig_with: Callable[[list[str]], Rig],
    axis: MapAxis,
    speed_rad_s: float | None,
    speed_ratio: float | None,
    effects: Callable[[RotorParameters], RotorParameters] = lambda physics: physics,
) -> RigLine:
    """Return the line along an axis. The rigs at its ends are checked against the limits of a rig file.

    Args:
        rig_with: returns the rig with further settings applied.
        axis: number and its values.
        speed_rad_s, speed_ratio: speed of the rotor if the axis is not a speed; one of the two.
        effects: applies identified effects that are not in a rig file to its physics.
    Raises:
        RigFileError: an impossible value, a missing speed, or two speeds.
    """
    given: Sequence[float] = [one for one in (speed_rad_s, speed_ratio) if one is not None]
    if axis.is_speed and given:
        raise RigFileError("sweep: it goes over the speed; leave out the constant speed")
    if not axis.is_speed and len(given) != 1:
        raise RigFileError("sweep: expected a constant speed in addition; give a point, a speed ratio or rpm")
    if axis.count < 2:
        raise RigFileError(f"sweep: expected N of 2 or more values, got {axis.text!r}")
    for value in axis.span:
        rig_with([f"{key}={value!r}" for key in axis.keys if key not in NAMES])
    return RigLine(effects(rig_with([]).physics), axis, speed_rad_s, speed_ratio)
