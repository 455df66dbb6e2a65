"""The device's end of a cable: a pty or a TCP port that a host opens.

`send` is for what happens now and will not wait: what the host does not fetch in time is dropped and counted, as an
adapter does. `offer` is for what can wait: it takes what there is room for and leaves the rest to the caller.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from daq.errors import LinkLost

KINDS = ("pty", "tcp")
"""Kinds of wire there are; ptys not on every system."""

_BUFFER_BYTES = 4 * 1024 * 1024  # an adapter's driver queue, generous: a host may stall …
_OLD_S = 1.5  # … this long, on the wall's clock
_FETCHES_S = 0.5  # wall s: a host that has not fetched all for so long is no longer waited for


class Wire(Protocol):
    """One end of a cable."""

    port: str
    overrun_bytes: int

    def descriptor(self) -> int | None:
        """What to wait on for incoming bytes; None when nobody is connected."""
        ...

    def receive(self) -> bytes:
        """What the host sent; never blocks."""
        ...

    def send(self, data: bytes) -> None:
        """Queue bytes for the host and send what fits; never blocks."""
        ...

    def offer(self, data: bytes) -> int:
        """Send what there is room for, queueing nothing; how many bytes that were; never blocks.

        Raises:
            LinkLost: the host is gone.
        """
        ...

    def held_up(self) -> bool:
        """Whether bytes wait for a host that had fetched all of them a moment ago."""
        ...

    def connected(self) -> bool:
        """Whether a host has the port open."""
        ...

    def pull(self) -> None:
        """Pull the cable: the port is gone. Where the system lets it, its name stays taken until `close`: whoever asks
        for it meanwhile finds nothing, not a port that another program was given under the same name."""
        ...

    def close(self) -> None:
        """Pull the cable and give its port's name back."""
        ...


class _Outbox:
    """A bounded queue of bytes that could not be sent yet; what is old or too much is dropped and counted.

    The oldest goes first: whoever connects to a port that nobody read wants to see now, not some minutes ago.
    """

    def __init__(self) -> None:
        self.overrun_bytes = 0
        self._parts: deque[tuple[float, bytes]] = deque()
        self._size = 0
        self._fetched_s = 0.0  # when nothing was seen to wait

    def _underway(self) -> int:
        """How many bytes are in the cable, as far as can be told."""
        return 0

    def held_up(self) -> bool:
        """See Wire."""
        now = time.monotonic()
        waiting = bool(self._parts) or self._underway() > 0
        if not waiting:
            self._fetched_s = now
        return waiting and now - self._fetched_s < _FETCHES_S

    def _queue(self, data: bytes) -> None:
        now = time.monotonic()
        if data:
            self._parts.append((now, data))
            self._size += len(data)
        while self._parts and (self._size > _BUFFER_BYTES or now - self._parts[0][0] > _OLD_S):
            dropped = len(self._parts.popleft()[1])
            self._size -= dropped
            self.overrun_bytes += dropped

    def _drain(self, write: Callable[[bytes], int]) -> None:
        while self._parts:
            queued, data = self._parts[0]
            try:
                written = write(data)
            except BlockingIOError:
                return
            self._size -= written
            if written < len(data):
                self._parts[0] = (queued, data[written:])
                return
            self._parts.popleft()


