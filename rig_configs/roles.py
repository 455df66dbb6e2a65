# pyright: strict
"""What devices are to a rig: the roles they play, with the calibration that goes with each.

Everything above a driver asks for a role, never for a device's name or its maker's. A device's settings say which roles
it plays (`rig_configs.device.DeviceSettings.roles`); a log keeps them, so that it can be read where the driver is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import Field

from rig_configs.table import Finite, NotNegative, Positive

Axis = Literal["x", "y"]
AXIS_TOLERANCE_DEG, SQUARE_TOLERANCE_DEG = 10.0, 3.0
"""How far a sensor may look off its axis before that is more than mounting; how far two may be off a right angle."""
AT_REST_RPM = 1.0
"""A speed source's reading of a standing rotor may flicker by one count, where nothing else is said of it."""
USUAL_GAIN_STD, USUAL_ZERO_STD_DEG, USUAL_DIRECTION_STD_DEG = 0.001, 0.05, 1.0
"""Of a sensor of which nothing is said: also of one that recorded elsewhere and that the rig file does not know."""


@dataclass(frozen=True)
class Displacement:
    """A sensor of the column's motion.

    Attributes:
        topic: the channel its samples are in.
        axis: which of the two displacements it measures, "x" or "y".
        rate_Hz: samples a second.
        range_m: what it measures over; its middle is displacement 0.
        lever_ratio: its displacement over the disk centre's.
        gain_std: relative standard uncertainty of calibration and lever together.
        clock_tolerance_ppm: standard uncertainty of its clock's rate.
        witness: whether another sensor measures the displacement along the axis for the rig, and this one checks it.
        direction_deg: angle from +x, counter-clockwise, of the direction in which its reading grows; None: its axis'.
        direction_std_deg: standard uncertainty of how it was mounted against the suspension's axes.
    """

    role: ClassVar[str] = "displacement"

    device: str
    topic: str
    axis: Axis
    rate_Hz: Positive
    range_m: Positive
    clock_tolerance_ppm: NotNegative
    lever_ratio: Positive = 1.0
    gain_std: NotNegative = 0.0
    witness: bool = False
    direction_deg: Finite | None = None
    direction_std_deg: NotNegative = USUAL_DIRECTION_STD_DEG

    @property
    def off_axis_deg(self) -> float:
        """Angle from its axis to its direction, -180 to 180."""
        own = 0.0 if self.axis == "x" else 90.0
        return 0.0 if self.direction_deg is None else math.remainder(self.direction_deg - own, 360.0)

    @property
    def reach_m(self) -> float:
        """The largest displacement of the disk centre to either side that it sees, m."""
        return 0.5 * self.range_m / self.lever_ratio


@dataclass(frozen=True)
class PendulumAngles:
    """Encoders of both pendulums.

    Attributes:
        counts_per_revolution: of each encoder.
        zero_std_deg: standard uncertainty of each encoder's zero against the imbalance direction.
    """

    role: ClassVar[str] = "pendulum angles"

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


@dataclass(frozen=True)
class RotorPhase:
    """A mark once a revolution.

    Attributes:
        index_angle_deg: ψ (imbalance direction from +x) when the mark fires.
        index_angle_std_deg: its standard uncertainty.
    """

    role: ClassVar[str] = "rotor phase"

    device: str
    topic: str
    index_angle_deg: Finite
    clock_tolerance_ppm: NotNegative
    index_angle_std_deg: NotNegative = 0.0


@dataclass(frozen=True)
class SpeedSource:
    """What turns the rotor as told, and tells how fast it turns.

    Attributes:
        ramp_rpm_per_s: how fast it speeds up where a test has no ramp of its own.
        rest_rpm: its reading of a standing rotor is up to this.
    """

    role: ClassVar[str] = "speed source"

    device: str
    topic: str
    ramp_rpm_per_s: Positive
    rest_rpm: Positive = AT_REST_RPM


@dataclass(frozen=True)
class PendulumLocks:
    """What locks and releases the pendulums as told."""

    role: ClassVar[str] = "pendulum locks"

    device: str


@dataclass(frozen=True)
class OtherQuantity:
    """Anything else worth recording: it is kept, plotted and exported, and no test needs it.

    Attributes:
        fields: what the channel's fields are, by name, with the unit in it.
    """

    role: ClassVar[str] = "other quantity"

    device: str
    topic: str
    fields: tuple[str, ...]


Role = Displacement | PendulumAngles | RotorPhase | SpeedSource | PendulumLocks | OtherQuantity
_KINDS: dict[str, type[Role]] = {
    kind.role: kind for kind in (Displacement, PendulumAngles, RotorPhase, SpeedSource, PendulumLocks, OtherQuantity)
}


def role_table(role: Role) -> dict[str, Any]:
    """A role as JSON can hold it."""
    return {"role": role.role, **asdict(role)}


def read_role(table: object) -> Role:
    """A role from what JSON held.

    Raises:
        ValueError: no such role, or numbers that it cannot have.
    """
    if not isinstance(table, dict):
        raise ValueError(f"expected a role as a table, got {table!r:.60}")
    given = dict(cast("dict[str, Any]", table))
    name = given.pop("role", None)
    if name not in _KINDS:
        raise ValueError(f"expected a role of {', '.join(_KINDS)}, got {name!r:.60}")
    from pydantic import TypeAdapter  # noqa: PLC0415 (slow, and only logs without a driver need it)

    return TypeAdapter[Role](_KINDS[name]).validate_python(given)


