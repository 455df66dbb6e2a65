"""RF60x sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, SampleClock, SpeedControl, Talk
from daq.drivers.played import PlayedDevice
from daq.drivers.riftek.settings import RiftekLaser
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

_COUNTER_WRAP = 2**32


class Riftek:
    """See Driver."""

    name = "riftek"
    settings = RiftekLaser
    rest_s: float = 0.01
    example: ClassVar[Mapping[str, Any]] = {"axis": "x"}
    claims: frozenset[str] = frozenset({"falls silent"})

    def line(self, settings: RiftekLaser) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud, parity=settings.parity)

    def channels(self, settings: RiftekLaser) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.displacement_channel(settings.topic),)

    def occasional(self, settings: RiftekLaser) -> tuple[Channel, ...]:
        """See Driver."""
        return ()

    def clocks(self, settings: RiftekLaser) -> tuple[SampleClock, ...]:
        """See Driver. Results contain no time; the clock's time is their number times the sampling period."""
        (channel,) = self.channels(settings)
        tick_ns = round(channels.DEVICE_TICK_S * 1e9)
        return (
            SampleClock(
                channel.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "device_ticks", tick_ns, _COUNTER_WRAP
            ),
        )

    def pipeline(self, device: str, settings: RiftekLaser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.riftek.stream import RiftekPipeline  # imports numba

        (channel,) = self.channels(settings)
        return RiftekPipeline(device, settings, channel, identity)

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        return event.text

    def checks(
        self, settings: RiftekLaser, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver."""
        return {}

    def far_end(self, device: str, settings: RiftekLaser, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.riftek.far_end import SimulatedRiftek

        return SimulatedRiftek.of(device, settings, world)

    def played(self, settings: RiftekLaser, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.riftek.played import PlayedRiftek

        return PlayedRiftek(identity, settings)

    def prepare(self) -> None:
        """See Driver."""
        import numpy as np

        from daq.drivers.riftek import wire
        from daq.drivers.riftek.decoder import ResultDecoder
        from daq.drivers.spikes import compile_watch

        compile_watch()
        ResultDecoder().feed(wire.results(np.zeros(8, np.int64), np.arange(8)))

    def open(self, device: str, settings: RiftekLaser, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.riftek.dialogue import configure

        return configure(device, settings, talk)

    def stop(self, talk: Talk) -> None:
        """See Driver."""
        from daq.drivers.riftek.dialogue import stop

        stop(talk)


DRIVER = Riftek()
