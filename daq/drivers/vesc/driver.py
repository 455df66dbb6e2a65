"""VESC motor controllers as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import Pipeline, RotorGuard, SpeedControl, Talk
from daq.drivers.identification import Announcement, IdentityTurns
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.drivers.vesc.settings import Vesc, VescMotor
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


_FAULTY = ("FAULT", "KILL SWITCH OPEN", "UNKNOWN")


class VescDriver(PlainDriver):
    """See Driver: what controllers on a serial port and on a CAN bus have in common, as on a serial port."""

    name = "vesc"
    rest_s: float = 0.01
    example: ClassVar[Mapping[str, Any]] = {"pole_pairs": 7, "timeout_s": 1.0, "brake_A": 5.0}
    claims: frozenset[str] = frozenset({"checksum", "falls silent"})
    settings: type[VescMotor] = Vesc

    def channels(self, settings: VescMotor) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.MOTOR,)

    def pipeline(self, device: str, settings: Any, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.vesc.stream import SerialLine, VescPipeline

        return VescPipeline(device, settings, SerialLine)

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        from daq.drivers.vesc import wire

        code = int(event.facts["error_code"])
        return wire.fault_words(code) if code else ""

    def checks(
        self, settings: VescMotor, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the controller's state, and the faults it reported."""
        from daq.drivers.fault_checks import controller_checks
        from daq.drivers.vesc.wire import fault_words

        return controller_checks(control, events, fault_words, _FAULTY)

    def far_end(self, device: str, settings: Any, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.vesc.far_end import SimulatedVesc

        return SimulatedVesc.of(settings, world)

    def played(self, settings: Any, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.vesc.played import PlayedVesc

        return PlayedVesc(identity)

    def open(self, device: str, settings: Any, talk: Talk) -> dict[str, Any]:
        """See Driver. The controller reports only on request, by its command (`control`)."""
        from daq.drivers.vesc import wire
        from daq.drivers.vesc.dialogue import identify

        advice = f"Is the controller powered, its serial port enabled at {settings.baud} baud, are both wires right?"
        return {"driver": self.name, **identify(device, settings, talk, wire.firmware_version(), advice)}

    def stop(self, talk: Talk) -> None:
        """See Driver; the controller's command (`control`) has stopped it."""

    def speed_source(
        self, settings: Any, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> SpeedControl:
        """See TurnsRotor."""
        from daq.drivers.vesc.control import VescControl

        return VescControl(settings, send, clock, guard)


class SerialVescDriver(VescDriver):
    """See Driver, AnswersIdentityRequest and AnnouncesItself: a controller on its serial port or its network bridge."""

    def identity_request(self, settings: Vesc) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.vesc.identity import identity_turns

        return identity_turns(settings)

    @property
    def announcement(self) -> Announcement:
        """See AnnouncesItself."""
        from daq.drivers.vesc.identity import ANNOUNCEMENT

        return ANNOUNCEMENT


DRIVER = SerialVescDriver()
