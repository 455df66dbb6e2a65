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
from dataclasses import replace
from typing import Annotated, Literal, cast

from pydantic import BeforeValidator, Field, SerializeAsAny, field_validator, model_validator
from pydantic_core import PydanticCustomError

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
from rig_configs.roles import USUAL_RELEASE_STD_S, Roles, role_table
from rig_configs.table import Finite, NotNegative, Positive, RigTable, Share


class Rotor(RigTable):
    """Disk and column."""

    mass_kg: Annotated[float, Field(gt=0, le=1e4)]
    mass_std_kg: NotNegative | None = None


class Imbalance(RigTable):
    """The imbalance weight."""

    mass_kg: Annotated[float, Field(ge=0, le=100)]
    radius_m: Annotated[float, Field(ge=0, le=1)]
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

    mass_kg: Annotated[float, Field(ge=0, le=100)]
    length_m: Annotated[float, Field(gt=0, le=1)]
    damping_Nms_per_rad: Annotated[float, Field(ge=0, le=50)]
    drag_Nms2_per_rad2: Annotated[float, Field(ge=0, le=1)] = 0.0
    friction_arm_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    ball_radius_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    ball_inertia_ratio: Annotated[float, Field(ge=0, le=1)] = 0.4
    rolling_resistance_m: Annotated[float, Field(ge=0, le=0.01)] = 0.0
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
    pivot_shift_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    pivot_shift_compensated: bool = True
    pivot_shift_std_m: NotNegative | None = None
    release_std_s: Annotated[float, Field(ge=0, le=0.02)] = USUAL_RELEASE_STD_S


class Suspension(RigTable):
    """Springs and eddy-current dampers, k1 and ζ1 along x, k2 and ζ2 along y; gravity along −y for a lying shaft."""

    k1_N_per_m: Annotated[float, Field(gt=0, le=1e9)]
    k2_N_per_m: Annotated[float, Field(gt=0, le=1e9)]
    zeta1: Annotated[float, Field(ge=0, le=2)]
    zeta2: Annotated[float, Field(ge=0, le=2)]
    gravity_m_per_s2: Annotated[float, Field(ge=0, le=30)] = 0.0


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

    speed_rpm: Annotated[float, Field(gt=0, le=3000)] = 1200.0
    amplitude_m: Positive = 0.011


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


class TruthPendulum(RigTable):
    """True numbers of one pendulum; missing ones are those of the file's physical part."""

    mass_kg: Positive | None = None
    length_m: Positive | None = None
    damping_Nms_per_rad: NotNegative | None = None
    friction_arm_m: NotNegative | None = None


class TruthPendulums(RigTable):
    """True numbers of the pendulums."""

    a: TruthPendulum = TruthPendulum()
    b: TruthPendulum = TruthPendulum()
    pivot_shift_m: NotNegative | None = None


class TruthRotor(RigTable):
    """True mass of the rotor."""

    mass_kg: Positive | None = None


class TruthImbalance(RigTable):
    """True imbalance."""

    mass_kg: NotNegative | None = None
    radius_m: NotNegative | None = None


class TruthSuspension(RigTable):
    """True suspension."""

    k1_N_per_m: Positive | None = None
    k2_N_per_m: Positive | None = None
    zeta1: NotNegative | None = None
    zeta2: NotNegative | None = None


class Truth(RigTable):
    """True numbers of the simulated rig that differ from the rig file's physical part. Only its bytes reveal them."""

    rotor: TruthRotor = TruthRotor()
    imbalance: TruthImbalance = TruthImbalance()
    pendulums: TruthPendulums = TruthPendulums()
    suspension: TruthSuspension = TruthSuspension()


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
        return _physics(self.rotor, self.imbalance, self.pendulums, self.suspension)

    @property
    def roles(self) -> Roles:
        """Roles of its devices, which all code above the drivers uses."""
        return Roles.of(role for name, device in self.devices.items() for role in device.timed_roles(name))

    @property
    def known(self) -> KnownNumbers:
        """Known numbers with standard uncertainties and common sources of error."""
        values = physical_numbers(self.physics) | {ZERO_A: 0.0, ZERO_B: 0.0, INDEX: 0.0}
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
        a, b, roles = self.pendulums.a, self.pendulums.b, self.roles
        zero = math.radians(roles.zero_std_deg)
        return {
            "rotor.mass_kg": self.rotor.mass_std_kg,
            "imbalance.mass_kg": self.imbalance.mass_std_kg,
            "pendulums.a.mass_kg": a.mass_std_kg,
            "pendulums.a.length_m": a.length_std_m,
            "pendulums.b.mass_kg": b.mass_std_kg,
            "pendulums.b.length_m": b.length_std_m,
            "pendulums.pivot_shift_m": self.pendulums.pivot_shift_std_m,
            ZERO_A: zero,
            ZERO_B: zero,
            INDEX: math.radians(roles.phase.index_angle_std_deg) if roles.phase else 0.0,
        }

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
        *path, key = name.split(".")
        tables: list[RigTable] = [self]
        for part in path:
            tables.append(getattr(tables[-1], part))
        changed = tables.pop().model_copy(update={key: value})
        for part in reversed(path):
            changed = tables.pop().model_copy(update={part: changed})
        assert isinstance(changed, Rig)
        return changed

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
        return _laid_over(self.physics, self.virtual.truth)


def _physics(rotor: Rotor, imbalance: Imbalance, pendulums: Pendulums, suspension: Suspension) -> RotorParameters:
    return RotorParameters(
        rotor_mass_kg=rotor.mass_kg,
        imbalance_mass_kg=imbalance.mass_kg,
        imbalance_radius_m=imbalance.radius_m,
        a=pendulums.a.physics,
        b=pendulums.b.physics,
        pivot_shift_m=pendulums.pivot_shift_m,
        pivot_shift_compensated=pendulums.pivot_shift_compensated,
        **suspension.model_dump(),
    )


def _laid_over(physics: RotorParameters, truth: Truth) -> RotorParameters:
    """Return the physics with the numbers of the truth in place of its own."""

    def given(table: RigTable) -> dict[str, float]:
        return {k: v for k, v in table if isinstance(v, float)}

    shift = truth.pendulums.pivot_shift_m
    return replace(
        physics,
        rotor_mass_kg=physics.rotor_mass_kg if truth.rotor.mass_kg is None else truth.rotor.mass_kg,
        **{f"imbalance_{k}": v for k, v in given(truth.imbalance).items()},
        a=replace(physics.a, **given(truth.pendulums.a)),
        b=replace(physics.b, **given(truth.pendulums.b)),
        **given(truth.suspension),
        pivot_shift_m=physics.pivot_shift_m if shift is None else shift,
    )
