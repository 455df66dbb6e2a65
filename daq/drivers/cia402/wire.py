"""CANopen frames (CiA 301) of a drive, and the CiA 402 state machine in velocity mode.

A pure codec without bus and clock, used by the host and by the simulated drive. Speeds are the drive's words, in rpm.

The two ways to command a speed: velocity mode (vl) and profile velocity mode (pv) of CiA 402.

They differ in their objects, in the width of a speed, and in its unit. In velocity mode speeds are i16 in rpm. In
profile velocity mode they are i32 in a unit of the drive, and ramps are rates in that unit per second.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property, lru_cache

from daq.drivers.canopen import cia301
from daq.drivers.cia402.settings import MotorDrive

# Object dictionary
ABORT_REACTION, ERROR_CODE = 0x6007, 0x603F
CONTROLWORD, STATUSWORD = 0x6040, 0x6041
TARGET_VELOCITY, ACTUAL_VELOCITY = 0x6042, 0x6044
VELOCITY_ACCELERATION, VELOCITY_DECELERATION = 0x6048, 0x6049
"""Ramps: sub 1 Δspeed in rpm (u32), sub 2 Δtime in s (u16)."""
MODE_OF_OPERATION, MODE_DISPLAY, SUPPORTED_MODES = 0x6060, 0x6061, 0x6502
UNIT_OF_SPEED = 0x60A9
MODE_VELOCITY = 2

# Controlword
DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN = 0x0000, 0x0002, 0x0006
SWITCH_ON, ENABLE_OPERATION = 0x0007, 0x000F
FAULT_RESET, HALT = 0x0080, 0x0100
RAMP_BITS = 0x0070
"""Bits 4 … 6 in velocity mode: enable the ramp generator, unlock the ramp, use the target."""

NOT_READY = "NOT READY TO SWITCH ON"
SWITCH_ON_DISABLED = "SWITCH ON DISABLED"
READY = "READY TO SWITCH ON"
SWITCHED_ON = "SWITCHED ON"
OPERATION_ENABLED = "OPERATION ENABLED"
QUICK_STOP_ACTIVE = "QUICK STOP ACTIVE"
FAULT_REACTION = "FAULT REACTION ACTIVE"
FAULT = "FAULT"
UNKNOWN = "UNKNOWN"

STATES = {
    NOT_READY: (0x4F, 0x00),
    SWITCH_ON_DISABLED: (0x4F, 0x40),
    READY: (0x6F, 0x21),
    SWITCHED_ON: (0x6F, 0x23),
    OPERATION_ENABLED: (0x6F, 0x27),
    QUICK_STOP_ACTIVE: (0x6F, 0x07),
    FAULT_REACTION: (0x4F, 0x0F),
    FAULT: (0x4F, 0x08),
}
"""State name to (mask, value) of the statusword. Source: CiA 402 state table."""

_TOWARDS_OPERATION = {
    SWITCH_ON_DISABLED: SHUTDOWN,
    READY: SWITCH_ON,
    SWITCHED_ON: ENABLE_OPERATION,
    OPERATION_ENABLED: ENABLE_OPERATION,
    QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
    FAULT: FAULT_RESET,
}


@lru_cache(1024)
def state(statusword: int) -> str:
    """Return the name of the drive state, a key of `STATES`, or `UNKNOWN` for a pattern that is not in the table."""
    return next((name for name, (mask, value) in STATES.items() if statusword & mask == value), UNKNOWN)


def signed(word: int) -> int:
    """Return the signed number of a 16-bit word."""
    return (word & 0xFFFF ^ 0x8000) - 0x8000


def towards_operation(state_name: str) -> int | None:
    """Return the controlword for the next step towards OPERATION ENABLED; None if the host has to wait."""
    return _TOWARDS_OPERATION.get(state_name)


def write_word(index: int, value: int) -> bytes:
    """Return the request that writes a u16 to an object, sub-index 0 (CiA 301, expedited)."""
    return struct.pack("<BHBHH", 0x2B, index, 0, value, 0)


def consumer_heartbeat(host_node: int, timeout_ms: int) -> int:
    """Return the value of 1016h sub 1: the drive makes a quick stop without this node's heartbeat for `timeout_ms`."""
    return host_node << 16 | timeout_ms


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
        word, speed = self._form.unpack_from(data)
        return word, speed / self.units_per_rpm

    def rpm(self, raw: int) -> float:
        """Return the speed, rpm, of the unsigned value of an object."""
        sign = 1 << self.bits - 1
        return ((raw & 2 * sign - 1 ^ sign) - sign) / self.units_per_rpm

    def mapping(self, word: int, speed: int) -> tuple[int, int]:
        """Return the entries of a PDO's mapping for a word of 16 bits and a speed."""
        return cia301.mapped_word(word), speed << 16 | self.bits


VELOCITY = SpeedProfile(MODE_VELOCITY, TARGET_VELOCITY, ACTUAL_VELOCITY, 16)


def profile_of(config: MotorDrive) -> SpeedProfile:
    """Return the mode of operation of a drive, with the drive's unit."""
    if config.mode == "velocity":
        return VELOCITY
    return SpeedProfile(MODE_PROFILE_VELOCITY, PROFILE_TARGET, PROFILE_ACTUAL, 32, config.units_per_rpm)
