"""The device's end of a cable: a pty or a TCP port that a host opens.

`send` is used for real-time data: bytes that the host does not fetch in time are dropped and counted, as an adapter
does. `offer` is used for data that can wait: it sends as many bytes as fit and leaves the rest to the caller.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable

from typing_extensions import override

from daq.errors import LinkLost
from daq.transports.slcan import AdapterText
from rig_basics.ignoring import ignoring

if sys.platform != "win32":
    import tty

_log = logging.getLogger(__name__)

KINDS = ("pty", "tcp")
"""Kinds of wire. Windows has no ptys."""

_BUFFER_BYTES = 4 * 1024 * 1024  # size of the send queue; larger than an adapter's, because a host may stall …
_MAX_AGE_S = 1.5  # … for this long, s: older bytes are dropped


class Wire(ABC):
    """One end of a cable, with a bounded queue of bytes that could not be sent yet.

    Queued bytes beyond the limits of size and age are dropped and counted, the oldest first: a host that connects to a
    port without a reader receives current data.

    Args:
        adapter: whether it is the line of a CAN adapter: slcan text on the wire, records of `can_frames` for its bus.

    Attributes:
        port: name by which the host opens it.
        overrun_bytes: bytes that the host did not fetch in time, so far.
    """

    port: str

    def __init__(self, adapter: bool = False) -> None:
        self.overrun_bytes: int = 0
        self._text = AdapterText() if adapter else None
        self._offered = b""  # text of the offered records that is not sent yet
        self._parts: deque[tuple[float, bytes]] = deque()
        self._size = 0

    @abstractmethod
    def descriptor(self) -> int | None:
        """Return the file descriptor to wait on for incoming bytes; None if no host is connected."""

    @abstractmethod
    def connected(self) -> bool:
        """Whether a host has the port open."""

    @abstractmethod
    def pull(self) -> None:
        """Remove the port, as if the cable were pulled.

        If the system allows it, the port's name stays reserved until `close`. A program that opens it in the meantime
        gets an error, not a port of another program under the same name.
        """

    @abstractmethod
    def close(self) -> None:
        """Remove the port and release its name."""

    @abstractmethod
    def _read(self) -> bytes:
        """Return the bytes on the wire that the host sent; never blocks."""

    @abstractmethod
    def _write(self, data: bytes) -> None:
        """See `send`, of the bytes on the wire."""

    @abstractmethod
    def _fit(self, data: bytes) -> int:
        """See `offer`, of the bytes on the wire."""

    def receive(self) -> bytes:
        """Return the bytes that the host sent; never blocks. An adapter answers at once."""
        data = self._read()
        if self._text is None:
            return data
        records, answers = self._text.received(data)
        if answers:
            self._write(answers)
        return records

    def send(self, data: bytes) -> None:
        """Queue bytes for the host and send what fits; never blocks."""
        self._write(data if self._text is None else self._text.sent(data))

    def offer(self, data: bytes) -> int:
        """Send as many bytes as fit without queueing; never blocks.

        Records of an adapter count as sent when all of their text is; they are offered again until then.

        Returns:
            Number of bytes sent.

        Raises:
            LinkLost: the host has closed the port.
        """
        if self._text is None:
            return self._fit(data)
        self._offered = self._offered or self._text.sent(data)
        self._offered = self._offered[self._fit(self._offered) :] if self._offered else b""
        return 0 if self._offered else len(data)

    def _queue(self, data: bytes) -> None:
        now = time.monotonic()
        if data:
            self._parts.append((now, data))
            self._size += len(data)
        while self._parts and (self._size > _BUFFER_BYTES or now - self._parts[0][0] > _MAX_AGE_S):
            dropped = len(self._parts.popleft()[1])
            self._size -= dropped
            self.overrun_bytes += dropped

    def _drain(self, write: Callable[[bytes], int]) -> None:
        while self._parts:
            queued, data = self._parts[0]
            try:
                written = write(data)
            except BlockingIOError:  # usual: the cable is full
                return
            self._size -= written
            if written < len(data):
                self._parts[0] = (queued, data[written:])
                return
            self._parts.popleft()


class PtyWire(Wire):
    """A pseudo-terminal; the host opens `port` as a serial line.

    Args:
        notice_host: whether `connected` follows the host's opening and closing of the port. Otherwise the port is
            always reported as connected, like a cable whose other end is not plugged in.
        adapter: see Wire.
    """

    def __init__(self, notice_host: bool = False, adapter: bool = False) -> None:
        super().__init__(adapter)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # before a host opens it: a line in cooked mode would echo the sent bytes
        os.set_blocking(self._master, False)
        self.port: str = os.ttyname(self._slave)
        if notice_host:  # an own descriptor of the host's end would hide that no host has it open
            os.close(self._slave)
            self._slave = -1

    @override
    def descriptor(self) -> int | None:
        return self._master if self._master >= 0 else None

    @override
    def _read(self) -> bytes:
        with contextlib.suppress(OSError):  # usual: no bytes wait, or no host has the port open
            return os.read(self._master, 65536)
        return b""

    @override
    def _write(self, data: bytes) -> None:
        self._queue(data)
        with contextlib.suppress(OSError):  # usual: no host has the port open, the bytes wait
            self._drain(lambda data: os.write(self._master, data))

    @override
    def _fit(self, data: bytes) -> int:
        if not self.connected():
            raise LinkLost(f"{self.port}: the program that had it open has closed it")
        try:
            return os.write(self._master, data)
        except BlockingIOError:  # usual: the cable is full
            return 0
        except OSError as error:
            raise LinkLost(f"{self.port}: lost while writing ({error})") from error

    @override
    def connected(self) -> bool:
        if self._master < 0:
            return False
        watch = select.poll()
        watch.register(self._master, 0)  # poll reports POLLHUP without being requested
        return not any(events & select.POLLHUP for _, events in watch.poll(0))

    @override
    def pull(self) -> None:
        """Linux keeps a pty's number reserved while any process has the host's end open."""
        self._master = _closed(self._master)

    @override
    def close(self) -> None:
        self.pull()
        self._slave = _closed(self._slave)


def _closed(descriptor: int) -> int:
    if descriptor >= 0:
        with ignoring(_log, "closing a pty", OSError):
            os.close(descriptor)
    return -1


class TcpWire(Wire):
    """A TCP port on loopback for machines without ptys; one host at a time."""

    def __init__(self, adapter: bool = False) -> None:
        super().__init__(adapter)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: str = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._peer: socket.socket | None = None
        self._unread = b""  # last bytes of a host that has disconnected

    def _accept(self) -> None:
        """Accept a waiting host, or close its connection while another host is served: a line has one master."""
        with contextlib.suppress(OSError):  # usual: no host waits, or the cable is pulled
            peer, _ = self._listener.accept()
            if self._still_served():
                peer.close()
                return
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._peer = peer
            self._parts.clear()
            self._size = 0

    def _still_served(self) -> bool:
        """Whether the host is still connected; the last bytes of a disconnected host are kept for `receive`."""
        while self._peer is not None:
            try:
                data = self._peer.recv(65536)
            except BlockingIOError:  # usual: connected, and no bytes wait
                return True
            except OSError:  # usual: a reset connection has ended like a closed one
                data = b""
            if not data:
                self._disconnect()
            self._unread += data
        return False

    def _disconnect(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _keep_last_bytes(self) -> None:
        """Read the last bytes of a host whose connection failed on writing, and disconnect it."""
        with contextlib.suppress(OSError):  # usual: the failed connection has no further bytes
            while self._peer is not None and (data := self._peer.recv(65536)):
                self._unread += data
        self._disconnect()

    @override
    def descriptor(self) -> int | None:
        self._accept()
        descriptor = self._listener.fileno() if self._peer is None else self._peer.fileno()
        return descriptor if descriptor >= 0 else None

    @override
    def _read(self) -> bytes:
        self._accept()
        kept, self._unread = self._unread, b""
        if kept or self._peer is None:
            return kept
        try:
            data = self._peer.recv(65536)
        except BlockingIOError:  # usual: no bytes wait
            return b""
        except OSError:  # usual: a reset connection has ended like a closed one
            data = b""
        if not data:
            self._disconnect()
        return data

    @override
    def _write(self, data: bytes) -> None:
        """Without a host the bytes are discarded, as on an open cable."""
        if self._peer is None:
            return
        self._queue(data)
        try:
            self._drain(self._peer.send)
        except OSError:  # usual: the host has closed the connection
            self._keep_last_bytes()

    @override
    def _fit(self, data: bytes) -> int:
        if self._peer is None:
            raise LinkLost(f"{self.port}: the program that was connected is gone")
        try:
            return self._peer.send(data)
        except BlockingIOError:  # usual: the cable is full
            return 0
        except OSError as error:
            self._keep_last_bytes()
            raise LinkLost(f"{self.port}: lost while writing ({error})") from error

    @override
    def connected(self) -> bool:
        self._accept()
        return self._peer is not None

    @override
    def pull(self) -> None:
        """The number of a TCP port is not kept reserved: the system may assign it again."""
        self.close()

    @override
    def close(self) -> None:
        self._disconnect()
        self._listener.close()


def make_wire(kind: str, notice_host: bool = False, *, adapter: bool = False) -> Wire:
    """Make a wire.

    Args:
        kind: "pty", "tcp", or "auto" (a pty if the system has them).
        notice_host: see PtyWire; a TCP port always follows its host.
        adapter: whether it is the line of a CAN adapter.

    Raises:
        OSError: "pty" on a system without ptys.
    """
    has_pty = sys.platform != "win32"
    if kind == "pty" and not has_pty:
        raise OSError('ptys need Linux or macOS; use "tcp" on this system')
    return PtyWire(notice_host, adapter) if kind in ("pty", "auto") and has_pty else TcpWire(adapter)