@dataclass(frozen=True)
class Roles:
    """All roles that the devices of a rig play.

    Attributes:
        displacements: those that measure for the rig, by their axes, each at most once.
        angles, phase, speed, locks: who plays the role; None where no device does.
        others: whatever else is recorded.
        witnesses: further displacements along an axis; each is recorded and held against the axis' own sensor.
    """

    displacements: tuple[Displacement, ...] = ()
    angles: PendulumAngles | None = None
    phase: RotorPhase | None = None
    speed: SpeedSource | None = None
    locks: PendulumLocks | None = None
    others: tuple[OtherQuantity, ...] = ()
    witnesses: tuple[Displacement, ...] = ()

    @property
    def rest_rpm(self) -> float:
        """What the speed source's word on a standing rotor is at most."""
        return AT_REST_RPM if self.speed is None else self.speed.rest_rpm

    @classmethod
    def of(cls, played: Iterable[Role]) -> Roles:
        """Roles sorted by kind.

        Raises:
            ValueError: two devices play one role, or fill one channel.
        """
        displacements: list[Displacement] = []
        witnesses: list[Displacement] = []
        others: list[OtherQuantity] = []
        single: dict[str, Any] = {}
        for role in played:
            if isinstance(role, Displacement) and role.witness:
                witnesses.append(role)
            elif isinstance(role, Displacement):
                _refuse_second(
                    next((d for d in displacements if d.axis == role.axis), None),
                    role,
                    f"displacement along {role.axis}",
                    '; a second sensor of an axis is a witness of the first: witness = "NAME" in its table',
                )
                displacements.append(role)
            elif isinstance(role, OtherQuantity):
                others.append(role)
            else:
                _refuse_second(single.get(_PLACES[role.role]), role, role.role)
                single[_PLACES[role.role]] = role
        mains = tuple(sorted(displacements, key=lambda d: d.axis))
        _refuse_directions(mains)
        found = cls(mains, others=tuple(others), witnesses=tuple(witnesses), **single)
        topics = [topic for topic, _ in found._filled()]
        if twice := next((topic for topic in topics if topics.count(topic) > 1), None):
            both = " and ".join(device for topic, device in found._filled() if topic == twice)
            raise ValueError(f"{both} fill the same channel {twice!r}")
        return found

    def along(self, axis: str) -> Displacement | None:
        """The sensor that measures along an axis for the rig."""
        return next((d for d in self.displacements if d.axis == axis), None)

    def beside(self, witness: Displacement) -> Displacement | None:
        """The sensor that measures for the rig what a witness sees too; None where none looks in its direction."""
        main = self.along(witness.axis)
        if main is None or abs(math.remainder(main.off_axis_deg - witness.off_axis_deg, 360.0)) > SQUARE_TOLERANCE_DEG:
            return None
        return main

    @property
    def turn_deg(self) -> float:
        """Angle from the x axis to sensor x, and from y to sensor y; of one sensor alone, its own."""
        angles = [sensor.off_axis_deg for sensor in self.displacements]
        return angles[0] + 0.5 * math.remainder(angles[-1] - angles[0], 360.0) if angles else 0.0

    @property
    def mounted_deg(self) -> tuple[float, float]:
        """`turn_deg` and its standard uncertainty, one error of both sensors; the usual one where there is none."""
        stds = [sensor.direction_std_deg for sensor in self.displacements]
        return self.turn_deg, max(stds, default=USUAL_DIRECTION_STD_DEG)

    @property
    def duties(self) -> dict[str, str]:
        """What each displacement sensor measures, in words, by device."""
        words = {d.device: f"{d.axis}{_direction(d)}" for d in self.displacements}
        for witness in self.witnesses:
            beside = self.beside(witness)
            against = f", held against {beside.device}" if beside else ", held against no other: none looks its way"
            words[witness.device] = f"witness of {witness.axis}{_direction(witness)}{against}"
        return words

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
        for role in (*self.displacements, *self.witnesses, self.angles, self.phase, self.speed, *self.others):
            if role is not None:
                yield role.topic, role.device


_PLACES = {"pendulum angles": "angles", "rotor phase": "phase", "speed source": "speed", "pendulum locks": "locks"}


def _direction(sensor: Displacement) -> str:
    return "" if sensor.direction_deg is None else f", looking along {sensor.direction_deg:g}°"


def _refuse_directions(sensors: tuple[Displacement, ...]) -> None:
    """Two sensors may stand turned, at right angles; one alone looks along its axis."""
    if len(sensors) == 2:
        x, y = sensors
        skew = math.remainder(y.off_axis_deg - x.off_axis_deg, 360.0)
        if abs(skew) > SQUARE_TOLERANCE_DEG:
            raise ValueError(
                f"{x.device} and {y.device}: expected direction_deg of the sensor of y 90° beyond that of x, within "
                f"{SQUARE_TOLERANCE_DEG:g}°, got {90 + skew:g}°. Where it is about 270°, exchange their axis"
            )
    elif sensors and abs(sensors[0].off_axis_deg) > AXIS_TOLERANCE_DEG:
        raise ValueError(
            f"{sensors[0].device}: a single sensor must look along its axis within {AXIS_TOLERANCE_DEG:g}°, got "
            f"direction_deg = {sensors[0].direction_deg:g}: alone it sees both directions mixed. Add a second one at "
            "right angles, or turn it"
        )


def _refuse_second(first: Role | None, second: Role, what: str, advice: str = "") -> None:
    if first is not None:
        raise ValueError(f"{first.device} and {second.device} are both the rig's {what}: expected one{advice}")
