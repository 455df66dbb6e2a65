# pyright: strict
"""What devices are to a rig: the roles they play, with the calibration that goes with each.

Everything above a driver asks for a role, never for a device's name or its maker's. A device's settings say which roles
it plays (`rig_configs.device.DeviceSettings.roles`); a log keeps them, so that it can be read where the driver is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from rig_configs.table import Finite, NotNegative, Positive, Table

Axis = Literal["x", "y"]
USUAL_GAIN_STD, USUAL_ZERO_STD_DEG = 0.001, 0.05
"""Of a sensor of which nothing is said: also of one that recorded elsewhere and that the rig file does not know."""


class Displacement(Table):
    """A sensor of the column's motion.

    Attributes:
        topic: the channel its samples are in.
        axis: the direction it looks along.
        rate_Hz: samples a second.
        range_m: what it measures over; its middle is displacement 0.
        lever_ratio: its displacement over the disk centre's.
        gain_std: relative standard uncertainty of calibration and lever together.
        clock_tolerance_ppm: standard uncertainty of its clock's rate.
    """

    role: Literal["displacement"] = "displacement"
    device: str
    topic: str
    axis: Axis
    rate_Hz: Positive
    range_m: Positive
    lever_ratio: Positive = 1.0
    gain_std: NotNegative = 0.0
    clock_tolerance_ppm: NotNegative

    @property
    def reach_m(self) -> float:
        """The largest displacement of the disk centre to either side that it sees, m."""
        return 0.5 * self.range_m / self.lever_ratio


class PendulumAngles(Table):
    """Encoders of both pendulums.

    Attributes:
        counts_per_revolution: of each encoder.
        zero_std_deg: standard uncertainty of each encoder's zero against the imbalance direction.
    """

    role: Literal["pendulum angles"] = "pendulum angles"
    device: str
    topic: str
    rate_Hz: Positive
    counts_per_revolution: Annotated[int, Field(ge=1)]
    zero_std_deg: NotNegative
    clock_tolerance_ppm: NotNegative

    @property
    def step_rad(self) -> float:
        """Angle of one count."""
        return 2 * math.pi / self.counts_per_revolution


class RotorPhase(Table):
    """A mark once a revolution.

    Attributes:
        index_angle_deg: ψ (imbalance direction from +x) when the mark fires.
    """

    role: Literal["rotor phase"] = "rotor phase"
    device: str
    topic: str
    index_angle_deg: Finite
    clock_tolerance_ppm: NotNegative


class SpeedSource(Table):
    """What turns the rotor as told, and tells how fast it turns.

    Attributes:
        ramp_rpm_per_s: how fast it speeds up where a test has no ramp of its own.
    """

    role: Literal["speed source"] = "speed source"
    device: str
    topic: str
    ramp_rpm_per_s: Positive


class PendulumLocks(Table):
    """What locks and releases the pendulums as told."""

    role: Literal["pendulum locks"] = "pendulum locks"
    device: str


class OtherQuantity(Table):
    """Anything else worth recording: it is kept, plotted and exported, and no test needs it.

    Attributes:
        fields: what the channel's fields are, by name, with the unit in it.
    """

    role: Literal["other quantity"] = "other quantity"
    device: str
    topic: str
    fields: Annotated[tuple[str, ...], Field(strict=False)]


Role = Displacement | PendulumAngles | RotorPhase | SpeedSource | PendulumLocks | OtherQuantity
AnyRole = Annotated[Role, Field(discriminator="role")]


@dataclass(frozen=True)
class Roles:
    """All roles that the devices of a rig play.

    Attributes:
        displacements: by their axes, each at most once.
        angles, phase, speed, locks: who plays the role; None where no device does.
        others: whatever else is recorded.
    """

    displacements: tuple[Displacement, ...] = ()
    angles: PendulumAngles | None = None
    phase: RotorPhase | None = None
    speed: SpeedSource | None = None
    locks: PendulumLocks | None = None
    others: tuple[OtherQuantity, ...] = ()

    @classmethod
    def of(cls, played: Iterable[Role]) -> Roles:
        """Roles sorted by kind.

        Raises:
            ValueError: two devices play one role, or fill one channel.
        """
        displacements: list[Displacement] = []
        others: list[OtherQuantity] = []
        single: dict[str, Any] = {}
        for role in played:
            if isinstance(role, Displacement):
                _refuse_second(
                    next((d for d in displacements if d.axis == role.axis), None),
                    role,
                    f"displacement along {role.axis}",
                )
                displacements.append(role)
            elif isinstance(role, OtherQuantity):
                others.append(role)
            else:
                _refuse_second(single.get(_PLACES[role.role]), role, role.role)
                single[_PLACES[role.role]] = role
        found = cls(tuple(sorted(displacements, key=lambda d: d.axis)), others=tuple(others), **single)
        topics = [topic for topic, _ in found._filled()]
        if twice := next((topic for topic in topics if topics.count(topic) > 1), None):
            both = " and ".join(device for topic, device in found._filled() if topic == twice)
            raise ValueError(f"{both} fill the same channel {twice!r}")
        return found

    def along(self, axis: str) -> Displacement | None:
        """The sensor along an axis."""
        return next((d for d in self.displacements if d.axis == axis), None)

    @property
    def gain_stds(self) -> tuple[float, float]:
        """Relative standard uncertainties of the displacements along x and y; the usual one where no sensor looks."""
        x, y = (USUAL_GAIN_STD if (d := self.along(axis)) is None else d.gain_std for axis in "xy")
        return x, y

    @property
    def zero_std_deg(self) -> float:
        """Standard uncertainty of each encoder's zero; the usual one where the rig has none."""
        return self.angles.zero_std_deg if self.angles else USUAL_ZERO_STD_DEG

    @property
    def device_of(self) -> dict[str, str]:
        """Which device fills a channel, by topic."""
        return dict(self._filled())

    def _filled(self) -> Iterator[tuple[str, str]]:
        for role in (*self.displacements, self.angles, self.phase, self.speed, *self.others):
            if role is not None:
                yield role.topic, role.device


_PLACES = {"pendulum angles": "angles", "rotor phase": "phase", "speed source": "speed", "pendulum locks": "locks"}


def _refuse_second(first: Role | None, second: Role, what: str) -> None:
    if first is not None:
        raise ValueError(f"{first.device} and {second.device} are both the rig's {what}: expected one")
