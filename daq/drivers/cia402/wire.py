"""CANopen frames (CiA 301) of a drive, and the CiA 402 state machine in velocity mode.

A pure codec without bus and clock, used by the host and by the simulated drive. Speeds are the drive's words, in rpm.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

from daq.transports.slcan import CanFrame

# Object dictionary
ERROR_REGISTER, PREDEFINED_ERROR_FIELD = 0x1001, 0x1003
REGISTER_COMMUNICATION = 0x10
CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT = 0x1016, 0x1017
ERROR_CODE = 0x603F
CONTROLWORD, STATUSWORD = 0x6040, 0x6041
TARGET_VELOCITY, VELOCITY_DEMAND, ACTUAL_VELOCITY = 0x6042, 0x6043, 0x6044
VELOCITY_ACCELERATION, VELOCITY_DECELERATION = 0x6048, 0x6049
"""Ramps: sub 1 Δspeed in rpm (u32), sub 2 Δtime in s (u16)."""
RPDO1, TPDO1 = 0x1400, 0x1800
"""Communication parameters of the PDOs 1: sub 1 COB-ID (u32), 2 transmission type (u8), 5 event timer in ms (u16)."""
RPDO1_MAPPING, TPDO1_MAPPING = 0x1600, 0x1A00
"""Mapping of the PDOs 1: sub 0 number of objects (u8), then each index << 16 | sub-index << 8 | bits (u32)."""
MODE_OF_OPERATION, MODE_DISPLAY = 0x6060, 0x6061
MODE_VELOCITY = 2

# Controlword
DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN = 0x0000, 0x0002, 0x0006
SWITCH_ON, ENABLE_OPERATION = 0x0007, 0x000F
FAULT_RESET, HALT = 0x0080, 0x0100
RAMP_BITS = 0x0070
"""Bits 4 … 6 in velocity mode: enable the ramp generator, unlock the ramp, use the target."""

HEARTBEAT_ERROR = 0x8130
"""Emergency and error code of a drive that did not receive its host's heartbeat in time (CiA 301)."""

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
_STATUS_SPEED = struct.Struct("<Hh")
_EMERGENCY = struct.Struct("<HB5s")


class Heartbeat(IntEnum):
    """NMT state in a heartbeat frame."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True)
class Emergency:
    """An emergency frame: CiA error code, error register (1001h), five manufacturer-specific bytes."""

    error_code: int
    error_register: int
    maker_bytes: bytes


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


def pack_tpdo1(statusword: int, actual_rpm: int) -> bytes:
    """Encode drive to host: statusword u16, actual speed i16 in rpm."""
    return _STATUS_SPEED.pack(statusword, actual_rpm)


def own_frames(frames: Sequence[CanFrame]) -> list[CanFrame]:
    """Return the frames of CANopen: those with data and identifiers of 11 bits. Other frames may share the bus."""
    return [frame for frame in frames if not (frame.extended or frame.remote)]


def write_word(index: int, value: int) -> bytes:
    """Return the request that writes a u16 to an object, sub-index 0 (CiA 301, expedited)."""
    return struct.pack("<BHBHH", 0x2B, index, 0, value, 0)


def mapped_word(index: int) -> int:
    """Return the entry of a PDO's mapping for an object of 16 bits, sub-index 0."""
    return index << 16 | 16


TPDO1_BYTES = 4


def unpack_tpdo1(data: bytes) -> tuple[int, int]:
    """Return statusword and actual speed in rpm; further mapped objects are ignored.

    Raises:
        ValueError: there are fewer than 4 bytes.
    """
    return _four(data[:TPDO1_BYTES], "TPDO1 (statusword u16, actual rpm i16)")


def pack_rpdo1(controlword: int, target_rpm: int) -> bytes:
    """Encode host to drive: controlword u16, target speed i16 in rpm."""
    return _STATUS_SPEED.pack(controlword, target_rpm)


def unpack_rpdo1(data: bytes) -> tuple[int, int]:
    """Return controlword and target speed in rpm.

    Raises:
        ValueError: the length is not 4 bytes.
    """
    return _four(data, "RPDO1 (controlword u16, target rpm i16)")


