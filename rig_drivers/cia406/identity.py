"""Identification of CiA 406 encoders on an unknown port; see `daq.drivers.canopen.identity`."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from daq.drivers.canopen import cia301
from daq.drivers.canopen.identity import Search, close, find_nodes, read
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import EncoderBus

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
