"""Settings and targets that a drive must accept, with what to do if it refuses one.

Setting of a drive's ramps.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from daq.drivers.canopen import cia301
from daq.drivers.canopen.objects import NoAnswer, NodeObjects
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.wire import MODE_PROFILE_VELOCITY, PROFILE_ACCELERATION, PROFILE_DECELERATION, SpeedProfile
from daq.drivers.questions import TRIES
from daq.drivers.ramp import check_ramp
from daq.errors import DeviceError
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_MODES = {cia402.MODE_VELOCITY: "velocity", MODE_PROFILE_VELOCITY: "profile velocity"}
"""Mode of operation (6060h) to `mode` in the rig file. Bit n - 1 of 6502h states that a drive has mode n."""


def set_heartbeat(objects: NodeObjects, period_ms: int) -> None:
    """Set the period of the drive's own heartbeat, ms.

    Raises:
        DeviceError: the drive does not answer or refuses it.
    """
    _demand(
        lambda: objects.write(cia301.PRODUCER_HEARTBEAT, 0, period_ms, 2),
        lambda: (
            f"It is to send a heartbeat each {period_ms} ms. Look up 1017h and its range in its manual (heartbeat_ms); "
            "a drive with node guarding alone cannot be used"
        ),
    )


def set_mode(objects: NodeObjects, profile: SpeedProfile) -> None:
    """Set the mode of operation.

    Raises:
        DeviceError: the drive does not answer or does not have the mode.
    """
    _demand(
        lambda: objects.write(cia402.MODE_OF_OPERATION, 0, profile.mode, 1),
        lambda: f'It does not take mode = "{_MODES[profile.mode]}" of the rig file. {_its_modes(objects)}',
    )


def set_watch(objects: NodeObjects, host_node_id: int, timeout_ms: int) -> None:
    """Set the watch of the host's heartbeat, and its timeout, ms.

    Raises:
        DeviceError: the drive does not answer or refuses it.
    """
    value = cia402.consumer_heartbeat(host_node_id, timeout_ms)
    _demand(
        lambda: objects.write(cia301.CONSUMER_HEARTBEAT, 1, value, 4),
        lambda: (
            f"It is to watch the heartbeat of node {host_node_id} for {timeout_ms} ms: a drive that does not stop when "
            "its host is gone must not turn the rotor. Look up 1016h and its range in its manual "
            "(heartbeat_timeout_ms), and whether another entry of 1016h watches this node"
        ),
    )


def confirm_target(
    objects: NodeObjects, profile: SpeedProfile, rpm: float, command_again: Callable[[float], bool]
) -> None:
    """Read the target speed back; it is commanded again if the drive does not have it, because a frame may be lost.

    A drive that limits its target, or that answers with another value, is reported in the program's messages.

    Args:
        objects: objects of the drive.
        profile: mode of operation.
        rpm: target speed that was commanded, rpm.
        command_again: commands a speed, rpm, again; it returns False if another command has replaced it.
    """
    raw = profile.pack(0, rpm)[2:]
    found: int | None = None
    for attempt in range(TRIES):
        if attempt and not command_again(rpm):
            return
        with ignoring(_log, "reading the target speed back", DeviceError):
            found = objects.read(profile.target, 0)
            if found is None or found & (1 << 8 * len(raw)) - 1 == int.from_bytes(raw, "little"):
                return
    has = "is not known" if found is None else f"is {profile.rpm(found):g} rpm"
    words = "drive: %g rpm were commanded, its target (%04Xh) %s. Look at its limits (607Fh, 6080h, 6046h)"
    _log.warning(words, rpm, profile.target, has)


def _demand(write: Callable[[], None], remedy: Callable[[], str]) -> None:
    """Write a setting; the error about a refusal contains what to do."""
    try:
        write()
    except NoAnswer:
        raise
    except DeviceError as error:
        raise DeviceError(f"{error}. {remedy()}") from error


def _its_modes(objects: NodeObjects) -> str:
    """Return what the drive states about its modes of operation, and what to do."""
    with ignoring(_log, "reading the supported modes", DeviceError):
        supported = objects.read(cia402.SUPPORTED_MODES, 0) or 0
        if names := [name for mode, name in _MODES.items() if supported >> (mode - 1) & 1]:
            return f'By 6502h it has "{names[0]}"'
    return "Look up its modes of operation in its manual"


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
