"""Objects and messages of CANopen encoders (CiA 406), in addition to those of CiA 301.

A pure codec without bus and clock. Sources: the object tables of makers' manuals (Kübler 9080, Lika, SIKO AP10, BEI
MHM5, Hydac HLT 1100) that follow CiA 406.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from daq.drivers.canopen import cia301
from daq.transports.can_frames import CanFrame, encode

PROFILE = 406
"""Low 16 bits of 1000h (0196h). The high ones are the kind: 1 single-turn, 2 multi-turn absolute rotary encoder."""
OPERATING_PARAMETERS, UNITS_PER_TURN, TOTAL_RANGE, PRESET, POSITION = 0x6000, 0x6001, 0x6002, 0x6003, 0x6004
"""6000h: bit 0 code sequence, bit 2 scaling on. 6001h and 6002h in counts, if scaling is on. 6004h: position, u32."""
CYCLIC_TIMER = 0x6200
"""Period in ms, u16; the same timer as the event timer of TPDO1."""
SINGLE_TURN_RESOLUTION, DISTINGUISHABLE_TURNS = 0x6501, 0x6502
"""Physical resolution: counts per revolution, u32; number of revolutions, u16."""

ALARMS, WARNINGS = 0x6503, 0x6505
"""Present alarms and warnings, u16; see `alarm_words` and `warning_words`. Encoders of class 1 need not have them."""

COUNTER_CLOCKWISE, SCALING = 0x1, 0x4
"""Bits of 6000h: whether positions grow counter-clockwise (seen on the shaft); whether 6001h and 6002h apply."""
POSITION_MAPPED = POSITION << 16 | 32
"""Entry of a PDO's mapping: 6004h, sub-index 0, 32 bits."""
EVERY_SYNC, OWN_TIMER = 1, 254
"""Transmission types: at each SYNC; by the node's own event timer, as the profile defines."""
POSITION_BYTES = 4

SYNC = encode(CanFrame(cia301.COB_SYNC))
"""The host's SYNC without counter, as text; encoders of older versions of CiA 301 accept no counter."""


@dataclass(frozen=True)
class Scale:
    """How an encoder counts.

    Attributes:
        per_turn: counts per revolution.
        positions: number of different positions; a position is smaller.
        counter_clockwise: whether positions grow counter-clockwise, seen on the shaft.
    """

    per_turn: int
    positions: int
    counter_clockwise: bool


def position(data: bytes, offset: int = 0) -> int | None:
    """Return the position, counts, in a report that contains 6004h at a place in bytes; None if it is too short."""
    end = offset + POSITION_BYTES
    return None if len(data) < end else int(struct.unpack_from("<I", data, offset)[0])


def network_command(command: int, node: int) -> bytes:
    """Return the text of a network command (NMT) for one node."""
    return encode(CanFrame(cia301.COB_NMT, bytes((command, node))))


_ALARMS = {0: "position error", 1: "commissioning diagnostics"}
_WARNINGS = {
    0: "speed too high",
    1: "reserve of the light source used up",
    2: "watchdog",
    3: "operating time exceeded",
    4: "battery low",
    5: "reference point not reached",
}


def alarm_words(bits: int) -> str:
    """Return alarms (6503h) with their meanings."""
    return _bit_words(bits, _ALARMS)


def warning_words(bits: int) -> str:
    """Return warnings (6505h) with their meanings."""
    return _bit_words(bits, _WARNINGS)


def _bit_words(bits: int, words: dict[int, str]) -> str:
    maker = "manufacturer-specific"
    found = [words.get(bit, maker if bit >= 12 else "reserved") for bit in range(16) if bits >> bit & 1]
    return f"{bits:04X}h ({', '.join(dict.fromkeys(found))})"
