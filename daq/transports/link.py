"""Byte stream of a device: serial ports and ptys, TCP ports and CAN adapters behind one protocol, `Link`."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import select
import socket
import sys
import threading
from typing import Any, Protocol

import can
import serial
from typing_extensions import override

from daq.errors import LinkLost
from daq.transports import can_frames, slcan
from daq.transports.terminals import terminal_of
from rig_basics.ignoring import ignoring

if sys.platform != "win32":
    import termios

_log = logging.getLogger(__name__)

_READ_BYTES = 65536  # size of the one reused buffer: allocating this size for every read fragments the heap
_TTY_BYTES = 4096  # most that one read of a serial port or pty returns
_FULL_BYTES = 2048  # a read of this size is followed by another one: more may have arrived
_MOST_FRAMES = 1000  # of one read: a busy bus must not keep the reader
_MOST_FOREIGN = 16  # senders that are reported
_DATAGRAM_BUFFER_BYTES = 1 << 20  # a datagram that finds no room is lost
_RESERVED_PORTS = 1024  # numbers below it need a permission
_POLL_S = 0.1
_LOCKED_ERRNOS = (errno.EAGAIN, errno.EBUSY)  # another program holds the lock of the serial port
_PROBE_S, _PROBES = 3, 100  # period of the probes of a silent connection, s; unanswered ones until it is lost
_REJECT_WAIT_S = 0.05  # s within which a far end that serves another program closes a new connection


class Link(Protocol):
    """Bytes in and out of one device. One thread reads, any thread writes."""

    name: str

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that have arrived; b"" if none arrived within `timeout_s`.

        Args:
            timeout_s: maximum wait, s.

        Raises:
            LinkLost: the connection to the device is lost.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all bytes.

        Raises:
            LinkLost: the connection to the device is lost.
        """
        ...

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        ...


def open_link(port: str, baud: int, bitrate: int | None = None, parity: str = "N", stop_bits: int = 1) -> Link:
    """Open the link that a rig file names.

    A link to a CAN bus carries the records of `daq.transports.can_frames`.

    Args:
        port: serial device or pty ("/dev/ttyUSB0", "COM3"), "socket://host:port", "udp://address:port" of this host
            for a device that sends datagrams to it ("?from=ADDRESS" at the end: from this address alone), any other
            URL that pyserial supports, or "can:INTERFACE:CHANNEL" for an adapter that python-can supports
            ("can:socketcan:can0").
        baud: line rate of a serial port, baud.
        bitrate: bit rate of a CAN bus, bit/s: a port other than "can:" is then the line of an slcan adapter.
        parity: parity of a serial port: "N", "E" or "O".
        stop_bits: stop bits of a serial port: 1 or 2.

    Raises:
        LinkLost: the port cannot be opened, or is a terminal in use. The message contains the cause and what to check.
    """
    if owner := terminal_of(port):
        raise LinkLost(
            f"{port}: is the terminal of {owner}, not a device; it was not opened. The rig file is older than this "
            "terminal: enter the present port, as `rig virtual` prints it or `rig devices` finds it"
        )
    try:
        if port.startswith("can:"):
            _, interface, channel = port.split(":", 2)
            return CanLink(interface, channel, bitrate or 500_000)
        line = _line(port, baud, parity, stop_bits)
        return line if bitrate is None else SlcanLink(line)
    except (OSError, ValueError, OverflowError, serial.SerialException, can.CanError) as error:
        if isinstance(error, OSError) and error.errno in _LOCKED_ERRNOS:
            raise LinkLost(
                f"{port}: another program has it open ({error}). End that program first: a line has one master"
            ) from error
        if isinstance(error, PermissionError) and port.startswith("udp://"):
            raise LinkLost(
                f"{port}: cannot be opened ({error}). Most systems reserve the ports below {_RESERVED_PORTS}: permit "
                "this user to open them, on Linux by the setting net.ipv4.ip_unprivileged_port_start"
            ) from error
        raise LinkLost(
            f"{port}: cannot be opened ({error}). Is the device plugged in, the port's name right, "
            "and no other program using it?"
        ) from error


def _line(port: str, baud: int, parity: str, stop_bits: int) -> Link:
    if port.startswith("socket://"):
        host, _, number = port.removeprefix("socket://").rpartition(":")
        return SocketLink(host, int(number))
    if port.startswith("udp://"):
        place, _, sender = port.removeprefix("udp://").partition("?from=")
        host, _, number = place.rpartition(":")
        return DatagramLink(host, int(number), sender)
    return SerialLink(port, baud, parity, stop_bits)


def _check_parity(port: Any) -> None:
    """Configure the port to drop received bytes with a wrong parity; pyserial only generates parity when sending."""
    if sys.platform == "win32":
        return
    try:
        settings = termios.tcgetattr(port.fileno())
        settings[0] |= termios.INPCK | termios.IGNPAR
        termios.tcsetattr(port.fileno(), termios.TCSANOW, settings)
    except (OSError, AttributeError, NotImplementedError, termios.error) as error:
        _log.info("parity not checked, so bytes with a wrong parity are decoded: %s", error)


