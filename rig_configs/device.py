"""Settings of a device in a rig file: its driver and its roles.

A driver's package has a settings class of its own, derived from one of these.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, cast

from pydantic import BeforeValidator, ConfigDict, Field, field_validator

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
from rig_configs.table import Finite, NotNegative, Positive, RigTable


class DeviceSettings(RigTable):
    """Settings of every device.

    Attributes:
        calibration: names of the settings that a calibration may correct in an old log.
    """

    calibration: ClassVar[tuple[str, ...]] = ()

    driver: str
    port: str

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles of the device.

        Args:
            device: name of the device in the rig file.
        """
        return ()


class DisplacementSettings(DeviceSettings):
    """Settings of a sensor of the column's motion; the numbers are those of Displacement.

    Attributes:
        witness: name of its channel, `laser/NAME`, if another sensor measures along its axis for the rig; "" for the
            measuring sensor.
        direction_deg: direction of the sensor, if it differs from its axis.
        names_its_channel: whether the driver records in the channel `topic`; otherwise it cannot be a witness.
    """

    calibration: ClassVar[tuple[str, ...]] = (
        "range_m",
        "lever_ratio",
        "gain_std",
        "clock_tolerance_ppm",
        "direction_deg",
        "direction_std_deg",
    )

    names_its_channel: ClassVar[bool] = False

    axis: Axis
    rate_Hz: Positive
    range_m: Positive = 0.025
    range_std_m: NotNegative = 0.0
    lever_ratio: Positive = 1.0
    lever_ratio_std: NotNegative = 0.0
    gain_std: Annotated[float, Field(ge=0, le=0.1)] = USUAL_GAIN_STD
    clock_tolerance_ppm: Positive = 30.0
    direction_deg: Finite | None = None
    direction_std_deg: NotNegative = USUAL_DIRECTION_STD_DEG
    witness: Annotated[str, Field(pattern=r"^([a-z][a-z0-9_]{0,30})?$")] = ""

    @field_validator("witness", mode="after")
    @classmethod
    def _has_a_channel(cls, witness: str) -> str:
        if witness in ("x", "y"):
            raise ValueError(f"expected the name of a channel of its own, got {witness!r}: that is an axis' channel")
        if witness and not cls.names_its_channel:
            raise ValueError("this driver records in the channel of its axis only, so its device cannot be a witness")
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

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles; see DeviceSettings."""
        return (
            DisplacementSensor(
                device=device,
                topic=self.topic,
                axis=self.axis,
                rate_Hz=float(self.rate_Hz),
                range_m=self.range_m,
                lever_ratio=self.lever_ratio,
                gain_std=self._total_gain_std,
                clock_tolerance_ppm=self.clock_tolerance_ppm,
                witness=bool(self.witness),
                direction_deg=self.direction_deg,
                direction_std_deg=self.direction_std_deg,
            ),
        )


class RotorNodeSettings(DeviceSettings):
    """A node on the rotor: both pendulum encoders, the index mark, and the locks if the rig commands any.

    Attributes:
        angles: whether its encoders measure the pendulums' angles for the rig. Otherwise another device does, and only
            the index marks (and locks) of this node are used.
    """

    calibration: ClassVar[tuple[str, ...]] = (
        "counts_per_revolution",
        "index_angle_deg",
        "index_angle_std_deg",
        "zero_std_deg",
        "clock_tolerance_ppm",
    )

    rate_Hz: Annotated[int, Field(ge=10, le=5000)] = 1000
    counts_per_revolution: Annotated[int, Field(ge=64)] = 4096
    index_angle_deg: Finite = 0.0
    index_angle_std_deg: NotNegative = 0.0
    zero_std_deg: NotNegative = USUAL_ZERO_STD_DEG
    clock_tolerance_ppm: Positive = 30.0
    locks: bool = True
    angles: bool = True
    node: Annotated[int | None, Field(ge=0, le=255)] = None

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles; see DeviceSettings."""
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
            RotorPhase(
                device=device,
                topic="tacho",
                index_angle_deg=self.index_angle_deg,
                clock_tolerance_ppm=tolerance,
                index_angle_std_deg=self.index_angle_std_deg,
            ),
            *([PendulumLocks(device=device)] if self.locks else []),
        )


def _read_roles(tables: object) -> object:
    if not isinstance(tables, list | tuple):
        raise ValueError(f"expected a list of roles, got {tables!r:.60}")
    return tuple(read_role(table) for table in cast("list[object]", tables))


class StoredDevice(DeviceSettings):
    """A device of a log whose driver is not installed: settings as stored, roles as the log contains them."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")

    stored_roles: Annotated[tuple[Any, ...], BeforeValidator(_read_roles)] = ()

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles; see DeviceSettings."""
        return self.stored_roles
