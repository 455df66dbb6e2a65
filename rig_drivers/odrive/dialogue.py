"""Opening of an ODrive: the bus, its reports, its version and serial number. The axis receives no command."""

from __future__ import annotations

from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.questions import TRIES, ask, drop_replies, replies_within
from daq.errors import DeviceError
from daq.transports.can_frames import encode, open_bus
from rig_basics.texts import number_of
from rig_drivers.odrive import wire
from rig_drivers.odrive.settings import Odrive

_REPORT_S = 2.0  # s for the first heartbeat and the first estimates


def identify(device: str, settings: Odrive, talk: Talk) -> dict[str, Any]:
    """Open the bus, wait for the reports, and query version and serial number as far as the firmware has them.

    Returns:
        Identity: node_id, firmware, hardware, serial, and the values of the controller in the rig file.

    Raises:
        DeviceError: reports are missing, or version or serial number differ from the rig file.
    """
    drop_replies(talk)
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
    for reply in replies_within(talk, _REPORT_S):
        missing.discard(reply)
        if not missing:
            return
    if "heartbeat" in missing:
        came = f"{number_of(talk.bytes_in, 'byte')} came, no heartbeat among them" if talk.bytes_in else "nothing came"
        raise DeviceError(
            f"{device} on {settings.port}: expected heartbeats of node {settings.node_id}, {came}. Is it powered, are "
            f"node number and bit rate ({settings.bitrate} bit/s) right, is the bus terminated?"
        )
    raise DeviceError(
        f"{device}: it sends heartbeats but no encoder estimates. Set their period to {settings.estimates_ms} ms "
        "(encoder_rate_ms or encoder_msg_rate_ms) and save its configuration"
    )


def _query_version(settings: Odrive, talk: Talk) -> wire.Version | None:
    """Return the version; None if it is not answered, as by most firmware 0.5."""
    data = _query(wire.VERSION, "version ", settings, talk, 1 if settings.firmware == "0.5" else TRIES)
    return None if data is None else wire.parse_version(data)


def _query_serial(settings: Odrive, talk: Talk) -> str:
    """Return the serial number; empty if it is not answered. The version must have shown firmware 0.6."""
    data = _query(wire.ADDRESS, "address ", settings, talk, TRIES)
    address = None if data is None else wire.parse_address(data)
    return "" if address is None else address[1]


def _query(command: int, prefix: str, settings: Odrive, talk: Talk, tries: int) -> bytes | None:
    def found_in(reply: str) -> bytes | None:
        return bytes.fromhex(reply.removeprefix(prefix)) if reply.startswith(prefix) else None

    return ask(talk, encode(wire.request(settings.node_id, command)), found_in, tries=tries)
