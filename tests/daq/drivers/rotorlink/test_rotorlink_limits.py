"""Pipeline of a RotorLink node at its limits: counts, times, restarts and events of every kind of frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.items import RX, TX, Batch, DeviceEvent
from rig_configs import load_rig

CONFIG = load_rig("virtual").devices["encoder"]
START_NS = 1_700_000_000_000_000_000
LOST, REPEATS = rotorlink.FLAG_SAMPLES_LOST, rotorlink.FLAG_REPEATS
Items = list[Batch | DeviceEvent]


class Line:
    """A pipeline whose reads arrive at the node's own time, and what it has returned."""

    def __init__(self, identity: dict[str, Any] | None = None, **settings: Any) -> None:
        self.pipeline = NodePipeline("encoder", CONFIG.model_copy(update=settings), identity or {})
        self.items: Items = []

    def at(self, us: int, *frames: bytes) -> Items:
        found = self.pipeline.feed(RX, b"".join(map(rotorlink.wire, frames)), START_NS + 1000 * us)
        self.items += found
        return found

    def mark(self, seq: int, us: int, node: int = 1) -> Items:
        return self.at(us, mark(seq, us, node))

    def end(self) -> Items:
        self.items += (found := self.pipeline.feed(RX, b"", START_NS))
        return found

    def events(self, kind: str) -> list[DeviceEvent]:
        return [item for item in self.items if isinstance(item, DeviceEvent) and item.kind == kind]

    def values(self, name: str) -> list[Any]:
        batches = [item for item in self.items if isinstance(item, Batch) and name in item.columns]
        return [value for batch in batches for value in batch.columns[name].tolist()]

    @property
    def losses(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}


def mark(seq: int, us: int, node: int = 1) -> bytes:
    return rotorlink.IndexMark(node, seq % 65536, us % 2**32, 7).pack()


def block(seq: int, index: int, us: int, n: int = 10, flags: int = 0, period_us: int = 1000) -> bytes:
    counts = np.column_stack([np.arange(n) + index % 1000, np.arange(n)]).astype(np.int32)
    return rotorlink.EncoderBlock(1, seq % 65536, index % 2**32, us % 2**32, period_us, flags, counts).pack()


def dongle(seq: int, us: int, rssi_dBm: int = -70) -> bytes:
    return rotorlink.DongleStatus(0x30, seq, us, 0, 0, rssi_dBm).pack()


def wrapped(seq: int, us: int, inner: bytes) -> bytes:
    return rotorlink.Wrapped(0x30, seq, us, -60, rotorlink.parse_node(inner)).pack()


def unknown(kind: int, seq: int, node: int = 1) -> bytes:
    return rotorlink.encode_frame(bytes((kind, node, seq, 0, 9)))


# --- frames lost on air ----------------------------------------------------------------------------------------


def test_the_time_of_a_gap_is_that_between_the_newest_frames_around_it() -> None:
    line = Line()
    line.mark(0, 0)
    line.mark(1, 1)
    line.mark(4, 10_001)
    line.at(10_002, mark(5, 9_000))  # older than the one before
    line.mark(8, 30_001)
    (first, second) = line.events("gap")
    assert first.facts == {"radio_frames": 2, "span_s": pytest.approx(0.01, abs=1e-9)}
    assert second.facts == {"radio_frames": 2, "span_s": pytest.approx(0.02, abs=1e-9)}
    assert second.text == "2 radio frames lost within 20 ms"
    assert line.pipeline.status.heard_frames == (0, 8)
    assert line.values("revolutions") == [7] * 5


def test_the_time_of_a_gap_goes_on_over_the_wrap_of_the_node_s_clock() -> None:
    line = Line()
    for seq, us in ((0, -9_000), (1, -5_000), (2, 5_000), (5, 15_000)):
        line.at(us, mark(seq, us))
    assert line.events("gap")[0].facts == {"radio_frames": 2, "span_s": pytest.approx(0.01, abs=1e-9)}
    line = Line()
    line.at(-5_000, mark(0, -5_000))
    line.at(5_000, mark(3, 5_000))
    assert line.events("gap")[0].facts["span_s"] == pytest.approx(0.01, abs=1e-9)


