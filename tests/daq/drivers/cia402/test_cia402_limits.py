"""Pipeline of a CiA 402 drive at its limits: which frames are its own, and when an event is one."""

from __future__ import annotations

from typing import Any

import pytest

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig

CONFIG = load_rig("virtual").devices["drive"]
NODE, HOST = CONFIG.node_id, CONFIG.host_node_id
MS, S = 1_000_000, 1_000_000_000
Items = list[Batch | DeviceEvent]


def line(identifier: int, data: bytes) -> bytes:
    return encode(CanFrame(identifier, data))


def report(word: int = 0x0637, rpm: int = 300) -> bytes:
    return line(cia301.cob_tpdo(1, NODE), cia402.VELOCITY.pack(word, rpm))


def beat(state: int) -> bytes:
    return line(cia301.cob_heartbeat(NODE), bytes([state]))


def joined() -> DrivePipeline:
    """A pipeline whose log has begun."""
    return DrivePipeline("drive", CONFIG, {})


def events(items: Items) -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent)]


def column(items: Items, name: str) -> list[Any]:
    return [value for item in items if isinstance(item, Batch) for value in item.columns[name].tolist()]


@pytest.mark.parametrize(
    "identifier", [0x000, 0x080, 0x084, 0x086, 0x184, 0x186, 0x204, 0x206, 0x285, 0x585, 0x701, 0x704, 0x706]
)
@pytest.mark.parametrize("size", [1, 4, 8])
def test_frames_of_other_identifiers_are_not_the_drive_s(identifier: int, size: int) -> None:
    """Identifiers next to the drive's own, of network commands, of its answers, and of the host's heartbeat."""
    assert (NODE, HOST) == (5, 1)
    pipeline, other = joined(), line(identifier, bytes([0x04, 0x01, 0x02, 0x03, 0x05, 0x06, 0x07, 0x08][:size]))
    assert pipeline.feed(TX, other, S) == []
    items = pipeline.feed(RX, other + report() + other + report(), S)
    assert column(items, "target_rpm") == [0.0, 0.0]
    assert column(items, "speed_rpm") == [300.0, 300.0]
    assert [event.kind for event in events(items)] == ["drive"]
    assert len(pipeline.frames) == 4


@pytest.mark.parametrize("size", [0, 2, 3, 5, 8])
def test_a_target_has_the_size_of_the_process_data(size: int) -> None:
    pipeline, order = joined(), line(cia301.cob_rpdo(1, NODE), (b"\x0f\x00\x50\x00" + bytes(4))[:size])
    pipeline.feed(TX, order, S)
    assert column(pipeline.feed(RX, order + report(), S), "target_rpm") == [0.0]
    right = line(cia301.cob_rpdo(1, NODE), b"\x0f\x00\x50\x00")
    assert column(pipeline.feed(RX, right + report(), S), "target_rpm") == [80.0]


def test_a_state_that_changes_after_equal_statuswords_of_a_read_is_an_event() -> None:
    pipeline = joined()
    items = pipeline.feed(RX, report(0x0637) * 3 + report(0x0633) * 2 + report(0x0637) + report(0x0608), S)
    assert [(event.text, event.facts) for event in events(items)] == [
        ("OPERATION ENABLED", {"statusword": 0x0637}),
        ("SWITCHED ON", {"statusword": 0x0633}),
        ("OPERATION ENABLED", {"statusword": 0x0637}),
        ("FAULT", {"statusword": 0x0608}),
    ]
    assert column(items, "statusword") == [0x0637] * 3 + [0x0633] * 2 + [0x0637, 0x0608]
    assert events(pipeline.feed(RX, report(0x0608), S)) == []


def test_an_emergency_within_a_read_has_its_code_and_no_other_frame_is_lost() -> None:
    pipeline = joined()
    emergency = line(cia301.cob_emergency(NODE), bytes.fromhex("3081 11 0000000001"))
    ended = line(cia301.cob_emergency(NODE), bytes(8))
    items = pipeline.feed(RX, report() + emergency + beat(0x04) + report(rpm=-7) + ended, S)
    assert [(event.kind, event.text) for event in events(items)] == [
        ("emergency", "drive error 0x8130"),
        ("network", "network state STOPPED: it reports no speed"),
        ("emergency", "drive error 0x0000"),
        ("drive", "OPERATION ENABLED"),
    ]
    assert events(items)[0].facts == {"error_code": 0x8130, "register": 0x11, "maker_bytes": "00 00 00 00 01"}
    assert events(items)[2].facts == {"error_code": 0, "register": 0}
    assert column(items, "speed_rpm") == [300.0, -7.0]
