"""RF60x sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from daq.drivers.contract import DeviceLine, Pipeline, Talk
from daq.drivers.identification import IdentityTurns
from daq.drivers.plain import DisplacementDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.riftek.settings import RiftekLaser
from daq.drivers.simulated import FarEnd


class Riftek(DisplacementDriver):
    """See Driver."""

    name = "riftek"
    settings = RiftekLaser
    count_wrap: int = 2**32
    example: ClassVar[Mapping[str, Any]] = {"axis": "x"}
    claims: frozenset[str] = frozenset({"falls silent"})
    usual: tuple[Mapping[str, Any], ...] = (
        {},
        {"baud": 9_600, "rate_Hz": 200},
        {"baud": 460_800},
        {"baud": 115_200, "rate_Hz": 2000},
    )

    def line(self, settings: RiftekLaser) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud, parity=settings.parity)

    def pipeline(self, device: str, settings: RiftekLaser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.riftek.stream import RiftekPipeline  # imports numba

        (channel,) = self.channels(settings)
        return RiftekPipeline(device, settings, channel, identity)

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

    def identity_request(self, settings: RiftekLaser) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.riftek.identity import identity_turns

        return identity_turns(settings)


DRIVER = Riftek()
