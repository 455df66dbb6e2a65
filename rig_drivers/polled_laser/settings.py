"""Settings of a polled displacement sensor in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from rig_configs.device import DisplacementSettings
from rig_drivers.polled_laser import wire

_BITS_PER_BYTE = 10
_BYTES_PER_READING = 24  # request and answer of the longest dialect with one output


class PolledLaser(DisplacementSettings):
    """A displacement sensor that answers one value to one request, on its serial line.

    Such a sensor is slow: it serves static measurements, calibration, and motion of a few hertz.

    Attributes:
        dialect: texts of the sensor, a key of `wire.DIALECTS`.
        output: number of the output or amplifier; for HL-G1 the sensor's address. By default the first one: 0 for IL,
            otherwise 1.
        baud: line rate of the sensor, baud.
        parity: parity of the line.
        rate_Hz: requests per second. The sensor may answer fewer.
        unit_m: unit of the values, m, if the sensor is set to another one than the dialect's usual.
        delay_s: time from the measurement to the middle between request and answer, s; that of the sensor's averaging.
        positive: direction in which its values grow: "away" from the sensor or "towards" it. Not verified: it is a
            setting of most of these sensors.
    """

    names_its_channel: ClassVar[bool] = True

    dialect: Literal["LK-G", "LK-G5000", "IL", "HL-G1"]
    output: Annotated[int, Field(ge=0, le=99)] = 1
    baud: Annotated[int, Field(ge=1200, le=921_600)] = 115_200
    parity: Literal["E", "O", "N"] = "N"
    rate_Hz: Annotated[float, Field(ge=0.1, le=200.0)] = 50.0
    unit_m: Annotated[float, Field(gt=0, le=1)] | None = None
    delay_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    positive: Literal["away", "towards"] = "away"

    @model_validator(mode="before")
    @classmethod
    def _has_first_output(cls, table: dict[str, object]) -> dict[str, object]:
        dialect = wire.DIALECTS.get(str(table.get("dialect")))
        return {"output": dialect.outputs[0]} | table if dialect else table

    @property
    def metres_per_unit(self) -> float:
        """Displacement away from the sensor for a value of 1, m."""
        unit = self.unit_m or wire.DIALECTS[self.dialect].unit_m
        return unit if self.positive == "away" else -unit

    @model_validator(mode="after")
    def _is_possible(self) -> PolledLaser:
        low, high = wire.DIALECTS[self.dialect].outputs
        if not low <= self.output <= high:
            raise ValueError(f"output: expected {low} to {high} for {self.dialect}, got {self.output}")
        need = _BYTES_PER_READING * _BITS_PER_BYTE * self.rate_Hz
        if need > self.baud:
            raise ValueError(
                f"{self.rate_Hz:g} readings a second need {need:.0f} baud, the line has {self.baud}: raise baud or set "
                f"rate_Hz to at most {self.baud / _BYTES_PER_READING / _BITS_PER_BYTE:.0f}"
            )
        return self
