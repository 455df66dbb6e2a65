"""The host's commands to a RotorLink node; they are repeated until the node acknowledges them."""

from __future__ import annotations

import queue
from collections.abc import Callable
from contextlib import suppress

from typing_extensions import override

from daq.drivers.contract import LockControl
from daq.drivers.rotorlink import wire
from daq.errors import DeviceError
from daq.items import DeviceEvent
from daq.transports.host_clock import HostClock

_DEFAULT_NODE = 1
_TRIES, _TRY_S, _CHECK_S = 20, 0.15, 0.02  # seconds
_PINGS, _PING_EVERY_S = 20, 0.04  # seconds; the least of 20 is near the least delay of a radio with jitter
_ACCEPTED, _ALREADY = 0, 4


class NodeLocks(LockControl):
    """See LockControl.

    Args:
        send: writes bytes to the node's dongle.
        clock: clock for the waits.
        node: number of the node; None for the node that is received. Its pipeline reports a number other than 1.
    """

    def __init__(self, send: Callable[[bytes], None], clock: HostClock, node: int | None = None) -> None:
        self._send, self._clock = send, clock
        self._node = _DEFAULT_NODE if node is None else node
        self._acknowledges: queue.Queue[DeviceEvent] = clock.queue()
        # The node stores the seq of past commands, also those of an earlier session, and acts once on each.
        self._seq = clock.now_ns() // 1_000_000 & 0x7FFF

    @override
    def heard(self, event: DeviceEvent) -> None:
        if "node" in event.facts:
            self._node = event.facts["node"]
            return
        self._acknowledges.put(event)

    def command(self, action: str, check: Callable[[], None]) -> None:
        """See LockControl; a command without acknowledgement is repeated with the same seq."""
        self._seq = (self._seq + 1) & 0x7FFF
        payload = wire.NodeCommand(self._node, self._seq, wire.ACTIONS[action]).pack()
        for _ in range(_TRIES):
            self._transmit(payload)
            deadline = self._clock.now_s() + _TRY_S
            while self._clock.now_s() < deadline:
                check()
                try:
                    event = self._acknowledges.get(timeout=_CHECK_S)
                except queue.Empty:  # usual: no acknowledgement so far
                    continue
                if self._settles(action, event):
                    return
            self._unanswered(action)
        raise DeviceError(f"the node has not acknowledged {action!r} after {_TRIES} tries. {self._advice()}")

    @override
    def measure_round_trip(self) -> float | None:
        sent_ns: dict[int, int] = {}
        found_ns: list[int] = []
        for _ in range(_PINGS):
            self._seq = (self._seq + 1) & 0x7FFF
            sent_ns[self._seq] = self._clock.now_ns()
            self._transmit(wire.Ping(self._node, self._seq).pack())
            deadline = self._clock.now_s() + _PING_EVERY_S
            while self._clock.now_s() < deadline:
                with suppress(queue.Empty):  # usual: no answer so far
                    event = self._acknowledges.get(timeout=_CHECK_S)
                    if event.facts.get("ping_seq") in sent_ns:
                        found_ns.append(event.facts["time_ns"] - sent_ns[event.facts["ping_seq"]])
        return min(found_ns) * 1e-9 if found_ns else None

    def _transmit(self, payload: bytes) -> None:
        """Send a command in the format of the node's dongle."""
        self._send(wire.wire(payload))

    def _settles(self, action: str, event: DeviceEvent) -> bool:
        """Whether an acknowledgement is that of the present command.

        Raises:
            DeviceError: it is, and the node refuses the command.
        """
        if event.facts.get("command_seq") != self._seq:  # also a late answer to a ping
            return False
        result = event.facts["result"]
        if result == _ACCEPTED or (result == _ALREADY and action != "zero"):  # for "zero" it means: not locked
            return True
        raise DeviceError(f"the node refuses {action!r}: {event.text}")

    def _unanswered(self, action: str) -> None:
        """Handle a try without an answer; subclasses raise DeviceError if further tries are useless."""

    def _advice(self) -> str:
        """Return what to look at after the last try."""
        return "Is the radio in reach?"
