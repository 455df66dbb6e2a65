"""Setting of a drive's ramps."""

from __future__ import annotations

from daq.drivers.canopen.objects import NodeObjects
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.profile import PROFILE_ACCELERATION, PROFILE_DECELERATION
from daq.drivers.ramp import check_ramp
from daq.errors import DeviceError

_RAMP_S = 10


def set_ramps(objects: NodeObjects, rpm_per_s: float, units: float | None = None) -> None:
    """Set the ramps for speeding up and slowing down, rpm/s.

    Args:
        objects: objects of the drive.
        rpm_per_s: rate, rpm/s.
        units: of profile velocity mode: units of the ramp for 1 rpm/s; None: velocity mode.

    Raises:
        DeviceError: the drive's ramp has a fixed time or too coarse a unit, which does not allow a ramp near this one.
    """
    if units is not None:
        _set_profile_ramps(objects, rpm_per_s, units)
        return
    for index in (cia402.VELOCITY_ACCELERATION, cia402.VELOCITY_DECELERATION):
        seconds = _ramp_seconds(objects, index)
        change = max(1, round(rpm_per_s * seconds))
        check_ramp(
            rpm_per_s,
            change / seconds,
            f"the time of its ramp ({index:04X}h sub 2) is fixed at {seconds} s, which allows whole rpm in it only",
        )
        objects.write(index, 1, change, 4)


def _set_profile_ramps(objects: NodeObjects, rpm_per_s: float, units: float) -> None:
    rate = max(1, round(rpm_per_s * units))
    check_ramp(rpm_per_s, rate / units, "the unit of its ramp (ramp_units_per_rpm_per_s) is coarse")
    for index in (PROFILE_ACCELERATION, PROFILE_DECELERATION):
        objects.write(index, 0, rate, 4)


def _ramp_seconds(objects: NodeObjects, index: int) -> int:
    """Return the time of a ramp, s: 10 s for a resolution of 0.1 rpm/s, or the drive's own if it is fixed."""
    try:
        objects.write(index, 2, _RAMP_S, 2)
    except DeviceError:
        if own := objects.read(index, 2):
            return own
        raise
    return _RAMP_S
