"""The schema of the rig file. Every number has its unit in its name; unknown keys are refused.

A mass or length without a stated standard uncertainty (`mass_std_kg`, `length_std_m`, …) is not exact: the usual share
of it is assumed (rig_configs.known.USUAL_SHARE). 0 states an exact number.

A file has the physical part (rotor, imbalance, pendulums, suspension), the devices with their calibration, the limits
of the rig, the validation points, and, for a simulated rig, `virtual`: properties of its wires and sensors and, under
`virtual.truth`, the true numbers that differ from the file's physical part.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Annotated, Any, Literal, TypeVar, cast

from pydantic import BeforeValidator, Field, SerializeAsAny, create_model, field_validator, model_validator
from pydantic_core import PydanticCustomError
from typing_extensions import override

from dynamics.equations.parameters import Pendulum, RotorParameters, rolling_arm
from rig_configs.device import DeviceSettings
from rig_configs.drivers import installed, settings_of
from rig_configs.known import (
    INDEX,
    PHYSICAL,
    USUAL_SHARE,
    ZERO_A,
    ZERO_B,
    Instrument,
    KnownNumbers,
    own_source,
    physical_numbers,
    scale_source,
)
from rig_configs.physical_numbers import PHYSICAL_KEYS, PHYSICAL_NUMBERS, PhysicalNumber
from rig_configs.roles import USUAL_RELEASE_STD_S, Roles, role_table
from rig_configs.table import Finite, NotNegative, Positive, RigTable, Share

_Table = TypeVar("_Table", bound=RigTable)


class Rotor(RigTable):
    """Disk and column."""

    mass_kg: Annotated[float, PHYSICAL_NUMBERS["rotor.mass_kg"]]
    mass_std_kg: NotNegative | None = None


class Imbalance(RigTable):
    """The imbalance weight."""

    mass_kg: Annotated[float, PHYSICAL_NUMBERS["imbalance.mass_kg"]]
    radius_m: Annotated[float, PHYSICAL_NUMBERS["imbalance.radius_m"]]
    mass_std_kg: NotNegative | None = None
    radius_std_m: NotNegative | None = None

    @property
    def assumed_radius_std_m(self) -> float:
        """Standard uncertainty of the radius, m: the stated one, or the usual share of it."""
        return USUAL_SHARE * self.radius_m if self.radius_std_m is None else self.radius_std_m


class PendulumTable(RigTable):
    """One pendulum with its magnet pack, or a ball in a channel; mass 0: does not exist.

    drag_Nms2_per_rad2 is the air drag over the square of the speed relative to the rotor, friction_arm_m the dry
    friction torque per contact force. With ball_radius_m > 0 it is a ball whose centre is at length_m, with
    ball_inertia_ratio = I/(m r²) (0.4 for a sphere). rolling_resistance_m is a ball's coefficient of rolling resistance
    as a length: torque on the ball per contact force. It adds itself times length_m over ball_radius_m to the friction
    arm.
    """

    mass_kg: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.mass_kg"]]
    length_m: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.length_m"]]
    damping_Nms_per_rad: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.damping_Nms_per_rad"]]
    drag_Nms2_per_rad2: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.drag_Nms2_per_rad2"]] = 0.0
    friction_arm_m: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.friction_arm_m"]] = 0.0
    ball_radius_m: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.ball_radius_m"]] = 0.0
    ball_inertia_ratio: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.ball_inertia_ratio"]] = 0.4
    rolling_resistance_m: Annotated[float, PHYSICAL_NUMBERS["pendulums.a.rolling_resistance_m"]] = 0.0
    mass_std_kg: NotNegative | None = None
    length_std_m: NotNegative | None = None

    @model_validator(mode="after")
    def _only_balls_roll(self) -> PendulumTable:
        if self.rolling_resistance_m and not self.ball_radius_m:
            raise ValueError(
                f"rolling_resistance_m = {self.rolling_resistance_m:g} needs a ball: expected ball_radius_m above 0 as "
                "well, or friction_arm_m for a pendulum"
            )
        return self

    @property
    def physics(self) -> Pendulum:
        """Parameters for dynamics."""
        own = self.model_dump(exclude={"mass_std_kg", "length_std_m", "rolling_resistance_m"})
        if self.rolling_resistance_m:
            own["friction_arm_m"] += rolling_arm(self.rolling_resistance_m, self.length_m, self.ball_radius_m)
        return Pendulum(**own)


class Pendulums(RigTable):
    """Both pendulums: A starts locked at 0°, B at 180°.

    release_std_s is the standard uncertainty of the instant at which each lock opens, relative to the message that the
    lock is open. A fit of a release estimates that instant.
    """

    a: PendulumTable
    b: PendulumTable
    pivot_shift_m: Annotated[float, PHYSICAL_NUMBERS["pendulums.pivot_shift_m"]] = 0.0
    pivot_shift_compensated: bool = True
    pivot_shift_std_m: NotNegative | None = None
    release_std_s: Annotated[float, Field(ge=0, le=0.02)] = USUAL_RELEASE_STD_S


class Suspension(RigTable):
    """Springs and eddy-current dampers, k1 and ζ1 along x, k2 and ζ2 along y; gravity along −y for a lying shaft."""

    k1_N_per_m: Annotated[float, PHYSICAL_NUMBERS["suspension.k1_N_per_m"]]
    k2_N_per_m: Annotated[float, PHYSICAL_NUMBERS["suspension.k2_N_per_m"]]
    zeta1: Annotated[float, PHYSICAL_NUMBERS["suspension.zeta1"]]
    zeta2: Annotated[float, PHYSICAL_NUMBERS["suspension.zeta2"]]
    gravity_m_per_s2: Annotated[float, PHYSICAL_NUMBERS["suspension.gravity_m_per_s2"]] = 0.0


def _settings(value: object) -> object:
    """Convert a device's table to its driver's settings; errors contain the driver's own keys."""
    if isinstance(value, DeviceSettings) or not isinstance(value, dict):
        return value
    table = cast("dict[str, object]", value)
    name = table.get("driver")
    if name is None:
        raise PydanticCustomError(
            NO_DRIVER, "no driver; expected driver = one of {drivers}", {"drivers": ", ".join(installed())}
        )
    if not isinstance(name, str):
        raise ValueError(f"driver: expected one of {', '.join(installed())}, got {name!r}")
    return settings_of(name).model_validate(table)


