"""MicroStrain wireless nodes behind a base station as a driver.

The claim `checksum` is that of packets of version 3, and of the angle itself: a sensor whose output repeats with each
revolution does not show how many whole turns passed while packets were lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks, signal_check
from daq.drivers.contract import Poller, SampleClock, SpeedControl
from daq.drivers.driver import Driver, parts_of
from daq.items import DeviceEvent
from rig_drivers.microstrain.settings import MicroStrainNode, quantity_channel

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock

_STATUS_ANSWER_S = 1.0
_EXAMPLE = {  # potentiometers of ten turns: their output does not repeat
    "node_address": 307,
    "turns": False,
    "slope_a_rad": 20 * math.pi / 65536,
    "slope_b_rad": 20 * math.pi / 65536,
    "offset_a_rad": -10 * math.pi,
    "offset_b_rad": -10 * math.pi,
    "counts_per_revolution": 6554,
}


def _channels(settings: MicroStrainNode) -> tuple[Channel, ...]:
    """Return the pendulums' angles, and further quantities if the rig file has any."""
    further = quantity_channel(settings)
    return (channels.PENDULUMS,) if further is None else (channels.PENDULUMS, further)


def _clocks(settings: MicroStrainNode) -> tuple[SampleClock, ...]:
    """Return the beacon's clock."""
    rate, tolerance = settings.rate_Hz, settings.clock_tolerance_ppm
    return (SampleClock(channels.PENDULUMS.topic, rate, tolerance, "node_time_us", 1000, 2**32),)


def _poller(settings: MicroStrainNode, send: Callable[[bytes], None], clock: HostClock) -> Poller:
    """Return periodical queries of the beacon's time."""
    from daq.drivers.polling import Request, RequestLoop
    from rig_drivers.microstrain import wire

    query = wire.request(settings.aspp, wire.BASE_ADDRESS, wire.BEACON_STATUS)
    end = wire.BEACON_STATUS.to_bytes(2, "big")
    return RequestLoop(Request(lambda number: query, end, settings.beacon_status_s, _STATUS_ANSWER_S), send, clock)


def _checks(
    settings: MicroStrainNode, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the strength of the node's signal at the base station."""
    return signal_check(pipeline.base_rssi_dBm, -85, "move the base station nearer")


_part = parts_of("rig_drivers.microstrain")
DRIVER = Driver(
    name="microstrain",
    settings=MicroStrainNode,
    by_radio=True,
    example=_EXAMPLE,
    usual=({}, {"aspp": 1}, {"aspp": 1, "baud": 115_200}, {"baud": 115_200}),
    claims=frozenset({"checksum", "counts exactly", "falls silent"}),
    measured=frozenset({"beacon_lag_ns"}),
    channels=_channels,
    clocks=_clocks,
    pipeline=_part("stream:MicroStrainPipeline"),
    poller=_poller,
    checks=_checks,
    far_end=_part("far_end:SimulatedMicroStrain.of"),
    played=_part("far_end:PlayedMicroStrain"),
    open=_part("dialogue:open_node"),
    stop=_part("dialogue:stop_node"),
    identity_request=_part("dialogue:identity_turns"),
)
