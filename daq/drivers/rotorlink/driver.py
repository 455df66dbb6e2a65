"""RotorLink nodes as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.drivers.checks import Checks
from daq.drivers.contract import LockControl, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import node_channels, node_clocks, node_marks
from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink.settings import EncoderNode
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _checks(settings: Any, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the node's status, and the signal strength of its frames."""
    from daq.drivers.rotorlink.status_checks import node_checks

    return node_checks(settings, pipeline)


def _played(settings: EncoderNode, identity: Mapping[str, Any]) -> PlayedDevice:
    from daq.drivers.rotorlink.played import PlayedNode

    return PlayedNode()


def _open(device: str, settings: EncoderNode, talk: Talk) -> dict[str, Any]:
    """Send nothing: a node streams as soon as it has power."""
    return {"driver": "rotorlink", "port": settings.port}


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
    checks=_checks,
    far_end=_part("far_end:SimulatedNode.of"),
    played=_played,
    open=_open,
    locks=_locks,
    recognise=_part("identity:recognise"),
)
