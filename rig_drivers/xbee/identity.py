"""Identification of an XBee module at the host, and of the module on the rotor from its radio frames."""

from __future__ import annotations

from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.identity import node_of
from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.settings import XBeeNode

_QUERIES: tuple[str, ...] = ("SH", "SL", "VR", "HV")


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
    heard = yield _query(1, "AP", settings.api_mode)
    mode = next((value[0] for m in (2, 1) if (value := _answer(heard, 1, "AP", m))), 0)
    if mode not in (1, 2):
        return None
    values: dict[str, bytes] = dict.fromkeys(_QUERIES, b"")
    for number, command in enumerate(_QUERIES, 2):
        received = yield _query(number, command, mode)
        heard += received
        values[command] = _answer(received, number, command, mode) or b""
    node = recognise(settings, heard)
    known = {"api_mode": mode, "baud": settings.baud} | dict(node.settings if node else {})
    own = {f"module_{name}": value for name, value in wire.module_identity(values).items()}
    return FoundDevice(known, own)


def _query(number: int, command: str, mode: int) -> IdentityRequest:
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
