"""Identification of a base station on an unknown port, and of the nodes whose samples it passes on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator

from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.framing import PacketSearch
from rig_drivers.microstrain.rates import BASE_ADDRESS, RATES_HZ
from rig_drivers.microstrain.settings import MicroStrainNode
from rig_drivers.microstrain.wire import Version


def identity_turns(settings: MicroStrainNode) -> IdentityTurns:
    """Ping the base station, then read its serial number and firmware from its EEPROM.

    No packet is sent by radio. The address of the node is that of the node with most samples among the received bytes;
    an idle node sends none.
    """
    heard = yield _request(settings.aspp, wire.PING)
    if _answer(heard, settings.aspp, wire.PING) is None:
        return None
    words: dict[int, int | None] = {}
    for place in (*wire.IDENTITY_PLACES, wire.FIRMWARE):
        words[place], received = yield from _word(settings.aspp, place)
        heard += received
    identity: dict[str, str | int] = {"sensor": "base station"}
    model, option, high, low, firmware = words.values()
    if model is not None and option is not None and high is not None and low is not None:
        identity["base_serial"] = wire.serial_number(model, option, high, low)
    if firmware is not None:
        identity["base_firmware"] = wire.firmware_version(firmware)
    return FoundDevice({"baud": settings.baud, "aspp": settings.aspp, **_node(heard, settings.aspp)}, identity)


def _word(version: Version, place: int) -> Generator[IdentityRequest, bytes, tuple[int | None, bytes]]:
    """Read a word of the base station's EEPROM; return it, None without an answer, and the received bytes."""
    data = place.to_bytes(2, "big")
    received = yield _request(version, wire.BASE_READ, data)
    answer = _answer(received, version, wire.BASE_READ, data)
    return None if answer is None or len(answer) != 2 else int.from_bytes(answer, "big"), received


def _request(version: Version, command: int, data: bytes = b"") -> IdentityRequest:
    request = wire.request(version, BASE_ADDRESS, command, data)
    return IdentityRequest(request, lambda got: _answer(got, version, command, data) is not None)


def _answer(data: bytes, version: Version, command: int, arguments: bytes = b"") -> bytes | None:
    """Return what an answer of the base station contains after the command and its arguments; None without it."""
    start = command.to_bytes(2, "big") + arguments
    for packet in PacketSearch(version).feed(data).packets:
        if (packet.kind, packet.address) == (wire.BASE_SUCCESS, BASE_ADDRESS) and packet.payload.startswith(start):
            return packet.payload[len(start) :]
    return None


def _node(data: bytes, version: Version) -> dict[str, int]:
    """Return address and sample rate of the node with most packets of samples; empty without one."""
    rates: dict[int, list[int]] = {}
    for packet in PacketSearch(version).feed(data).packets:
        try:
            content = wire.sweeps_of(packet, version)
            sweeps = None if content is None else wire.parse_sweeps(content, version)
        except ValueError:  # usual: a damaged packet that the check let pass
            continue
        if sweeps is not None and (rate_Hz := RATES_HZ.get(sweeps.rate_code)) is not None:
            rates.setdefault(packet.address, []).append(rate_Hz)
    if not rates:
        return {}
    address = max(rates, key=lambda each: len(rates[each]))
    return {"node_address": address, "rate_Hz": Counter(rates[address]).most_common(1)[0][0]}
