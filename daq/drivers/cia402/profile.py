"""The two ways to command a speed: velocity mode (vl) and profile velocity mode (pv) of CiA 402.

They differ in their objects, in the width of a speed, and in its unit. In velocity mode speeds are i16 in rpm. In
profile velocity mode they are i32 in a unit of the drive, and ramps are rates in that unit per second.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.settings import MotorDrive

MODE_PROFILE_VELOCITY = 3
PROFILE_TARGET, PROFILE_ACTUAL = 0x60FF, 0x606C
PROFILE_ACCELERATION, PROFILE_DECELERATION = 0x6083, 0x6084
"""Ramps of profile velocity mode (u32), in units of speed per second."""
TARGET_REACHED, SPEED_ZERO = 1 << 10, 1 << 12
"""Bits of the statusword in profile velocity mode."""


@dataclass(frozen=True)
class SpeedProfile:
    """A mode of operation for speeds.

    Attributes:
        mode: value of 6060h.
        target, actual: objects of target and actual speed.
        bits: width of both, 16 or 32.
        units_per_rpm: unit of both: their number for 1 rpm.
    """

    mode: int
    target: int
    actual: int
    bits: int
    units_per_rpm: float = 1.0

    @cached_property
    def _form(self) -> struct.Struct:
        return struct.Struct("<Hh" if self.bits == 16 else "<Hi")

    @property
    def size(self) -> int:
        """Bytes of the process data: control- or statusword u16, and speed."""
        return self._form.size

    def pack(self, word: int, rpm: float) -> bytes:
        """Encode control- or statusword and a speed, rpm; a speed outside of the range is limited to it."""
        largest = (1 << self.bits - 1) - 1
        return self._form.pack(word, max(-largest, min(round(rpm * self.units_per_rpm), largest)))

    def unpack(self, data: bytes) -> tuple[int, float]:
        """Return control- or statusword and the speed, rpm; further mapped objects are ignored.

        Raises:
            struct.error: there are fewer than `size` bytes.
        """
        word, speed = self._form.unpack(data[: self.size])
        return word, speed / self.units_per_rpm

    def rpm(self, raw: int) -> float:
        """Return the speed, rpm, of the unsigned value of an object."""
        sign = 1 << self.bits - 1
        return ((raw & 2 * sign - 1 ^ sign) - sign) / self.units_per_rpm

    def mapping(self, word: int, speed: int) -> tuple[int, int]:
        """Return the entries of a PDO's mapping for a word of 16 bits and a speed."""
        return cia301.mapped_word(word), speed << 16 | self.bits


VELOCITY = SpeedProfile(cia402.MODE_VELOCITY, cia402.TARGET_VELOCITY, cia402.ACTUAL_VELOCITY, 16)


def profile_of(config: MotorDrive) -> SpeedProfile:
    """Return the mode of operation of a drive, with the drive's unit."""
    if config.mode == "velocity":
        return VELOCITY
    return SpeedProfile(MODE_PROFILE_VELOCITY, PROFILE_TARGET, PROFILE_ACTUAL, 32, config.units_per_rpm)