AnyDevice = Annotated[SerializeAsAny[DeviceSettings], BeforeValidator(_settings)]
DeviceName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
NO_DRIVER = "no_driver"
"""Type of the validation error of a device table without a driver."""
_RESERVED = ("host", "log")  # devices of events that the suite itself creates


class Limits(RigTable):
    """Limits beyond which the rotor is stopped."""

    speed_rpm: Annotated[float, PHYSICAL_NUMBERS["limits.speed_rpm"]] = 1200.0
    amplitude_m: Annotated[float, PHYSICAL_NUMBERS["limits.amplitude_m"]] = 0.011


class Point(RigTable):
    """A validation point on the line of the rig's own stiffness ratio."""

    speed_ratio: Annotated[float, Field(gt=0, le=100)]
    expected: Literal["I", "II", "III", "slipping"]


class ValidationTable(RigTable):
    """Allowances of the comparison at the points.

    model_std_deg and model_std_mm are standard uncertainties of the model itself, for angles and for amplitudes, in
    addition to those of numbers and sensors. releases: whether the first seconds after each release are compared with
    the model in addition to the steady states.
    """

    model_std_deg: NotNegative = 0.0
    model_std_mm: NotNegative = 0.0
    releases: bool = True


class SimulatedSensors(RigTable):
    """Imperfections of the simulated sensors and wires; random values depend on the seed.

    Attributes:
        laser_nonlinearity_m: deviation of a laser's reading from a line at both ends of its range, cubic between them.
        hum_m, hum_Hz: amplitude and frequency of the hum of a noisy supply in the readings of the lasers.
        laser_hysteresis_m: difference between a laser's readings of a target that came from above and from below.
    """

    laser_noise_m: NotNegative = 4e-6
    hum_m: NotNegative = 0.0
    hum_Hz: Positive = 50.0
    laser_nonlinearity_m: Finite = 0.0
    laser_hysteresis_m: NotNegative = 0.0
    axis_angle_deg: Finite = 1.0
    encoder_noise_counts: NotNegative = 0.3
    clock_drift_ppm: NotNegative = 30.0
    clock_offset_s: NotNegative = 100.0
    draw_calibration: bool = True


