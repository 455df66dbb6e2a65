"""Identification of an XBee module by local AT commands in API frames. No parameter is changed."""

from __future__ import annotations

from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.questions import ANSWER_S, TRIES, ask
from daq.errors import DeviceError
from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.settings import XBeeNode

_QUERIES = ("AP", "VR", "HV", "SH", "SL", "NP", "DB")


def identify(device: str, settings: XBeeNode, talk: Talk) -> dict[str, Any]:
    """Query API mode, firmware, serial number, payload size and signal strength.

    The query for the API mode and its answer contain no byte that AP=2 would escape. The answer of a module in another
    mode than that of the rig file can therefore be decoded.

    Returns:
        Identity: driver, port, api_mode, and as far as the module answers: firmware, hardware (hex), serial (16 hex
        digits), payload_bytes, rssi_dBm (of the last packet from any sender).

    Raises:
        DeviceError: the module does not answer, is in another API mode, or `node_address` is its own address.
    """
    mode = _query(settings, talk, "AP")
    if mode is None:
        raise DeviceError(
            f"{device} on {settings.port}: no answer to the AT command AP within {ANSWER_S * TRIES:g} s. Is the "
            f"module in API mode (AP={settings.api_mode}, not 0), its baud rate {settings.baud} (BD), are both lines "
            "connected?"
        )
    if int.from_bytes(mode, "big") != settings.api_mode:
        raise DeviceError(
            f"{device}: the module is in API mode AP={int.from_bytes(mode, 'big')}, the rig file states "
            f"{settings.api_mode}. Correct devices.{device}.api_mode, or set AP and write it (WR)"
        )
    values = {command: _query(settings, talk, command) for command in _QUERIES[1:]}
    identity: dict[str, Any] = {"api_mode": settings.api_mode}
    identity |= wire.module_identity(values)
    if identity.get("serial") == settings.node_address:
        raise DeviceError(
            f"{device}: node_address {settings.node_address} is that of the module at the host itself. "
            f"Set devices.{device}.node_address to the address of the module on the rotor"
        )
    if payload := values["NP"]:
        identity["payload_bytes"] = int.from_bytes(payload, "big")
    if (strength := values["DB"]) and any(strength):  # 0: no packet has been received yet
        identity["rssi_dBm"] = -int.from_bytes(strength, "big")
    return identity


def _query(settings: XBeeNode, talk: Talk, command: str) -> bytes | None:
    """Return the value of a module's answer; None if it does not answer or refuses the command."""
    frame_id = _QUERIES.index(command) + 1

    def found_in(reply: str) -> wire.AtAnswer | None:
        answer = wire.AtAnswer.of_text(reply)
        return answer if (answer.frame_id, answer.command) == (frame_id, command) else None

    request = framing.encode(wire.at_command(frame_id, command), escaped=settings.api_mode == 2)
    answer = ask(talk, request, found_in)
    return answer.value if answer is not None and answer.status == 0 else None
