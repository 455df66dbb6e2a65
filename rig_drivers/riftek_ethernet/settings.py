"""Settings of an RF60x sensor on Ethernet in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from rig_configs.device import DisplacementSettings
from rig_drivers.riftek.settings import NoTargetCode
from rig_drivers.riftek.wire import FULL_SCALE


class RiftekEthernetLaser(DisplacementSettings):
    """An RF60x displacement sensor that sends its results in UDP packets to this host.

    The sensor is set up by the maker's program; the driver sends no command. The port is `udp://ADDRESS:603` with the
    address of this host to which the sensor sends. Two sensors send to two addresses or ports.

    Attributes:
        rate_Hz: sampling rate to which the sensor is set, Hz.
        no_target_codes: results without a target, as for the serial line. Not verified.
        valid_status: values of a result's status that mean a reading; empty: the status is not used. Not verified: the
            public sources do not state its meaning.
        checksum: what the last byte of a packet is: low byte of the sum, or exclusive or, of the bytes before it. Not
            verified; "none": it is not used.
    """

    names_its_channel: ClassVar[bool] = True

    rate_Hz: Annotated[float, Field(ge=20, le=70_000)] = 4000.0
    serial_limit: ClassVar[int | None] = 2**16
    no_target_codes: Annotated[tuple[NoTargetCode, ...], Field(strict=False, max_length=16)] = (0, FULL_SCALE)
    valid_status: Annotated[tuple[Annotated[int, Field(ge=0, le=255)], ...], Field(strict=False, max_length=16)] = ()
    checksum: Literal["none", "sum", "xor"] = "none"

    @field_validator("range_m")
    @classmethod
    def _is_whole_millimetres(cls, range_m: float) -> float:
        if abs(range_m * 1e3 - round(range_m * 1e3)) > 1e-9 or not 1 <= round(range_m * 1e3) < 2**16:
            raise ValueError(f"expected a whole number of millimetres, as the sensor reports it, got {range_m} m")
        return range_m

    @property
    def range_mm(self) -> int:
        """Measuring range as the packets state it, mm."""
        return round(self.range_m * 1e3)
