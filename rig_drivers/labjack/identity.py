"""Identification of a LabJack on the network by the search request of its maker. It only reads registers."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from daq.drivers.identification import Announcement, FoundDevice, NetworkDevice
from daq.transports.port_names import network_port
from rig_drivers.labjack import wire
from rig_drivers.labjack.wire import Register

MODELS: Mapping[float, str] = {4.0: "T4", 7.0: "T7"}
"""Value of the register PRODUCT to model."""
IDENTITY_READS = tuple(wire.read(register, 2) for register in (Register.PRODUCT, Register.FIRMWARE, Register.SERIAL))
_IDENTITY = struct.Struct(">ffI")
_SEARCH_PORT = 52_362
"""UDP port on which the devices answer requests. Source: the maker's data sheet of the T series, Ethernet."""
_COMMAND_PORT = 502
_SEARCH_NUMBER = 0x5052
"""Transaction number of the search: an answer has it too."""


def parse_identity(registers: bytes) -> tuple[float, float, int] | None:
    """Return product, firmware and serial number from the answer to IDENTITY_READS; None if it is not one."""
    return _IDENTITY.unpack(registers) if len(registers) == _IDENTITY.size else None


def found(data: bytes, sender: str) -> NetworkDevice | None:
    """Parse a datagram that answers the search.

    Args:
        data: the datagram.
        sender: address from which it came.
    """
    messages = wire.MessageDecoder().feed(data).messages
    if len(messages) != 1 or (messages[0].number, messages[0].function) != (_SEARCH_NUMBER, wire.FEEDBACK):
        return None
    values = parse_identity(messages[0].body)
    if values is None or values[0] not in MODELS:
        return None
    product, firmware, serial = values
    identity = {"model": MODELS[product], "firmware": round(firmware, 4), "serial": serial}
    return NetworkDevice(network_port(sender, _COMMAND_PORT), FoundDevice({"serial": serial}, identity))


def announcement() -> Announcement:
    """Return how a device answers the search request of its maker."""
    return Announcement(0, found, wire.request(_SEARCH_NUMBER, IDENTITY_READS), _SEARCH_PORT)
