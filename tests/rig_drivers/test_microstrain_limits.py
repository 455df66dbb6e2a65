"""Pipeline of a MicroStrain node at its limits, with every field of its samples and events."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from daq.items import RX, Batch, DeviceEvent
from tests.rig_drivers.test_microstrain import (
    NODE,
    RATE_CODE,
    UTC_S,
    S,
    kinds,
    packet,
    pipeline,
    status,
    sweeps,
    thetas,
)

BASE = 0x1234
STEP = 2 * math.pi / 65536
Items = list[Batch | DeviceEvent]


def only_batch(items: Items, topic: str = "pendulums") -> Batch:
    (batch,) = [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]
    return batch


def only_event(items: Items) -> DeviceEvent:
    (event,) = [item for item in items if isinstance(item, DeviceEvent)]
    return event


def shape(items: Items) -> list[str]:
    """The kinds of the events in their order, and "samples" for a batch."""
    return [item.kind if isinstance(item, DeviceEvent) else "samples" for item in items]


def floats(rows: list[tuple[float, ...]], mask: int = 3, tick: int = 0) -> bytes:
    """A packet of sweeps of floating-point numbers, one value for each channel of the mask."""
    after_ns = round(tick * 1e9 / 256)
    head = struct.pack(">IHBBHQ", 0, mask, RATE_CODE, 2, tick, UTC_S * S + after_ns)
    values = [value for row in rows for value in row]
    return packet(0x1A, head + struct.pack(f">{len(values)}f", *values))


def payload_of(data: bytes) -> bytes:
    return data[9:-6]


def test_further_quantities_are_those_of_their_channels() -> None:
    line = pipeline(quantities={"supply_V": 4, "hub_V": 6, "end_V": 5})
    items = line.feed(RX, floats([(1, 2, 4, 5, 6), (11, 12, 14, 15, 16)], mask=0b111011), S)
    columns = only_batch(items, "node").columns
    assert {name: column.tolist() for name, column in columns.items()} == {
        "supply_V": [4.0, 14.0],
        "hub_V": [6.0, 16.0],
        "end_V": [5.0, 15.0],
    }
    assert only_batch(items).columns["theta3_rad"] == pytest.approx([STEP, 11 * STEP])


def test_a_packet_as_set_up_ends_a_series_of_contradicting_ones() -> None:
    line, bad = pipeline(), sweeps(0, [(1, 1)], rate=106)
    found = [kinds(line.feed(RX, data, S)) for data in (bad, bad, sweeps(0, [(1, 1)]), bad, bad, bad, bad)]
    assert found == [["damage"], ["damage"], [], ["damage"], ["damage"], ["fault"], []]
    assert line.status.complaint
    assert len(thetas(line.feed(RX, sweeps(1, [(1, 1)]), S))) == 1
    assert line.status.complaint == ""
    assert line.losses == {"samples": 0, "damaged_packets": 6, "bytes": 0, "foreign_packets": 0}


def test_samples_before_a_gap_or_a_restart_come_before_its_event() -> None:
    four = [(1, 1)] * 4
    first = sweeps(1000, four)
    assert shape(pipeline().feed(RX, first + sweeps(1004, four), S)) == ["samples"]
    assert shape(pipeline().feed(RX, first + sweeps(2000, four, tick=0), S)) == ["samples", "restart", "samples"]
    assert shape(pipeline().feed(RX, first + sweeps(0, four, late_s=-100), S)) == ["samples", "restart", "samples"]
    line = pipeline()
    items = [*line.feed(RX, first + sweeps(1006, four), S), *line.feed(RX, status(UTC_S * S), 2 * S)]
    assert shape(items) == ["samples", "reply", "gap", "samples"]
    gap, after = items[2:]
    assert isinstance(gap, DeviceEvent)
    assert isinstance(after, Batch)
    assert gap.text == "2 samples lost (7.81 ms)"
    assert gap.facts == {"samples": 2, "span_s": 0.0078125, "time_ns": int(after.time_ns[0]), "rssi_dBm": -61}
    assert after.sequence.tolist() == [6, 7, 8, 9]
    assert shape(line.feed(RX, sweeps(1010, four), 2 * S)) == ["samples"]
    line.feed(RX, sweeps(1020, four, base_rssi=127), 2 * S)
    unknown = only_event(line.feed(RX, b"", 2 * S))
    assert (unknown.facts["samples"], "rssi_dBm" in unknown.facts, line.base_rssi_dBm) == (6, False, None)


def test_only_packets_of_samples_of_this_node_give_samples() -> None:
    line, payload = pipeline(), payload_of(sweeps(0, [(1, 1)]))
    for kind in (0x19, 0x1B):
        assert line.feed(RX, packet(kind, payload), S) == []
    assert not line.status.has_reported
    for address, kind in ((100, 0x1A), (308, 0x1A), (BASE + 1, 0x31), (BASE, 0x1A)):
        event = only_event(line.feed(RX, packet(kind, payload, address), S))
        assert (event.kind, event.facts) == ("foreign", {"node": address})
    answer = only_event(line.feed(RX, packet(0x22, b"\x00\x07", NODE), S))
    assert (answer.kind, answer.text) == ("reply", f"34 {NODE} {S} 0007")
    assert len(thetas(line.feed(RX, packet(0x1A, payload), S))) == 1
    assert line.status.has_reported


def test_the_first_state_of_the_beacon_is_a_reply_even_if_it_is_off() -> None:
    line = pipeline()
    off, on = status(0, is_on=False), status(UTC_S * S)
    event = only_event(line.feed(RX, off, 7 * S))
    assert (event.kind, event.text) == ("reply", f"49 {BASE} {7 * S} {payload_of(off).hex()}")
    assert [kinds(line.feed(RX, data, 8 * S)) for data in (off, on, on, off, off)] == [[], [], [], ["restart"], []]


@pytest.mark.parametrize(
    ("kind", "payload"),
    [(0x31, "0001"), (0x31, "beab ffffffff"), (0x32, "beac ffffffff"), (0x22, "beac ffffffff")],
)
def test_other_answers_are_replies_and_leave_the_beacon_s_state_known(kind: int, payload: str) -> None:
    line = pipeline()
    line.feed(RX, status(UTC_S * S), S)
    assert kinds(line.feed(RX, packet(kind, bytes.fromhex(payload), BASE), S)) == ["reply"]
    assert line.feed(RX, status(UTC_S * S), S) == []
    assert kinds(line.feed(RX, status(0, is_on=False), S)) == ["restart"]


def test_no_sample_is_later_than_its_arrival() -> None:
    line = pipeline({"beacon_lag_ns": 3 * S})
    early_ns = (UTC_S + 2) * S
    assert only_batch(line.feed(RX, sweeps(0, [(1, 1)]), early_ns)).time_ns.tolist() == [early_ns]
    for known in (True, "1", 1.0):
        line = pipeline({"beacon_lag_ns": known})
        assert only_batch(line.feed(RX, sweeps(0, [(1, 1)]), (UTC_S + 9) * S)).time_ns.tolist() == [(UTC_S + 9) * S]


def test_turns_continue_from_the_last_sample_of_a_packet() -> None:
    line = pipeline()
    first = sweeps(0, [(60_000, 16_384), (65_000, 16_384), (500, 16_384)])
    assert thetas(line.feed(RX, first, S)) == pytest.approx([-5536 * STEP, -536 * STEP, 500 * STEP])
    assert thetas(line.feed(RX, sweeps(3, [(600, 16_384)]), S)) == pytest.approx([600 * STEP])
    back = sweeps(4, [(100, 16_384), (65_500, 16_384), (65_400, 16_384), (10, 16_384), (60_000, 16_384)])
    assert thetas(line.feed(RX, back, S)) == pytest.approx([k * STEP for k in (100, -36, -136, 10, -5536)])
    assert thetas(line.feed(RX, sweeps(9, [(59_000, 16_384)]), S)) == pytest.approx([-6536 * STEP])


def test_a_packet_without_a_reading_leaves_the_turns_as_they_are() -> None:
    line = pipeline()
    assert thetas(line.feed(RX, floats([(-65_000.0, 0.0)]), S)) == pytest.approx([536 * STEP])
    batch = only_batch(line.feed(RX, floats([(math.nan, math.inf)] * 2, tick=1), S))
    assert np.isnan(batch.columns["theta3_rad"]).all()
    assert batch.columns["flags"].tolist() == [3, 3]
    assert thetas(line.feed(RX, floats([(-64_000.0, 0.0)], tick=3), S)) == pytest.approx([1536 * STEP])
