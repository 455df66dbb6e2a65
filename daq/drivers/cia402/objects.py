# pyright: strict
"""The objects of a drive, written and read by canopen's SDO client over our own recorded link."""

from __future__ import annotations

import contextlib
import logging
import queue
import struct
from collections.abc import Callable
from typing import TypeVar

import can
import canopen
from canopen.sdo.client import ABORT_TIMED_OUT, SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from daq.drivers.cia402 import wire as cia402
from daq.errors import DeviceError
from daq.transports import slcan
from daq.transports.host_clock import HostClock

logging.getLogger("canopen").addHandler(logging.NullHandler())  # what it meets is said by us, in our words

_ANSWER_S = 0.3  # wall seconds to wait for an answer
_TRIES = 3
_READ = struct.Struct("<BHBI")
_EXPEDITED = 0x42  # an answer that holds the value itself, under the mask 0xE2

_T = TypeVar("_T")


class _SendOnlyBus(can.BusABC):
    """What canopen needs to send: frames leave as slcan text through the recorded link.

    Received frames come to canopen from the link's reader thread (Network.notify), so there is no second reader.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        super().__init__(channel="recorded link")
        self._send_bytes = send
        self._is_shutdown = True  # it owns no hardware: nothing to shut down, and no warning about it

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame."""
        frame = slcan.CanFrame(msg.arbitration_id, bytes(msg.data), msg.is_extended_id, msg.is_remote_frame)
        self._send_bytes(slcan.encode(frame))


class _SdoClient(SdoClient):
    """canopen's client of a node's objects, whose wait for an answer is the host clock's."""

    RESPONSE_TIMEOUT = _ANSWER_S

    def __init__(self, node_id: int, network: canopen.Network, clock: HostClock) -> None:
        answers = cia402.cob_sdo_answer(node_id)
        super().__init__(cia402.cob_sdo_request(node_id), answers, canopen.ObjectDictionary())
        self.network = network
        self.responses: queue.Queue[bytes] = clock.queue()
        self._asked = b""  # index and sub-index, as they stand in a request; empty where no answer is waited for
        network.subscribe(answers, self.on_response)

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Take an answer, unless it is late and of another object, or of an order that is not waited for."""
        if bytes(data[1:4]) == self._asked:
            super().on_response(can_id, data, timestamp)  # pyright: ignore[reportUnknownMemberType] (untyped)

    def request_response(self, sdo_request: bytes) -> bytes:
        """Send a request and wait for its answer; one that comes late is not taken for the next one's."""
        with contextlib.suppress(queue.Empty):
            while True:
                self.responses.get_nowait()
        self._asked = bytes(sdo_request[1:4])
        self.send_request(sdo_request)  # pyright: ignore[reportUnknownMemberType]
        try:
            return bytes(self.read_response())  # pyright: ignore[reportUnknownArgumentType] (untyped)
        except SdoCommunicationError:
            self.abort(ABORT_TIMED_OUT)
            raise
        finally:
            self._asked = b""


class NodeObjects:
    """A node's objects, and the bus it is on.

    Args:
        node_id: of the drive.
        send: writes bytes to the drive's link (and to the log).
        clock: for time-outs.
    """

    def __init__(self, node_id: int, send: Callable[[bytes], None], clock: HostClock) -> None:
        self.node_id, self._clock = node_id, clock
        self._network = canopen.Network(bus=_SendOnlyBus(send))
        self._sdo = _SdoClient(node_id, self._network, clock)

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame of any kind."""
        self._network.send_message(identifier, data)

    def heed(self, data: bytes) -> None:
        """Take an answer of the node, 8 bytes."""
        self._network.notify(cia402.cob_sdo_answer(self.node_id), bytearray(data), self._clock.now_s())

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """Write an object of so many bytes, and wait until the drive confirms it.

        Raises:
            DeviceError: it does not answer, or refuses the value.
        """
        self._tried(f"writing {index:04X}h sub {sub}", lambda: self._download(index, sub, value, size))

    def _download(self, index: int, sub: int, value: int, size: int) -> None:
        try:
            self._sdo.download(index, sub, value.to_bytes(size, "little"))
        except SdoAbortedError as error:
            raise DeviceError(f"drive: refused {value} at {index:04X}h sub {sub}: {error}") from error

    def read(self, index: int, sub: int) -> int | None:
        """The value of an object of up to 4 bytes, unsigned; None when the drive does not have it or does not tell.

        Raises:
            DeviceError: it does not answer.
        """
        return self._tried(f"reading {index:04X}h sub {sub}", lambda: self._upload(index, sub))

    def _upload(self, index: int, sub: int) -> int | None:
        try:
            answer = self._sdo.request_response(_READ.pack(0x40, index, sub, 0))
        except SdoAbortedError:
            return None
        if answer[0] & 0xE2 != _EXPEDITED:  # longer than what is asked for here
            return None
        size = 4 - (answer[0] >> 2 & 3) if answer[0] & 1 else 4
        return int.from_bytes(answer[4 : 4 + size], "little")

    def _tried(self, what: str, request: Callable[[], _T]) -> _T:
        attempt = 1
        while True:
            try:
                return request()
            except SdoCommunicationError as error:
                if attempt == _TRIES:
                    raise DeviceError(
                        f"drive: no answer to {what} after {_TRIES} tries ({error}). Is node {self.node_id} "
                        "powered, the bit rate right, the bus terminated?"
                    ) from error
            attempt += 1
