"""The rig file's schema. Every number carries its unit in its name; unknown keys are refused.

A file has the physical part (rotor, imbalance, pendulums, suspension), the devices with their calibration, the
limits that guard the rig, the validation points, and, for a simulated rig, `virtual`: what its wires and sensors
are like and, under `virtual.truth`, where its true numbers differ from the file's physical part.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from dynamics.parameters import Pendulum, RotorParameters

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, lt=1)]


class Table(BaseModel):
    """A table of the rig file: frozen, unknown keys refused; a number is a finite number, not true and not a text."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Rotor(Table):
    """Disk and column."""

    mass_kg: Annotated[float, Field(gt=0, le=1e4)]


class Imbalance(Table):
    """The brass weight."""

    mass_kg: Annotated[float, Field(ge=0, le=100)]
    radius_m: Annotated[float, Field(ge=0, le=1)]


class PendulumTable(Table):
    """One pendulum with its magnet pack, or a ball in a channel; mass 0 for none.

    friction_arm_m is the dry friction torque per contact force; ball_radius_m > 0 makes it a ball whose centre runs
    at length_m, with ball_inertia_ratio = I/(m r²) (0.4 for a sphere).
    """

    mass_kg: Annotated[float, Field(ge=0, le=100)]
    length_m: Annotated[float, Field(gt=0, le=1)]
    damping_Nms_per_rad: Annotated[float, Field(ge=0, le=50)]
    friction_arm_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    ball_radius_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    ball_inertia_ratio: Annotated[float, Field(ge=0, le=1)] = 0.4

    @property
    def physics(self) -> Pendulum:
        """As dynamics takes it."""
        return Pendulum(**self.model_dump())


class Pendulums(Table):
    """Both pendulums: A starts locked at 0°, B at 180°."""

    a: PendulumTable
    b: PendulumTable
    pivot_shift_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    pivot_shift_compensated: bool = True


class Suspension(Table):
    """Springs and eddy-current dampers, k1 and ζ1 along x, k2 and ζ2 along y; gravity along −y for a lying shaft."""

    k1_N_per_m: Annotated[float, Field(gt=0, le=1e9)]
    k2_N_per_m: Annotated[float, Field(gt=0, le=1e9)]
    zeta1: Annotated[float, Field(ge=0, le=2)]
    zeta2: Annotated[float, Field(ge=0, le=2)]
    gravity_m_per_s2: Annotated[float, Field(ge=0, le=30)] = 0.0


class Laser(Table):
    """An optoNCDT displacement sensor on its serial line.

    lever_ratio is the sensor's displacement over the disk centre's (below 1 when it looks at the column under the
    disk); gain_std is the relative standard uncertainty of calibration and lever together.
    """

    driver: Literal["optoncdt"]
    port: str
    axis: Literal["x", "y"]
    baud: Annotated[int, Field(ge=9600, le=1_000_000)] = 921_600
    rate_Hz: Literal[250, 500, 1000, 2000, 4000] = 4000
    range_m: Positive = 0.025
    lever_ratio: Positive = 1.0
    gain_std: Annotated[float, Field(ge=0, le=0.1)] = 0.001
    clock_tolerance_ppm: Positive = 30.0


class EncoderNode(Table):
    """The on-rotor node: both pendulum encoders and the tachometer mark, behind a radio dongle.

    index_angle_deg is ψ (imbalance direction from +x) when the index mark fires; zero_std_deg is the standard
    uncertainty of each encoder's zero against the imbalance direction.
    """

    driver: Literal["rotorlink"]
    port: str
    baud: Annotated[int, Field(ge=230_400)] = 921_600
    rate_Hz: Annotated[int, Field(ge=10, le=5000)] = 1000
    counts_per_revolution: Annotated[int, Field(ge=64)] = 4096
    index_angle_deg: Finite = 0.0
    zero_std_deg: NotNegative = 0.05
    clock_tolerance_ppm: Positive = 30.0


class Drive(Table):
    """The CiA 402 motor drive behind a CAN adapter."""

    driver: Literal["cia402"]
    port: str
    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 500_000
    node_id: Annotated[int, Field(ge=1, le=127)] = 5
    host_node_id: Annotated[int, Field(ge=1, le=127)] = 1
    heartbeat_ms: Annotated[int, Field(ge=10, le=1000)] = 100
    heartbeat_timeout_ms: Annotated[int, Field(ge=50, le=800)] = 500
    ramp_rpm_per_s: Annotated[float, Field(gt=0, le=1000)] = 120.0

    @model_validator(mode="after")
    def _beats_before_timeout(self) -> Drive:
        if self.heartbeat_timeout_ms < 2 * self.heartbeat_ms:
            raise ValueError("heartbeat_timeout_ms must be at least twice heartbeat_ms, or one late beat stops the rig")
        return self


