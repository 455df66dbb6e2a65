"""Opening of the encoders: they are identified, compared with the rig file, set up and started.

Nothing is stored in an encoder (1010h): after a restart it has its own settings again, and the device must be opened
again. Only the communication is set; direction, scaling and preset are read and never changed.

Identification of CiA 406 encoders on an unknown port; see `daq.drivers.canopen.identity`.
"""

from __future__ import annotations

import logging
from collections.abc import Generator
from typing import Any

from daq.drivers.canopen import cia301
from daq.drivers.canopen.changes import restoring
from daq.drivers.canopen.identity import Search, close, find_nodes, read
from daq.drivers.canopen.node import NMT_PRE_OPERATIONAL, NMT_START
from daq.drivers.canopen.objects import DialogueObjects, NodeObjects
from daq.drivers.contract import Talk
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.questions import drop_replies
from daq.errors import DeviceError
from daq.transports.can_frames import open_bus
from rig_basics.ignoring import ignoring
from rig_drivers.cia406 import wire
from rig_drivers.cia406.report_setup import set_reports
from rig_drivers.cia406.settings import FAULT_KEYS, Encoder, EncoderBus

_log = logging.getLogger(__name__)

_SENDS_SYNC = 1 << 30  # bit of 1005h


def open_encoders(device: str, settings: EncoderBus, talk: Talk) -> dict[str, Any]:
    """Identify all encoders and set them up, then start them.

    Returns:
        Identity: serial (those of all encoders), and of each encoder: serial, maker, product, counts per revolution,
        number of positions, whether they grow counter-clockwise, the place of the position in its reports (bytes), and
        the faults that it has (`node_watch.FoundFaults`).

    Raises:
        DeviceError: an encoder does not answer, is no encoder or another one, counts otherwise than the rig file
            states, or refuses the set-up.
    """
    talk.send(open_bus(settings.bitrate))
    drop_replies(talk)
    identity: dict[str, Any] = {}
    nodes: list[tuple[Encoder, DialogueObjects]] = []
    for encoder in settings.encoders:
        talk.send(wire.network_command(NMT_PRE_OPERATIONAL, encoder.node))
        nodes.append((encoder, DialogueObjects(f"{device}: encoder {encoder.name}", encoder.node, talk)))
    for encoder, objects in nodes:
        identity |= _identify(device, encoder, objects)
        _compare(device, settings, encoder, identity)
    for encoder, objects in nodes:
        identity[f"{encoder.name}_offset"] = _set_up(settings, encoder, objects)
    for encoder, _ in nodes:
        talk.send(wire.network_command(NMT_START, encoder.node))
    serials = [str(identity[f"{encoder.name}_serial"]) for encoder in settings.encoders]
    return {"serial": "/".join(serials), **identity}


def _identify(device: str, encoder: Encoder, objects: NodeObjects) -> dict[str, int]:
    """Read what an encoder is and how it counts."""
    kind = objects.read(cia301.DEVICE_TYPE, 0)
    if kind is None or kind & 0xFFFF != wire.PROFILE:
        shown = "nothing" if kind is None else f"{kind:08X}h, profile {kind & 0xFFFF}"
        raise DeviceError(
            f"{device}: node {encoder.node} is no encoder: its device type (1000h) is {shown}, expected the profile "
            f"{wire.PROFILE}. Correct devices.{device}.{encoder.name}_node"
        )
    scale = _scale(device, encoder, objects)
    maker, product, serial = (objects.read(cia301.IDENTITY, sub) or 0 for sub in (1, 2, 4))
    found = {
        "serial": serial,
        "maker": maker,
        "product": product,
        "per_turn": scale.per_turn,
        "positions": scale.positions,
        "counter_clockwise": int(scale.counter_clockwise),
        **_faults(objects),
    }
    return {f"{encoder.name}_{name}": value for name, value in found.items()}


def _faults(objects: NodeObjects) -> dict[str, int]:
    """Read the faults that an encoder has now: its emergencies about them may have been sent before the session."""
    register = objects.read(cia301.ERROR_REGISTER, 0) or 0
    code = (objects.read(cia301.PREDEFINED_ERROR_FIELD, 1) or 0) & 0xFFFF if register else 0
    alarms, warnings = (objects.read(index, 0) or 0 for index in (wire.ALARMS, wire.WARNINGS))
    return dict(zip(FAULT_KEYS, (register, code, alarms, warnings), strict=True))


