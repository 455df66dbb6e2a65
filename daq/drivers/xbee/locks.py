# pyright: strict
"""The host's commands to a node behind XBee modules: transmit requests, told at once when they are not delivered."""

from __future__ import annotations

from collections.abc import Callable

from daq.drivers.items import Event
from daq.drivers.rotorlink.locks import NodeLocks
from daq.drivers.xbee import framing, wire
from daq.drivers.xbee.settings import XBeeNode
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock

_FAILURES = 5  # tries that the module could not deliver, some 0.8 s


class XBeeLocks(NodeLocks):
    """See PendulumLocks; the node's acknowledgement decides, whatever became of the radio frame.

    A frame that the module could not deliver is sent again with the node's seq, a few times: the module repeats on air
    by itself, and gives up within some ten ms. A frame can reach the node although its acknowledgement on air was lost.

    Args:
        send: writes bytes to the host's module.
        clock: for the waits.
    """

    def __init__(self, config: XBeeNode, send: Callable[[bytes], None], clock: HostClock) -> None:
        super().__init__(send, clock, config.node)
        self._address = wire.Address.parse(config.node_address)
        self._escaped, self._legacy = config.api_mode == 2, config.legacy_transmit
        self._frame_id = 0
        self._tried: set[int] = set()
        self._failed, self._failures = "", 0

    def command(self, action: str, check: Callable[[], None]) -> None:
        """See PendulumLocks."""
        self._tried.clear()
        self._failed, self._failures = "", 0
        super().command(action, check)

    def _transmit(self, payload: bytes) -> None:
        self._frame_id = self._frame_id % 255 + 1
        self._tried.add(self._frame_id)
        request = wire.transmit_request(self._frame_id, self._address, payload, legacy=self._legacy)
        self._send(framing.encode(request, escaped=self._escaped))

    def _settles(self, action: str, event: Event) -> bool:
        if "delivery_status" not in event.facts:
            return super()._settles(action, event)
        if event.facts["frame_id"] in self._tried:
            self._failed, self._failures = event.text, self._failures + 1
        return False

    def _unanswered(self, action: str) -> None:
        if self._failures >= _FAILURES:
            raise DeviceError(
                f"{action!r} was not delivered to the node in {_FAILURES} tries: {self._failed}. Look at the node's "
                "power, its module and node_address in the rig file; should it have come through nonetheless, the lock "
                "events say so"
            )