class Radio(RigTable):
    """Radio link between node and dongle: a two-state loss model and a delay with jitter."""

    burst_start: Share = 0.002
    burst_stop: Annotated[float, Field(gt=0, le=1)] = 0.4
    loss_in_burst: Annotated[float, Field(ge=0, le=1)] = 0.8
    delay_s: NotNegative = 0.003
    jitter_s: NotNegative = 0.002


class VirtualDrive(RigTable):
    """The simulated drive: slip relative to the commanded speed, lag of its speed loop, interval of its reports."""

    slip: Annotated[float, Field(ge=-0.05, le=0.05)] = 0.002
    lag_s: NotNegative = 0.08
    report_s: Annotated[float, Field(ge=0.001, le=1)] = 0.01


def _may_state(numbers: Mapping[str, PhysicalNumber]) -> type[RigTable]:
    """Return a table that may state each of some physical numbers, by dotted key in the table."""
    parts: dict[str, dict[str, PhysicalNumber]] = {}
    for key, number in numbers.items():
        name, _, inside = key.partition(".")
        parts.setdefault(name, {})[inside] = number
    fields: dict[str, Any] = {}
    for name, inner in parts.items():
        if number := inner.get(""):
            kind: Any = Annotated[float, number]
            fields[name] = (kind | None, None)
        else:
            table = _may_state(inner)
            fields[name] = (table, table())
    return create_model("Truth", __base__=RigTable, **fields)


class Truth(_may_state({key: PHYSICAL_NUMBERS[key] for key in PHYSICAL_KEYS})):
    """True numbers of the simulated rig that differ from the rig file's physical part. Only its bytes reveal them."""

    @override
    def __reduce__(self) -> tuple[Callable[..., Truth], tuple[dict[str, Any]]]:
        """Be sent to other processes as its numbers: no module has the tables inside it."""
        return Truth.model_validate, (self.model_dump(exclude_unset=True),)


class Virtual(RigTable):
    """A simulated rig with the same wires as a real one."""

    seed: Annotated[int, Field(ge=0)] = 0
    lock_play_deg: NotNegative = 0.2
    sensors: SimulatedSensors = SimulatedSensors()
    radio: Radio = Radio()
    drive: VirtualDrive = VirtualDrive()
    truth: Truth = Truth()


