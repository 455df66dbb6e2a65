"""Identification of a CiA 402 drive on an unknown port: uploads of objects 1000h and 1018h (CiA 301).

No network command, heartbeat or process data is sent, and no object is written. On an slcan adapter with a closed bus
the bus is opened for the request and closed after it: first in listen-only mode (L) at each bit rate, to find that of
a bus with traffic, then (O) at that rate. On a bus without traffic only the rate of the settings is used, because a
frame at a wrong rate disturbs the nodes. Source of the adapter's commands: LAWICEL CAN232 manual.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Generator, Iterable
from functools import partial

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.transports import slcan

BITRATES = {500_000: "S6", 1_000_000: "S8", 250_000: "S5", 125_000: "S4"}
"""Bit rates of the settings, with the adapter's command."""
_DEVICE_TYPE, _IDENTITY = 0x1000, 0x1018
_PROFILE = 402
_PARTS = {1: "vendor_id", 2: "product_code", 3: "revision", 4: "serial"}
_ANSWER_S, _BATCH_S = 0.3, 0.15  # longest waits for one node and for a batch, wall s
_BATCH = 16  # nodes that are queried at once; an adapter's buffer holds so many frames
_UPLOAD, _EXPEDITED = 0x40, 0x43
_SDO = struct.Struct("<BHBI")

_Steps = Generator[IdentityRequest, bytes, "list[slcan.CanFrame]"]


def recognise(settings: MotorDrive, data: bytes) -> FoundDevice | None:
    """Return the node with the most reports of a valid CiA 402 state; see RecognisesBytes."""
    reports = Counter[int]()
    for frame in _frames(data):
        node = frame.arbitration_id - cia301.cob_tpdo(1, 0)
        if 1 <= node <= 127 and len(frame.data) >= cia402.TPDO1_BYTES:
            word, _ = cia402.unpack_tpdo1(frame.data)
            reports[node] += cia402.state(word) != cia402.UNKNOWN
    node, count = next(iter(reports.most_common(1)), (0, 0))
    return FoundDevice({"node_id": node}) if count else None


def identity_turns(settings: MotorDrive) -> IdentityTurns:
    """Query the nodes of the bus for the device type; return the first CiA 402 drive."""
    if settings.port.startswith("can:"):
        return (yield from _drive_on(settings, settings.bitrate))
    answer = yield IdentityRequest(b"\r\rV\r", lambda data: b"V" in data and data.endswith(b"\r"))
    lines = slcan.LineDecoder().feed(answer)
    if not (lines.frames or any(line[:1] == "V" for line in lines.other_lines)):
        return None
    if lines.frames:  # the bus is open: another program has left it so, at an unknown bit rate
        return (yield from _drive_on(settings, None))
    bitrate = yield from _bitrate_of_traffic()
    speed = bitrate or settings.bitrate
    yield IdentityRequest(f"{BITRATES[speed]}\rO\r".encode(), _acknowledged)
    found = yield from _drive_on(settings, speed)
    yield IdentityRequest(b"C\r", _acknowledged, 0.1)
    return found


def _bitrate_of_traffic() -> Generator[IdentityRequest, bytes, int | None]:
    """Return the bit rate at which frames are received without taking part on the bus; None if none are."""
    for bitrate, command in BITRATES.items():
        heard = yield IdentityRequest(f"{command}\rL\r".encode(), lambda data: bool(_frames(data)), 0.15)
        yield IdentityRequest(b"C\r", _acknowledged, 0.1)
        if _frames(heard):
            return bitrate
    return None


def _acknowledged(data: bytes) -> bool:
    return data.endswith((b"\r", b"\a"))


def _drive_on(settings: MotorDrive, bitrate: int | None) -> IdentityTurns:
    """Return the first drive on an open bus."""
    first = [settings.node_id]
    others = [node for node in range(1, 128) if node not in (settings.node_id, settings.host_node_id)]
    for nodes in [first, *(others[at : at + _BATCH] for at in range(0, len(others), _BATCH))]:
        heard = yield _uploads(nodes, _DEVICE_TYPE, 0)
        drives = [node for node in nodes if (_value(heard, node, _DEVICE_TYPE, 0) or 0) & 0xFFFF == _PROFILE]
        if not drives:
            continue
        node, identity = drives[0], dict[str, int | str]()
        for sub, name in _PARTS.items():
            value = _value((yield _uploads([node], _IDENTITY, sub)), node, _IDENTITY, sub)
            if value is not None:
                identity[name] = f"{value:#x}" if sub < 4 else value
        if drives[1:]:
            identity["other_nodes"] = ", ".join(map(str, drives[1:]))
        return FoundDevice({"node_id": node} | ({} if bitrate is None else {"bitrate": bitrate}), identity)
    return None


def _uploads(nodes: Iterable[int], index: int, sub: int) -> IdentityRequest:
    """Return the request that reads an object of some nodes; it is answered when each node has answered."""
    nodes = list(nodes)
    data = _SDO.pack(_UPLOAD, index, sub, 0)
    lines = b"".join(slcan.encode(slcan.CanFrame(cia301.cob_sdo_request(node), data)) for node in nodes)

    def is_answered(got: bytes, wanted: frozenset[int]) -> bool:
        return wanted <= {frame.arbitration_id for frame in _frames(got)}

    wanted = frozenset(map(cia301.cob_sdo_answer, nodes))
    return IdentityRequest(lines, partial(is_answered, wanted=wanted), _ANSWER_S if len(nodes) == 1 else _BATCH_S)


def _value(data: bytes, node: int, index: int, sub: int) -> int | None:
    """Return the value in a node's answer (expedited upload); None without it."""
    for frame in _frames(data):
        if frame.arbitration_id == cia301.cob_sdo_answer(node) and len(frame.data) == _SDO.size:
            command, *place, value = _SDO.unpack(frame.data)
            if command & _EXPEDITED == _EXPEDITED and place == [index, sub]:
                return value & (1 << 8 * (4 - (command >> 2 & 3))) - 1
    return None


def _frames(data: bytes) -> list[slcan.CanFrame]:
    return cia301.own_frames(slcan.LineDecoder().feed(data).frames)