class Devices(Table):
    """What is plugged in. All four are needed for the guided tests."""

    laser_x: Laser
    laser_y: Laser
    encoder: EncoderNode
    drive: Drive

    @model_validator(mode="after")
    def _axes(self) -> Devices:
        if (self.laser_x.axis, self.laser_y.axis) != ("x", "y"):
            raise ValueError('laser_x must look along axis "x" and laser_y along "y"')
        return self


class Limits(Table):
    """Beyond these the rig is stopped."""

    speed_rpm: Annotated[float, Field(gt=0, le=3000)] = 1200.0
    amplitude_m: Positive = 0.011


class Point(Table):
    """A validation point on the line of the rig's own stiffness ratio."""

    speed_ratio: Annotated[float, Field(gt=0, le=100)]
    expected: Literal["I", "II", "III", "slipping"]


class Sensors(Table):
    """How the simulated sensors and wires fall short of ideal; drawn values come from the seed."""

    laser_noise_m: NotNegative = 4e-6
    axis_angle_deg: Finite = 1.0
    encoder_noise_counts: NotNegative = 0.3
    clock_drift_ppm: NotNegative = 30.0
    clock_offset_s: NotNegative = 100.0
    draw_calibration: bool = True


class Radio(Table):
    """The air between node and dongle: a two-state loss model and a delay that jitters."""

    burst_start: Share = 0.002
    burst_stop: Annotated[float, Field(gt=0, le=1)] = 0.4
    loss_in_burst: Annotated[float, Field(ge=0, le=1)] = 0.8
    delay_s: NotNegative = 0.003
    jitter_s: NotNegative = 0.002


class VirtualDrive(Table):
    """The simulated drive: slip against the commanded speed, the lag of its speed loop, how often it reports."""

    slip: Annotated[float, Field(ge=-0.05, le=0.05)] = 0.002
    lag_s: NotNegative = 0.08
    report_s: Annotated[float, Field(ge=0.001, le=1)] = 0.01


class TruthPendulum(Table):
    """True numbers of one pendulum; what is absent is as in the file's physical part."""

    mass_kg: Positive | None = None
    length_m: Positive | None = None
    damping_Nms_per_rad: NotNegative | None = None


class TruthPendulums(Table):
    """True numbers of the pendulums."""

    a: TruthPendulum = TruthPendulum()
    b: TruthPendulum = TruthPendulum()
    pivot_shift_m: NotNegative | None = None


class TruthRotor(Table):
    """True mass of the rotor."""

    mass_kg: Positive | None = None


class TruthImbalance(Table):
    """True imbalance."""

    mass_kg: NotNegative | None = None
    radius_m: NotNegative | None = None


class TruthSuspension(Table):
    """True suspension."""

    k1_N_per_m: Positive | None = None
    k2_N_per_m: Positive | None = None
    zeta1: NotNegative | None = None
    zeta2: NotNegative | None = None


class Truth(Table):
    """Where the simulated rig differs from the rig file's physical part. Only its bytes tell anyone."""

    rotor: TruthRotor = TruthRotor()
    imbalance: TruthImbalance = TruthImbalance()
    pendulums: TruthPendulums = TruthPendulums()
    suspension: TruthSuspension = TruthSuspension()


class Virtual(Table):
    """A simulated rig behind the same wires."""

    seed: Annotated[int, Field(ge=0)] = 0
    lock_play_deg: NotNegative = 0.2
    sensors: Sensors = Sensors()
    radio: Radio = Radio()
    drive: VirtualDrive = VirtualDrive()
    truth: Truth = Truth()


class Rig(Table):
    """A whole rig file."""

    name: str
    rotor: Rotor
    imbalance: Imbalance
    pendulums: Pendulums
    suspension: Suspension
    devices: Devices
    limits: Limits = Limits()
    points: dict[str, Point]
    virtual: Virtual | None = None

    @property
    def physics(self) -> RotorParameters:
        """The physical part as dynamics takes it."""
        return _physics(self.rotor, self.imbalance, self.pendulums, self.suspension)

    @model_validator(mode="after")
    def _sensors_see_the_limit(self) -> Rig:
        for name, laser in (("laser_x", self.devices.laser_x), ("laser_y", self.devices.laser_y)):
            seen = 0.5 * laser.range_m / laser.lever_ratio
            if self.limits.amplitude_m >= seen:
                raise ValueError(
                    f"limits.amplitude_m = {self.limits.amplitude_m:g} can never be seen: {name} reaches ± {seen:g} m"
                )
        return self

    @model_validator(mode="after")
    def _has_physics(self) -> Rig:
        _ = self.physics  # refuses what the single limits let through; a ValueError
        _ = self.physics if self.virtual is None else self.true_physics
        return self

    def snapshot_json(self) -> bytes:
        """The rig file as it goes into a log: all a reader of the log needs, nothing only a simulation knows."""
        return self.model_dump_json(exclude={"virtual"}).encode()

    @property
    def true_physics(self) -> RotorParameters:
        """The simulated rig's own numbers; for the virtual rig and for the demo's closing comparison only."""
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
    """The physics with every number the truth gives in its place."""

    def given(table: Table) -> dict[str, float]:
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