@pytest.mark.parametrize("restarts", [False, True])
def test_a_first_block_across_the_wrap_of_the_node_s_clock_has_no_negative_times(restarts: bool) -> None:
    line = Line()
    if restarts:  # the first block after a restart is a first block, too
        line.at(-30_000_000, block(0, 90_000, 30_000_000))
        line.items.clear()
    line.at(5_000, block(1, 0, -4_000))
    line.at(15_000, block(2, 10, 6_000))
    line.end()
    node_us = np.array(line.values("node_time_us"), np.int64)
    assert len(line.events("restart")) == restarts
    assert len(node_us) == 20
    assert np.all(np.diff(node_us) == 1_000)
    assert node_us[0] == 2**32 - 4_000


@pytest.mark.parametrize(
    ("silence_us", "span_s", "next_s"), [(2**31 - 1, 2147.483647, 0.01), (2**31, 0.0, 0.0), (2**31 + 1, 0.0, 0.0)]
)
def test_a_gap_of_half_the_node_s_clock_has_no_known_time(silence_us: int, span_s: float, next_s: float) -> None:
    line = Line()
    line.mark(0, 0)
    line.mark(3, silence_us)
    line.mark(6, silence_us + 10_000)
    spans = [event.facts["span_s"] for event in line.events("gap")]
    assert spans == [pytest.approx(span_s, abs=1e-9), pytest.approx(next_s, abs=1e-9)]
    assert line.losses == {"radio_frames": 4}


def test_a_gap_of_ten_seconds_has_its_milliseconds() -> None:
    line = Line()
    line.mark(0, 0)
    line.mark(2, 10_000_000)
    assert line.events("gap")[0].text == "1 radio frame lost within 10000 ms"


def test_a_gap_before_a_frame_without_a_time_has_no_span() -> None:
    line = Line()
    line.mark(0, 5_000)
    line.at(9_000, rotorlink.Acknowledge(1, 3, 42, 0).pack())
    line.at(9_500, rotorlink.Pong(1, 5, 1, 2, 3).pack())
    line.mark(8, 15_000)
    assert [event.facts for event in line.events("gap")] == [
        {"radio_frames": 2, "span_s": 0.0},
        {"radio_frames": 1, "span_s": 0.0},
        {"radio_frames": 2, "span_s": pytest.approx(0.01)},
    ]
    assert line.pipeline.status.heard_frames == (0, 8)


@pytest.mark.parametrize("newest_us", [0, 9_000])
def test_after_a_silence_of_more_than_30_s_the_number_of_a_frame_shows_no_restart(newest_us: int) -> None:
    """The silence begins at the last sample of a block."""
    for more_us, restarts in ((0, 1), (1, 0)):
        line = Line()
        line.at(newest_us, block(200, 0, 0) if newest_us else mark(200, 0))
        line.mark(100, newest_us + 30_000_000 + more_us)
        assert len(line.events("restart")) == restarts
        assert line.losses == ({} if restarts else {"radio_frames": 65_435})
        assert line.values("revolutions")[-1] == 7
        line.mark(102, newest_us + 30_010_000)
        assert line.pipeline.losses["radio_frames"] == 1 + (0 if restarts else 65_435)


def test_the_silence_after_a_restart_begins_at_the_last_sample_of_its_block() -> None:
    line = Line()
    line.mark(500, 60_000_000)
    line.pipeline.feed(RX, rotorlink.wire(block(200, 0, 0)), START_NS + 61_000_000_000)
    items = line.pipeline.feed(RX, rotorlink.wire(mark(100, 30_009_000)), START_NS + 91_000_000_000)
    assert [item.kind for item in items if isinstance(item, DeviceEvent)] == ["restart"]
    assert line.losses == {}


# --- restarts --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("back", "restarts"), [(1_000_000, 0), (1_000_001, 1)])
def test_samples_older_than_a_second_show_a_restart_to_the_microsecond(back: int, restarts: int) -> None:
    line = Line()
    line.at(10, block(0, 2_000_000, 0, period_us=1))
    line.at(30, block(1, 2_000_010 - back, 20, period_us=1))
    assert len(line.events("restart")) == restarts
    assert len(line.values("index")) == (20 if restarts else 10)
    assert line.losses == {}


