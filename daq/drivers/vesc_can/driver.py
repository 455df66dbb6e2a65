"""VESC motor controllers on a CAN bus as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, RotorGuard, SpeedControl, Talk
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.drivers.vesc.driver import VescDriver
from daq.drivers.vesc.settings import VescMotor
from daq.drivers.vesc_can.settings import VescCan
from daq.items import DeviceEvent
from daq.transports.can_frames import CLOSE_BUS, open_bus

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class VescCanDriver(VescDriver):
    """See Driver, and VescDriver for the controller on its serial port."""

    name = "vesc_can"
    example: ClassVar[Mapping[str, Any]] = {**VescDriver.example, "controller_id": 23}
    claims: frozenset[str] = frozenset({"falls silent"})
    settings: type[VescMotor] = VescCan

    def line(self, settings: VescCan) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)

    def pipeline(self, device: str, settings: VescCan, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.vesc_can.stream import can_pipeline

        return can_pipeline(device, settings)

    def checks(
        self, settings: VescMotor, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the state, the faults, and the rate of the status messages."""
        from daq.drivers.vesc_can.status_watch import status_check
        from daq.drivers.vesc_can.stream import VescCanPipeline

        assert isinstance(settings, VescCan)
        assert isinstance(pipeline, VescCanPipeline)
        found = super().checks(settings, pipeline, control, events)
        return {**found, "status_Hz": status_check(settings, pipeline.status)}

    def far_end(self, device: str, settings: VescCan, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.vesc_can.far_end import SimulatedVescCan

        return SimulatedVescCan.of(settings, world)

    def played(self, settings: VescCan, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.vesc_can.played import PlayedVescCan

        return PlayedVescCan(settings, identity)

    def open(self, device: str, settings: VescCan, talk: Talk) -> dict[str, Any]:
        """See Driver: open the bus and query the controller; it is polled by its command (`control`)."""
        from daq.drivers.vesc.dialogue import identify
        from daq.drivers.vesc_can.wire import CanCommands

        talk.send(open_bus(settings.bitrate))
        query = CanCommands(settings.controller_id, settings.host_id).firmware_version()
        advice = (
            f"Is the controller powered, its CAN mode VESC, are its number ({settings.controller_id}) and the bit rate "
            f"({settings.bitrate} bit/s) right, is the bus terminated?"
        )
        found = identify(device, settings, talk, query, advice)
        return {"driver": self.name, "controller_id": settings.controller_id, **found}

    def stop(self, talk: Talk) -> None:
        """See Driver: close the bus; the controller's command (`control`) has stopped it."""
        talk.send(CLOSE_BUS)

    def speed_source(
        self, settings: VescCan, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> SpeedControl:
        """See TurnsRotor."""
        from daq.drivers.vesc.control import VescControl
        from daq.drivers.vesc_can.wire import CanCommands

        return VescControl(settings, send, clock, guard, CanCommands(settings.controller_id, settings.host_id))


DRIVER = VescCanDriver()