def _scale(device: str, encoder: Encoder, objects: NodeObjects) -> wire.Scale:
    parameters = objects.read(wire.OPERATING_PARAMETERS, 0) or 0
    if parameters & wire.SCALING:
        per_turn, positions = objects.read(wire.UNITS_PER_TURN, 0), objects.read(wire.TOTAL_RANGE, 0)
    else:
        per_turn = objects.read(wire.SINGLE_TURN_RESOLUTION, 0)
        turns = objects.read(wire.DISTINGUISHABLE_TURNS, 0)
        positions = None if per_turn is None else per_turn * max(1, turns or 1)
    if not per_turn or not positions or positions % per_turn:
        raise DeviceError(
            f"{device}: encoder {encoder.name} (node {encoder.node}) counts {per_turn} a revolution and {positions} in "
            "all: expected whole revolutions (6001h, 6002h, 6501h, 6502h), or angles would jump at the end of its range"
        )
    return wire.Scale(per_turn, positions, bool(parameters & wire.COUNTER_CLOCKWISE))


def _compare(device: str, settings: EncoderBus, encoder: Encoder, identity: dict[str, Any]) -> None:
    """Compare an encoder with the rig file."""
    name, per_turn, serial = encoder.name, identity[f"{encoder.name}_per_turn"], identity[f"{encoder.name}_serial"]
    if per_turn != settings.counts_per_revolution:
        raise DeviceError(
            f"{device}: encoder {name} (node {encoder.node}) counts {per_turn} a revolution, the rig file states "
            f"{settings.counts_per_revolution}: every angle would be scaled wrongly. Correct the rig file, or the "
            "encoder's scaling (6000h, 6001h)"
        )
    if encoder.serial and serial != encoder.serial:
        raise DeviceError(
            f"{device}: encoder {name} (node {encoder.node}) has serial number {serial}, the rig file states "
            f"{encoder.serial}: it is another encoder, so its zero is unknown. Determine {name}_zero_counts, then "
            f"correct {name}_serial"
        )


def _set_up(settings: EncoderBus, encoder: Encoder, objects: NodeObjects) -> int:
    """Set heartbeat and reports. The heartbeat is optional: the missing reports of an encoder are counted anyway.

    Returns:
        Place of the position in the report, bytes.
    """
    with ignoring(_log, f"setting the heartbeat of encoder {encoder.name}", DeviceError):
        objects.write(cia301.PRODUCER_HEARTBEAT, 0, settings.heartbeat_ms, 2)
    sync = objects.read(cia301.SYNC_IDENTIFIER, 0)
    if sync is not None and (sync & _SENDS_SYNC or sync & 0x7FF != cia301.COB_SYNC):
        objects.write(cia301.SYNC_IDENTIFIER, 0, cia301.COB_SYNC, 4)
    with restoring(objects) as changes:
        return set_reports(settings, encoder, changes)


_NODES = ("a_node", "b_node", "shaft_node")


def identity_turns(settings: EncoderBus) -> IdentityTurns:
    """Query all nodes of the bus for the device type; return the first three encoders, in the order of their numbers.

    Which of them is A, B or the shaft's cannot be queried.
    """
    likely = tuple(encoder.node for encoder in settings.encoders)
    search = Search(settings.port, settings.bitrate, wire.PROFILE, likely, every=True)
    found = yield from find_nodes(search)
    device = None
    if found.nodes:
        nodes = sorted(found.nodes)
        known: dict[str, Any] = dict(zip(_NODES, nodes, strict=False))
        identity: dict[str, str] = {}
        for node in nodes:
            serial = yield from read(settings.port, node, cia301.IDENTITY, 4)
            identity[f"node_{node}"] = "no serial number" if serial is None else f"serial {serial}"
        if (per_turn := (yield from _counts_per_revolution(settings.port, nodes[0]))) is not None:
            known["counts_per_revolution"] = per_turn
        if found.bitrate is not None:
            known["bitrate"] = found.bitrate
        device = FoundDevice(known, identity)
    yield from close(found)
    return device


def _counts_per_revolution(port: str, node: int) -> Generator[IdentityRequest, bytes, int | None]:
    parameters = yield from read(port, node, wire.OPERATING_PARAMETERS, 0)
    scaled = bool((parameters or 0) & wire.SCALING)
    return (yield from read(port, node, wire.UNITS_PER_TURN if scaled else wire.SINGLE_TURN_RESOLUTION, 0))