def test_a_block_that_is_sent_again_is_neither_counted_nor_a_restart() -> None:
    line = Line()
    line.at(9_000, block(7, 5_000, 0))
    line.at(29_000, block(9, 5_020, 20_000))
    line.at(30_000, block(8, 5_010, 10_000, flags=REPEATS))
    line.at(31_000, block(7, 5_000, 0, flags=REPEATS))
    line.at(31_500, block(6, 0, 0, flags=REPEATS))
    line.at(39_000, block(12, 5_030, 30_000))
    assert line.values("index") == list(range(5_000, 5_040))
    assert line.losses == {"radio_frames": 3}
    assert [event.facts["span_s"] for event in line.events("gap")] == [pytest.approx(0.02), pytest.approx(0.01)]
    assert line.events("restart") == []
    assert line.pipeline.status.heard_frames == (7, 12)


def test_after_a_restart_numbers_and_losses_begin_again() -> None:
    line = Line()
    line.at(60_009_000, block(900, 5_000, 60_000_000))
    line.at(60_029_000, block(902, 5_020, 60_020_000))  # waits for the block before
    items = line.pipeline.feed(RX, rotorlink.wire(block(0, 0, 1_000)), START_NS + 60_100_000_000)
    assert [item.kind if isinstance(item, DeviceEvent) else "samples" for item in items] == [
        "gap",
        "samples",
        "restart",
        "samples",
    ]
    line.items += items
    line.items += line.pipeline.feed(RX, rotorlink.wire(block(1, 10, 11_000)), START_NS + 60_110_000_000)
    line.items += line.pipeline.feed(RX, rotorlink.wire(block(4, 40, 41_000)), START_NS + 60_140_000_000)
    line.end()
    assert line.values("index") == [*range(5_000, 5_010), *range(5_020, 5_030), *range(20), *range(40, 50)]
    assert line.losses == {"radio_frames": 3, "samples": 30}
    assert len(line.events("restart")) == 1


def test_blocks_after_a_gap_wait() -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0))
    found = line.at(29_000, block(2, 20, 20_000))
    assert not any(isinstance(item, Batch) for item in found)
    line.end()
    assert line.values("index") == [*range(10), *range(20, 30)]


# --- samples ---------------------------------------------------------------------------------------------------


def test_indices_and_times_go_on_over_their_wraps() -> None:
    line = Line()
    line.at(-1_000, block(0, -15, -10_000))
    line.at(9_000, block(1, -5, 0))
    line.at(19_000, block(2, 5, 10_000))
    assert line.values("index") == [(k - 15) % 2**32 for k in range(30)]
    assert line.values("node_time_us") == [2**32 - 10_000 + 1000 * k for k in range(30)]
    times = [int(t) for item in line.items if isinstance(item, Batch) for t in item.time_ns]
    assert times == [START_NS + 1_000_000 * (k - 10) for k in range(30)]
    assert line.losses == {}


def test_samples_that_overlap_are_taken_once_with_all_their_columns() -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0))
    line.at(14_000, block(1, 5, 5_000, flags=3))
    assert line.at(14_100, block(2, 5, 5_000), block(3, 0, 0, n=5)) == []
    assert line.values("index") == list(range(15))
    assert line.values("flags") == [0] * 10 + [3] * 5
    assert line.values("count_a") == list(range(15))
    assert line.values("count_b") == [*range(10), *range(5, 10)]
    assert line.values("theta3_rad") == pytest.approx([k * 2 * math.pi / 4096 for k in range(15)])
    assert line.losses == {}


def test_a_gap_has_its_samples_time_and_place() -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0))
    line.at(24_000, block(1, 15, 15_000))
    gap, batch = line.end()
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert gap.facts == {"samples": 5, "span_s": pytest.approx(0.005), "time_ns": START_NS + 15_000_000}
    assert gap.text == "5 samples lost (5.00 ms)"
    long = Line()
    long.at(0, block(0, 0, 0, n=1, period_us=10_000))
    long.at(9_990_000, block(1, 999, 9_990_000, n=1, period_us=10_000))
    assert long.events("gap")[0].text == "998 samples lost (9980.00 ms)"


