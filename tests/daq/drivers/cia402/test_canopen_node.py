"""A CANopen node's end of the bus: a client that is not ours reads and writes it."""

from __future__ import annotations

import struct

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError
from hypothesis import given, strategies as st

from daq.drivers.can_lines import Adapter
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import Node, SdoServer
from daq.drivers.canopen.objects import NodeObjects
from daq.drivers.cia402.far_end import drive_objects
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, decode
from daq.transports.slcan import AdapterText


class Wire:
    """canopen's client, its requests answered at once."""

    def __init__(self, server: SdoServer) -> None:
        self.node = canopen.RemoteNode(5, canopen.ObjectDictionary())
        self.network = canopen.Network()
        self.network.add_node(self.node)
        self.network.send_message = self._answered
        self.server = server

    def _answered(self, identifier: int, data: bytes, remote: bool = False) -> None:
        assert identifier == cia301.cob_sdo_request(5)
        answer = self.server.answer(bytes(data).ljust(8, b"\0"))
        self.network.notify(cia301.cob_sdo_answer(5), bytearray(answer), 0.0)


def test_what_a_client_writes_it_reads_again() -> None:
    written: list[tuple[int, int, int]] = []
    wire = Wire(SdoServer(drive_objects(5), {}, lambda *what: written.append(what)))
    for index, sub, value in ((0x1017, 0, b"\x64\0"), (0x6060, 0, b"\x02"), (0x6048, 1, b"\xe8\x03\0\0")):
        wire.node.sdo.download(index, sub, value)
        assert wire.node.sdo.upload(index, sub) == value
    assert written == [(0x1017, 0, 100), (0x6060, 0, 2), (0x6048, 1, 1000)]


def test_what_is_measured_is_read_from_where_it_is() -> None:
    wire = Wire(SdoServer({}, {(0x6044, 0): lambda: struct.pack("<h", -7), (0x6041, 0): lambda: None}))
    assert wire.node.sdo.upload(0x6044, 0) == struct.pack("<h", -7)
    with pytest.raises(SdoAbortedError, match="0x06020000"):
        wire.node.sdo.upload(0x6041, 0)


@pytest.mark.parametrize(
    ("index", "data", "code"), [(0x2000, b"\0", "0x06020000"), (0x1017, b"\0\0\0\0", "0x06070010")]
)
def test_what_cannot_be_written_is_refused_and_changes_nothing(index: int, data: bytes, code: str) -> None:
    server = SdoServer(drive_objects(5), {})
    with pytest.raises(SdoAbortedError, match=code):
        Wire(server).node.sdo.download(index, 0, data)
    assert server.objects == drive_objects(5)


@given(st.binary(min_size=8, max_size=8))
def test_any_request_gets_eight_bytes_that_name_its_object(request: bytes) -> None:
    answer = SdoServer(drive_objects(5), {}).answer(request)
    assert len(answer) == 8
    assert answer[1:4] == request[1:4]


def test_a_late_answer_to_a_read_does_not_end_a_write() -> None:
    """A slow node answers the reading of an object after the host has begun to write it."""
    sent: list[bytes] = []

    def send(text: bytes) -> None:
        (frame,) = decode(text).frames
        sent.append(frame.data)
        objects.take_answer(bytes.fromhex("4B 17 10 00 64 00 00 00"))
        objects.take_answer(bytes.fromhex("60 17 10 00 00 00 00 00"))

    objects = NodeObjects("encoder", 5, send, HostClock())
    objects.write(0x1017, 0, 200, 2)
    assert objects.read(0x1017, 0) == 100
    assert [data[0] for data in sent] == [0x2B, 0x40]


def test_the_network_starts_and_stops_this_node_or_all() -> None:
    node = Node(5, drive_objects(5))
    for data, state in (
        (b"\x01\x05", cia301.Heartbeat.OPERATIONAL),
        (b"\x80\x06", cia301.Heartbeat.OPERATIONAL),  # another node's
        (b"\x80\x00", cia301.Heartbeat.PRE_OPERATIONAL),
        (b"\x01", cia301.Heartbeat.PRE_OPERATIONAL),
        (b"\x02\x05", cia301.Heartbeat.STOPPED),
        (b"\x82\x05", cia301.Heartbeat.PRE_OPERATIONAL),
        (b"\x77\x05", cia301.Heartbeat.PRE_OPERATIONAL),
    ):
        frame = CanFrame(cia301.COB_NMT, data)
        assert node.command(frame) == (data[0] if len(data) == 2 and data[1] in (0, 5) else None)
        boot_up = [CanFrame(cia301.cob_heartbeat(5), b"\x00")] if data == b"\x82\x05" else []
        assert (node.answers(frame), node.state) == (boot_up, state)
    assert node.command(CanFrame(0x205, b"\x01\x05")) is None


def test_a_node_sends_its_heartbeat_with_its_state_when_it_is_due() -> None:
    node = Node(5, drive_objects(5))
    assert node.heartbeat(1.0) == []
    node.sdo.answer(struct.pack("<BHBHH", 0x2B, cia301.PRODUCER_HEARTBEAT, 0, 100, 0))
    node.answers(CanFrame(cia301.COB_NMT, b"\x01\x05"))
    sent = [frame.data for k in range(100) for frame in node.heartbeat(1.0 + 0.01 * k)]
    assert set(sent) == {bytes([cia301.Heartbeat.OPERATIONAL])}
    assert 10 <= len(sent) <= 11


def test_an_adapter_answers_for_itself() -> None:
    line, adapter = AdapterText(), Adapter()
    records, answers = line.received(b"\rC\rS6\rV\rN\rO\rt1230\rT000001230\rt1\r")
    assert [frame.arbitration_id for frame in adapter.receive(records)] == [0x123, 0x123]
    assert answers == b"\x07" + b"\r\r\r" + b"V1013\rN4F1C\r" + b"\r" + b"z\rZ\r"
    assert adapter.open
    adapter.receive(line.received(b"C\r")[0])
    assert not adapter.open
