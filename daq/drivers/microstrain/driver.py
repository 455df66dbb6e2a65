"""MicroStrain wireless nodes behind a base station as a driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import Pipeline, Poller, SampleClock, SpeedControl, Talk
from daq.drivers.microstrain.settings import MicroStrainNode
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.drivers.identification import IdentityTurns
    from daq.transports.host_clock import HostClock

_MIN_SIGNAL_DBM = -85
_STATUS_ANSWER_S = 1.0


class MicroStrain(PlainDriver):
    """See Driver.

    The claim `checksum` is that of packets of version 3, and of the angle itself: a sensor whose output repeats with
    each revolution does not show how many whole turns passed while packets were lost.
    """

    name = "microstrain"
    by_radio: bool = True
    rest_s: float = 0.01
    settings = MicroStrainNode
    example: ClassVar[Mapping[str, Any]] = {  # potentiometers of ten turns: their output does not repeat
        "node_address": 307,
        "turns": False,
        "slope_a_rad": 20 * math.pi / 65536,
        "slope_b_rad": 20 * math.pi / 65536,
        "offset_a_rad": -10 * math.pi,
        "offset_b_rad": -10 * math.pi,
        "counts_per_revolution": 6554,
    }
    usual: tuple[Mapping[str, Any], ...] = ({}, {"aspp": 1}, {"aspp": 1, "baud": 115_200}, {"baud": 115_200})
    claims: frozenset[str] = frozenset({"checksum", "counts exactly", "falls silent"})
    measured: frozenset[str] = frozenset({"beacon_lag_ns"})

    def channels(self, settings: MicroStrainNode) -> tuple[Channel, ...]:
        """See Driver: the pendulums' angles, and further quantities if the rig file has any."""
        further = _quantities(settings)
        return (channels.PENDULUMS,) if further is None else (channels.PENDULUMS, further)

    def clocks(self, settings: MicroStrainNode) -> tuple[SampleClock, ...]:
        """See Driver: the beacon's clock."""
        rate, tolerance = settings.rate_Hz, settings.clock_tolerance_ppm
        return (SampleClock(channels.PENDULUMS.topic, rate, tolerance, "node_time_us", 1000, 2**32),)

    def pipeline(self, device: str, settings: MicroStrainNode, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.microstrain.stream import MicroStrainPipeline

        return MicroStrainPipeline(device, settings, identity, _quantities(settings))

    def identity_request(self, settings: MicroStrainNode) -> IdentityTurns:
        """See AnswersIdentityRequest."""
        from daq.drivers.microstrain.identity import identity_turns

        return identity_turns(settings)

    def poller(self, settings: MicroStrainNode, send: Callable[[bytes], None], clock: HostClock) -> Poller:
        """See AnswersOnRequest: the beacon's time is queried periodically."""
        from daq.drivers.microstrain import wire
        from daq.drivers.polling import Request, RequestLoop

        query = wire.request(settings.aspp, wire.BASE_ADDRESS, wire.BEACON_STATUS)
        end = wire.BEACON_STATUS.to_bytes(2, "big")
        return RequestLoop(Request(lambda number: query, end, settings.beacon_status_s, _STATUS_ANSWER_S), send, clock)

    def checks(
        self, settings: MicroStrainNode, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the strength of the node's signal at the base station."""
        strength = pipeline.base_rssi_dBm
        if strength is None:
            return {}
        weak = strength < _MIN_SIGNAL_DBM
        note = "weak: move the base station nearer" if weak else ""
        return {"signal_dBm": DeviceCheck(strength, f"at least {_MIN_SIGNAL_DBM}", not weak, note)}

    def far_end(self, device: str, settings: MicroStrainNode, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.microstrain.far_end import SimulatedMicroStrain

        return SimulatedMicroStrain.of(device, settings, world)

    def played(self, settings: MicroStrainNode, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.microstrain.played import PlayedMicroStrain

        return PlayedMicroStrain(identity, settings)

    def open(self, device: str, settings: MicroStrainNode, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.microstrain.dialogue import open_node

        return open_node(device, settings, talk)

    def stop_by(self, settings: MicroStrainNode, talk: Talk) -> None:
        """See StopsBySettings."""
        from daq.drivers.microstrain.dialogue import stop_node

        stop_node(settings, talk)


def _quantities(settings: MicroStrainNode) -> Channel | None:
    """Return the channel of the further quantities; None without any."""
    fields = tuple((name, "double") for name in settings.quantities)
    return Channel("node", "rig.NodeSample", fields) if fields else None


DRIVER = MicroStrain()
