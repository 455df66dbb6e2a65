"""Packets that a node sends again, older nodes, and base stations that start again, as the maker describes them."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from daq.items import RX, Batch, DeviceEvent
from rig_drivers.microstrain.stream import MicroStrainPipeline
from tests.rig_drivers.microstrain.test_node import NODE, RATE_CODE, UTC_S, S, kinds, packet, pipeline, status, sweeps

BASE = 0x1234
PER = 16  # sweeps of a packet
PERIOD_NS = PER * S // 256


class Radio:
    """Packets of a node, each by its number; they arrive 40 ms after their last sweep unless they are late."""

    def __init__(self, line: MicroStrainPipeline) -> None:
        self.line = line
        self.items: list[Batch | DeviceEvent] = []

    def arrive(self, number: int, at: float | None = None, **more: int) -> None:
        """Receive a packet; `at` is the number of the packet in whose time it arrives."""
        data = sweeps(PER * number, [(100 + number % 1000, 16_384)] * PER, **more)
        at_ns = UTC_S * S + int(((number if at is None else at) + 1) * PERIOD_NS) + 40_000_000
        self.items += self.line.feed(RX, data, at_ns)

    def status(self, at: float) -> None:
        at_ns = UTC_S * S + int(at * PERIOD_NS)
        self.items += self.line.feed(RX, status(at_ns), at_ns)

    @property
    def numbers(self) -> list[int]:
        """Numbers of the recorded packets, in their order."""
        batches = [item for item in self.items if isinstance(item, Batch)]
        times = np.concatenate([batch.columns["node_time_us"] for batch in batches]).astype(np.int64)
        return [round((int(us) * 1000 - UTC_S * S) / PERIOD_NS) for us in times[::PER]]

    @property
    def times_off_s(self) -> float:
        """Largest error of a time, s."""
        batches = [item for item in self.items if isinstance(item, Batch)]
        errors = [batch.time_ns - batch.columns["node_time_us"].astype(np.int64) * 1000 for batch in batches]
        return float(np.abs(np.concatenate(errors)).max()) * 1e-9


def radio() -> Radio:
    made = Radio(pipeline({"beacon_lag_ns": 0}))
    made.status(0)
    return made


def test_late_packets_are_put_into_order() -> None:
    node = radio()
    for number in (0, 2, 3):
        node.arrive(number)
    node.arrive(1, at=3.5)
    node.arrive(4)
    node.arrive(6)
    node.arrive(7)
    assert node.numbers == [0, 1, 2, 3, 4]
    node.arrive(5, at=7.5)
    node.arrive(8)
    assert node.numbers == list(range(9))
    assert kinds(node.items) == ["reply"]
    assert node.times_off_s < 0.001


def test_a_clock_of_the_node_that_is_set_back_is_a_restart_and_no_repetition() -> None:
    node = radio()
    for number in range(10):
        node.arrive(number)
    data = sweeps(PER * 5, [(1, 1)] * PER, tick=PER * 10)  # ticks go on, times are 5 packets earlier
    items = node.line.feed(RX, data, UTC_S * S + 12 * PERIOD_NS)
    assert kinds(items) == ["restart"]
    assert sum(len(item.time_ns) for item in items if isinstance(item, Batch)) == PER


def test_waiting_packets_come_before_a_restart_of_the_node() -> None:
    node = radio()
    for number, at in ((0, 0), (1, 1), (2, 2), (4, 4)):
        node.arrive(number, at=at)
    node.items.clear()
    node.arrive(6, tick=0)
    assert [item.kind if isinstance(item, DeviceEvent) else "samples" for item in node.items] == [
        "gap",
        "samples",
        "restart",
        "samples",
    ]


def eight(kind: int = 0x0A, mode: int = 2, data_type: int = 3, number: int = 0) -> bytes:
    """A packet of synchronized sampling of a node with 8 channels, by the maker's protocol."""
    head = struct.pack(">BBBBHII", mode, 3, RATE_CODE, data_type, number, UTC_S, 0)
    return packet(kind, head + struct.pack(">4H", 10, 20, 11, 21), version=1)


@pytest.mark.parametrize("kind", [0x0A, 0x09])
def test_nodes_with_eight_channels_are_read(kind: int) -> None:
    line = pipeline({"beacon_lag_ns": 0}, aspp=1, turns=False, slope_a_rad=1.0, slope_b_rad=1.0)
    (batch,) = line.feed(RX, eight(kind), UTC_S * S + S)
    assert isinstance(batch, Batch)
    assert batch.columns["theta3_rad"].tolist() == [10.0, 11.0]
    assert batch.columns["theta4_rad"].tolist() == [20.0, 21.0]


@pytest.mark.parametrize("wrong", [{"mode": 3}, {"data_type": 0x10}])
def test_impossible_content_of_eight_channels_is_damage(wrong: dict[str, int]) -> None:
    line = pipeline(aspp=1)
    assert kinds(line.feed(RX, eight(**wrong), S)) == ["damage"]
    assert line.losses["damaged_packets"] == 1
    assert pipeline(aspp=1).feed(RX, eight(0x09, mode=3), S) == []


