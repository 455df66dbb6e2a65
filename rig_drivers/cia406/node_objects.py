"""The objects of an encoder at the far end: of the simulated one, and of the stand-in for one of a log."""

from __future__ import annotations

from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import Objects

TURNS = 4096
"""Number of distinguishable revolutions of the simulated encoders."""


def encoder_objects(node: int, serial: int, per_turn: int, positions: int, parameters: int) -> Objects:
    """Return the objects of a multi-turn encoder as delivered: reports by its own timer, which is off, and at SYNC.

    Args:
        node: node number.
        serial: serial number.
        per_turn, positions: its scaling, counts per revolution and in all.
        parameters: its operating parameters (6000h).
    """
    kind = 0x0002_0196 if positions > per_turn else 0x0001_0196
    objects: Objects = {
        (cia301.DEVICE_TYPE, 0): (kind, "<I"),
        (cia301.ERROR_REGISTER, 0): (0, "<B"),
        (cia301.PREDEFINED_ERROR_FIELD, 0): (0, "<B"),
        (cia301.PREDEFINED_ERROR_FIELD, 1): (0, "<I"),
        (cia301.SYNC_IDENTIFIER, 0): (cia301.COB_SYNC, "<I"),
        (cia301.PRODUCER_HEARTBEAT, 0): (0, "<H"),
        (cia301.IDENTITY, 1): (0x0000_0D0C, "<I"),
        (cia301.IDENTITY, 2): (0x0000_3643, "<I"),
        (cia301.IDENTITY, 3): (0x0001_0002, "<I"),
        (cia301.IDENTITY, 4): (serial, "<I"),
        (0x6000, 0): (parameters, "<H"),
        (0x6001, 0): (per_turn, "<I"),
        (0x6002, 0): (positions, "<I"),
        (0x6003, 0): (0, "<I"),
        (0x6200, 0): (0, "<H"),
        (0x6501, 0): (per_turn, "<I"),
        (0x6502, 0): (max(1, positions // per_turn), "<H"),
        (0x6503, 0): (0, "<H"),
        (0x6505, 0): (0, "<H"),
    }
    for number, kind in ((0, 254), (1, 1)):
        objects[cia301.TPDO1 + number, 1] = (cia301.cob_tpdo(number + 1, node), "<I")
        objects[cia301.TPDO1 + number, 2] = (kind, "<B")
        objects[cia301.TPDO1 + number, 3] = (0, "<H")
        objects[cia301.TPDO1 + number, 5] = (0, "<H")
        objects[cia301.TPDO1_MAPPING + number, 0] = (1, "<B")
        objects[cia301.TPDO1_MAPPING + number, 1] = (0x6004_0020, "<I")
    return objects
