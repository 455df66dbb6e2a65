"""ODrive motor controllers as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, RotorGuard, SpeedControl, Talk
from daq.drivers.odrive.settings import Odrive
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent
from daq.transports.can_frames import CLOSE_BUS

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class OdriveDriver(PlainDriver):
    """See Driver."""

    name = "odrive"
    rest_s: float = 0.01
    example: ClassVar[Mapping[str, Any]] = {"node_id": 1, "firmware": "0.6", "watchdog_s": 0.5}
    claims: frozenset[str] = frozenset({"falls silent"})
    settings = Odrive

    def line(self, settings: Odrive) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)

    def channels(self, settings: Odrive) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.MOTOR,)

    def pipeline(self, device: str, settings: Odrive, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.odrive.stream import OdrivePipeline

        return OdrivePipeline(device, settings)

    def words(self, event: DeviceEvent) -> str:
        """See Driver. The event contains the firmware, on which the meaning of the code depends."""
        from daq.drivers.odrive import wire

        code = int(event.facts["error_code"])
        return wire.error_words(str(event.facts.get("firmware", "0.6")), code) if code else ""

    def checks(
        self, settings: Odrive, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the axis' state, and the errors it reported."""
        from daq.drivers.fault_checks import controller_checks
        from daq.drivers.odrive.wire import error_words

        return controller_checks(
            control, events, lambda code: error_words(settings.firmware, code), ("FAULT", "UNKNOWN", "UNDEFINED")
        )

    def far_end(self, device: str, settings: Odrive, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.odrive.far_end import SimulatedOdrive

        return SimulatedOdrive.of(settings, world)

    def played(self, settings: Odrive, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.odrive.played import PlayedOdrive

        return PlayedOdrive(settings, identity)

    def open(self, device: str, settings: Odrive, talk: Talk) -> dict[str, Any]:
        """See Driver. The axis receives no command; a request feeds the watchdog of firmware 0.5."""
        from daq.drivers.odrive.dialogue import identify

        return {"driver": self.name, **identify(device, settings, talk)}

    def stop(self, talk: Talk) -> None:
        """See Driver: close the bus; the controller's command (`control`) has stopped it."""
        talk.send(CLOSE_BUS)

    def speed_source(
        self, settings: Odrive, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> SpeedControl:
        """See TurnsRotor."""
        from daq.drivers.odrive.control import OdriveControl

        return OdriveControl(settings, send, clock, guard)


DRIVER = OdriveDriver()