@pytest.mark.parametrize(
    ("index", "us", "flags", "missing"),
    [
        (10, 10_000, LOST, 0),
        (10, 9_000, LOST, 0),
        (10, 13_000, LOST, 3),
        (10, 13_000, 0, 0),
        (10, 13_000, 3 | LOST, 3),
        (10, 13_000, 3, 0),
        (13, 15_000, LOST, 3),  # the index shows how many
        (5, 13_000, LOST, 0),
    ],
)
def test_the_node_s_clock_counts_samples_that_it_lost_only_before_the_next_index(
    index: int, us: int, flags: int, missing: int
) -> None:
    for first in (0, 70_000):
        line = Line()
        line.at(9_000, block(0, first, 0))
        line.at(us + 9_000, block(1, first + index, us, flags=flags))
        line.end()
        steps = {} if flags & LOST else {"clock_steps": 1}
        assert line.losses == ({"samples": missing} if missing else steps)
        assert line.values("index") == [first + k for k in (*range(10), *range(max(10, index), index + 10))]


@pytest.mark.parametrize("n", [5, 10])
def test_a_block_that_brings_nothing_new_leaves_the_time_of_the_next_sample(n: int) -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0))
    line.at(60_000, block(1, 0, 50_000, n=n))
    line.at(62_000, block(2, 10, 53_000, flags=LOST))
    assert line.losses == {"samples": 43}


def test_a_block_without_a_period_counts_nothing_by_time() -> None:
    line = Line()
    line.at(0, block(0, 0, 0, n=1, period_us=0))
    line.at(5_000, block(1, 1, 5_000, n=1, flags=LOST, period_us=0))
    assert line.values("index") == [0, 1]
    assert line.losses == {}


@pytest.mark.parametrize(("flags", "low"), [(0x67, False), (0x08, True), (0x6F, True), (0x80, False)])
def test_only_its_own_flag_shows_a_low_battery(flags: int, low: bool) -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0, flags=flags))
    assert line.pipeline.battery_low is low
    line.at(19_000, block(1, 10, 10_000))
    assert not line.pipeline.battery_low


def test_without_its_angles_or_marks_a_node_gives_only_the_others() -> None:
    for settings, topics in (({"angles": False}, ["tacho"]), ({"index_marks": False}, ["pendulums"] * 2)):
        line = Line(**settings)
        line.at(9_000, block(0, 0, 0))
        line.at(9_500, mark(1, 9_500))
        line.at(29_000, block(2, 20, 20_000))
        line.end()
        assert [item.channel.topic for item in line.items if isinstance(item, Batch)] == topics
        assert line.losses == ({"samples": 10} if topics[0] == "pendulums" else {})


def test_marks_and_locks_have_the_times_of_the_node_s_clock() -> None:
    line = Line()
    for second in range(5):
        line.mark(2 * second, 1_000_000 * second)
        line.at(1_000_000 * second + 1000, rotorlink.LockEvent(1, 2 * second + 1, 1_000_000 * second, 2, 1, 7).pack())
    times = [int(t) for item in line.items if isinstance(item, Batch) for t in item.time_ns]
    assert times == [START_NS + 1_000_000_000 * second for second in range(5)]
    assert line.values("node_time_us") == [1_000_000 * second for second in range(5)]
    locks = line.events("lock")
    assert [event.facts["time_ns"] for event in locks] == times
    assert {(event.text, event.facts["pendulum"]) for event in locks} == {("pendulum A released", 2)}
    assert line.at(4_000_000, rotorlink.LockEvent(1, 10, 4_000_000, 3, 1, 7).pack())[0].text == "pendulum B released"


# --- the node's number and status ------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_number_other_than_1_is_reported_and_those_of_other_nodes_are_foreign(number: int) -> None:
    line = Line()
    line.mark(0, 0, number)
    assert [event.facts for event in line.events("acknowledge")] == ([{"node": number}] if number != 1 else [])
    others = [each for each in (0, 1, 2, 3) if each != number]
    for node in (*others, *others):
        line.mark(1, 1_000, node)
    assert [event.facts["node"] for event in line.events("foreign")] == others
    assert f"this rig's is node {number}" in line.events("foreign")[0].text
    assert len(line.values("revolutions")) == 1
    assert line.pipeline.status.learned == {"node": number}


def test_the_number_of_the_rig_file_counts_more_than_that_of_the_identity() -> None:
    line = Line({"node": 3}, node=5)
    line.mark(0, 0, 3)
    line.mark(0, 0, 5)
    assert [event.facts for event in line.events("foreign")] == [{"node": 3}]
    assert len(line.values("revolutions")) == 1


