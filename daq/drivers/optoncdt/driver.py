"""optoNCDT sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, SampleClock, SpeedControl, Talk
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

_COUNTER_WRAP = 2**18


class OptoNcdt:
    """See Driver."""

    name = "optoncdt"
    settings = Laser
    rest_s: float = 0.01
    example: ClassVar[Mapping[str, Any]] = {"axis": "x"}
    claims: frozenset[str] = frozenset({"counts exactly", "falls silent"})

    def line(self, settings: Laser) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud)

    def channels(self, settings: Laser) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.displacement_channel(settings.topic),)

    def occasional(self, settings: Laser) -> tuple[Channel, ...]:
        """See Driver."""
        return ()

    def clocks(self, settings: Laser) -> tuple[SampleClock, ...]:
        """See Driver."""
        (channel,) = self.channels(settings)
        tick_ns = round(channels.DEVICE_TICK_S * 1e9)
        return (
            SampleClock(
                channel.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "device_ticks", tick_ns, _COUNTER_WRAP
            ),
        )

    def pipeline(self, device: str, settings: Laser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.optoncdt.stream import LaserPipeline  # imports numba

        (channel,) = self.channels(settings)
        return LaserPipeline(device, settings, channel, identity)

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        return event.text

    def checks(
        self, settings: Laser, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver."""
        return {}

    def far_end(self, device: str, settings: Laser, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.optoncdt.far_end import SimulatedLaser

        return SimulatedLaser.of(device, settings, world)

    def played(self, settings: Laser, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.optoncdt.played import PlayedLaser

        return PlayedLaser(identity, settings)

    def prepare(self) -> None:
        """See Driver."""
        from daq.drivers.optoncdt.blocks import compile_loop

        compile_loop()

    def open(self, device: str, settings: Laser, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.optoncdt.dialogue import configure

        return configure(device, settings, talk)

    def stop(self, talk: Talk) -> None:
        """See Driver."""
        talk.send(b"OUTPUT NONE\n")


DRIVER = OptoNcdt()
