"""Requirements of a Link, tested with a pty, a TCP port and a CAN adapter."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest

from daq.errors import LinkLost
from daq.transports import HostClock, Link, open_link
from daq.transports.can_frames import CanFrame, FrameDecoder, decode, encode
from daq.transports.wires import PtyWire, TcpWire, make_wire
from tests.daq.free_ports import free_udp_port

FRAME = encode(CanFrame(0x185, b"\x37\x02\x10\x00"))


@dataclass
class Peer:
    """The far end of a link: send, receive, pull the cable."""

    link: Link
    send: Callable[[bytes], None]
    receive: Callable[[], bytes]
    pull: Callable[[], None] | None
    close: Callable[[], None]


def _wired(wire: Any, bitrate: int | None = None) -> Peer:
    link = open_link(wire.port, 921_600, bitrate)
    wire.receive()  # a TCP wire accepts here
    return Peer(link, wire.send, wire.receive, wire.pull, wire.close)


def _can() -> Peer:
    far = can.Bus(interface="virtual", channel="contract")
    link = open_link("can:virtual:contract", 0)
    decoder = FrameDecoder()

    def send(data: bytes) -> None:
        for frame in decoder.feed(data).frames:
            far.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))

    def receive() -> bytes:
        message = far.recv(1.0)
        return b"" if message is None else encode(CanFrame(message.arbitration_id, bytes(message.data)))

    return Peer(link, send, receive, None, far.shutdown)


@pytest.fixture(params=["pty", "tcp", "can", "slcan"])
def peer(request: pytest.FixtureRequest) -> Iterator[Peer]:
    if request.param == "pty" and sys.platform == "win32":
        pytest.skip("ptys need POSIX")
    makers = {
        "pty": lambda: _wired(PtyWire()),
        "tcp": lambda: _wired(TcpWire()),
        "can": _can,
        "slcan": lambda: _wired(make_wire("tcp", adapter=True), 500_000),
    }
    made = makers[request.param]()
    yield made
    made.link.close()
    made.close()


def _arrives(read: Callable[[], bytes], wanted: bytes) -> bytes:
    got, deadline = b"", time.monotonic() + 3
    while len(got) < len(wanted) and time.monotonic() < deadline:
        got += read()
    return got


def test_bytes_arrive_whole_and_in_order(peer: Peer) -> None:
    for _ in range(20):
        peer.send(FRAME)
    came = decode(_arrives(lambda: peer.link.read(0.2), FRAME * 20))
    assert (came.frames, came.damaged) == (decode(FRAME * 20).frames, 0)  # an adapter may state their times


def test_bytes_leave_whole_and_in_order(peer: Peer) -> None:
    peer.link.write(FRAME * 3)
    assert _arrives(peer.receive, FRAME * 3) == FRAME * 3


def test_silence_is_an_empty_read_after_the_timeout(peer: Peer) -> None:
    assert peer.link.read(0.01) == b""


def test_a_pulled_cable_is_link_lost(peer: Peer) -> None:
    if peer.pull is None:
        pytest.skip("an in-process bus has no cable")
    peer.pull()
    with pytest.raises(LinkLost, match=r"lost|closed"):
        _arrives(lambda: peer.link.read(0.2), b"x" * 100)


def test_the_error_for_a_missing_port_contains_what_to_check() -> None:
    with pytest.raises(LinkLost, match="plugged in"):
        open_link("/dev/no-such-port", 921_600)
    with pytest.raises(LinkLost, match="plugged in"):
        open_link("socket://127.0.0.1:1", 921_600)


def test_a_device_that_sends_datagrams_is_read_and_answered() -> None:
    device = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    device.bind(("127.0.0.1", 0))
    port = free_udp_port()
    link = open_link(f"udp://127.0.0.1:{port}", 0)
    try:
        assert link.read(0.01) == b""
        with pytest.raises(LinkLost, match="address is unknown"):
            link.write(b"?")
        for data in (b"one", b"", b"two"):
            device.sendto(data, ("127.0.0.1", port))
        assert link.read(3.0) == b"onetwo"
        device.sendto(b"", ("127.0.0.1", port))
        assert link.read(3.0) == b""
        link.write(b"answer")
        assert device.recv(100) == b"answer"
        with pytest.raises(LinkLost, match=r"another program has it open|cannot be opened"):
            open_link(f"udp://127.0.0.1:{port}", 0)
    finally:
        device.close()
        link.close()
        link.close()
    with pytest.raises(LinkLost, match="lost while reading"):
        link.read(0.01)
    with pytest.raises(LinkLost, match="lost while writing"):
        link.write(b"x")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems may assign a pty's name again")
def test_the_name_of_a_pulled_port_is_not_given_to_another_program() -> None:
    pulled = PtyWire()
    pulled.pull()
    others = [PtyWire() for _ in range(8)]
    try:
        assert pulled.port not in [other.port for other in others]
        with pytest.raises(LinkLost, match="cannot be opened"):
            open_link(pulled.port, 921_600)
    finally:
        for wire in (pulled, *others):
            wire.close()


def test_the_host_clock_advances_with_the_monotonic_one_from_the_present() -> None:
    clock = HostClock()
    assert abs(clock.now_ns() - time.time_ns()) < 5_000_000_000
    longest = time.monotonic_ns()
    before = clock.now_ns()
    clock.wait(0.05)
    clock.wait(-1.0)
    passed = clock.now_ns() - before
    longest = time.monotonic_ns() - longest
    assert 50_000_000 <= passed <= longest


def test_a_tcp_far_end_serves_one_host_and_hangs_up_on_the_next() -> None:
    wire = TcpWire()
    first = open_link(wire.port, 921_600)
    assert wire.connected()
    refused: list[LinkLost] = []

    def intrude() -> None:
        try:
            open_link(wire.port, 921_600)
        except LinkLost as error:
            refused.append(error)

    intruder = threading.Thread(target=intrude)
    intruder.start()
    while intruder.is_alive():
        wire.send(FRAME)
        wire.descriptor()
        assert first.read(0.01) != b""  # the first goes on as if nothing had happened
    intruder.join()
    assert len(refused) == 1
    assert "it serves one program" in str(refused[0])
    first.write(b"the last words")
    first.close()
    second = open_link(wire.port, 921_600)  # the first has gone: the next is served, and nothing was lost
    assert _arrives(wire.receive, b"the last words") == b"the last words"
    wire.send(FRAME)
    assert _arrives(lambda: second.read(0.2), FRAME) == FRAME
    second.close()
    wire.close()


@pytest.mark.parametrize("write", ["offer", "send"])
def test_the_last_words_of_a_host_are_kept_when_writing_shows_that_it_has_gone(write: str) -> None:
    wire = TcpWire()
    host = open_link(wire.port, 921_600)
    assert wire.connected()
    host.write(b"stop")  # it closes with bytes unread, so that its end resets the connection
    wire.send(FRAME)
    host.close()
    with contextlib.suppress(LinkLost):
        while wire._peer is not None:
            getattr(wire, write)(FRAME)
    assert wire.receive() == b"stop"
    wire.close()


@pytest.mark.skipif(sys.platform == "win32", reason="ptys need POSIX")
def test_a_serial_port_has_one_master() -> None:
    wire = PtyWire()
    first = open_link(wire.port, 921_600)
    with pytest.raises(LinkLost, match="another program has it open"):
        open_link(wire.port, 921_600)
    wire.send(FRAME)
    assert _arrives(lambda: first.read(0.2), FRAME) == FRAME
    first.close()
    open_link(wire.port, 921_600).close()
    wire.close()


@pytest.mark.skipif(sys.platform == "win32", reason="no ptys")
def test_a_port_is_read_until_it_is_empty_and_keeps_what_came_before_a_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system returns at most 4 kB of a serial port in one read."""
    wire = PtyWire()
    try:
        link = open_link(wire.port, 115_200)
        sizes: list[int | OSError] = [4095, 4095, 10, 5, 4095, OSError("pulled"), OSError("pulled")]

        def read_some(descriptor: int, buffers: list[memoryview]) -> int:
            size = sizes.pop(0)
            if isinstance(size, OSError):
                raise size
            buffers[0][:size] = size.to_bytes(2, "big")[1:] * size
            return size

        monkeypatch.setattr("daq.transports.link.select.select", lambda read, *_: (read, [], []))
        monkeypatch.setattr("daq.transports.link.os.readv", read_some)
        assert link.read(1.0) == b"\xff" * 8190 + b"\x0a" * 10
        assert link.read(1.0) == b"\x05" * 5
        assert link.read(1.0) == b"\xff" * 4095
        with pytest.raises(LinkLost, match="lost while reading"):
            link.read(1.0)
    finally:
        monkeypatch.undo()
        wire.close()