@pytest.mark.parametrize("counts", [2048, 4095, 4097, 8192])
def test_another_number_of_counts_than_the_rig_file_s_is_a_fault(counts: int) -> None:
    line = Line()
    line.at(0, rotorlink.NodeStatus(1, 0, 0, 3700, 200, 8, 2, 1, 4, counts).pack())
    (fault,) = line.events("fault")
    assert fault.text == line.pipeline.status.complaint
    assert f"the node reports {counts} counts per revolution, the rig file states 4096" in fault.text
    assert line.events("status")[0].facts["temperature_degC"] == 20.0


# --- the dongle and other frames on the line -------------------------------------------------------------------


@pytest.mark.parametrize(("wraps", "radio"), [(False, 2), (True, 0)])
def test_frames_lost_on_the_cable_explain_node_frames_only_if_the_dongle_wraps_them(wraps: bool, radio: int) -> None:
    line = Line()
    line.at(1_000, wrapped(9, 1_000, mark(0, 1_000)) if wraps else mark(0, 1_000))
    line.at(2_000, dongle(10, 2_000))
    line.at(3_000, dongle(14, 6_000))
    line.at(7_000, wrapped(15, 7_000, mark(3, 7_000)) if wraps else mark(3, 7_000))
    line.at(8_000, wrapped(16, 8_000, mark(5, 8_000)) if wraps else mark(5, 8_000))
    assert line.losses == {"cable_frames": 3, "radio_frames": radio + 1}
    cable = next(event for event in line.events("gap") if "cable_frames" in event.facts)
    assert cable.facts == {"cable_frames": 3, "span_s": pytest.approx(0.004)}
    assert line.pipeline.rssi_dBm == (-60 if wraps else -70)


def test_a_frame_that_the_dongle_sends_again_is_not_taken() -> None:
    line = Line()
    line.at(1_000, wrapped(0, 1_000, mark(0, 1_000)))
    line.at(2_000, wrapped(1, 2_000, mark(1, 2_000)))
    assert line.at(2_500, wrapped(1, 2_000, mark(2, 2_500))) == []
    assert line.pipeline.status.heard_frames == (0, 1)


def test_unknown_frames_of_a_dongle_are_counted_as_its_own() -> None:
    line = Line()
    line.at(0, unknown(0x20, 1), unknown(0x2F, 4))
    line.at(1_000, dongle(6, 1_000))
    line.at(4_000, dongle(8, 4_000))
    line.at(5_000, unknown(0x1F, 0), unknown(0x10, 2), unknown(0x0F, 9), unknown(0x30, 99))
    assert [event.facts for event in line.events("gap")] == [
        {"cable_frames": 2, "span_s": 0.0},
        {"cable_frames": 1, "span_s": 0.0},
        {"cable_frames": 1, "span_s": pytest.approx(0.003)},
        {"radio_frames": 1, "span_s": 0.0},
    ]
    assert line.losses == {"cable_frames": 4, "radio_frames": 1, "damaged_frames": 5}


def test_a_dongle_that_starts_again_has_lost_nothing_and_its_clock_begins_again() -> None:
    line = Line()
    line.at(1_000, dongle(100, 20_000_000))
    line.at(2_000, dongle(7, 1_000))
    line.at(3_000, dongle(8, 2_000))
    line.at(6_000, dongle(11, 5_000))
    assert [event.kind for event in line.items if isinstance(event, DeviceEvent)] == ["dongle", "gap"]
    assert line.events("gap")[0].facts == {"cable_frames": 2, "span_s": pytest.approx(0.003)}


def test_what_the_host_sends_or_an_echo_of_it_gives_nothing() -> None:
    line = Line()
    line.mark(0, 0)
    assert line.pipeline.feed(TX, rotorlink.wire(mark(5, 5_000)), START_NS) == []
    assert line.at(1_000, rotorlink.NodeCommand(1, 50, 3).pack(), rotorlink.Ping(1, 60).pack()) == []
    line.mark(1, 10_000)
    assert line.losses == {}


def test_of_the_damage_in_the_first_read_only_the_first_is_the_rest_of_a_frame() -> None:
    line = Line()
    found = line.pipeline.feed(RX, b"\x05\x01\x00" * 4, START_NS)
    assert [item.kind for item in found if isinstance(item, DeviceEvent)] == ["damage"] * 3
    assert line.losses == {"damaged_frames": 3}


def test_a_node_without_frames_states_the_error_of_its_clock() -> None:
    assert Line().pipeline.status.clock_std_ns > 0.0
