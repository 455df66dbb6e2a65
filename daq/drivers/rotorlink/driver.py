"""RotorLink nodes as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, LockControl, Pipeline, SampleClock, SpeedControl, Talk
from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink.settings import EncoderNode
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class RotorLink:
    """See Driver."""

    name = "rotorlink"
    settings = EncoderNode
    rest_s: float = 0.01
    claims: frozenset[str] = frozenset({"checksum", "counts exactly"})

    def line(self, settings: EncoderNode) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud)

    def channels(self, settings: EncoderNode) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.PENDULUMS,)

    def occasional(self, settings: EncoderNode) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.TACHO,)

    def clocks(self, settings: EncoderNode) -> tuple[SampleClock, ...]:
        """See Driver."""
        return (
            SampleClock(
                channels.PENDULUMS.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "node_time_us", 1000, 2**32
            ),
        )

    def pipeline(self, device: str, settings: EncoderNode, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.rotorlink.stream import NodePipeline

        return NodePipeline(device, settings, identity)

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        return event.text

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

    def prepare(self) -> None:
        """See Driver."""

    def open(self, device: str, settings: EncoderNode, talk: Talk) -> dict[str, Any]:
        """See Driver; a node streams as soon as it has power."""
        return {"driver": self.name, "port": settings.port}

    def stop(self, talk: Talk) -> None:
        """See Driver; a node sends as long as it has power."""

    def locks(self, settings: EncoderNode, send: Callable[[bytes], None], clock: HostClock) -> LockControl:
        """See MovesLocks."""
        from daq.drivers.rotorlink.locks import NodeLocks

        return NodeLocks(send, clock, settings.node)


DRIVER = RotorLink()