@pytest.mark.parametrize("stop_bits", [1, 2])
def test_a_serial_port_has_the_stop_bits_of_its_line(stop_bits):
    termios: Any = pytest.importorskip("termios")
    wire = PtyWire()
    link = open_link(wire.port, 9600, None, "N", stop_bits)
    try:
        descriptor = os.open(wire.port, os.O_RDONLY | os.O_NOCTTY)
        flags = termios.tcgetattr(descriptor)[2]
        os.close(descriptor)
    finally:
        link.close()
        wire.close()
    assert bool(flags & termios.CSTOPB) == (stop_bits == 2)


@pytest.mark.skipif(sys.platform == "darwin", reason="127.0.0.2 is not an address of the loopback interface there")
def test_datagrams_of_others_are_dropped_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    port = free_udp_port()
    link = open_link(f"udp://127.0.0.1:{port}?from=127.0.0.1", 0)
    with contextlib.closing(link), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.2", 0))
        for _ in range(3):
            other.sendto(b"foreign", ("127.0.0.1", port))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
            device.sendto(b"own", ("127.0.0.1", port))
            assert link.read(5.0) == b"own"
            link.write(b"answer")
            assert device.recv(100) == b"answer"
    assert [record.getMessage() for record in caplog.records] == [
        f"udp://127.0.0.1:{port}: datagrams from 127.0.0.2 are dropped: the device is 127.0.0.1"
    ]


