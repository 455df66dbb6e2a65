"""Causes of a drive's FAULT, from its objects and its emergencies.

What a drive states about itself in its objects: its unit of speed, and its reaction to a missing host.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection
from typing import Final

from daq.drivers.canopen import cia301
from daq.drivers.canopen.objects import NodeObjects
from daq.drivers.cia402 import wire as cia402
from daq.errors import DeviceError
from rig_basics.ignoring import ignoring

REMEDY: Final = "Look into its manual, mend the cause and reset it there"
"""What to do about a drive that has a fault or does not follow a command."""

_OTHER_FAULTS = 0x6E  # bits of 1001h: current, voltage, temperature, profile, reserved; not generic, line, maker's
_log = logging.getLogger(__name__)


def emergency_text(emergencies: Collection[int]) -> str:
    """Return emergencies for a message, each once, with code and meaning; empty without one."""
    return "".join(f"; emergency {cia301.emergency_words(code)}" for code in dict.fromkeys(emergencies))


def fault_code(objects: NodeObjects) -> int | None:
    """Return the cause of FAULT as the drive reports it; None if it reports none.

    The cause is read from 603Fh, otherwise from 1003h. Without either, the register 1001h is used if it only shows
    an error of the communication.
    """
    for index, sub in ((cia402.ERROR_CODE, 0), (cia301.PREDEFINED_ERROR_FIELD, 1)):
        with ignoring(_log, f"reading the error code {index:04X}h", DeviceError):
            if code := (objects.read(index, sub) or 0) & 0xFFFF:
                return code
    register = _error_register(objects)
    if register is not None and register & 0xFE == cia301.REGISTER_COMMUNICATION:
        return cia301.HEARTBEAT_ERROR
    return None


def check_only_heartbeat(
    objects: NodeObjects, emergencies: Callable[[], Collection[int]], *, reset: bool = False
) -> None:
    """Raise DeviceError if there is a fault other than the missing heartbeat.

    The newest error code hides earlier ones, so the error register and the emergencies are checked too.

    Args:
        objects: objects of the drive.
        emergencies: returns the error codes that the drive has sent; called after the objects are read, because the
            drive may send one in the meantime.
        reset: whether a reset was commanded: then the drive may report no cause any more.
    """
    code = fault_code(objects)
    register = _error_register(objects)
    others = (register or 0) & _OTHER_FAULTS or set(emergencies()) - {cia301.HEARTBEAT_ERROR}
    if others or (code != cia301.HEARTBEAT_ERROR and not (reset and code is None)):
        cause = "it reports no cause" if code is None else f"its error code is 0x{code:04X}"
        cause += f", its error register 0x{register:02X}" if register else ""
        raise DeviceError(f"drive: it is in FAULT, {cause}{emergency_text(emergencies())}. {REMEDY}")


def _error_register(objects: NodeObjects) -> int | None:
    """Return the error register 1001h; None if it cannot be read."""
    with ignoring(_log, "reading the error register", DeviceError):
        return objects.read(cia301.ERROR_REGISTER, 0)
    return None


NO_REACTION = 0
"""Value of 6007h: no reaction. Others: 1 fault, 2 disable voltage, 3 quick stop; negative ones are the maker's."""
_REVOLUTIONS_PER_MINUTE = 0xB44700  # 60A9h without its prefix: revolution (B4h) over minute (47h), CiA 303-2
_MAX_DIGITS = 6


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
