"""Pipeline of an RF60x sensor at its limits: damaged results, reads that wait, late losses, and its set-up."""

from __future__ import annotations

import numpy as np
import pytest

from daq.items import RX, TX, Batch, DeviceEvent
from rig_basics.texts import number_of
from rig_drivers.riftek import stream, wire
from rig_drivers.riftek.stream import RiftekPipeline
from tests.rig_drivers.test_riftek_stream import START_NS, codes_of, column, feed, laser, pipeline, reads_of, without

MS = 1_000_000
Items = list[Batch | DeviceEvent]


def events(items: Items, kind: str = "") -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and kind in ("", item.kind)]


def counters(items: Items) -> list[int]:
    return [int(n) for item in items if isinstance(item, Batch) for n in item.columns["counter"]]


def after_3_s() -> RiftekPipeline:
    """A pipeline after 3000 results at 1 kHz, read every 20 ms without any delay."""
    pipe = pipeline(laser())
    feed(pipe, reads_of(np.arange(3000), 1000.0, 0.0))
    return pipe


def read(pipe: RiftekPipeline, numbers: list[int], late_ns: int, extra: bytes = b"") -> Items:
    """Read results whose last one is so late that the host's time would allow later numbers."""
    data = extra + wire.results(codes_of(np.array(numbers)), np.array(numbers))
    return pipe.feed(RX, data, START_NS + MS * numbers[-1] + late_ns)


# --- damaged results -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("skipped", "lost", "found"), [(9, 4, 0), (10, 4, 4), (13, 4, 4), (1, 3, 3), (38, 4, 4)])
def test_damaged_bytes_are_as_many_results_as_they_can_have_been(skipped: int, lost: int, found: int) -> None:
    """The count is known modulo 4. Damage of 38 bytes is 8 results, but there was time for 4 or 5 only."""
    pipe = after_3_s()
    first = wire.results(codes_of(np.arange(3000, 3004)), np.arange(3000, 3004))
    numbers = [*range(3004 + lost, 3020 + lost)]
    late_ns = 0 if skipped < 38 else 400_000
    items = read(pipe, numbers, late_ns, first + bytes(skipped))
    gaps = events(items, "gap")
    assert sum(event.facts["samples"] for event in gaps) == pipe.losses["samples"] == (found if skipped < 38 else 0)
    assert ["uncertain_samples" in event.facts for event in gaps] == [found == 4 and skipped < 38] * len(gaps)
    assert pipe.losses["bytes"] == skipped
    (damage,) = events(items, "damage")
    words = number_of(skipped, "byte skipped that belongs", "bytes skipped that belong")
    assert damage.text == f"{words} to no packet"
    assert damage.facts == {"bytes": skipped}


def test_a_packet_that_is_too_long_is_suspect_wherever_the_reads_are_divided() -> None:
    numbers = np.arange(100)
    whole = wire.results(codes_of(numbers), numbers)
    data = whole[:204] + whole[203:]
    for at in range(58, 65):
        cut = 4 * at + 1
        batches, found = feed(pipeline(laser()), [(data[:cut], START_NS), (data[cut:], START_NS + 50 * MS)])
        flags = column(batches, "flags")
        assert np.flatnonzero(flags).tolist() == [60]
        (suspect,) = (event for event in found if event.kind == "suspect")
        assert suspect.text == "a sample marked as suspect: a jump for one sample, or a packet that was too long"
        time_ns = np.concatenate([batch.time_ns for batch in batches])
        assert suspect.facts["suspect"] == 1
        assert suspect.facts["time_ns"] == pytest.approx(int(time_ns[50]), abs=5 * MS)


# --- reads that wait -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_of_a_late_read_the_results_before_its_gap_do_not_wait(lost: int) -> None:
    pipe = after_3_s()
    items = read(pipe, [*range(3000, 3005), *range(3005 + lost, 3020)], 40 * MS)
    assert counters(items) == [*range(3000, 3005)]
    assert events(items) == []
    items = read(pipe, [*range(3020, 3040)], 0)
    assert counters(items) == [*range(3005 + lost, 3040)]
    (gap,) = events(items)
    assert gap.text == f"{number_of(lost, 'sample')} lost ({lost}.00 ms)"
    assert gap.facts["samples"] == pipe.losses["samples"] == lost
    assert "uncertain_samples" not in gap.facts
    single = after_3_s()
    assert read(single, [*range(3000 + lost, 3020)], 40 * MS) == []
    items = read(single, [*range(3020, 3040)], 0)
    assert [set(event.facts) for event in events(items)] == [{"samples", "span_s", "time_ns", "device_ticks"}]


