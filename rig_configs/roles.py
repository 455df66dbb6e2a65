"""Roles of devices in a rig, with the calibration that belongs to each.

All code above the drivers uses roles, never a device's name or manufacturer. A device's settings determine its roles
(`rig_configs.device.DeviceSettings.roles`). A log contains them, so that it can be read without the driver.
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
"""Largest angle between a sensor and its axis that counts as mounting; largest deviation of two from a right angle."""
AT_REST_RPM = 1.0
"""Default of the reading of a speed source at a standing rotor, which may flicker by one count."""
USUAL_GAIN_STD, USUAL_ZERO_STD_DEG, USUAL_DIRECTION_STD_DEG = 0.001, 0.05, 1.0
USUAL_RELEASE_STD_S = 0.005
"""Standard uncertainty of the instant at which a lock opens after its message: usual for a pin that a magnet draws."""
"""Defaults of a sensor, also of one that recorded elsewhere and is not in the rig file."""


@dataclass(frozen=True)
class DisplacementSensor:
    """A sensor of the column's motion.

    Attributes:
        device: name of the device.
        topic: channel of its samples.
        axis: displacement that it measures, "x" or "y".
        rate_Hz: samples per second.
        range_m: measuring range; its middle is displacement 0.
        lever_ratio: its displacement over the disk centre's.
        gain_std: relative standard uncertainty of calibration and lever together.
        clock_tolerance_ppm: standard uncertainty of its clock's rate.
        least_delay_s: least time from a sample to the arrival of its bytes at the host.
        witness: whether another sensor measures the displacement along the axis for the rig, and this one checks it.
        direction_deg: angle from +x, counter-clockwise, of the direction of increasing readings; None: its axis'.
        direction_std_deg: standard uncertainty of the mounting relative to the suspension's axes.
        clock: name of its clock, if its device has several clocks.
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
    least_delay_s: NotNegative = 0.0
    clock: str = ""

    @property
    def off_axis_deg(self) -> float:
        """Angle from its axis to its direction, -180 to 180, °."""
        own = 0.0 if self.axis == "x" else 90.0
        return 0.0 if self.direction_deg is None else math.remainder(self.direction_deg - own, 360.0)

    @property
    def reach_m(self) -> float:
        """Largest measurable displacement of the disk centre to either side, m."""
        return 0.5 * self.range_m / self.lever_ratio


@dataclass(frozen=True)
class PendulumAngles:
    """Encoders of both pendulums.

    Attributes:
        counts_per_revolution: counts of each encoder.
        zero_std_deg: standard uncertainty of each encoder's zero relative to the imbalance direction.
        least_delay_s: see DisplacementSensor.
    """

    role: ClassVar[str] = "pendulum angles"

    device: str
    topic: str
    rate_Hz: Positive
    counts_per_revolution: Annotated[int, Field(ge=1)]
    zero_std_deg: NotNegative
    clock_tolerance_ppm: NotNegative
    least_delay_s: NotNegative = 0.0

    @property
    def step_rad(self) -> float:
        """Angle of one count, rad."""
        return 2 * math.pi / self.counts_per_revolution


@dataclass(frozen=True)
class RotorPhase:
    """A mark once per revolution.

    Attributes:
        index_angle_deg: ψ (imbalance direction from +x) at the mark.
        index_angle_std_deg: its standard uncertainty.
        least_delay_s: see DisplacementSensor.
    """

    role: ClassVar[str] = "rotor phase"

    device: str
    topic: str
    index_angle_deg: Finite
    clock_tolerance_ppm: NotNegative
    index_angle_std_deg: NotNegative = 0.0
    least_delay_s: NotNegative = 0.0


@dataclass(frozen=True)
class SpeedSource:
    """Device that turns the rotor by command and reports its speed.

    Attributes:
        ramp_rpm_per_s: acceleration if a test has no ramp of its own.
        rest_rpm: largest reading at a standing rotor.
    """

    role: ClassVar[str] = "speed source"

    device: str
    topic: str
    ramp_rpm_per_s: Positive
    rest_rpm: Positive = AT_REST_RPM


@dataclass(frozen=True)
class PendulumLocks:
    """Device that locks and releases the pendulums by command."""

    role: ClassVar[str] = "pendulum locks"

    device: str


@dataclass(frozen=True)
class OtherQuantity:
    """Any other quantity: it is recorded, plotted and exported, but no test needs it.

    Attributes:
        fields: names of the channel's fields, with units.
    """

    role: ClassVar[str] = "other quantity"

    device: str
    topic: str
    fields: tuple[str, ...]


Role = DisplacementSensor | PendulumAngles | RotorPhase | SpeedSource | PendulumLocks | OtherQuantity
_KINDS: dict[str, type[Role]] = {
    kind.role: kind
    for kind in (DisplacementSensor, PendulumAngles, RotorPhase, SpeedSource, PendulumLocks, OtherQuantity)
}


