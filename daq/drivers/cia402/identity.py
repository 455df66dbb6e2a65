"""Recognition and identification of a CiA 402 drive on an unknown port; see `daq.drivers.canopen.identity`."""

from __future__ import annotations

from collections import Counter

from daq.drivers.canopen import cia301
from daq.drivers.canopen.identity import Search, close, find_nodes, frames_in, identity_of
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.identification import FoundDevice, IdentityTurns

_PROFILE = 402


def recognise(settings: MotorDrive, data: bytes) -> FoundDevice | None:
    """Return the node with the most reports of a valid CiA 402 state; see `Driver.recognise`."""
    reports = Counter[int]()
    for frame in frames_in(data):
        node = frame.arbitration_id - cia301.cob_tpdo(1, 0)
        if 1 <= node <= 127 and len(frame.data) >= cia402.VELOCITY.size:
            word, _ = cia402.VELOCITY.unpack(frame.data)
            reports[node] += cia402.state(word) != cia402.UNKNOWN
    node, count = next(iter(reports.most_common(1)), (0, 0))
    return FoundDevice({"node_id": node}) if count else None


def identity_turns(settings: MotorDrive) -> IdentityTurns:
    """Query the nodes of the bus for the device type; return the first CiA 402 drive."""
    search = Search(settings.port, settings.bitrate, _PROFILE, (settings.node_id,), settings.host_node_id)
    found = yield from find_nodes(search)
    device = None
    if found.nodes:
        node, *others = found.nodes
        identity = yield from identity_of(settings.port, node)
        if others:
            identity["other_nodes"] = ", ".join(map(str, others))
        bitrate = {} if found.bitrate is None else {"bitrate": found.bitrate}
        device = FoundDevice({"node_id": node} | bitrate, identity)
    yield from close(found)
    return device