def _four(data: bytes, what: str) -> tuple[int, int]:
    if len(data) != _STATUS_SPEED.size:
        raise ValueError(f"expected 4 bytes of {what}, got {len(data)}: check the drive's PDO mapping")
    word, speed = _STATUS_SPEED.unpack(data)
    return word, speed


def pack_emergency(emergency: Emergency) -> bytes:
    """Return the 8 data bytes of an emergency frame."""
    return _EMERGENCY.pack(emergency.error_code, emergency.error_register, emergency.maker_bytes)


def unpack_emergency(data: bytes) -> Emergency:
    """Parse the 8 data bytes of an emergency frame.

    Raises:
        ValueError: the length is not 8 bytes.
    """
    if len(data) != _EMERGENCY.size:
        raise ValueError(f"expected 8 bytes of an emergency frame, got {len(data)}")
    return Emergency(*_EMERGENCY.unpack(data))


_EMERGENCIES = {
    0x0000: "error reset",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current on the input side",
    0x2200: "current inside the device",
    0x2300: "current on the output side",
    0x2310: "continuous over-current on the output side",
    0x2320: "short circuit or earth leakage on the output side",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3200: "DC link voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4200: "device temperature",
    0x4210: "device over-temperature",
    0x4300: "drive temperature",
    0x4310: "drive over-temperature",
    0x5000: "device hardware",
    0x5100: "supply of the device hardware",
    0x5200: "control of the device hardware",
    0x5300: "operating unit",
    0x5400: "power section",
    0x5500: "data storage",
    0x6000: "device software",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data set",
    0x7000: "additional modules",
    0x7100: "power of additional modules",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7200: "measurement circuit",
    0x7300: "sensor",
    0x7305: "incremental sensor",
    0x7310: "speed measurement",
    0x7320: "position measurement",
    0x7400: "computation circuit",
    0x7500: "communication of additional modules",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error: the host's heartbeat stayed away",
    0x8140: "recovered from bus off",
    0x8150: "CAN identifier collision",
    0x8200: "protocol error",
    0x8210: "PDO not processed, wrong length",
    0x8220: "PDO too long",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8400: "speed controller",
    0x8500: "position controller",
    0x8600: "positioning controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronising controller",
    0x8800: "winding controller",
    0x8900: "process data monitoring",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "device specific",
}
"""Error codes and their classes. Sources: CiA 301 (emergency object), CiA 402 (error codes)."""


def emergency_words(error_code: int) -> str:
    """Return an error code with its meaning; for a code that is not in the standard, with that of its class."""
    known = next(
        (
            error_code & mask
            for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000)
            if error_code & mask in _EMERGENCIES and (error_code & mask or not error_code)
        ),
        None,
    )
    return f"0x{error_code:04X}, " + ("unknown to CiA 301 and 402" if known is None else _EMERGENCIES[known])


def heartbeat(data: bytes) -> Heartbeat | None:
    """Return the NMT state in a heartbeat frame; None if it is invalid (the top bit may toggle and is ignored)."""
    value = data[0] & 0x7F if len(data) == 1 else -1
    return Heartbeat(value) if value in Heartbeat.__members__.values() else None


def consumer_heartbeat(host_node: int, timeout_ms: int) -> int:
    """Return the value of 1016h sub 1: the drive makes a quick stop without this node's heartbeat for `timeout_ms`."""
    return host_node << 16 | timeout_ms


def cob_emergency(node: int) -> int:
    """Return the COB-ID of emergency frames."""
    return 0x080 + node


def cob_tpdo(number: int, node: int) -> int:
    """Return the COB-ID of transmit PDO 1 … 4 (device to host), predefined connection set."""
    return 0x080 + 0x100 * number + node


def cob_rpdo(number: int, node: int) -> int:
    """Return the COB-ID of receive PDO 1 … 4 (host to device), predefined connection set."""
    return 0x100 + 0x100 * number + node


def cob_sdo_answer(node: int) -> int:
    """Return the COB-ID of a device's SDO answers."""
    return 0x580 + node


def cob_sdo_request(node: int) -> int:
    """Return the COB-ID of SDO requests to a device."""
    return 0x600 + node


def cob_heartbeat(node: int) -> int:
    """Return the COB-ID of heartbeat frames."""
    return 0x700 + node
