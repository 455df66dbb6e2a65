"""The host's commands to a node behind XBee modules: transmit requests, whose delivery the module reports."""

from __future__ import annotations

from collections.abc import Callable

from typing_extensions import override

from daq.drivers.rotorlink.locks import NodeLocks
from daq.errors import DeviceError
from daq.items import DeviceEvent
from daq.transports.host_clock import HostClock
from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.settings import XBeeNode

_MAX_FAILURES = 5  # commands that the module could not deliver, about 0.8 s


class XBeeLocks(NodeLocks):
    """See LockControl. The node's acknowledgement decides, independent of the delivery of the radio frame.

    A frame that the module could not deliver is sent again with the same seq, up to `_MAX_FAILURES` times. The module
    itself repeats a frame on air and ends its tries after about 10 ms. A frame can reach the node although its
    acknowledgement on air was lost.

    Args:
        config: table of the node in the rig file.
        send: writes bytes to the host's module.
        clock: clock for the waits.
    """

    def __init__(self, config: XBeeNode, send: Callable[[bytes], None], clock: HostClock) -> None:
        super().__init__(send, clock, config.node)
        self._address = wire.Address.parse(config.node_address)
        self._escaped, self._legacy = config.api_mode == 2, config.legacy_transmit
        self._frame_id = 0
        self._sent_ids: set[int] = set()
        self._failed, self._failures = "", 0

    @override
    def command(self, action: str, check: Callable[[], None]) -> None:
        self._sent_ids.clear()
        self._failed, self._failures = "", 0
        super().command(action, check)

    def _transmit(self, payload: bytes) -> None:
        self._frame_id = self._frame_id % 255 + 1
        self._sent_ids.add(self._frame_id)
        request = wire.transmit_request(self._frame_id, self._address, payload, legacy=self._legacy)
        self._send(framing.encode(request, escaped=self._escaped))

    def _settles(self, action: str, event: DeviceEvent) -> bool:
        if "delivery_status" not in event.facts:
            return super()._settles(action, event)
        if event.facts["frame_id"] in self._sent_ids:
            self._failed, self._failures = event.text, self._failures + 1
        return False

    def _unanswered(self, action: str) -> None:
        if self._failures >= _MAX_FAILURES:
            raise DeviceError(
                f"{action!r} was not delivered to the node in {_MAX_FAILURES} tries: {self._failed}. Look at the "
                "node's power, its module and node_address in the rig file. If it was delivered nevertheless, the lock "
                "events show it"
            )

    @override
    def _advice(self) -> str:
        if self._failures or self._legacy:
            return super()._advice()
        return (
            f"{super()._advice()} Is the module at the host a first-generation 802.15.4 module? It executes no request "
            "of type 10h, and does not report this: set legacy_transmit = true"
        )