class PtyWire(_Outbox):
    """A pseudo-terminal; the host opens `port` as a serial line.

    Args:
        notice_host: whether `connected` is to tell when a host opens and closes the port. Otherwise it counts as open
            always, as a cable does that nobody has plugged in at the other end.
    """

    def __init__(self, notice_host: bool = False) -> None:
        super().__init__()
        import tty  # noqa: PLC0415 (POSIX only)

        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # before anyone opens it: a cooked line would echo our own bytes back
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        if notice_host:  # our own hold on the host's end would hide that nobody else has it
            os.close(self._slave)
            self._slave = -1

    def _underway(self) -> int:
        if self._master < 0 or self._slave < 0:
            return 0
        import fcntl  # noqa: PLC0415 (POSIX only)
        import termios  # noqa: PLC0415

        return int.from_bytes(fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)), sys.byteorder)

    def descriptor(self) -> int | None:
        """See Wire."""
        return self._master if self._master >= 0 else None

    def receive(self) -> bytes:
        """See Wire."""
        with contextlib.suppress(OSError):
            return os.read(self._master, 65536)
        return b""

    def send(self, data: bytes) -> None:
        """See Wire."""
        self._queue(data)
        with contextlib.suppress(OSError):
            self._drain(lambda data: os.write(self._master, data))

    def offer(self, data: bytes) -> int:
        """See Wire."""
        if not self.connected():
            raise LinkLost(f"{self.port}: the program that had it open has closed it")
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise LinkLost(f"{self.port}: lost while writing ({error})") from error

    def connected(self) -> bool:
        """See Wire."""
        if self._master < 0:
            return False
        watch = select.poll()
        watch.register(self._master, 0)  # a hang-up is told unasked
        return not any(what & select.POLLHUP for _, what in watch.poll(0))

    def pull(self) -> None:
        """See Wire. Linux keeps a pty's number while anybody has the host's end open."""
        self._master = _closed(self._master)

    def close(self) -> None:
        """See Wire."""
        self.pull()
        self._slave = _closed(self._slave)


def _closed(descriptor: int) -> int:
    if descriptor >= 0:
        with contextlib.suppress(OSError):
            os.close(descriptor)
    return -1


class TcpWire(_Outbox):
    """A TCP port on loopback for machines without ptys; one host at a time."""

    def __init__(self) -> None:
        super().__init__()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._peer: socket.socket | None = None
        self._unread = b""  # of a host that has gone

    def _accept(self) -> None:
        """Serve who waits, or hang up on him at once while another host is served: a line has one master."""
        with contextlib.suppress(OSError):  # nobody waits, or the cable is pulled
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
        """Whether the host is still there; what a host that has gone sent last is kept for `receive`."""
        while self._peer is not None:
            try:
                data = self._peer.recv(65536)
            except BlockingIOError:
                return True
            except OSError:
                data = b""
            if not data:
                self._hang_up()
            self._unread += data
        return False

    def _hang_up(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _gone(self) -> None:
        """The host has gone, as writing has shown; what it sent last waits in its socket."""
        with contextlib.suppress(OSError):
            while self._peer is not None and (data := self._peer.recv(65536)):
                self._unread += data
        self._hang_up()

    def descriptor(self) -> int | None:
        """See Wire."""
        self._accept()
        descriptor = self._listener.fileno() if self._peer is None else self._peer.fileno()
        return descriptor if descriptor >= 0 else None

    def receive(self) -> bytes:
        """See Wire."""
        self._accept()
        kept, self._unread = self._unread, b""
        if kept or self._peer is None:
            return kept
        try:
            data = self._peer.recv(65536)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def send(self, data: bytes) -> None:
        """See Wire. Without a host the bytes go nowhere, as on an open cable."""
        if self._peer is None:
            return
        self._queue(data)
        try:
            self._drain(self._peer.send)
        except OSError:
            self._gone()

    def offer(self, data: bytes) -> int:
        """See Wire."""
        if self._peer is None:
            raise LinkLost(f"{self.port}: the program that was connected is gone")
        try:
            return self._peer.send(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            self._gone()
            raise LinkLost(f"{self.port}: lost while writing ({error})") from error

    def connected(self) -> bool:
        """See Wire."""
        self._accept()
        return self._peer is not None

    def pull(self) -> None:
        """See Wire. A TCP port's number is free at once; the system gives another one to who asks next."""
        self.close()

    def close(self) -> None:
        """See Wire."""
        self._hang_up()
        self._listener.close()


def make_wire(kind: str, notice_host: bool = False) -> Wire:
    """A wire of a kind: "pty", "tcp", or "auto" (ptys where the system has them).

    Args:
        notice_host: see PtyWire; a TCP port always does.
    """
    has_pty = sys.platform != "win32"
    if kind == "pty" and not has_pty:
        raise OSError('ptys need Linux or macOS; use "tcp" on this system')
    return PtyWire(notice_host) if kind in ("pty", "auto") and has_pty else TcpWire()