class SerialLink(Link):
    """A serial port through pyserial. `read` returns as soon as bytes have arrived."""

    def __init__(self, port: str, baud: int, parity: str = "N", stop_bits: int = 1) -> None:
        self.name = port
        self._port: Any = serial.serial_for_url(
            port,
            baudrate=baud,
            parity=parity,
            stopbits=stop_bits,
            timeout=_POLL_S,
            write_timeout=1.0,
            exclusive=True,
            do_not_open=True,
        )
        self._port.open()
        with ignoring(_log, "setting low latency", ValueError, OSError, AttributeError, NotImplementedError):
            self._port.set_low_latency_mode(True)
        if sys.platform == "win32":  # default 4096: less than a fast sensor sends between two reads
            with contextlib.suppress(AttributeError):  # usual: a port behind a URL has no such buffer
                self._port.set_buffer_size(rx_size=_READ_BYTES)
        self._buffer = memoryview(bytearray(_READ_BYTES))
        self._descriptor = None
        if parity != "N":
            _check_parity(self._port)
        if sys.platform != "win32":
            with ignoring(_log, "getting the descriptor", OSError, AttributeError, NotImplementedError):
                self._descriptor = self._port.fileno()
        self._lock = threading.Lock()

    @override
    def read(self, timeout_s: float) -> bytes:
        try:
            if self._descriptor is None:  # no descriptor to wait on: the port's own timeout (_POLL_S) applies
                first = self._port.read(1)
                return first + self._port.read(self._port.in_waiting) if first else b""
            ready, _, _ = select.select([self._descriptor], [], [], timeout_s)
            if not ready:
                return b""
            size = self._more(self._descriptor, os.readv(self._descriptor, [self._buffer]))
            data = bytes(self._buffer[:size])
        except (OSError, ValueError, TypeError, serial.SerialException) as error:
            raise LinkLost(f"{self.name}: lost while reading ({error}). Look at cable and power") from error
        if not data:
            raise LinkLost(f"{self.name}: the other end closed. Look at cable and power")
        return data

    def _more(self, descriptor: int, size: int) -> int:
        """Read further bytes behind `size` bytes in the buffer, because the system returns one page at a time.

        Returns:
            Number of bytes in the buffer. A loss of the connection is left to the next read, so that no byte is lost.
        """
        last = size
        with contextlib.suppress(OSError):  # usual: the next read reports the loss
            while last >= _FULL_BYTES and size <= _READ_BYTES - _TTY_BYTES:
                ready, _, _ = select.select([descriptor], [], [], 0.0)
                last = os.readv(descriptor, [self._buffer[size : size + _TTY_BYTES]]) if ready else 0
                size += last
        return size

    @override
    def write(self, data: bytes) -> None:
        with self._lock:
            try:
                self._port.write(data)
            except (OSError, ValueError, TypeError, serial.SerialException) as error:
                raise LinkLost(f"{self.name}: lost while writing ({error}). Look at cable and power") from error

    @override
    def close(self) -> None:
        with ignoring(_log, "closing the port", OSError, serial.SerialException):
            self._port.close()


