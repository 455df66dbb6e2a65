"""RotorLink nodes behind XBee modules as a driver."""

from __future__ import annotations

from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import node_channels, node_clocks, node_marks
from rig_drivers.xbee.settings import XBeeNode

_part = parts_of("rig_drivers.xbee")
DRIVER = Driver(
    name="xbee",
    settings=XBeeNode,
    by_radio=True,
    example={"node_address": "0013A20040522BAB"},
    claims=frozenset({"checksum", "counts exactly"}),
    measured=frozenset({"rssi_dBm"}),
    usual=({}, {"baud": 9_600, "rate_Hz": 100}, {"baud": 57_600}, {"baud": 230_400}),
    channels=node_channels,
    occasional=node_marks,
    clocks=node_clocks,
    pipeline=_part("stream:XBeePipeline"),
    checks=parts_of("daq.drivers.rotorlink")("status_checks:node_checks"),
    far_end=_part("far_end:SimulatedXBeeNode.of"),
    played=_part("far_end:PlayedXBee"),
    open=_part("dialogue:identify"),
    locks=_part("locks:XBeeLocks"),
    recognise=_part("dialogue:recognise"),
    identity_request=_part("dialogue:identity_turns"),
)
