"""RotorLink nodes behind XBee modules as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq.drivers.checks import Checks
from daq.drivers.contract import LockControl, Pipeline, SpeedControl, Talk
from daq.drivers.identification import FoundDevice, IdentityTurns
from daq.drivers.plain import RotorNodeDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.drivers.xbee.settings import XBeeNode
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class XBee(RotorNodeDriver):
    """See Driver."""

    name = "xbee"
    by_radio: bool = True
    settings = XBeeNode
    example: ClassVar[Mapping[str, Any]] = {"node_address": "0013A20040522BAB"}
    claims: frozenset[str] = frozenset({"checksum", "counts exactly"})
    measured: frozenset[str] = frozenset({"rssi_dBm"})
    usual: tuple[Mapping[str, Any], ...] = ({}, {"baud": 9_600, "rate_Hz": 100}, {"baud": 57_600}, {"baud": 230_400})

    def pipeline(self, device: str, settings: XBeeNode, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.xbee.stream import XBeePipeline

        return XBeePipeline(device, settings, identity)

    def checks(
        self, settings: XBeeNode, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the node's status."""
        from daq.drivers.rotorlink.status_checks import node_checks

        return node_checks(settings, pipeline)

    def far_end(self, device: str, settings: XBeeNode, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.xbee.far_end import SimulatedXBeeNode

        return SimulatedXBeeNode.of(device, settings, world)

    def played(self, settings: XBeeNode, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.xbee.played import PlayedXBee

        return PlayedXBee(identity, settings)

    def open(self, device: str, settings: XBeeNode, talk: Talk) -> dict[str, Any]:
        """See Driver; the module is identified. The node streams as soon as it has power."""
        from daq.drivers.xbee.dialogue import identify

        return identify(device, settings, talk)

    def locks(self, settings: XBeeNode, send: Callable[[bytes], None], clock: HostClock) -> LockControl:
        """See MovesLocks."""
        from daq.drivers.xbee.locks import XBeeLocks

        return XBeeLocks(settings, send, clock)

    def recognise(self, settings: XBeeNode, data: bytes) -> FoundDevice | None:
        """See RecognisesBytes."""
        from daq.drivers.xbee.identity import recognise

        return recognise(settings, data)

    def identity_request(self, settings: XBeeNode) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.xbee.identity import identity_turns

        return identity_turns(settings)


DRIVER = XBee()
