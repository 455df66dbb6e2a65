"""Identification of CANopen nodes on an unknown port: uploads of objects 1000h and 1018h (CiA 301).

No network command, heartbeat or process data is sent, and no object is written. On an slcan adapter with a closed bus
the bus is opened for the request and closed after it: first in listen-only mode (L) at each bit rate, to find that of
a bus with traffic, then (O) at that rate. On a bus without traffic only the rate of the settings is used, because a
frame at a wrong rate disturbs the nodes. Source of the adapter's commands: LAWICEL CAN232 manual. The firmware of
CANable and CANtact adapters has M1 and O in place of L, acknowledges no command, and answers V with its revision and
the address of its source.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from functools import partial

from daq.drivers.canopen import cia301
from daq.drivers.canopen.objects import read_request, value_of
from daq.drivers.identification import IdentityRequest
from daq.transports.can_frames import CanFrame, decode, encode
from daq.transports.slcan import HostText, LineDecoder

BITRATES = {500_000: "S6", 1_000_000: "S8", 250_000: "S5", 125_000: "S4"}
"""Bit rates of the settings, with the adapter's command."""
_PARTS = {1: "vendor_id", 2: "product_code", 3: "revision", 4: "serial"}
_ANSWER_S, _BATCH_S = 0.3, 0.15  # longest waits for one node and for a batch, s
_BATCH = 16  # nodes that are queried at once; an adapter's buffer holds so many frames
_CANABLE = re.compile(rb"[0-9A-Za-z._-]+ [^\r]*can(?:able|tact)[^\r]*\r", re.IGNORECASE)
_LISTENING, _NORMAL = ("L\r", ""), ("M1\rO\r", "M0\r")  # commands to listen only, and those that end it


@dataclass(frozen=True)
class Search:
    """Nodes to look for.

    Attributes:
        port: the port.
        bitrate: bit rate of a bus without traffic, bit/s.
        profile: device profile of the nodes (the low 16 bits of 1000h).
        likely: nodes that are asked first.
        host: the host's own node, which is not asked; 0: none.
        every: whether all nodes are asked even if some have the profile.
    """

    port: str
    bitrate: int
    profile: int
    likely: tuple[int, ...]
    host: int = 0
    every: bool = False


@dataclass(frozen=True)
class FoundNodes:
    """Nodes with a profile.

    Attributes:
        nodes: their numbers, ascending in each of the groups that are asked at once.
        bitrate: bit rate of the bus, bit/s; None if it is unknown, because the bus was open already.
        opened: whether the bus was opened at an adapter for the search.
    """

    nodes: tuple[int, ...] = ()
    bitrate: int | None = None
    opened: bool = False


def find_nodes(search: Search) -> Generator[IdentityRequest, bytes, FoundNodes]:
    """Ask the nodes of the bus for their profile; the bus stays open at an adapter, see `close`."""
    if search.port.startswith("can:"):
        return FoundNodes((yield from _nodes_on(search)), search.bitrate)
    answer = yield IdentityRequest(b"\r\rV\r", lambda data: b"V" in data and data.endswith(b"\r"))
    lines = LineDecoder().feed(answer)
    canable = _CANABLE.search(answer) is not None
    if not (canable or lines.frames or any(line[:1] == "V" for line in lines.other_lines)):
        return FoundNodes()
    if lines.frames:  # the bus is open: another program has left it so, at an unknown bit rate
        return FoundNodes((yield from _nodes_on(search)))
    bitrate = yield from _bitrate_of_traffic(*_LISTENING)
    if bitrate is None and canable:
        bitrate = yield from _bitrate_of_traffic(*_NORMAL)
    speed = bitrate or search.bitrate
    yield IdentityRequest(f"{BITRATES[speed]}\rO\r".encode(), _acknowledged)
    return FoundNodes((yield from _nodes_on(search)), speed, True)