def test_what_the_host_sends_ends_the_wait_without_a_loss() -> None:
    pipe = after_3_s()
    assert read(pipe, [*range(3000, 3020)], 60 * MS) == []
    items = pipe.feed(TX, wire.request(wire.EVERYONE, wire.STOP), START_NS + 3100 * MS)
    assert (counters(items), events(items)) == ([*range(3000, 3020)], [])
    assert pipe.feed(TX, wire.request(wire.EVERYONE, wire.STOP), START_NS + 3101 * MS) == []
    assert pipe.feed(RX, b"", START_NS + 3102 * MS) == []
    assert counters(read(pipe, [*range(3020, 3040)], 0)) == [*range(3020, 3040)]


def test_what_the_host_sends_after_two_late_reads_leaves_their_loss() -> None:
    """The cable was unplugged for 3 s: the set-up stops the stream before the results have waited long enough."""
    pipe = pipeline(laser())
    feed(pipe, reads_of(np.arange(3000), 1000.0, 0.0))
    numbers = [*range(6000, 6020)]
    assert read(pipe, numbers, 0) == read(pipe, [*range(6020, 6040)], 0) == []
    items = pipe.feed(TX, wire.request(wire.EVERYONE, wire.STOP), START_NS + 6040 * MS)
    (batch,) = [item for item in items if isinstance(item, Batch)]
    (gap,) = events(items, "gap")
    assert gap.facts["samples"] == pipe.losses["samples"] == 3000
    assert gap.facts["uncertain_samples"] == 4
    assert counters(items) == [*range(6000, 6040)]
    assert abs(int(batch.time_ns[0]) - START_NS - 6000 * MS) <= MS


def test_a_request_of_the_set_up_does_not_end_the_wait() -> None:
    """The cable is back while the sensor is asked for its identity: one read has come, and the stream goes on."""
    pipe = after_3_s()
    assert read(pipe, [*range(6000, 6020)], 0) == []
    for code in (wire.IDENTIFY, wire.READ, wire.WRITE):
        assert pipe.feed(TX, wire.request(1, code, b"\x08"), START_NS + 6020 * MS) == []
    found = [read(pipe, [*range(6020 + 20 * i, 6040 + 20 * i)], 0) for i in range(13)]
    items = [item for each in found for item in each if not isinstance(item, DeviceEvent) or item.kind == "gap"]
    (gap,) = events(items)
    assert gap.facts["samples"] == pipe.losses["samples"] == 3000
    assert counters(items) == [*range(6000, 6280)]


@pytest.mark.parametrize("lost", [8, 20])
def test_a_loss_found_late_is_that_of_the_first_gap_only(lost: int) -> None:
    """Results are lost at 3000, found after three quarters of a second, in a read with a gap of 2 more."""
    pipe = after_3_s()
    first = next(number for number in range(3000 + lost, 4000, 20) if number + 19 >= 3750)
    for number in range(3000 + lost, first, 20):
        assert events(read(pipe, [*range(number, number + 20)], 0)) == []
    numbers = [*range(first, first + 10), *range(first + 12, first + 20)]
    found = read(pipe, numbers, 0)
    late, other = events(found, "gap")
    assert (late.facts["samples"], late.facts["found_late"], late.facts["uncertain_samples"]) == (lost, lost, 4)
    assert late.text == (
        f"about {lost} samples lost ({lost}.00 ms): known modulo 4, the rest by the host's time, ± 4; {lost} of them "
        "within the last 1.25 s: the times since their loss are early by that"
    )
    assert set(other.facts) == {"samples", "span_s", "time_ns", "device_ticks"}
    assert other.facts["device_ticks"] - late.facts["device_ticks"] == 1200
    assert counters(found) == numbers
    assert 0 < pipe.status.clock_std_ns < 1e7


# --- set-up ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damaged", [False, True])
def test_another_rate_is_a_sign_of_a_lost_set_up_unless_bytes_are_damaged(damaged: bool) -> None:
    pipe = pipeline(laser())
    number = 0
    for turn in range(140):
        numbers = np.arange(number, number + 25)
        number += 25
        noise = b"\x00" if damaged and turn % 20 == 10 else b""
        pipe.feed(RX, noise + wire.results(codes_of(numbers), numbers), START_NS + turn * 50 * MS)
    assert bool(pipe.status.set_up_lost) is not damaged
    assert stream.NOT_NEW == 2


@pytest.mark.parametrize("lost", [60, 0])
def test_a_loss_on_a_busy_host_is_found_by_the_least_lags_of_seconds(lost: int) -> None:
    """Results at 2 kHz on a host whose reads are late by 20 ms on the average; 60 results are 30 ms."""
    for seed in (0, 2, 3):
        numbers = without(30_000, 15_000, lost)
        pipe = pipeline(laser(2000.0))
        batches, gaps = feed(pipe, reads_of(numbers, 2000.0, 0.02, seed))
        assert pipe.losses["samples"] == pytest.approx(lost, abs=4)
        assert int(batches[-1].columns["counter"][-1]) == 29_999 + pipe.losses["samples"]
        late = [event for event in gaps if "found_late" in event.facts]
        assert bool(late) == (lost > 0)
        assert all(event.facts["uncertain_samples"] >= 4 for event in late)