class Rig(RigTable):
    """A complete rig file."""

    name: str
    rotor: Rotor
    imbalance: Imbalance
    pendulums: Pendulums
    suspension: Suspension
    devices: dict[DeviceName, AnyDevice]
    limits: Limits = Limits()
    points: dict[str, Point]
    validation: ValidationTable = ValidationTable()
    instruments: dict[DeviceName, Instrument] = Field(default_factory=dict[str, Instrument])
    virtual: Virtual | None = None

    @property
    def physics(self) -> RotorParameters:
        """Physical part as parameters for dynamics."""
        return RotorParameters(
            rotor_mass_kg=self.rotor.mass_kg,
            imbalance_mass_kg=self.imbalance.mass_kg,
            imbalance_radius_m=self.imbalance.radius_m,
            a=self.pendulums.a.physics,
            b=self.pendulums.b.physics,
            pivot_shift_m=self.pendulums.pivot_shift_m,
            pivot_shift_compensated=self.pendulums.pivot_shift_compensated,
            **self.suspension.model_dump(),
        )

    @property
    def roles(self) -> Roles:
        """Roles of its devices, which all code above the drivers uses."""
        return Roles.of(role for name, device in self.devices.items() for role in device.timed_roles(name))

    @property
    def known(self) -> KnownNumbers:
        """Known numbers with standard uncertainties and common sources of error."""
        values = physical_numbers(self.physics) | dict.fromkeys((ZERO_A, ZERO_B, INDEX), 0.0)
        instrument_of = {name: each for each in self.instruments.values() for name in each.measures}
        scales = [scale_source(name, each, values) for name, each in self.instruments.items()]
        by_scale = {name for scale in scales if scale is not None for name in scale.effects}
        stated = self._stds()
        assumed = tuple(n for n, std in stated.items() if std is None and values[n] and n not in by_scale)
        stds = stated | {name: USUAL_SHARE * values[name] for name in assumed}
        found = [own_source(name, std, instrument_of.get(name)) for name, std in stds.items() if std]
        return KnownNumbers(values, (*found, *(scale for scale in scales if scale is not None)), assumed)

    def _stds(self) -> dict[str, float | None]:
        """Return the standard uncertainty of each number alone; None where the rig file does not state it."""
        zero, phase = math.radians(self.roles.zero_std_deg), self.roles.phase
        index = math.radians(phase.index_angle_std_deg) if phase else 0.0
        stated = {name: attrgetter(PHYSICAL_NUMBERS[name].std_key)(self) for name in PHYSICAL}
        return stated | {ZERO_A: zero, ZERO_B: zero, INDEX: index}

    @model_validator(mode="after")
    def _instruments_measure_numbers_of_the_rig(self) -> Rig:
        measured: dict[str, str] = {}
        for name, instrument in self.instruments.items():
            for number in instrument.measures:
                if number not in PHYSICAL:
                    raise ValueError(f"instruments.{name}.measures: expected {', '.join(PHYSICAL)}, got {number!r}")
                if number in measured:
                    raise ValueError(f"{number} is measured by {measured[number]} and {name}: expected one instrument")
                measured[number] = name
        return self

    @field_validator("devices", mode="after")
    @classmethod
    def _names_are_free(cls, devices: dict[str, AnyDevice]) -> dict[str, AnyDevice]:
        if taken := [name for name in devices if name in _RESERVED]:
            raise ValueError(f"{taken[0]!r} cannot be a device's name: it is reserved for events of the suite itself")
        return devices

    @model_validator(mode="after")
    def _sensors_see_the_limit(self) -> Rig:
        for sensor in self.roles.displacements:
            if self.limits.amplitude_m >= sensor.reach_m:
                raise ValueError(
                    f"limits.amplitude_m = {self.limits.amplitude_m:g} cannot be measured: {sensor.device} reaches "
                    f"± {sensor.reach_m:g} m"
                )
        return self

    @model_validator(mode="after")
    def _has_physics(self) -> Rig:
        _ = self.physics  # a ValueError for numbers that are impossible only in combination
        _ = self.physics if self.virtual is None else self.true_physics
        return self

    def with_number(self, name: str, value: float) -> Rig:
        """Return the rig with one physical number changed.

        Args:
            name: name in rig_configs.known.PHYSICAL.
            value: new value in its unit.
        """
        changed: Any = value
        for part in reversed(name.split(".")):
            changed = {part: changed}
        return _with(self, changed)

    def snapshot_json(self) -> bytes:
        """Return the rig file for a log, without the numbers of a simulation."""
        return self.model_dump_json(exclude={"virtual"}).encode()

    def roles_json(self) -> bytes:
        """Return the roles by device for a reader of a log without the drivers."""
        roles = {name: [role_table(role) for role in device.timed_roles(name)] for name, device in self.devices.items()}
        return json.dumps(roles).encode()

    @property
    def true_physics(self) -> RotorParameters:
        """Numbers of the simulated rig; only for the virtual rig and the demo's closing comparison."""
        if self.virtual is None:
            raise ValueError(f"rig {self.name} is not simulated: it has no [virtual] table")
        changes = self.virtual.truth.model_dump(exclude_none=True)
        for pendulum in (changes["pendulums"]["a"], changes["pendulums"]["b"]):
            if "friction_arm_m" in pendulum:  # the whole true arm: rolling resistance is a part of it
                pendulum["rolling_resistance_m"] = 0.0
        return _with(self, changes).physics


def _with(table: _Table, changes: Mapping[str, Any]) -> _Table:
    """Return a table with other values; those of a table inside are a mapping."""
    update = dict(changes)
    for name, value in changes.items():
        if isinstance(inner := getattr(table, name), RigTable):
            update[name] = _with(inner, value)
    return table.model_copy(update=update)
