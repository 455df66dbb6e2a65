"""Identification of an XBee module by local AT commands in API frames. No parameter is changed.

Identification of an XBee module at the host, and of the module on the rotor from its radio frames.
"""

from __future__ import annotations

from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.questions import ANSWER_S, TRIES, ask
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.identity import node_of
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


_SEARCH_QUERIES: tuple[str, ...] = ("SH", "SL", "VR", "HV")


def recognise(settings: XBeeNode, data: bytes) -> FoundDevice | None:
    """Return API mode, the address of the module that sends most of the RotorLink payloads, and its node.

    See `Driver.recognise`.
    """
    senders: dict[tuple[int, str], list[rotorlink.NodeFrame]] = {}
    for mode in (2, 1):
        for frame in _frames(data, mode):
            if isinstance(frame, wire.Received) and (node_frame := _payload(frame)) is not None:
                senders.setdefault((mode, frame.source), []).append(node_frame)
    if not senders:
        return None
    (mode, address), frames = max(senders.items(), key=lambda each: len(each[1]))
    return node_of(frames, {"api_mode": mode, "node_address": address, "baud": settings.baud})


def identity_turns(settings: XBeeNode) -> IdentityTurns:
    """Query API mode, serial number and firmware by local AT commands, which are not sent by radio.

    The query for the API mode contains no byte that a mode escapes; its answer shows the mode.
    """
    heard = yield _ask_module(1, "AP", settings.api_mode)
    mode = next((value[0] for m in (2, 1) if (value := _answer(heard, 1, "AP", m))), 0)
    if mode not in (1, 2):
        return None
    values: dict[str, bytes] = dict.fromkeys(_SEARCH_QUERIES, b"")
    for number, command in enumerate(_SEARCH_QUERIES, 2):
        received = yield _ask_module(number, command, mode)
        heard += received
        values[command] = _answer(received, number, command, mode) or b""
    node = recognise(settings, heard)
    known = {"api_mode": mode, "baud": settings.baud} | dict(node.settings if node else {})
    own = {f"module_{name}": value for name, value in wire.module_identity(values).items()}
    return FoundDevice(known, own)


def _ask_module(number: int, command: str, mode: int) -> IdentityRequest:
    data = framing.encode(wire.at_command(number, command), escaped=mode == 2)
    return IdentityRequest(data, lambda got: any(_answer(got, number, command, m) is not None for m in (1, 2)))


def _answer(data: bytes, number: int, command: str, mode: int) -> bytes | None:
    """Return the value of an answer to an AT command among received bytes; None without it, or if it is refused."""
    for frame in _frames(data, mode):
        if isinstance(frame, wire.AtAnswer) and (frame.frame_id, frame.command) == (number, command):
            return frame.value if frame.status == 0 else None
    return None


def _frames(data: bytes, mode: int) -> list[wire.ApiFrame]:
    found: list[wire.ApiFrame] = []
    for part in framing.ApiDecoder(escaped=mode == 2).feed(data):
        if isinstance(part, framing.DamagedPart):
            continue
        try:
            found.append(wire.parse(part))
        except ValueError:  # usual: bytes of another device that look like a frame
            continue
    return found


def _payload(frame: wire.Received) -> rotorlink.NodeFrame | None:
    """Return the node's frame in radio data; None if they are of another device, or the sender is unknown."""
    if frame.source_64 is None and frame.source_16 is None:
        return None
    try:
        return rotorlink.parse_node(frame.payload)
    except rotorlink.BadFrame:  # usual: radio data of another device
        return None
