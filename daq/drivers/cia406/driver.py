"""CANopen encoders (CiA 406) as a driver."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.cia406.settings import FAULT_KEYS, EncoderBus
from daq.drivers.contract import DeviceLine, Pipeline, Poller, SpeedControl, Talk
from daq.drivers.identification import IdentityTurns
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class Cia406(PlainDriver):
    """See Driver."""

    name = "cia406"
    settings = EncoderBus
    rest_s: float = 0.001
    example: ClassVar[Mapping[str, Any]] = {"a_node": 3, "b_node": 4, "shaft_node": 5}
    claims: frozenset[str] = frozenset({"falls silent"})
    measured: frozenset[str] = frozenset(f"{name}_{key}" for name in ("a", "b", "shaft") for key in FAULT_KEYS)

    def line(self, settings: EncoderBus) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud, settings.bitrate)

    def channels(self, settings: EncoderBus) -> tuple[Channel, ...]:
        """See Driver: the pendulums' angles."""
        return (channels.PENDULUMS,)

    def occasional(self, settings: EncoderBus) -> tuple[Channel, ...]:
        """See Driver: the index marks, if there is an encoder on the shaft."""
        return () if settings.shaft_node is None else (channels.TACHO,)

    def pipeline(self, device: str, settings: EncoderBus, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.cia406.stream import EncoderPipeline

        return EncoderPipeline(device, settings, identity)

    def poller(self, settings: EncoderBus, send: Callable[[bytes], None], clock: HostClock) -> Poller:
        """See AnswersOnRequest: the sender of SYNC."""
        from daq.drivers.cia406.sync_sender import NoRequests, SyncSender

        return SyncSender(settings, send, clock) if settings.sync else NoRequests()

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        from daq.drivers.canopen import cia301

        code = int(event.facts["error_code"])
        return f"of encoder {event.facts['encoder']}: {cia301.emergency_words(code)}" if code else ""

    def checks(
        self, settings: EncoderBus, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver."""
        from daq.drivers.cia406.status_checks import encoder_checks
        from daq.drivers.cia406.stream import EncoderPipeline

        codes = [self.words(event) for event in events if event.kind == "emergency"]
        return (
            encoder_checks(pipeline, [words for words in codes if words])
            if isinstance(pipeline, EncoderPipeline)
            else {}
        )

    def far_end(self, device: str, settings: EncoderBus, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.cia406.far_end import SimulatedEncoders

        return SimulatedEncoders.of(device, settings, world)

    def played(self, settings: EncoderBus, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.cia406.played import PlayedEncoders

        return PlayedEncoders(settings, identity)

    def identity_request(self, settings: EncoderBus) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.cia406.identity import identity_turns

        return identity_turns(settings)

    def prepare(self) -> None:
        """See Driver."""
        importlib.import_module("daq.drivers.cia406.dialogue")

    def open(self, device: str, settings: EncoderBus, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.cia406.dialogue import open_encoders

        return {"driver": self.name, **open_encoders(device, settings, talk)}

    def stop(self, talk: Talk) -> None:
        """See Driver: the bus is closed at the adapter. The host's SYNC has ended, so the encoders sample no more."""
        from daq.transports.can_frames import CLOSE_BUS

        talk.send(CLOSE_BUS)


DRIVER = Cia406()
