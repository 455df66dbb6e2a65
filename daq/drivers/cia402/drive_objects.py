"""The objects of a simulated drive, and of the stand-in for a drive of a log."""

from __future__ import annotations

from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import Objects
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.profile import PROFILE_ACCELERATION, PROFILE_DECELERATION, VELOCITY, SpeedProfile


def drive_objects(node: int, profile: SpeedProfile = VELOCITY) -> Objects:
    """Return the minimum objects of a drive with initial values: ramps 100 rpm/s, no reports at rest."""
    ordered = profile.mapping(cia402.CONTROLWORD, profile.target)
    reported = profile.mapping(cia402.STATUSWORD, profile.actual)
    ramp = round(100 * profile.units_per_rpm)
    return {
        (cia301.RPDO1, 1): (cia301.cob_rpdo(1, node), "<I"),
        (cia301.RPDO1, 2): (255, "<B"),
        (cia301.RPDO1_MAPPING, 0): (2, "<B"),
        (cia301.RPDO1_MAPPING, 1): (ordered[0], "<I"),
        (cia301.RPDO1_MAPPING, 2): (ordered[1], "<I"),
        (cia301.TPDO1, 1): (cia301.cob_tpdo(1, node), "<I"),
        (cia301.TPDO1, 2): (255, "<B"),
        (cia301.TPDO1, 5): (0, "<H"),
        (cia301.TPDO1_MAPPING, 0): (2, "<B"),
        (cia301.TPDO1_MAPPING, 1): (reported[0], "<I"),
        (cia301.TPDO1_MAPPING, 2): (reported[1], "<I"),
        (0x1000, 0): (0x00020192, "<I"),
        (0x1001, 0): (0, "<B"),
        (cia301.CONSUMER_HEARTBEAT, 1): (0, "<I"),
        (cia301.PRODUCER_HEARTBEAT, 0): (0, "<H"),
        (cia402.CONTROLWORD, 0): (0, "<H"),
        (profile.target, 0): (0, "<h" if profile.bits == 16 else "<i"),
        (PROFILE_ACCELERATION, 0): (ramp, "<I"),
        (PROFILE_DECELERATION, 0): (ramp, "<I"),
        (cia402.VELOCITY_ACCELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_ACCELERATION, 2): (1, "<H"),
        (cia402.VELOCITY_DECELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_DECELERATION, 2): (1, "<H"),
        (cia402.MODE_OF_OPERATION, 0): (0, "<b"),
    }
