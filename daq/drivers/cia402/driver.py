"""CiA 402 drives as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.checks import Checks
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.contract import DeviceLine, Pipeline, RotorGuard, SpeedControl, Talk
from daq.drivers.identification import FoundDevice, IdentityTurns
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class Cia402(PlainDriver):
    """See Driver."""

    name = "cia402"
    settings = MotorDrive
    rest_s: float = 0.01
    example: ClassVar[Mapping[str, Any]] = {"node_id": 5}
    claims: frozenset[str] = frozenset({"falls silent"})

    def line(self, settings: MotorDrive) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)

    def channels(self, settings: MotorDrive) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.MOTOR,)

    def pipeline(self, device: str, settings: MotorDrive, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.cia402.stream import DrivePipeline

        return DrivePipeline(device, settings)

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        from daq.drivers.canopen import cia301

        code = int(event.facts["error_code"])
        return cia301.emergency_words(code) if code else ""

    def checks(
        self, settings: MotorDrive, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the drive's state and emergencies, and heartbeats of another node under the host's number."""
        from daq.drivers.cia402.status_checks import drive_checks
        from daq.drivers.cia402.stream import DrivePipeline

        assert isinstance(pipeline, DrivePipeline)
        return drive_checks(control, events, pipeline.host_beats.foreign)

    def far_end(self, device: str, settings: MotorDrive, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.cia402.far_end import SimulatedDrive

        return SimulatedDrive.of(settings, world)

    def played(self, settings: MotorDrive, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.cia402.played import PlayedDrive

        return PlayedDrive(settings)

    def open(self, device: str, settings: MotorDrive, talk: Talk) -> dict[str, Any]:
        """See Driver; the drive's command (`control`) starts the network."""
        return {"driver": self.name, "node_id": settings.node_id}

    def stop(self, talk: Talk) -> None:
        """See Driver; the drive's command (`control`) has stopped it."""

    def speed_source(
        self, settings: MotorDrive, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> SpeedControl:
        """See TurnsRotor."""
        from daq.drivers.cia402.control import DriveControl

        return DriveControl(settings, send, clock, guard)

    def recognise(self, settings: MotorDrive, data: bytes) -> FoundDevice | None:
        """See RecognisesBytes."""
        from daq.drivers.cia402.identity import recognise

        return recognise(settings, data)

    def identity_request(self, settings: MotorDrive) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.cia402.identity import identity_turns

        return identity_turns(settings)


DRIVER = Cia402()