def close(found: FoundNodes) -> Generator[IdentityRequest, bytes, None]:
    """Close the bus if it was opened for the search."""
    if found.opened:
        yield IdentityRequest(b"C\r", _acknowledged, 0.1)


def identity_of(port: str, node: int) -> Generator[IdentityRequest, bytes, dict[str, int | str]]:
    """Read what 1018h of a node contains: vendor_id, product_code, revision, serial."""
    identity: dict[str, int | str] = {}
    for sub, name in _PARTS.items():
        value = yield from read(port, node, cia301.IDENTITY, sub)
        if value is not None:
            identity[name] = f"{value:#x}" if sub < 4 else value
    return identity


def read(port: str, node: int, index: int, sub: int) -> Generator[IdentityRequest, bytes, int | None]:
    """Read a value of at most four bytes; None if the node has none."""
    return _value(_on(port, (yield _uploads(port, [node], index, sub))), node, index, sub)


def frames_in(data: bytes) -> list[CanFrame]:
    """Return the frames in a link's records that belong to CANopen."""
    return cia301.own_frames(decode(data).frames)


def _on(port: str, data: bytes) -> bytes:
    """Return what a port gave as records: an adapter's line is searched as text, because it may be another device's."""
    return data if port.startswith("can:") else HostText().received(b"\r" + data)


def _bitrate_of_traffic(listen: str, end: str) -> Generator[IdentityRequest, bytes, int | None]:
    """Return the bit rate at which frames are received without taking part on the bus; None if none are."""
    for bitrate, command in BITRATES.items():
        heard = yield IdentityRequest(
            f"{command}\r{listen}".encode(), lambda data: bool(LineDecoder().feed(data).frames), 0.15
        )
        yield IdentityRequest(f"C\r{end}".encode(), _acknowledged, 0.1)
        if cia301.own_frames(LineDecoder().feed(heard).frames):
            return bitrate
    return None


def _acknowledged(data: bytes) -> bool:
    return data.endswith((b"\r", b"\a"))


def _nodes_on(search: Search) -> Generator[IdentityRequest, bytes, tuple[int, ...]]:
    """Return the nodes with the profile on an open bus."""
    found: list[int] = []
    others = [node for node in range(1, 128) if node not in (*search.likely, search.host)]
    for nodes in [search.likely, *(others[at : at + _BATCH] for at in range(0, len(others), _BATCH))]:
        heard = _on(search.port, (yield _uploads(search.port, nodes, cia301.DEVICE_TYPE, 0)))
        types = {node: _value(heard, node, cia301.DEVICE_TYPE, 0) or 0 for node in nodes}
        found += [node for node, kind in types.items() if kind & 0xFFFF == search.profile]
        if found and not search.every:
            break
    return tuple(found)


def _uploads(port: str, nodes: Iterable[int], index: int, sub: int) -> IdentityRequest:
    """Return the request that reads an object of some nodes; it is answered when each node has answered."""
    nodes = list(nodes)
    data = read_request(index, sub)
    records = encode(*(CanFrame(cia301.cob_sdo_request(node), data) for node in nodes))

    def is_answered(got: bytes, wanted: frozenset[int]) -> bool:
        return wanted <= {frame.arbitration_id for frame in frames_in(_on(port, got))}

    wanted = frozenset(map(cia301.cob_sdo_answer, nodes))
    request = records if port.startswith("can:") else HostText().sent(records)
    return IdentityRequest(request, partial(is_answered, wanted=wanted), _ANSWER_S if len(nodes) == 1 else _BATCH_S)


def _value(data: bytes, node: int, index: int, sub: int) -> int | None:
    """Return the value in a node's answer; None without it."""
    asked = read_request(index, sub)[1:4]
    for frame in frames_in(data):
        is_answer = frame.arbitration_id == cia301.cob_sdo_answer(node) and len(frame.data) == len(read_request(0, 0))
        if is_answer and frame.data[1:4] == asked and (value := value_of(frame.data)) is not None:
            return value
    return None
