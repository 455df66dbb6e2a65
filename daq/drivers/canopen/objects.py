"""Access to the objects of a node by canopen's SDO client over the recorded link."""

from __future__ import annotations

import contextlib
import logging
import queue
import struct
from collections.abc import Callable
from typing import Protocol, TypeVar

import can
import canopen
from canopen.sdo.client import ABORT_TIMED_OUT, SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from daq.drivers.canopen import cia301
from daq.drivers.contract import Talk
from daq.errors import DeviceError
from daq.transports import slcan
from daq.transports.host_clock import HostClock

logging.getLogger("canopen").addHandler(logging.NullHandler())  # its errors are reported by DeviceError

_ANSWER_S = 0.3  # wall s to wait for an answer
_TRIES = 3
_READ = struct.Struct("<BHBI")
_ABORTED = 0x80
_KIND = 0xE0  # bits of a command byte that state the kind of a request or answer
_ANSWERS = {0x20: 0x60, 0x40: 0x40}  # kinds of the answers to a write and to a read
_EXPEDITED = 0x42  # command byte, under the mask 0xE2, of an answer that contains the value itself

_T = TypeVar("_T")


class _SendOnlyBus(can.BusABC):
    """Bus on which canopen sends: frames are written as slcan text to the recorded link.

    The link's reader thread passes received frames to canopen (Network.notify), so a second reader is not needed.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        super().__init__(channel="recorded link")
        self._send_bytes = send
        self._is_shutdown = True  # without hardware there is nothing to shut down; this avoids the warning

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame."""
        data = bytes(msg.dlc) if msg.is_remote_frame else bytes(msg.data)
        frame = slcan.CanFrame(msg.arbitration_id, data, msg.is_extended_id, msg.is_remote_frame)
        self._send_bytes(slcan.encode(frame))


class _SdoExchange(Protocol):
    """Methods of canopen's client, which has no annotations, with their types."""

    def on_response(self, can_id: int, data: bytearray, timestamp: float, /) -> None: ...

    def send_request(self, request: bytes, /) -> None: ...

    def read_response(self) -> bytes | bytearray: ...


