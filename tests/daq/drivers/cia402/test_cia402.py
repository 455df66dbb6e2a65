"""CiA 402 and CiA 301 pieces against the standard's tables."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, strategies as st

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia, wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig

U16, I16 = st.integers(0, 2**16 - 1), st.integers(-(2**15), 2**15 - 1)


@pytest.mark.parametrize(
    ("statusword", "name"),
    [
        (0x0000, cia.NOT_READY),
        (0x0250, cia.SWITCH_ON_DISABLED),
        (0x0231, cia.READY),
        (0x0233, cia.SWITCHED_ON),
        (0x0637, cia.OPERATION_ENABLED),
        (0x0217, cia.QUICK_STOP_ACTIVE),
        (0x021F, cia.FAULT_REACTION),
        (0x0218, cia.FAULT),
        (0x0001, cia.UNKNOWN),
    ],
)
def test_state_names(statusword, name):
    assert cia.state(statusword) == name


@given(U16)
def test_at_most_one_state_fits(statusword):
    fitting = [name for name, (mask, value) in cia.STATES.items() if statusword & mask == value]
    assert len(fitting) <= 1
    assert cia.state(statusword) == (fitting[0] if fitting else cia.UNKNOWN)


def test_the_way_to_operation():
    steps = [cia.towards_operation(name) for name in (cia.FAULT, cia.SWITCH_ON_DISABLED, cia.READY, cia.SWITCHED_ON)]
    assert steps == [0x80, 0x06, 0x07, 0x0F]
    assert cia.towards_operation(cia.FAULT_REACTION) is None


@given(U16, I16)
def test_process_data_round_trip(word, rpm):
    assert cia.VELOCITY.unpack(cia.VELOCITY.pack(word, max(-32767, rpm))) == (word, max(-32767, rpm))


def test_process_data_bytes():
    assert cia.VELOCITY.pack(cia.ENABLE_OPERATION, -300) == bytes.fromhex("0f00 d4fe")


@given(U16, st.integers(0, 255), st.binary(min_size=5, max_size=5))
def test_emergency_round_trip(error_code, register, maker):
    emergency = cia301.Emergency(error_code, register, maker)
    assert cia301.unpack_emergency(cia301.pack_emergency(emergency)) == emergency


def test_emergency_bytes():
    assert cia301.unpack_emergency(bytes.fromhex("3081 10 0102030405")).error_code == 0x8130
    with pytest.raises(ValueError, match="8 bytes"):
        cia301.unpack_emergency(b"")


def test_heartbeat():
    assert cia301.heartbeat(b"\x05") is cia301.Heartbeat.OPERATIONAL
    assert cia301.heartbeat(b"\x85") is cia301.Heartbeat.OPERATIONAL
    assert cia301.heartbeat(b"\x06") is None
    assert cia301.heartbeat(b"") is None
    assert cia.consumer_heartbeat(1, 500) == 0x000101F4


def test_connection_set_of_node_5():
    ids = [
        cia301.cob_emergency(5),
        cia301.cob_tpdo(1, 5),
        cia301.cob_rpdo(1, 5),
        cia301.cob_tpdo(4, 5),
        cia301.cob_rpdo(4, 5),
    ]
    assert ids == [0x085, 0x185, 0x205, 0x485, 0x505]
    assert [cia301.cob_sdo_answer(5), cia301.cob_sdo_request(5), cia301.cob_heartbeat(5)] == [0x585, 0x605, 0x705]


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x0000, "0x0000, error reset"),
        (0x3220, "0x3220, DC link under-voltage"),
        (
            0x8130,
            "0x8130, life guard or heartbeat error: the host's heartbeat stayed away: cable, or a busy host",
        ),
        (0x3225, "0x3225, DC link under-voltage"),
        (0x42FF, "0x42FF, device temperature"),
        (0x9ABC, "0x9ABC, external error"),
        (0xFF12, "0xFF12, device specific"),
        (0x0010, "0x0010, unknown to CiA 301 and 402"),
        (0xA000, "0xA000, unknown to CiA 301 and 402"),
    ],
)
def test_an_emergency_is_reported_with_its_meaning(code, words):
    assert cia301.emergency_words(code) == words


@given(U16)
def test_every_emergency_code_has_words(code):
    assert cia301.emergency_words(code).startswith(f"0x{code:04X}, ")


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
