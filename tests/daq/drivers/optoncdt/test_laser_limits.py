"""Pipeline of an optoNCDT on a serial line at its limits: gaps, rates, damage, error codes, words without samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.items import RX, TX, Batch, DeviceEvent

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
Items = list[Batch | DeviceEvent]


def laser(rate_Hz: float = 4000.0, **more: Any) -> LaserPipeline:
    table = {"driver": "optoncdt", "port": "p", "axis": "x", "rate_Hz": rate_Hz, **more}
    return LaserPipeline("laser_x", Laser.model_validate(table), {})


def blocks(counters: np.ndarray, ticks: np.ndarray | None = None, codes: np.ndarray | int = 30_000) -> bytes:
    """Blocks of these samples; by default at 4 kHz."""
    time = 25 * counters if ticks is None else ticks
    words = [np.full(len(counters), codes), counters % 2**18, time & 0xFFFF, time >> 16 & 0xFFFF]
    return optoncdt.encode_block(np.column_stack(words).astype(np.uint32))


def events(items: Items, kind: str = "") -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and kind in ("", item.kind)]


def values(items: Items, name: str) -> list[Any]:
    return [value for item in items if isinstance(item, Batch) for value in item.columns[name].tolist()]


def test_samples_have_the_scale_of_the_lever_and_the_times_of_their_ticks() -> None:
    """In the middle of the range, and a quarter of it farther: by the formula of the model."""
    pipe = laser(lever_ratio=0.5, range_m=0.1)
    codes = distance_words.code(np.array([0.05, 0.075, 0.05]), 0.1)
    (batch,) = pipe.feed(RX, blocks(np.arange(250_000, 250_003), codes=codes), START_NS)
    assert isinstance(batch, Batch)
    assert batch.columns["displacement_m"] == pytest.approx([0, 0.05, 0], abs=4e-6)
    assert batch.time_ns.tolist() == [START_NS - 500_000, START_NS - 250_000, START_NS]
    assert batch.columns["device_ticks"].tolist() == [25 * n for n in (250_000, 250_001, 250_002)]
    assert batch.columns["flags"].tolist() == [0, 0, 0]
    assert pipe.losses["samples"] == 0


def test_a_sample_after_a_gap_at_the_end_of_a_read_is_handed_out_with_it() -> None:
    pipe = laser()
    pipe.feed(RX, blocks(np.arange(100)), START_NS)
    items = pipe.feed(RX, blocks(np.r_[100:110, 113]), START_NS + 3 * MS)
    assert values(items, "counter") == [*range(100, 110), 113]
    assert [event.facts["samples"] for event in events(items, "gap")] == [3]
    assert pipe.feed(RX, b"", START_NS + 4 * MS) == []
    assert events(pipe.feed(RX, blocks(np.arange(114, 120)), START_NS + 5 * MS)) == []


@pytest.mark.parametrize("lost", [100_000, 2**18 + 100_000])
def test_a_gap_of_more_than_a_quarter_of_the_counter_s_wrap_is_counted_exactly(lost: int) -> None:
    pipe = laser()
    pipe.feed(RX, blocks(np.arange(100)), START_NS)
    items = pipe.feed(RX, blocks(np.arange(100 + lost, 150 + lost)), START_NS + 250_000 * (lost + 50))
    (gap,) = events(items)
    assert gap.facts["samples"] == pipe.losses["samples"] == lost
    assert gap.text == f"{lost} samples lost ({lost / 4:.2f} ms)"
    assert gap.facts["time_ns"] == START_NS + 250_000 * (lost + 1)


@pytest.mark.parametrize(("deviation", "reported"), [(0.0025, True), (-0.0025, True), (0.0015, False), (0.0, False)])
def test_a_rate_near_that_of_the_rig_file_is_reported_when_it_is_certain(deviation: float, reported: bool) -> None:
    """Ticks of some milliseconds show no rate to two thousandths."""
    pipe = laser(25_000.0)
    found: list[DeviceEvent] = []
    for first in range(0, 6000, 1000):
        counters = np.arange(first, first + 1000)
        ticks = np.rint(4 * counters * (1 + deviation)).astype(np.int64)
        items = pipe.feed(RX, blocks(counters, ticks), START_NS + 40_000 * int(counters[-1]))
        assert values(items, "counter") == counters.tolist()
        found += events(items)
    assert 0 < pipe.status.clock_std_ns < 1e7
    assert len(found) == int(reported)
    for event in found:
        assert event.kind == "rate"
        assert event.facts["nominal_Hz"] == pytest.approx(25_000.0)
        assert event.facts["rate_Hz"] == pytest.approx(25_000.0 / (1 + deviation), rel=2e-4)
        rate = "2.494e+04" if deviation > 0 else "2.506e+04"
        assert event.text == (f"the sensor measures {rate} times a second by its own clock, the rig file states 25000")


def test_only_bytes_before_the_first_block_are_no_damage() -> None:
    pipe = laser()
    (damage, _) = pipe.feed(
        RX, b"\xff\xff" + blocks(np.arange(4)) + b"\xff\xff\xff" + blocks(np.arange(4, 9)), START_NS
    )
    assert isinstance(damage, DeviceEvent)
    assert (damage.text, damage.facts) == ("3 bytes skipped that belong to no block", {"bytes": 3})
    assert pipe.losses["bytes"] == 3


def test_a_block_that_is_cut_at_the_end_of_a_read_is_damage() -> None:
    pipe = laser()
    pipe.feed(RX, blocks(np.arange(100)), START_NS)
    assert values(pipe.feed(RX, blocks(np.arange(100, 101)), START_NS + MS), "counter") == [100]
    pipe.feed(RX, blocks(np.arange(101, 110)) + blocks(np.arange(110, 111))[:6], START_NS + 3 * MS)
    items = pipe.feed(RX, blocks(np.arange(110, 120)), START_NS + 5 * MS)
    assert values(items, "counter") == [*range(110, 120)]
    assert [(event.kind, event.facts) for event in events(items)] == [("damage", {"bytes": 6})]


def test_error_codes_are_counted_each() -> None:
    pipe = laser()
    codes = np.array([262_076, 262_078, 30_000, 262_076, 262_077, 262_076])
    pipe.feed(RX, blocks(np.arange(6), codes=codes), START_NS)
    assert pipe.error_codes == {262_076: 3, 262_077: 1, 262_078: 1}
    pipe.feed(RX, blocks(np.arange(6, 12), codes=codes), START_NS + MS)
    assert pipe.error_codes == {262_076: 6, 262_077: 2, 262_078: 2}
    assert pipe.losses["invalid"] == 10
    pipe.feed(RX, blocks(np.arange(12, 112), codes=np.arange(262_000, 262_100)), START_NS + 2 * MS)
    assert len(pipe.error_codes) == 32, "garbage has any number of codes"
    assert pipe.error_codes[262_076] == 7


@pytest.mark.parametrize(("spikes", "text"), [([300], "a sample jumps out of"), ([300, 340], "2 samples jump out of")])
def test_spikes_have_one_event_with_the_time_of_the_first(spikes: list[int], text: str) -> None:
    pipe = laser()
    codes = 30_000 + np.rint(9000 * np.sin(0.02 * np.arange(400))).astype(np.int64)
    codes[spikes] ^= 0x2000
    items = pipe.feed(RX, blocks(np.arange(400), codes=codes), START_NS)
    (event,) = events(items)
    assert event.kind == "suspect"
    assert event.text == f"{text} the signal for one sample: marked as suspect"
    assert event.facts == {"suspect": len(spikes), "time_ns": START_NS - 99 * 250_000}
    assert pipe.losses["suspect"] == len(spikes)


def test_words_without_samples_are_reported_once_until_they_change() -> None:
    pipe = laser()

    def announced(*names: str) -> bytes:
        return " ".join(("GETOUTINFO_RS422", *names)).encode() + b"\r\n->"

    def distances(count: int) -> bytes:
        return optoncdt.encode_block(np.full((count, 1), 30_000, np.uint32))

    found: list[list[str]] = []
    data = [blocks(np.arange(40)) + announced("DIST") + distances(10), distances(10), distances(10)]
    data += [announced("DIST", "COUNTER", "TIMESTAMP") + blocks(np.arange(100, 140)), announced("DIST") + distances(9)]
    for index, part in enumerate(data):
        items = pipe.feed(RX, part, START_NS + 25 * index * MS)
        found.append([event.text for event in events(items, "words")])
    none = (
        "the stream's words are DIST: no samples without distance, counter and timestamp "
        "(OUTADD_RS422 COUNTER TIMESTAMP)"
    )
    usual = "DIST COUNTER TIMESTAMP_LO TIMESTAMP_HI"
    assert found[0] == [f"from here on the stream's words are DIST, no longer {usual}", none]
    assert found[1:3] == [[], []]
    assert found[3] == [f"from here on the stream's words are {usual}, no longer DIST"]
    assert found[4][-1] == none
    assert pipe.losses["unusable"] >= 38


def test_commands_of_the_host_give_no_samples_and_the_start_ends_the_sign_of_a_lost_set_up() -> None:
    pipe = laser()
    assert pipe.feed(TX, blocks(np.arange(40)), START_NS) == []
    for turn in range(9):
        pipe.feed(RX, b"\xff", START_NS + 250 * turn * MS)
        assert pipe.status.set_up_lost == ""
    pipe.feed(RX, b"\xff", START_NS + 2001 * MS)
    assert pipe.status.set_up_lost == "it sends bytes that give no samples, so it may have other settings"
    pipe.feed(TX, b"OUTPUT RS422\n", START_NS + 2002 * MS)
    assert pipe.status.set_up_lost == ""