def test_datagrams_that_wait_do_not_delay_those_after_them() -> None:
    """A reader that rests 40 ms took two of them in each turn, fewer than some devices send."""
    port = free_udp_port()
    link = open_link(f"udp://127.0.0.1:{port}", 0)
    sent = [bytes([number]) * 512 for number in range(150)]
    with contextlib.closing(link), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        for data in sent:
            device.sendto(data, ("127.0.0.1", port))
        reads = [link.read(1.0) for _ in range(2)]
        assert b"".join(reads) == b"".join(sent)
        assert len(reads[0]) == 65_536
        assert link.read(0.0) == b""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems reserve other ports")
def test_a_port_that_is_reserved_is_named_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("daq.transports.link.DatagramLink", refused)
    with pytest.raises(LinkLost, match=r"ports below 1024: permit .*ip_unprivileged_port_start"):
        open_link("udp://0.0.0.0:603", 0)


@pytest.mark.parametrize("port", ["udp://127.0.0.1:99999", "udp://127.0.0.1:x", "udp://", "socket://127.0.0.1:99999"])
def test_a_port_of_the_network_that_cannot_be_is_a_lost_link(port: str) -> None:
    with pytest.raises(LinkLost, match="cannot be opened"):
        open_link(port, 0)


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="the system does not list the timers of connections")
def test_a_silent_connection_is_probed() -> None:
    """A device that lost power does not close its connection; the probe finds out once it runs again."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        link = open_link(f"socket://127.0.0.1:{port}", 0)
        try:
            rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
            timers = [row[5].partition(":")[0] for row in rows if row[2].endswith(f":{port:04X}") and row[3] == "01"]
        finally:
            link.close()
    assert timers == ["02"]  # that of the probes
