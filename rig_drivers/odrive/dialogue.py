"""Opening of an ODrive: the bus, its reports, its version and serial number. The axis receives no command."""

from __future__ import annotations

import queue
from typing import Any

from daq.drivers.contract import Talk
from daq.errors import DeviceError
from daq.transports.can_frames import encode, open_bus
from rig_basics.texts import number_of
from rig_drivers.odrive import wire
from rig_drivers.odrive.settings import Odrive

_REPORT_S = 2.0  # s for the first heartbeat and the first estimates
_ANSWER_S, _TRIES = 0.3, 3  # s for an answer, and requests until it counts as missing


def identify(device: str, settings: Odrive, talk: Talk) -> dict[str, Any]:
    """Open the bus, wait for the reports, and query version and serial number as far as the firmware has them.

    Returns:
        Identity: node_id, firmware, hardware, serial, and the values of the controller in the rig file.

    Raises:
        DeviceError: reports are missing, or version or serial number differ from the rig file.
    """
    while not talk.replies.empty():
        talk.replies.get_nowait()
    talk.send(open_bus(settings.bitrate))
    _wait_for_reports(device, settings, talk)
    version = _query_version(settings, talk)
    if version is None and settings.firmware == "0.6":
        raise DeviceError(
            f"{device}: it does not report its version. Is its firmware 0.5? Then set firmware in its table"
        )
    if version is not None and version.series != settings.firmware:
        raise DeviceError(
            f"{device}: expected firmware {settings.firmware}, it has {version.series}. Its commands and error codes "
            "differ: set firmware in its table"
        )
    serial = "" if settings.firmware == "0.5" else _query_serial(settings, talk)
    if settings.serial and serial != settings.serial:
        found = f"it is {serial}" if serial else "it does not report one"
        raise DeviceError(f"{device}: expected the controller with serial number {settings.serial}, {found}")
    return {
        "node_id": settings.node_id,
        "firmware": settings.firmware if version is None else ".".join(map(str, version.firmware)),
        "hardware": "" if version is None else ".".join(map(str, version.hardware)),
        "serial": serial,
        "gear_ratio": settings.gear_ratio,
        "watchdog_s": settings.watchdog_s,
    }


def _wait_for_reports(device: str, settings: Odrive, talk: Talk) -> None:
    missing = {"heartbeat", "estimates"}
    deadline = talk.clock.wall_s() + _REPORT_S
    while missing and (reply := _reply(talk, deadline)) is not None:
        missing.discard(reply)
    if "heartbeat" in missing:
        came = f"{number_of(talk.bytes_in, 'byte')} came, no heartbeat among them" if talk.bytes_in else "nothing came"
        raise DeviceError(
            f"{device} on {settings.port}: expected heartbeats of node {settings.node_id}, {came}. Is it powered, are "
            f"node number and bit rate ({settings.bitrate} bit/s) right, is the bus terminated?"
        )
    if missing:
        raise DeviceError(
            f"{device}: it sends heartbeats but no encoder estimates. Set their period to {settings.estimates_ms} ms "
            "(encoder_rate_ms or encoder_msg_rate_ms) and save its configuration"
        )


def _query_version(settings: Odrive, talk: Talk) -> wire.Version | None:
    """Return the version; None if it is not answered, as by most firmware 0.5."""
    data = _query(wire.VERSION, "version ", settings, talk, 1 if settings.firmware == "0.5" else _TRIES)
    return None if data is None else wire.parse_version(data)


def _query_serial(settings: Odrive, talk: Talk) -> str:
    """Return the serial number; empty if it is not answered. The version must have shown firmware 0.6."""
    data = _query(wire.ADDRESS, "address ", settings, talk, _TRIES)
    address = None if data is None else wire.parse_address(data)
    return "" if address is None else address[1]


def _query(command: int, prefix: str, settings: Odrive, talk: Talk, tries: int) -> bytes | None:
    for _ in range(tries):
        talk.send(encode(wire.request(settings.node_id, command)))
        deadline = talk.clock.wall_s() + _ANSWER_S
        while (reply := _reply(talk, deadline)) is not None:
            if reply.startswith(prefix):
                return bytes.fromhex(reply.removeprefix(prefix))
    return None


def _reply(talk: Talk, deadline_s: float) -> str | None:
    """Return the next reply; None if none arrives before a time, s."""
    left_s = deadline_s - talk.clock.wall_s()
    if left_s <= 0:
        return None
    try:
        return talk.replies.get(timeout=left_s)
    except queue.Empty:  # usual: no answer in time
        return None
