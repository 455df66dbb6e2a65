"""Polled displacement sensors as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import DeviceLine, Pipeline, Poller, Talk
from daq.drivers.identification import IdentityTurns
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.polled_laser.settings import PolledLaser
from daq.drivers.simulated import FarEnd

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class PolledLaserDriver(PlainDriver):
    """See Driver."""

    name = "polled_laser"
    rest_s: float = 0.001
    settings = PolledLaser
    example: ClassVar[Mapping[str, Any]] = {"axis": "x", "dialect": "LK-G"}
    claims: frozenset[str] = frozenset({"falls silent"})
    usual: tuple[Mapping[str, Any], ...] = (
        {"dialect": "LK-G"},
        {"dialect": "LK-G5000"},
        {"dialect": "HL-G1"},
        {"dialect": "IL", "baud": 9_600, "rate_Hz": 20},
        {"dialect": "LK-G", "baud": 9_600, "rate_Hz": 20},
    )

    def line(self, settings: PolledLaser) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud, parity=settings.parity)

    def channels(self, settings: PolledLaser) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.displacement_channel(settings.topic),)

    def pipeline(self, device: str, settings: PolledLaser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.polled_laser.stream import PolledPipeline

        (channel,) = self.channels(settings)
        return PolledPipeline(device, settings, channel)

    def poller(self, settings: PolledLaser, send: Callable[[bytes], None], clock: HostClock) -> Poller:
        """See AnswersOnRequest."""
        from daq.drivers.polled_laser import wire
        from daq.drivers.polled_laser.poller import SensorPoller, Turns
        from daq.drivers.polled_laser.stream import LATEST_S

        turns = Turns(wire.DIALECTS[settings.dialect], settings.output)
        return SensorPoller(turns, 1.0 / settings.rate_Hz, 2 * LATEST_S, send, clock)

    def far_end(self, device: str, settings: PolledLaser, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.polled_laser.far_end import SimulatedPolledLaser

        return SimulatedPolledLaser.of(device, settings, world)

    def played(self, settings: PolledLaser, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.polled_laser.played import PlayedPolledLaser

        return PlayedPolledLaser(settings)

    def open(self, device: str, settings: PolledLaser, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.polled_laser.dialogue import identify

        return {"driver": self.name, **identify(device, settings, talk)}

    def identity_request(self, settings: PolledLaser) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.polled_laser.identity import identity_turns

        return identity_turns(settings)


DRIVER = PolledLaserDriver()
