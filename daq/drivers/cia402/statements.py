"""What a drive states about itself in its objects: its unit of speed, and its reaction to a missing host."""

from __future__ import annotations

import logging
import math

from daq.drivers.canopen.objects import NodeObjects
from daq.drivers.cia402 import wire as cia402
from daq.errors import DeviceError
from rig_basics.ignoring import ignoring

NO_REACTION = 0
"""Value of 6007h: no reaction. Others: 1 fault, 2 disable voltage, 3 quick stop; negative ones are the maker's."""
_REVOLUTIONS_PER_MINUTE = 0xB44700  # 60A9h without its prefix: revolution (B4h) over minute (47h), CiA 303-2
_MAX_DIGITS = 6
_log = logging.getLogger(__name__)


def units_per_rpm(objects: NodeObjects) -> float | None:
    """Return the number of units of speed for 1 rpm by 60A9h; None if it states none, or another kind of unit."""
    with ignoring(_log, "reading the unit of speed", DeviceError):
        unit = objects.read(cia402.UNIT_OF_SPEED, 0)
        if unit is not None and unit & 0xFFFFFF == _REVOLUTIONS_PER_MINUTE:
            prefix = unit >> 24  # power of ten, i8
            return 10.0 ** (256 - prefix if prefix > 127 else -prefix)
    return None


def reaction(objects: NodeObjects) -> int | None:
    """Return the reaction to a missing host by 6007h, or None if the drive states none."""
    with ignoring(_log, "reading the reaction to a missing host", DeviceError):
        found = objects.read(cia402.ABORT_REACTION, 0)
        return None if found is None else cia402.signed(found)
    return None


def is_decimal_error(stated: float, given: float) -> bool:
    """Return whether two numbers of units differ by a power of ten other than 1: another prefix, not a gear."""
    digits = math.log10(stated / given)
    return abs(digits) > 0.5 and abs(digits - round(digits)) < 1e-3 and abs(digits) <= _MAX_DIGITS
