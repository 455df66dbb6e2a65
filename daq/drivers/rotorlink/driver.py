"""RotorLink nodes as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.drivers.checks import Checks
from daq.drivers.contract import LockControl, Pipeline, SpeedControl, Talk
from daq.drivers.identification import FoundDevice
from daq.drivers.plain import RotorNodeDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink.settings import EncoderNode
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class RotorLink(RotorNodeDriver):
    """See Driver."""

    name = "rotorlink"
    by_radio: bool = True
    settings = EncoderNode
    claims: frozenset[str] = frozenset({"checksum", "counts exactly"})
    usual: tuple[Mapping[str, Any], ...] = ({}, {"baud": 460_800}, {"baud": 230_400})

    def pipeline(self, device: str, settings: EncoderNode, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.rotorlink.stream import NodePipeline

        return NodePipeline(device, settings, identity)

    def checks(
        self, settings: EncoderNode, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the node's status, and the signal strength of its frames."""
        from daq.drivers.rotorlink.status_checks import node_checks

        return node_checks(settings, pipeline)

    def far_end(self, device: str, settings: EncoderNode, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.rotorlink.far_end import SimulatedNode

        return SimulatedNode.of(device, settings, world)

    def played(self, settings: EncoderNode, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.rotorlink.played import PlayedNode

        return PlayedNode()

    def open(self, device: str, settings: EncoderNode, talk: Talk) -> dict[str, Any]:
        """See Driver; a node streams as soon as it has power."""
        return {"driver": self.name, "port": settings.port}

    def locks(self, settings: EncoderNode, send: Callable[[bytes], None], clock: HostClock) -> LockControl:
        """See MovesLocks."""
        from daq.drivers.rotorlink.locks import NodeLocks

        return NodeLocks(send, clock, settings.node)

    def recognise(self, settings: EncoderNode, data: bytes) -> FoundDevice | None:
        """See RecognisesBytes."""
        from daq.drivers.rotorlink.identity import recognise

        return recognise(settings, data)


DRIVER = RotorLink()
