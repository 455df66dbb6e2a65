"""The speed of a command: a point's, or a number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from rig_basics.units import RPM
from rig_cli.numbers import Positive, PositiveRpm
from rig_cli.option_groups import SPEED
from rig_configs import Rig, RigFileError


@Parameter(name="*", group=SPEED)
@dataclass(frozen=True)
class SpeedChoice:
    """Options for the speed of a command. At most one of them may be given.

    Attributes:
        point: name of a point of the rig file.
        speed_ratio: speed over the first natural frequency.
        speed_rpm: speed in rpm.
    """

    point: Annotated[str | None, Parameter(help="the speed of a point of the rig file")] = None
    speed_ratio: Annotated[Positive | None, Parameter(help="the speed as a ratio to the first resonance")] = None
    speed_rpm: Annotated[PositiveRpm | None, Parameter(help="the same in rpm")] = None

    @property
    def count(self) -> int:
        """Number of the options that are given."""
        return sum(value is not None for value in (self.point, self.speed_ratio, self.speed_rpm))

    def rad_s(self, command: str, rig: Rig) -> float:
        """Return the speed, rad/s.

        Args:
            command: "rig predict", for messages.
            rig: has the points and the first natural frequency.
        Raises:
            RigFileError: none or several were given, the point does not exist, or the speed is not above 0.
        """
        if self.count != 1:
            raise RigFileError(f"{command}: give one of --point, --speed-rpm, --speed-ratio")
        if self.point is not None:
            if self.point not in rig.points:
                raise RigFileError(f"{command}: no point {self.point!r} in {rig.name}; known: {', '.join(rig.points)}")
            return rig.physics.speed_rad_s(rig.points[self.point].speed_ratio)
        rpm, ratio = self.speed_rpm, self.speed_ratio or 0.0
        speed = rpm * RPM if rpm is not None else rig.physics.speed_rad_s(ratio)
        if not 0 < speed < math.inf:
            raise RigFileError(f"{command}: expected a speed above 0, got {speed:g} rad/s")
        return speed


NO_SPEED = SpeedChoice()