def test_a_node_that_sends_samples_of_another_kind_only_is_explained() -> None:
    line = pipeline()
    other = packet(0x1D, bytes(20))
    assert line.feed(RX, other * 2, S) == []
    (fault,) = line.feed(RX, other, S)
    assert isinstance(fault, DeviceEvent)
    assert (fault.kind, fault.text) == ("fault", line.status.complaint)
    assert "type 1Dh (buffered low duty cycle), not of synchronized sampling" in line.status.complaint
    assert line.feed(RX, other, S) == []
    line = pipeline()
    line.feed(RX, sweeps(0, [(1, 1)]), S)
    assert line.feed(RX, other * 5, S) == []
    assert line.status.complaint == ""


@pytest.mark.parametrize(("kind", "payload"), [(0x16, bytes(21)), (0x00, b"\x0f\x08\xfc")])
def test_every_report_of_a_start_is_a_restart(kind: int, payload: bytes) -> None:
    line = pipeline()
    line.feed(RX, sweeps(0, [(1, 1)]), S)
    assert kinds(line.feed(RX, packet(kind, payload), S)).count("restart") == 1


def test_the_repetition_of_the_beacon_is_no_foreign_node() -> None:
    line = pipeline()
    assert line.feed(RX, packet(0x10, b"\xbe\xac" + UTC_S.to_bytes(4, "big"), 0), S) == []
    assert not any(line.losses.values())


def test_a_node_that_was_switched_on_and_does_not_sample_has_lost_its_set_up() -> None:
    line = pipeline()
    line.feed(RX, status(UTC_S * S), S)
    line.feed(RX, packet(0x18, bytes(17)), S)
    line.feed(RX, status(UTC_S * S), 6 * S)
    assert line.status.set_up_lost == ""
    line.feed(RX, status(UTC_S * S), 6 * S + 1)
    assert line.status.set_up_lost == "the node was switched on and does not sample"
    line.feed(RX, status(UTC_S * S), 7 * S)
    assert line.status.set_up_lost
    line.feed(RX, packet(0x31, b"\xbe\xac" + UTC_S.to_bytes(4, "big"), BASE), 8 * S)
    line.feed(RX, status(UTC_S * S), 20 * S)
    assert line.status.set_up_lost == ""
    line.feed(RX, packet(0x18, bytes(17)), 21 * S)
    line.feed(RX, sweeps(0, [(1, 1)]), 22 * S)
    line.feed(RX, status(UTC_S * S), 40 * S)
    assert line.status.set_up_lost == ""


def test_a_base_station_that_refuses_its_beacon_s_time_is_doubted_once() -> None:
    line, refusal = pipeline(), packet(0x32, b"\xbe\xad\x04", BASE)
    assert kinds(line.feed(RX, refusal, S)) == ["reply"]
    (doubt,) = line.feed(RX, refusal, 2 * S)
    assert isinstance(doubt, DeviceEvent)
    assert doubt.kind == "doubt"
    assert "refuses the query with code 4. Samples have the time of their arrival" in doubt.text
    assert line.feed(RX, refusal, 3 * S) == []


def test_a_beacon_that_the_host_sets_again_begins_a_new_clock_at_the_next_start_of_the_node() -> None:
    """The first beacon is 6 ms late at the host, the second in time: its samples are at once as exact as before."""
    line = pipeline({"beacon_lag_ns": 6_000_000})
    begin_ns, again_s = UTC_S * S, 20
    for number in range(200):
        due_ns = begin_ns + (number + 1) * PERIOD_NS + 6_000_000
        line.feed(RX, status(due_ns - 6_000_000), due_ns)
        line.feed(RX, sweeps(PER * number, [(1, 1)] * PER), due_ns)
    line.feed(RX, packet(0x31, b"\xbe\xac" + (UTC_S + again_s).to_bytes(4, "big"), BASE), begin_ns + again_s * S)
    line.feed(RX, status(begin_ns + again_s * S), begin_ns + again_s * S + 20_000_000)
    data = sweeps(0, [(1, 1)] * PER, late_s=again_s)
    _, batch = line.feed(RX, data, begin_ns + again_s * S + PERIOD_NS + 60_000_000)
    assert isinstance(batch, Batch)
    assert int(batch.time_ns[0]) - (begin_ns + again_s * S) == pytest.approx(20_000_000, abs=100_000)


def test_the_confirmation_of_a_request_by_the_base_station_is_no_damage() -> None:
    """A base station of version 1 sends a single AA when it has sent a request to a node."""
    line = pipeline(aspp=1)
    answer = packet(0x00, b"\x00\x07\x00\x2e\x18\xa1", version=1)
    line.feed(RX, answer, S)
    for parts in ((b"\xaa", answer), (b"\xaa" + answer,), (b"\xaa" + answer[:1], answer[1:])):
        assert [kind for part in parts for kind in kinds(line.feed(RX, part, S))] == ["reply"]
    assert line.losses["bytes"] == 0
    assert kinds(line.feed(RX, b"\xaa\x55" + answer, S)) == ["damage", "reply"]
    assert line.losses["bytes"] == 2
    assert answer[3:5] == NODE.to_bytes(2, "big")