class _SdoClient(SdoClient):
    """canopen's client of a node's objects, which waits for answers by the host clock."""

    RESPONSE_TIMEOUT = _ANSWER_S

    def __init__(self, node_id: int, network: canopen.Network, clock: HostClock) -> None:
        answers = cia301.cob_sdo_answer(node_id)
        super().__init__(cia301.cob_sdo_request(node_id), answers, canopen.ObjectDictionary())
        self.network = network
        self.responses: queue.Queue[bytes] = clock.queue()
        self._requested = b""  # first bytes of the request: kind, index and sub-index; empty if no answer is expected
        network.subscribe(answers, self._take_answer)

    @property
    def _exchange(self) -> _SdoExchange:
        return self

    def _take_answer(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Take an answer, unless it is a late answer to another request, or no answer is expected."""
        asked = self._requested
        if not asked or bytes(data[1:4]) != asked[1:]:
            return
        if data[0] == _ABORTED or data[0] & _KIND == _ANSWERS.get(asked[0] & _KIND):
            self._exchange.on_response(can_id, data, timestamp)

    def request_response(self, sdo_request: bytes) -> bytes:
        """Send a request and wait for its answer; a late answer to an earlier request is dropped."""
        with contextlib.suppress(queue.Empty):  # usual: no late answer is left
            while True:
                self.responses.get_nowait()
        self._requested = bytes(sdo_request[:4])
        self._exchange.send_request(sdo_request)
        try:
            return bytes(self._exchange.read_response())
        except SdoCommunicationError:
            self.abort(ABORT_TIMED_OUT)
            raise
        finally:
            self._requested = b""


class NodeObjects:
    """A node's objects, and its bus.

    Args:
        name: name of the node in messages.
        node_id: node number.
        send: writes bytes to the node's link (and to the log).
        clock: clock for timeouts.
    """

    def __init__(self, name: str, node_id: int, send: Callable[[bytes], None], clock: HostClock) -> None:
        self.node_id: int = node_id
        self._name = name
        self._clock = clock
        self._bus = _SendOnlyBus(send)
        self._network = canopen.Network(bus=self._bus)
        self._sdo = _SdoClient(node_id, self._network, clock)

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        self._network.send_message(identifier, data)

    def request(self, identifier: int, size: int) -> None:
        """Request the process data of an identifier, of `size` bytes, by a remote frame."""
        message = can.Message(arbitration_id=identifier, is_extended_id=False, is_remote_frame=True, dlc=size)
        with self._network.send_lock:
            self._bus.send(message)

    def take_answer(self, data: bytes) -> None:
        """Take an answer of the node, 8 bytes."""
        self._network.notify(cia301.cob_sdo_answer(self.node_id), bytearray(data), self._clock.now_s())

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """Write an object of `size` bytes and wait until the node confirms it.

        Raises:
            DeviceError: the node does not answer, or refuses the value.
        """
        self._retry(f"writing {index:04X}h sub {sub}", lambda: self._download(index, sub, value, size))

    def _download(self, index: int, sub: int, value: int, size: int) -> None:
        try:
            self._sdo.download(index, sub, value.to_bytes(size, "little"))
        except SdoAbortedError as error:
            raise DeviceError(f"{self._name}: refused {value} at {index:04X}h sub {sub}: {error}") from error

    def read(self, index: int, sub: int) -> int | None:
        """Return the unsigned value of an object of up to 4 bytes; None if the node has no such object or refuses it.

        Raises:
            DeviceError: the node does not answer.
        """
        return self._retry(f"reading {index:04X}h sub {sub}", lambda: self._upload(index, sub))

    def _upload(self, index: int, sub: int) -> int | None:
        try:
            answer = self._sdo.request_response(_READ.pack(0x40, index, sub, 0))
        except SdoAbortedError:  # usual: the node has no such object
            return None
        if answer[0] & 0xE2 != _EXPEDITED:  # the object has more than 4 bytes
            return None
        size = 4 - (answer[0] >> 2 & 3) if answer[0] & 1 else 4
        return int.from_bytes(answer[4 : 4 + size], "little")

    def _retry(self, what: str, request: Callable[[], _T]) -> _T:
        """Repeat a request until it is answered, up to `_TRIES` times."""
        attempt = 1
        while True:
            try:
                return request()
            except SdoCommunicationError as error:
                if attempt == _TRIES:
                    raise DeviceError(
                        f"{self._name}: no answer to {what} after {_TRIES} tries ({error}). Is node {self.node_id} "
                        "powered, the bit rate right, the bus terminated?"
                    ) from error
            attempt += 1


def no_answer(error: DeviceError) -> bool:
    """Return whether an error of `NodeObjects` is a missing answer; otherwise the node refused the value."""
    return isinstance(error.__cause__, SdoCommunicationError)


class _DialogueClient(_SdoClient):
    """Client that takes the answers from the replies of a dialogue; no other thread passes them to it."""

    def __init__(self, node_id: int, network: canopen.Network, talk: Talk) -> None:
        super().__init__(node_id, network, talk.clock)
        self._answers, self._talk = cia301.cob_sdo_answer(node_id), talk

    def read_response(self) -> bytes | bytearray:
        """Return the answer of the node to the present request.

        Raises:
            SdoCommunicationError, SdoAbortedError: no answer in time, or a refusal.
        """
        deadline = self._talk.clock.wall_s() + _ANSWER_S
        while self.responses.empty() and (left := deadline - self._talk.clock.wall_s()) > 0:
            try:
                text = self._talk.replies.get(timeout=left)
            except queue.Empty:  # usual: the base class reports it
                break
            for frame in slcan.LineDecoder().feed(text.encode() + b"\r").frames:
                if frame.arbitration_id == self._answers and len(frame.data) == _READ.size:
                    self._take_answer(self._answers, bytearray(frame.data), 0.0)
        try:
            answer = self.responses.get_nowait()
        except queue.Empty as error:
            raise SdoCommunicationError("No SDO response received") from error
        if answer[0] == _ABORTED:
            raise SdoAbortedError(int.from_bytes(answer[4:8], "little"))
        return answer


class DialogueObjects(NodeObjects):
    """A node's objects during the opening of a device, whose pipeline reports SDO answers as `reply` events.

    Args:
        name: name of the node in messages.
        node_id: node number.
        talk: the open device.
    """

    def __init__(self, name: str, node_id: int, talk: Talk) -> None:
        super().__init__(name, node_id, talk.send, talk.clock)
        self._sdo = _DialogueClient(node_id, self._network, talk)
