"""Settings of an RF60x sensor in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from rig_configs.device import DisplacementSettings
from rig_drivers.riftek import wire

_BAUD_STEP = 2400
_BITS_PER_BYTE = 11  # start, eight of data, parity, stop

NoTargetCode = Annotated[int, Field(strict=True, ge=0, le=0xFFFF)]


class RiftekLaser(DisplacementSettings):
    """An RF60x displacement sensor on its serial line; it must be the only sensor on the line.

    Attributes:
        baud: line rate of the sensor, baud.
        parity: parity of the line. Not verified: one manual states even, another odd.
        address: address of the sensor.
        rate_Hz: sampling rate, Hz; its period must be a whole number of microseconds, 100 … 65535.
        averages: number of results that the sensor averages.
        no_target_codes: results without a target. Not verified: the available manuals do not list them. By default 0
            and both values that full scale can mean. A result above full scale is never a reading.
    """

    names_its_channel: ClassVar[bool] = True

    baud: Annotated[int, Field(ge=_BAUD_STEP, le=921_600, multiple_of=_BAUD_STEP)] = 921_600
    parity: Literal["E", "O", "N"] = "E"
    address: Annotated[int, Field(ge=1, le=127)] = 1
    rate_Hz: Annotated[float, Field(ge=1e6 / wire.PERIODS_US[1], le=1e6 / wire.PERIODS_US[0])] = 4000.0
    averages: Annotated[int, Field(ge=1, le=128)] = 1
    no_target_codes: Annotated[tuple[NoTargetCode, ...], Field(strict=False, max_length=16)] = (
        0,
        wire.FULL_SCALE - 1,
        wire.FULL_SCALE,
    )

    @property
    def period_us(self) -> int:
        """Sampling period by the sensor's clock, µs."""
        return round(1e6 / self.rate_Hz)

    @field_validator("rate_Hz")
    @classmethod
    def _is_a_period(cls, rate_Hz: float) -> float:
        period = round(1e6 / rate_Hz)
        if abs(period * rate_Hz * 1e-6 - 1.0) > 1e-6:
            raise ValueError(
                f"expected a rate whose period is a whole number of microseconds, got {rate_Hz:g} Hz: "
                f"the nearest is {1e6 / period:.10g} Hz, a period of {period} us"
            )
        return rate_Hz

    @model_validator(mode="after")
    def _line_carries_the_stream(self) -> RiftekLaser:
        need = wire.RESULT_BYTES * _BITS_PER_BYTE * self.rate_Hz
        if need > self.baud:
            raise ValueError(
                f"{self.rate_Hz:g} results a second need {need:.0f} baud, the line has {self.baud}: "
                f"raise baud or set rate_Hz to at most {self.baud / wire.RESULT_BYTES / _BITS_PER_BYTE:.0f}"
            )
        return self
