"""RotorLink nodes as a driver."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from daq.drivers.contract import LockControl
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import node_channels, node_clocks, node_marks
from daq.drivers.rotorlink.settings import EncoderNode

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _locks(settings: EncoderNode, send: Callable[[bytes], None], clock: HostClock) -> LockControl:
    from daq.drivers.rotorlink.locks import NodeLocks

    return NodeLocks(send, clock, settings.node)


_part = parts_of("daq.drivers.rotorlink")
DRIVER = Driver(
    name="rotorlink",
    settings=EncoderNode,
    by_radio=True,
    claims=frozenset({"checksum", "counts exactly"}),
    usual=({}, {"baud": 460_800}, {"baud": 230_400}),
    channels=node_channels,
    occasional=node_marks,
    clocks=node_clocks,
    pipeline=_part("stream:NodePipeline"),
    checks=_part("status_checks:node_checks"),
    far_end=_part("far_end:SimulatedNode.of"),
    played=_part("played:PlayedNode"),
    locks=_locks,
    recognise=_part("identity:recognise"),
)
