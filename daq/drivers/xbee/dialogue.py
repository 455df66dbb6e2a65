# pyright: strict
"""Asking an XBee module who it is: local AT commands in API frames. Nothing is set."""

from __future__ import annotations

import queue
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.xbee import framing, wire
from daq.drivers.xbee.settings import XBeeNode
from daq.errors import DeviceError

_ANSWER_S, _TRIES = 0.5, 3  # wall seconds
_QUESTIONS = ("AP", "VR", "HV", "SH", "SL", "NP", "DB")


def identify(device: str, settings: XBeeNode, talk: Talk) -> dict[str, Any]:
    """Ask for API mode, firmware, serial number, payload size and signal strength.

    The question for the API mode and its answer hold no byte that AP=2 would escape, so a module in the other mode than
    the rig file's is understood and named.

    Returns:
        Identity: driver, port, api_mode, and what the module told: firmware, hardware (hex), serial (16 hex digits),
        payload_bytes, rssi_dBm (of the last packet, whoever sent it).
    Raises:
        DeviceError: no answer, another API mode, or the address of the module itself where the node's is expected.
    """
    mode = _ask(settings, talk, "AP")
    if mode is None:
        raise DeviceError(
            f"{device} on {settings.port}: no answer to the AT command AP within {_ANSWER_S * _TRIES:g} s. Is the "
            f"module in API mode (AP={settings.api_mode}, not 0), its baud rate {settings.baud} (BD), are both lines "
            "connected?"
        )
    if int.from_bytes(mode, "big") != settings.api_mode:
        raise DeviceError(
            f"{device}: the module is in API mode AP={int.from_bytes(mode, 'big')}, the rig file says "
            f"{settings.api_mode}. Correct devices.{device}.api_mode, or set AP and write it (WR)"
        )
    told = {command: _ask(settings, talk, command) for command in _QUESTIONS[1:]}
    identity: dict[str, Any] = {"driver": "xbee", "port": settings.port, "api_mode": settings.api_mode}
    for name, command in (("firmware", "VR"), ("hardware", "HV")):
        if value := told[command]:
            identity[name] = value.hex().upper()
    high, low = told["SH"], told["SL"]
    if high and low:
        identity["serial"] = f"{int.from_bytes(high, 'big'):08X}{int.from_bytes(low, 'big'):08X}"
        if identity["serial"] == settings.node_address:
            raise DeviceError(
                f"{device}: node_address {settings.node_address} is that of the module at the host itself. "
                f"Set devices.{device}.node_address to the address of the module on the rotor"
            )
    if payload := told["NP"]:
        identity["payload_bytes"] = int.from_bytes(payload, "big")
    if (strength := told["DB"]) and any(strength):  # 0: no packet came yet
        identity["rssi_dBm"] = -int.from_bytes(strength, "big")
    return identity


def _ask(settings: XBeeNode, talk: Talk, command: str) -> bytes | None:
    """The value a module answers with; None when it does not answer, or refuses."""
    while not talk.replies.empty():
        talk.replies.get_nowait()
    frame_id = _QUESTIONS.index(command) + 1
    for _ in range(_TRIES):
        talk.send(framing.encode(wire.at_command(frame_id, command), escaped=settings.api_mode == 2))
        deadline = talk.clock.wall_s() + _ANSWER_S
        while (left := deadline - talk.clock.wall_s()) > 0:
            try:
                reply = talk.replies.get(timeout=left)
            except queue.Empty:
                break
            told_id, told_command, value, *status = reply.split(" ")
            if (told_id, told_command) == (str(frame_id), command):
                return bytes.fromhex(value) if status == ["ok"] else None
    return None
