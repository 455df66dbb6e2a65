"""optoNCDT sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import Pipeline, SpeedControl, Talk
from daq.drivers.identification import IdentityTurns
from daq.drivers.optoncdt import distance_words
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.plain import DisplacementDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent
from rig_basics.texts import number_of

if TYPE_CHECKING:
    from daq.drivers.optoncdt.stream import LaserPipeline


class OptoNcdt(DisplacementDriver):
    """See Driver."""

    name = "optoncdt"
    settings = Laser
    count_wrap: int = 2**18
    example: ClassVar[Mapping[str, Any]] = {"axis": "x"}
    claims: frozenset[str] = frozenset({"counts exactly", "falls silent"})
    usual: tuple[Mapping[str, Any], ...] = (
        {},
        {"baud": 691_200},
        {"baud": 115_200},
        {"baud": 230_400},
        {"baud": 460_800},
        {"baud": 1_000_000},
    )

    def pipeline(self, device: str, settings: Laser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.optoncdt.stream import LaserPipeline  # imports numba

        (channel,) = self.channels(settings)
        return LaserPipeline(device, settings, channel, identity)

    def far_end(self, device: str, settings: Laser, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.optoncdt.far_end import SimulatedLaser

        return SimulatedLaser.of(device, settings, world)

    def played(self, settings: Laser, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.optoncdt.played import PlayedLaser

        return PlayedLaser(identity, settings)

    def checks(
        self, settings: Any, pipeline: LaserPipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the meaning of the error codes in place of distances, if there were any."""
        if not pipeline.error_codes:
            return {}
        code, count = max(pipeline.error_codes.items(), key=lambda found: found[1])
        meaning = self.code_meaning(code) or "not in the manuals"
        remedy = distance_words.REMEDIES.get(code)
        note = f"in {number_of(count, 'sample')}" + (f": {remedy}" if remedy else "")
        return {"error_code": DeviceCheck(f"{code}: {meaning}", None, True, note)}

    def code_meaning(self, code: int) -> str:
        """See NamesCodes."""
        return distance_words.ERROR_CODES.get(code, "")

    def prepare(self) -> None:
        """See Driver."""
        from daq.drivers.spikes import compile_watch

        compile_watch()

    def open(self, device: str, settings: Laser, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.optoncdt.dialogue import configure

        return configure(device, settings, talk)

    def stop(self, talk: Talk) -> None:
        """See Driver."""
        talk.send(b"OUTPUT NONE\n")

    def identity_request(self, settings: Laser) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.optoncdt.identity import identity_turns

        return identity_turns(settings)


DRIVER = OptoNcdt()
