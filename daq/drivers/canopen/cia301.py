"""Messages and objects of CANopen (CiA 301) that do not depend on the kind of device.

A pure codec without bus and clock, used by the host and by simulated devices.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from daq.transports.can_frames import CanFrame

COB_NMT, COB_SYNC = 0x000, 0x080
"""Identifiers of network commands and of SYNC."""

# Object dictionary
DEVICE_TYPE, SYNC_IDENTIFIER, IDENTITY = 0x1000, 0x1005, 0x1018
"""1005h: identifier of SYNC, with bit 30 if the node sends it. 1018h: sub 1 maker, 2 product, 3 revision, 4 serial."""
ERROR_REGISTER, PREDEFINED_ERROR_FIELD = 0x1001, 0x1003
REGISTER_COMMUNICATION = 0x10
CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT = 0x1016, 0x1017
RPDO1, TPDO1 = 0x1400, 0x1800
"""Communication parameters of the PDOs 1: sub 1 COB-ID (u32), 2 transmission type (u8), 5 event timer in ms (u16)."""
RPDO1_MAPPING, TPDO1_MAPPING = 0x1600, 0x1A00
"""Mapping of the PDOs 1: sub 0 number of objects (u8), then each index << 16 | sub-index << 8 | bits (u32)."""

HEARTBEAT_ERROR = 0x8130
"""Emergency and error code of a drive that did not receive its host's heartbeat in time (CiA 301)."""

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


def own_frames(frames: Sequence[CanFrame]) -> list[CanFrame]:
    """Return the frames of CANopen: those with data and identifiers of 11 bits. Other frames may share the bus."""
    return [frame for frame in frames if not (frame.extended or frame.remote)]


def mapped_word(index: int) -> int:
    """Return the entry of a PDO's mapping for an object of 16 bits, sub-index 0."""
    return index << 16 | 16


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
    0x8130: "life guard or heartbeat error: the host's heartbeat stayed away: cable, or a busy host",
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