def role_table(role: Role) -> dict[str, Any]:
    """Convert a role to JSON values."""
    return {"role": role.role, **asdict(role)}


def read_role(table: object) -> Role:
    """Return a role from JSON values.

    Raises:
        ValueError: an unknown role, or impossible numbers.
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
    """All roles of the devices of a rig.

    Attributes:
        displacements: measuring sensors by their axes, each at most once.
        angles, phase, speed, locks: device with the role, or None.
        others: other recorded quantities.
        witnesses: further sensors along an axis; each is recorded and compared with the measuring sensor.
    """

    displacements: tuple[DisplacementSensor, ...] = ()
    angles: PendulumAngles | None = None
    phase: RotorPhase | None = None
    speed: SpeedSource | None = None
    locks: PendulumLocks | None = None
    others: tuple[OtherQuantity, ...] = ()
    witnesses: tuple[DisplacementSensor, ...] = ()

    @property
    def rest_rpm(self) -> float:
        """Largest reading of the speed source at a standing rotor, rpm."""
        return AT_REST_RPM if self.speed is None else self.speed.rest_rpm

    @classmethod
    def of(cls, played: Iterable[Role]) -> Roles:
        """Sort roles by kind.

        Raises:
            ValueError: two devices have the same role, or the same channel.
        """
        displacements: list[DisplacementSensor] = []
        witnesses: list[DisplacementSensor] = []
        others: list[OtherQuantity] = []
        single: dict[str, Any] = {}
        for role in played:
            if isinstance(role, DisplacementSensor) and role.witness:
                witnesses.append(role)
            elif isinstance(role, DisplacementSensor):
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

    def along(self, axis: str) -> DisplacementSensor | None:
        """Return the measuring sensor along an axis."""
        return next((d for d in self.displacements if d.axis == axis), None)

    def measuring_sensor(self, witness: DisplacementSensor) -> DisplacementSensor | None:
        """Return the measuring sensor that a witness is compared with; None if no sensor has its direction."""
        main = self.along(witness.axis)
        if main is None or abs(math.remainder(main.off_axis_deg - witness.off_axis_deg, 360.0)) > SQUARE_TOLERANCE_DEG:
            return None
        return main

    @property
    def turn_deg(self) -> float:
        """Angle from the x axis to sensor x, and from y to sensor y; with one sensor alone, its own."""
        angles = [sensor.off_axis_deg for sensor in self.displacements]
        return angles[0] + 0.5 * math.remainder(angles[-1] - angles[0], 360.0) if angles else 0.0

    @property
    def mounted_deg(self) -> tuple[float, float]:
        """`turn_deg` and its standard uncertainty, one error of both sensors; the default without sensors."""
        stds = [sensor.direction_std_deg for sensor in self.displacements]
        return self.turn_deg, max(stds, default=USUAL_DIRECTION_STD_DEG)

    @property
    def duties(self) -> dict[str, str]:
        """Measured quantity of each displacement sensor, in words, by device."""
        words = [(d.device, f"{d.axis}{_direction(d)}") for d in self.displacements]
        for witness in self.witnesses:
            main = self.measuring_sensor(witness)
            against = f", compared with {main.device}" if main else ", compared with no other: none has its direction"
            words.append((witness.device, f"witness of {witness.axis}{_direction(witness)}{against}"))
        return {device: "; ".join(text for name, text in words if name == device) for device, _ in words}

    @property
    def gain_stds(self) -> tuple[float, float]:
        """Relative standard uncertainties of the displacements along x and y; the default without a sensor."""
        x, y = (USUAL_GAIN_STD if (d := self.along(axis)) is None else d.gain_std for axis in "xy")
        return x, y

    @property
    def zero_std_deg(self) -> float:
        """Standard uncertainty of each encoder's zero; the default without encoders."""
        return self.angles.zero_std_deg if self.angles else USUAL_ZERO_STD_DEG

    @property
    def device_of(self) -> dict[str, str]:
        """Device of each channel, by topic."""
        return dict(self._filled())

    def _filled(self) -> Iterator[tuple[str, str]]:
        for role in (*self.displacements, *self.witnesses, self.angles, self.phase, self.speed, *self.others):
            if role is not None:
                yield role.topic, role.device


_PLACES = {"pendulum angles": "angles", "rotor phase": "phase", "speed source": "speed", "pendulum locks": "locks"}


def _direction(sensor: DisplacementSensor) -> str:
    return "" if sensor.direction_deg is None else f", looking along {sensor.direction_deg:g}°"


def _refuse_directions(sensors: tuple[DisplacementSensor, ...]) -> None:
    """Check directions: two sensors at right angles may be rotated, a single one must be near its axis."""
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
            f"direction_deg = {sensors[0].direction_deg:g}: alone it measures both directions mixed. Add a second "
            "one at right angles, or turn it"
        )


def _refuse_second(first: Role | None, second: Role, what: str, advice: str = "") -> None:
    if first is not None:
        raise ValueError(f"{first.device} and {second.device} are both the rig's {what}: expected one{advice}")
