"""Identification of a VESC, before any command to its motor.

Identification of a VESC on an unknown port or on the network. No command to the motor is sent.
"""

from __future__ import annotations

import ipaddress
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.identification import Announcement, FoundDevice, IdentityRequest, IdentityTurns, NetworkDevice
from daq.drivers.questions import TRIES, ask
from daq.errors import DeviceError
from daq.transports.port_names import network_port
from rig_basics.texts import number_of
from rig_drivers.vesc import wire
from rig_drivers.vesc.packets import PacketDecoder
from rig_drivers.vesc.settings import Vesc, VescMotor

_MIN_MAJOR = 3  # first major version of the firmware whose answers have the layout in `wire`


def identify(device: str, settings: VescMotor, talk: Talk, query: bytes, advice: str) -> dict[str, Any]:
    """Query firmware and hardware. The controller's set-up is not changed; it cannot be queried.

    Args:
        query: encoded query of the firmware.
        advice: what to look at if the controller does not answer.

    Returns:
        Identity: firmware, hardware, serial, and the values of the controller in the rig file.

    Raises:
        DeviceError: the controller does not answer, or its firmware's answers have another layout.
    """
    heard: list[str] = []

    def found_in(reply: str) -> wire.Firmware | None:
        try:
            return wire.parse_identity(bytes.fromhex(reply))
        except ValueError:  # usual: words, no payload: what else is on the line
            heard.append(reply)
            return None

    firmware = ask(talk, query, found_in)
    if firmware is not None:
        if firmware.major < _MIN_MAJOR:
            raise DeviceError(
                f"{device}: firmware {firmware.major}.{firmware.minor:02d} answers in an unknown layout, "
                f"expected {_MIN_MAJOR}.00 or later. Update the controller's firmware"
            )
        return {**firmware.facts, "pole_pairs": settings.pole_pairs, "timeout_s": settings.timeout_s}
    came = f"{number_of(talk.bytes_in, 'byte')} came, none of them an answer" if talk.bytes_in else "nothing came"
    also = f", but {', '.join(heard)}" if heard else ""
    raise DeviceError(
        f"{device} on {settings.port}: expected its firmware's version, {came} in {TRIES} tries{also}. {advice}"
    )


ANNOUNCED_ON = 65_109
"""UDP port to which a VESC Express broadcasts its address each second. Source: its firmware, main/comm_wifi.c."""


def identity_turns(settings: Vesc) -> IdentityTurns:
    """Query the firmware's version, which does not reset the controller's timeout."""
    request = IdentityRequest(wire.firmware_version(), lambda data: _firmware(data) is not None)
    firmware = _firmware((yield request))
    if firmware is None:
        return None
    return FoundDevice({"baud": settings.baud}, firmware.facts)


def _firmware(data: bytes) -> wire.Firmware | None:
    payloads = PacketDecoder().feed(data).payloads
    return next((found for payload in payloads if (found := wire.parse_identity(payload)) is not None), None)


def announced(data: bytes, sender: str) -> NetworkDevice | None:
    """Parse a datagram `NAME::ADDRESS::PORT`, which a NUL ends.

    Args:
        data: the datagram.
        sender: address from which it came. It is used in place of an address that cannot be reached.
    """
    name, *parts = data.rstrip(b"\0").decode("utf-8", "replace").split("::")
    if len(parts) != 2 or not (parts[1].isascii() and parts[1].isdecimal() and 0 < int(parts[1]) < 2**16):
        return None
    try:
        address = ipaddress.IPv4Address(parts[0])
    except ValueError:  # usual: the datagram of another device
        return None
    host = sender if address.is_unspecified else str(address)
    return NetworkDevice(network_port(host, int(parts[1])), FoundDevice({}, {"name": name}))


def announcement() -> Announcement:
    """Return how a program of the maker announces the controller that it is connected to."""
    return Announcement(ANNOUNCED_ON, announced)
