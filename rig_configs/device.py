"""Settings of a device in a rig file: its driver and its roles.

A driver's package has a settings class of its own, derived from one of these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, cast

from pydantic import BeforeValidator, ConfigDict, Field, field_validator
from typing_extensions import override

from rig_configs.physical_numbers import PHYSICAL_NUMBERS
from rig_configs.roles import (
    USUAL_DIRECTION_STD_DEG,
    USUAL_GAIN_STD,
    USUAL_ZERO_STD_DEG,
    Axis,
    DisplacementSensor,
    PendulumAngles,
    PendulumLocks,
    Role,
    RotorPhase,
    read_role,
)
from rig_configs.table import Finite, NotNegative, RigTable


def _as_text(serial: object) -> object:
    return str(serial) if isinstance(serial, int) and not isinstance(serial, bool) else serial


class DeviceSettings(RigTable):
    """Settings of every device.

    Attributes:
        driver: name of its driver, as `rig driver list` shows them.
        port: serial port ("/dev/ttyUSB0", "COM3"), "socket://host:port", "udp://address:port", another URL of pyserial,
            or "can:INTERFACE:CHANNEL" of python-can ("can:socketcan:can0").
        calibration: names of the settings that a calibration may correct in an old log; with a point before a setting
            of a table inside ("x.range_m").
        files: settings that name a text file, relative to the rig file, each with the setting that takes its text. A
            log contains the text, so it can be decoded without the file.
        serial: serial number of the device, digits or text; any other device is refused. "": any.
        calibrated: date and time (UTC) of the newest calibration, as `rig calibrate` writes it; "": never.
        calibration_record: file name of its record and the first digits of the file's SHA-256.
        least_delay_s: least time from a sample to the arrival of its bytes at the host: of a radio, a converter, a
            filter. Times of several devices agree only if it is known, since a host cannot measure it.
        serial_limit: for devices whose serial number is a number: the first one that is too large.
    """

    calibration: ClassVar[tuple[str, ...]] = ()
    files: ClassVar[Mapping[str, str]] = {}
    serial_limit: ClassVar[int | None] = None

    driver: str
    port: str
    serial: Annotated[str, BeforeValidator(_as_text), Field(max_length=80)] = ""
    least_delay_s: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    calibrated: Annotated[str, Field(max_length=40)] = ""
    calibration_record: Annotated[str, Field(max_length=200)] = ""

    @field_validator("serial")
    @classmethod
    def _is_a_number(cls, serial: str) -> str:
        limit = cls.serial_limit
        if serial and limit is not None and not (serial.isdecimal() and serial.isascii() and int(serial) < limit):
            raise ValueError(f"expected a number below {limit}, as the device reports it, got {serial!r}")
        return serial

    @property
    def serial_number(self) -> int:
        """Serial number as a number; 0: any."""
        return int(self.serial or 0)

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles of the device.

        Args:
            device: name of the device in the rig file.
        """
        return ()

    def timed_roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles of the device with the least delay of its bytes; see `roles`."""
        timed = DisplacementSensor | PendulumAngles | RotorPhase
        if not self.least_delay_s:
            return self.roles(device)
        delay_s = self.least_delay_s
        return tuple(replace(r, least_delay_s=delay_s) if isinstance(r, timed) else r for r in self.roles(device))


class DisplacementTable(RigTable):
    """Numbers of one sensor of the column's motion: those of a whole device, or of one of its signals.

    Attributes:
        axis: "x" or "y".
        range_m, range_std_m: measuring range, m; displacement 0 is its middle. With its standard uncertainty.
        lever_ratio, lever_ratio_std: displacement at the sensor over that of the disk centre, with its standard
            uncertainty.
        gain_std: relative standard uncertainty of the sensor's calibration.
        gain_factor: displacement over the displacement that the driver computes, which every sample is multiplied by;
            `gain_std` is its relative standard uncertainty.
        offset_m, offset_std_m: displacement of the disk centre that is added after that, m, with its standard
            uncertainty.
        witness: name of its channel, `laser/NAME`, if another sensor measures along its axis for the rig; "" for the
            measuring sensor.
        direction_deg, direction_std_deg: direction of the sensor, degrees, if it differs from its axis, with its
            standard uncertainty.
    """

    axis: Axis
    range_m: Annotated[float, PHYSICAL_NUMBERS["range_m"]] = 0.025
    range_std_m: NotNegative = 0.0
    lever_ratio: Annotated[float, PHYSICAL_NUMBERS["lever_ratio"]] = 1.0
    lever_ratio_std: NotNegative = 0.0
    gain_std: Annotated[float, PHYSICAL_NUMBERS["gain_std"]] = USUAL_GAIN_STD
    gain_factor: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    offset_m: Annotated[float, Field(ge=-1, le=1)] = 0.0
    offset_std_m: NotNegative = 0.0
    direction_deg: Finite | None = None
    direction_std_deg: NotNegative = USUAL_DIRECTION_STD_DEG
    witness: Annotated[str, Field(pattern=r"^([a-z][a-z0-9_]{0,30})?$")] = ""

    @field_validator("witness", mode="after")
    @classmethod
    def _has_a_channel_of_its_own(cls, witness: str) -> str:
        if witness in ("x", "y"):
            raise ValueError(f"expected the name of a channel of its own, got {witness!r}: that is an axis' channel")
        return witness

    @property
    def topic(self) -> str:
        """Topic of its channel."""
        return f"laser/{self.witness or self.axis}"

    @property
    def _total_gain_std(self) -> float:
        """Relative standard uncertainty of calibration, range and lever together."""
        parts = (self.gain_std, self.range_std_m / self.range_m, self.lever_ratio_std / self.lever_ratio)
        return math.hypot(*parts)

    def sensor(self, device: str, rate_Hz: float, clock_tolerance_ppm: float, clock: str = "") -> DisplacementSensor:
        """Return the role of the sensor.

        Args:
            device: name of its device in the rig file.
            rate_Hz: samples per second.
            clock_tolerance_ppm: standard uncertainty of the rate of the device's clock.
            clock: see DisplacementSensor.
        """
        return DisplacementSensor(
            device=device,
            topic=self.topic,
            axis=self.axis,
            rate_Hz=float(rate_Hz),
            range_m=self.range_m,
            lever_ratio=self.lever_ratio,
            gain_std=self._total_gain_std,
            clock_tolerance_ppm=clock_tolerance_ppm,
            witness=bool(self.witness),
            direction_deg=self.direction_deg,
            direction_std_deg=self.direction_std_deg,
            clock=clock,
        )


def displacement_tables(settings: DeviceSettings) -> tuple[DisplacementTable, ...]:
    """Return the tables of the displacement sensors of a device: itself, or tables inside, also in tables of tables."""
    if isinstance(settings, DisplacementTable):
        return (settings,)
    values: list[object] = [value for _, value in settings]
    inside = [
        each for value in values if isinstance(value, Mapping) for each in cast("list[object]", [*value.values()])
    ]
    return tuple(each for each in (*values, *inside) if isinstance(each, DisplacementTable))


DISPLACEMENT_CALIBRATION = (
    "range_m",
    "lever_ratio",
    "gain_std",
    "clock_tolerance_ppm",
    "direction_deg",
    "direction_std_deg",
    "gain_factor",
    "offset_m",
    "offset_std_m",
)
"""Settings of a DisplacementTable that a calibration may correct."""


class SampledTable(DisplacementTable):
    """A sensor of the column's motion with a sample rate and a clock of its own.

    Attributes:
        rate_Hz: samples per second.
        clock_tolerance_ppm: standard uncertainty of the rate of the sensor's clock, ppm.
    """

    rate_Hz: Annotated[float, PHYSICAL_NUMBERS["sensor.rate_Hz"]]
    clock_tolerance_ppm: Annotated[float, PHYSICAL_NUMBERS["clock_tolerance_ppm"]] = 30.0

    def sampled(self, device: str, clock: str = "") -> DisplacementSensor:
        """Return the role of the sensor; see DisplacementSensor."""
        return self.sensor(device, self.rate_Hz, self.clock_tolerance_ppm, clock)


class DisplacementSettings(SampledTable, DeviceSettings):
    """Settings of a sensor of the column's motion; see DisplacementTable.

    Attributes:
        names_its_channel: whether the driver records in the channel `topic`; otherwise it cannot be a witness.
    """

    calibration: ClassVar[tuple[str, ...]] = (
        *DISPLACEMENT_CALIBRATION,
        "least_delay_s",
        "calibrated",
        "calibration_record",
    )

    names_its_channel: ClassVar[bool] = False

    @field_validator("witness", mode="after")
    @classmethod
    def _has_a_channel(cls, witness: str) -> str:
        if witness and not cls.names_its_channel:
            raise ValueError("this driver records in the channel of its axis only, so its device cannot be a witness")
        return witness

    @override
    def roles(self, device: str) -> tuple[Role, ...]:
        return (self.sampled(device),)


class RotorNodeSettings(DeviceSettings):
    """A node on the rotor: both pendulum encoders, the index mark, and the locks if the rig commands any.

    Attributes:
        rate_Hz: samples per second.
        counts_per_revolution: counts of an encoder for one revolution.
        index_angle_deg, index_angle_std_deg: ψ (imbalance direction from +x) at the index mark, degrees, with its
            standard uncertainty.
        zero_std_deg: standard uncertainty of each encoder's zero against the imbalance direction, degrees.
        clock_tolerance_ppm: standard uncertainty of the rate of the node's clock, ppm.
        locks: whether the rig commands locks of this node.
        node: number of the rig's node; None: the first one that sends samples.
        index_marks: whether its index marks are the rig's rotor phase. If not, they are ignored: another device marks
            the rotor's phase, or the node has no index sensor.
        angles: whether its encoders measure the pendulums' angles for the rig. Otherwise another device does, and only
            the index marks of this node are used; its locks need `locks = false`, as their state comes with its angles.
    """

    calibration: ClassVar[tuple[str, ...]] = (
        "counts_per_revolution",
        "index_angle_deg",
        "index_angle_std_deg",
        "zero_std_deg",
        "clock_tolerance_ppm",
        "least_delay_s",
        "calibrated",
        "calibration_record",
    )

    rate_Hz: Annotated[int, PHYSICAL_NUMBERS["node.rate_Hz"]] = 1000
    counts_per_revolution: Annotated[int, Field(ge=64)] = 4096
    index_angle_deg: Finite = 0.0
    index_angle_std_deg: NotNegative = 0.0
    zero_std_deg: NotNegative = USUAL_ZERO_STD_DEG
    clock_tolerance_ppm: Annotated[float, PHYSICAL_NUMBERS["clock_tolerance_ppm"]] = 30.0
    locks: bool = True
    index_marks: bool = True
    angles: bool = True
    node: Annotated[int | None, Field(ge=0, le=255)] = None

    @override
    def roles(self, device: str) -> tuple[Role, ...]:
        tolerance = self.clock_tolerance_ppm
        angles = PendulumAngles(
            device=device,
            topic="pendulums",
            rate_Hz=float(self.rate_Hz),
            zero_std_deg=self.zero_std_deg,
            counts_per_revolution=self.counts_per_revolution,
            clock_tolerance_ppm=tolerance,
        )
        return (
            *([angles] if self.angles else []),
            *([self._phase(device)] if self.index_marks else []),
            *([PendulumLocks(device=device)] if self.locks else []),
        )

    def _phase(self, device: str) -> RotorPhase:
        return RotorPhase(
            device=device,
            topic="tacho",
            index_angle_deg=self.index_angle_deg,
            clock_tolerance_ppm=self.clock_tolerance_ppm,
            index_angle_std_deg=self.index_angle_std_deg,
        )


def _read_roles(tables: object) -> object:
    if not isinstance(tables, list | tuple):
        raise ValueError(f"expected a list of roles, got {tables!r:.60}")
    return tuple(read_role(table) for table in cast("list[object]", tables))


class StoredDevice(DeviceSettings):
    """A device of a log whose driver is not installed: settings as stored, roles as the log contains them."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")

    stored_roles: Annotated[tuple[Any, ...], BeforeValidator(_read_roles)] = ()

    @override
    def roles(self, device: str) -> tuple[Role, ...]:
        return self.stored_roles