def _probe_when_silent(connection: socket.socket) -> None:
    """Let the system probe a silent connection.

    A device that lost power does not close its connection. Once it runs again it rejects the next probe, so that the
    loss is found after some seconds. A cable may be out for `_PROBES` periods.
    """
    with ignoring(_log, "probing a silent connection", OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in (("TCP_KEEPIDLE", _PROBE_S), ("TCP_KEEPINTVL", _PROBE_S), ("TCP_KEEPCNT", _PROBES)):
            if (option := getattr(socket, name, None)) is not None:  # not on every system
                connection.setsockopt(socket.IPPROTO_TCP, option, value)


class SocketLink(Link):
    """A device behind a TCP port: a serial server, or a simulated rig on a system without ptys."""

    def __init__(self, host: str, port: int) -> None:
        self.name: str = f"socket://{host}:{port}"
        self._socket = socket.create_connection((host, port), timeout=5.0)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            _probe_when_silent(self._socket)
            if self._is_rejected():
                raise ConnectionRefusedError(
                    "the far end closed the connection at once: it serves one program at a time, and another program "
                    "is connected"
                )
        except BaseException:
            self._socket.close()
            raise
        self._buffer = memoryview(bytearray(_READ_BYTES))
        self._lock = threading.Lock()

    def _is_rejected(self) -> bool:
        ready, _, _ = select.select([self._socket], [], [], _REJECT_WAIT_S)
        return bool(ready) and not self._socket.recv(1, socket.MSG_PEEK)

    @override
    def read(self, timeout_s: float) -> bytes:
        try:
            ready, _, _ = select.select([self._socket], [], [], timeout_s)
            if not ready:
                return b""
            data = bytes(self._buffer[: self._socket.recv_into(self._buffer)])
        except (OSError, ValueError) as error:
            raise LinkLost(f"{self.name}: lost while reading ({error})") from error
        if not data:
            raise LinkLost(f"{self.name}: the other end closed the connection. Look at its power and its network")
        return data

    @override
    def write(self, data: bytes) -> None:
        with self._lock:
            try:
                self._socket.sendall(data)
            except (OSError, ValueError) as error:
                raise LinkLost(f"{self.name}: lost while writing ({error})") from error

    @override
    def close(self) -> None:
        with contextlib.suppress(OSError):  # usual: the other end has closed the connection
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class DatagramLink(Link):
    """A device that sends datagrams to a UDP port of this host. A read returns all that wait, in succession.

    A reader that rests between two reads would otherwise fall behind a device that sends more often.

    Args:
        address: address of this host at which they arrive; "" or "0.0.0.0" for every one.
        port: number of the port.
        device: address of the device; datagrams from other addresses are dropped. "": any.
    """

    def __init__(self, address: str, port: int, device: str = "") -> None:
        self._device = socket.gethostbyname(device) if device else ""
        self._foreign: set[str] = set()  # other senders, each reported once
        self.name: str = f"udp://{address}:{port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            with ignoring(_log, "enlarging the buffer for datagrams", OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _DATAGRAM_BUFFER_BYTES)
            self._socket.bind((address, port))
        except BaseException:
            self._socket.close()
            raise
        self._buffer = memoryview(bytearray(_READ_BYTES))
        self._lock = threading.Lock()
        self._sender: Any = None  # address of the newest datagram

    @override
    def read(self, timeout_s: float) -> bytes:
        out: list[bytes] = []
        size, wait_s = 0, timeout_s
        while size < _READ_BYTES:
            try:
                ready, _, _ = select.select([self._socket], [], [], wait_s)
                if not ready:
                    break
                count, sender = self._socket.recvfrom_into(self._buffer)
            except (OSError, ValueError) as error:
                raise LinkLost(f"{self.name}: lost while reading ({error})") from error
            size, wait_s = size + max(1, count), 0.0
            if not self._is_foreign(sender[0]):
                self._sender = sender
                out.append(bytes(self._buffer[:count]))
        return b"".join(out)

    def _is_foreign(self, sender: str) -> bool:
        """Return whether a datagram is not of the device; each other sender is reported once."""
        if not self._device or sender == self._device:
            return False
        if sender not in self._foreign and len(self._foreign) < _MOST_FOREIGN:
            self._foreign.add(sender)
            _log.warning("%s: datagrams from %s are dropped: the device is %s", self.name, sender, self._device)
        return True

    @override
    def write(self, data: bytes) -> None:
        if self._sender is None:
            raise LinkLost(f"{self.name}: nothing has come from the device, so its address is unknown")
        with self._lock:
            try:
                self._socket.sendto(data, self._sender)
            except (OSError, ValueError) as error:
                raise LinkLost(f"{self.name}: lost while writing ({error})") from error

    @override
    def close(self) -> None:
        self._socket.close()


class CanLink(Link):
    """Any CAN adapter that python-can supports, as records of `can_frames`."""

    def __init__(self, interface: str, channel: str, bitrate: int) -> None:
        self.name: str = f"can:{interface}:{channel}"
        self._bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate)
        self._decoder = can_frames.FrameDecoder()
        self._lock = threading.Lock()

    @override
    def read(self, timeout_s: float) -> bytes:
        records: list[bytes] = []
        try:
            message = self._bus.recv(timeout_s)
            while message is not None and len(records) < _MOST_FRAMES:
                records.append(_record(message))
                message = self._bus.recv(0)
        except (can.CanError, OSError, ValueError) as error:
            raise LinkLost(f"{self.name}: lost while reading ({error})") from error
        return b"".join(records)

    def write(self, data: bytes) -> None:
        """See Link. Messages to the adapter are dropped: python-can sets it up."""
        with self._lock:
            try:
                for frame in self._decoder.feed(data).frames:
                    self._bus.send(
                        can.Message(
                            arbitration_id=frame.arbitration_id,
                            data=frame.data,
                            is_extended_id=frame.extended,
                            is_remote_frame=frame.remote,
                        )
                    )
            except (can.CanError, OSError, ValueError) as error:
                raise LinkLost(f"{self.name}: lost while writing ({error})") from error

    @override
    def close(self) -> None:
        self._bus.shutdown()


def _record(message: can.Message) -> bytes:
    time_ns = round(message.timestamp * 1e9)
    if message.is_error_frame:  # a report of the adapter, not a frame of the bus
        return can_frames.error_frame(message.arbitration_id, bytes(message.data), time_ns)
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return can_frames.encode(
        can_frames.CanFrame(message.arbitration_id, data, message.is_extended_id, message.is_remote_frame, time_ns)
    )


class SlcanLink(Link):
    """A CAN adapter that speaks slcan text on another link, as records of `can_frames`."""

    def __init__(self, line: Link) -> None:
        self.name: str = line.name
        self._line, self._text, self._lock = line, slcan.HostText(), threading.Lock()

    @override
    def read(self, timeout_s: float) -> bytes:
        return self._text.received(self._line.read(timeout_s))

    @override
    def write(self, data: bytes) -> None:
        with self._lock:
            self._line.write(self._text.sent(data))

    @override
    def close(self) -> None:
        self._line.close()
