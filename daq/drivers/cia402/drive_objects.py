"""The objects of a simulated drive, and of the stand-in for a drive of a log."""

from __future__ import annotations

from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import Objects
from daq.drivers.cia402 import wire as cia402


def drive_objects(node: int) -> Objects:
    """Return the minimum objects of a velocity-mode drive with initial values: ramps 100 rpm/s, no reports at rest."""
    return {
        (cia301.RPDO1, 1): (cia301.cob_rpdo(1, node), "<I"),
        (cia301.RPDO1, 2): (255, "<B"),
        (cia301.RPDO1_MAPPING, 0): (2, "<B"),
        (cia301.RPDO1_MAPPING, 1): (cia301.mapped_word(cia402.CONTROLWORD), "<I"),
        (cia301.RPDO1_MAPPING, 2): (cia301.mapped_word(cia402.TARGET_VELOCITY), "<I"),
        (cia301.TPDO1, 1): (cia301.cob_tpdo(1, node), "<I"),
        (cia301.TPDO1, 2): (255, "<B"),
        (cia301.TPDO1, 5): (0, "<H"),
        (cia301.TPDO1_MAPPING, 0): (2, "<B"),
        (cia301.TPDO1_MAPPING, 1): (cia301.mapped_word(cia402.STATUSWORD), "<I"),
        (cia301.TPDO1_MAPPING, 2): (cia301.mapped_word(cia402.ACTUAL_VELOCITY), "<I"),
        (0x1000, 0): (0x00020192, "<I"),
        (0x1001, 0): (0, "<B"),
        (cia301.CONSUMER_HEARTBEAT, 1): (0, "<I"),
        (cia301.PRODUCER_HEARTBEAT, 0): (0, "<H"),
        (cia402.CONTROLWORD, 0): (0, "<H"),
        (cia402.TARGET_VELOCITY, 0): (0, "<h"),
        (cia402.VELOCITY_ACCELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_ACCELERATION, 2): (1, "<H"),
        (cia402.VELOCITY_DECELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_DECELERATION, 2): (1, "<H"),
        (cia402.MODE_OF_OPERATION, 0): (0, "<b"),
    }
