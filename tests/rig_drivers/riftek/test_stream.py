"""RF60x samples: counted by numbers modulo 4 and by the host's time, and honest about which."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from daq import channels
from daq.channels import suspects
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from rig_basics.texts import number_of
from rig_drivers.riftek import stream, stream as riftek, wire
from rig_drivers.riftek.driver import DRIVER
from rig_drivers.riftek.settings import RiftekLaser
from rig_drivers.riftek.stream import RiftekPipeline

START_NS = 1_700_000_000_000_000_000
MIDDLE = wire.FULL_SCALE // 2
Reads = list[tuple[bytes, int]]


def laser(rate_Hz: float = 1000.0, **other: Any) -> RiftekLaser:
    return RiftekLaser(driver="riftek", port="loop://", axis="x", rate_Hz=rate_Hz, **other)


def pipeline(config: RiftekLaser, identity: dict[str, Any] | None = None) -> RiftekPipeline:
    return RiftekPipeline("laser_x", config, identity or {})


def feed(pipe: RiftekPipeline, reads: Reads) -> tuple[list[Batch], list[DeviceEvent]]:
    items = [item for data, host_ns in reads for item in pipe.feed(RX, data, host_ns)]
    return [x for x in items if isinstance(x, Batch)], [x for x in items if isinstance(x, DeviceEvent)]


def column(batches: list[Batch], name: str) -> NDArray[Any]:
    return np.concatenate([batch.columns[name] for batch in batches])


def codes_of(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    return MIDDLE + np.rint(3000 * np.sin(0.02 * numbers)).astype(np.int64)


def reads_of(
    numbers: NDArray[np.int64],
    rate_Hz: float,
    late_s: float = 2e-4,
    seed: int = 0,
    every_s: float = 0.02,
    drift: float = 0.0,
) -> Reads:
    """What a host reads every `every_s` of results of these numbers, each read late by `late_s` on average."""
    rng = np.random.default_rng(seed)
    came_s = numbers / rate_Hz * (1 + drift)
    turns = np.floor(came_s / every_s).astype(int)
    reads: Reads = []
    host_s = 0.0
    for turn in np.unique(turns):
        here = turns == turn
        host_s = max(host_s, came_s[here][-1] + rng.exponential(late_s))
        reads.append((wire.results(codes_of(numbers[here]), numbers[here]), START_NS + round(host_s * 1e9)))
    return reads


def without(count: int, at: int, lost: int) -> NDArray[np.int64]:
    return np.delete(np.arange(count + lost), slice(at, at + lost))


def test_displacement_is_zero_in_the_middle_and_grows_with_the_distance() -> None:
    config = laser(range_m=0.05, lever_ratio=0.5)
    batches, _ = feed(pipeline(config), [(wire.results([8192, 8193, 677], [0, 1, 2]), START_NS)])
    expected = np.array([0.0, 1.0, 677 - 8192]) * 0.05 / 16384 / 0.5
    assert column(batches, "displacement_m") == pytest.approx(expected)
    assert batches[0].channel == channels.LASER_X
    assert set(batches[0].columns) == {name for name, _ in channels.LASER_X.fields}


def test_the_range_is_the_identitys() -> None:
    (batch,), _ = feed(pipeline(laser(), {"range_m": 0.1}), [(wire.results([0x2400], [0]) + b"\xd0", START_NS)])
    assert batch.columns["displacement_m"][0] == pytest.approx(0.1 * 1024 / 16384)


@pytest.mark.parametrize("range_m", [0, -1.0, "0.025", None, True, float("inf"), float("nan")])
def test_an_invalid_range_is_refused(range_m: object) -> None:
    with pytest.raises(DeviceError, match="expected a measuring range"):
        pipeline(laser(), {"range_m": range_m})


def test_no_target_full_scale_and_old_results_are_nan_and_counted() -> None:
    pipe = pipeline(laser(no_target_codes=(0, 5000)))
    data = wire.results([0, 5000, 16384, 16385, 65535], np.arange(5))
    data += wire.results([9000], [5], updated=False) + wire.results([9000, 9001], [6, 7])
    batches, _ = feed(pipe, [(data, START_NS)])
    seen = np.isfinite(column(batches, "displacement_m"))
    assert seen.tolist() == [False, False, True, False, False, False, True, True]
    assert pipe.losses["invalid"] == 5
    assert np.flatnonzero(column(batches, "flags") & riftek.NOT_NEW).tolist() == [5]
    assert column(batches, "code").tolist() == [0, 5000, 16384, 16385, 65535, 9000, 9000, 9001]


def test_ticks_are_the_number_times_the_period() -> None:
    batches, _ = feed(pipeline(laser(8000.0)), reads_of(np.arange(4000), 8000.0))
    number = np.arange(4000)
    assert np.array_equal(column(batches, "counter"), number)
    assert np.array_equal(column(batches, "device_ticks"), number * 125 // 10)
    times = np.concatenate([batch.time_ns for batch in batches])
    assert np.all(np.diff(times) > 0)
    assert times - START_NS == pytest.approx(number * 125_000, abs=2e6)


@settings(max_examples=30)
@example([(40, 2), (40, 1)])  # a read begins with the result after the gap
@given(st.lists(st.tuples(st.integers(2, 120), st.integers(0, 3)), min_size=1, max_size=20))
def test_fewer_than_four_lost_are_counted_exactly(parts: list[tuple[int, int]]) -> None:
    """Of results in pairs, at least: three single ones with the same number look like a line that is stuck."""
    kept, at = [], 0
    for length, lost in parts:
        kept.append(np.arange(at, at + length))
        at += length + lost
    numbers = np.concatenate([*kept, [at, at + 1]])
    pipe = pipeline(laser())
    batches, events = feed(pipe, reads_of(numbers, 1000.0))
    counted = [lost for _, lost in parts if lost]
    gaps = [event.facts for event in events if event.kind == "gap"]
    assert [facts["samples"] for facts in gaps] == counted
    assert not any("uncertain_samples" in facts or "found_late" in facts for facts in gaps)
    assert pipe.losses["samples"] == sum(counted)
    assert np.array_equal(column(batches, "counter"), numbers)


@pytest.mark.parametrize("lost", [4, 7, 8, 40, 401, 4000])
@pytest.mark.parametrize("late_s", [5e-5, 2e-3])
def test_more_are_counted_by_the_hosts_time(lost: int, late_s: float) -> None:
    pipe = pipeline(laser())
    numbers = without(6000, 3013, lost)
    batches, events = feed(pipe, reads_of(numbers, 1000.0, late_s))
    gaps = [event for event in events if event.kind == "gap"]
    assert pipe.losses["samples"] == lost == sum(event.facts["samples"] for event in gaps)
    assert any("uncertain_samples" in event.facts for event in gaps)
    assert "known modulo 4, the rest by the host's time" in gaps[-1].text
    assert np.array_equal(column(batches, "counter")[-500:], numbers[-500:])
    assert len(column(batches, "counter")) == len(numbers)


def test_a_long_gap_is_where_it_was_and_no_sample_bears_a_wrong_number() -> None:
    numbers = without(6000, 3013, 500)
    batches, events = feed(pipeline(laser()), reads_of(numbers, 1000.0))
    assert np.array_equal(column(batches, "counter"), numbers)
    (gap,) = events
    assert gap.facts["device_ticks"] == 3513 * 100
    assert gap.facts["span_s"] == pytest.approx(0.5)


def test_a_small_loss_is_found_late_and_its_event_states_it() -> None:
    numbers = without(6000, 3013, 8)
    batches, events = feed(pipeline(laser()), reads_of(numbers, 1000.0))
    (gap,) = events
    assert gap.facts["found_late"] == 8
    assert "the times since their loss are early by that" in gap.text
    off = np.flatnonzero(column(batches, "counter") != numbers)
    assert off[0] == 3013
    assert len(off) < 1050


def test_what_the_guard_hides_is_not_guessed() -> None:
    """At 10 kHz four lost results are 0.4 ms: less than a host is punctual by."""
    pipe = pipeline(laser(10_000.0))
    _, events = feed(pipe, reads_of(without(40_000, 20_000, 7), 10_000.0))
    assert pipe.losses["samples"] == 3
    assert [event.facts["samples"] for event in events] == [3]


@pytest.mark.parametrize("late_s", [1e-4, 2e-3, 3e-2])
@pytest.mark.parametrize("drift", [0.0, 6e-5, -6e-5])
def test_a_late_host_and_a_fast_clock_are_no_loss(late_s: float, drift: float) -> None:
    pipe = pipeline(laser(2000.0))
    batches, events = feed(pipe, reads_of(np.arange(40_000), 2000.0, late_s, drift=drift))
    assert events == []
    assert not any(pipe.losses.values())
    assert len(column(batches, "counter")) == 40_000


def test_one_stretch_of_late_reads_is_no_loss() -> None:
    """A host that was 5 ms late for 0.3 s: the next stretch is punctual again."""
    reads = [
        (data, ns + 5_000_000 * (2 * 10**9 <= ns - START_NS < 23 * 10**8))
        for data, ns in reads_of(np.arange(6000), 1000.0)
    ]
    _, events = feed(pipeline(laser()), reads)
    assert events == []


def test_the_guard_grows_with_how_unevenly_the_host_reads() -> None:
    """Floors that wander by some ms hide a loss of 8 ms, unless eight intervals are compared."""
    rng = np.random.default_rng(4)
    wander = 4_000_000 * rng.random(1000)
    for uneven in (1, 0):
        reads = [
            (data, ns + uneven * int(wander[(ns - START_NS) // 250_000_000]))
            for data, ns in reads_of(without(8000, 5013, 8), 1000.0)
        ]
        pipe = pipeline(laser())
        feed(pipe, reads)
        assert pipe.losses["samples"] == 8


def held_up(rate_Hz: float, count: int, from_s: float, to_s: float, most: int = 4095) -> Reads:
    """Reads of a host that slept for a while, then caught up as fast as a port's driver lets it."""
    data = wire.results(codes_of(np.arange(count)), np.arange(count))
    reads: Reads = []
    now_s, at = 0.0, 0
    while at < len(data):
        now_s += 0.02
        now_s = to_s if from_s < now_s < to_s else now_s
        came = 4 * min(count, int(now_s * rate_Hz))
        part = data[at : min(at + most, came)]
        at += len(part)
        if part:
            reads.append((part, START_NS + round(now_s * 1e9)))
    return reads


@pytest.mark.parametrize("slept_s", [0.2, 1.0, 5.0])
def test_a_host_that_slept_lost_nothing(slept_s: float) -> None:
    pipe = pipeline(laser(4000.0))
    batches, events = feed(pipe, held_up(4000.0, 40_000, 4.0, 4.0 + slept_s))
    assert events == []
    assert np.array_equal(column(batches, "counter"), np.arange(40_000))


def test_results_that_wait_are_bounded_and_handed_out_when_the_host_speaks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(riftek, "_MAX_WAIT_ROWS", 2000)
    config = laser(4000.0)
    batches, _ = feed(pipeline(config), held_up(4000.0, 60_000, 4.0, 13.0))
    assert np.array_equal(column(batches, "counter"), np.arange(60_000))
    pipe = pipeline(config)
    reads = held_up(4000.0, 20_000, 4.0, 4.5)
    slept = next(i for i, (before, after) in enumerate(itertools.pairwise(reads)) if after[1] - before[1] > 3e8) + 1
    feed(pipe, reads[:slept])
    assert pipe.feed(RX, *reads[slept]) == []
    (batch,) = pipe.feed(TX, wire.request(wire.EVERYONE, wire.STOP), reads[slept][1] + 1)
    assert isinstance(batch, Batch)
    assert len(batch.time_ns) == len(reads[slept][0]) // 4


def after_a_loss(lost: int, every_s: float, count: int) -> tuple[RiftekPipeline, Reads]:
    """A pipeline after 3 s without a loss, and reads of the results after `lost` lost ones."""
    pipe = pipeline(laser())
    feed(pipe, reads_of(np.arange(3000), 1000.0))
    numbers = np.arange(3000 + lost, 3000 + lost + round(count * every_s * 1000))
    parts = np.split(numbers, count)
    return pipe, [
        (wire.results(codes_of(part), part), START_NS + 1_000_000 * int(part[-1] + 1) + 200_000) for part in parts
    ]


@pytest.mark.parametrize(("late", "lost"), [(1, 0), (2, 40), (3, 40)])
def test_a_single_late_read_at_the_end_is_no_loss_and_two_are(late: int, lost: int) -> None:
    pipe, reads = after_a_loss(40, 0.02, late)
    assert feed(pipe, reads) == ([], [])
    items = pipe.feed(RX, b"", reads[-1][1] + 1)
    assert sum(len(item.time_ns) for item in items if isinstance(item, Batch)) == 20 * late
    assert pipe.losses["samples"] == lost


def test_late_results_wait_for_a_quarter_of_a_second_and_four_reads() -> None:
    for every_s, waiting in ((0.13, 3), (0.02, 13)):
        pipe, reads = after_a_loss(40, every_s, waiting + 1)
        assert feed(pipe, reads[:-1]) == ([], [])
        batches, (gap,) = feed(pipe, reads[-1:])
        assert sum(len(batch.time_ns) for batch in batches) == round((waiting + 1) * every_s * 1000)
        assert gap.facts["samples"] == pipe.losses["samples"] == 40


def test_a_garbled_stretch_counts_by_its_bytes_as_far_as_time_has_room() -> None:
    reads = reads_of(np.arange(6000), 1000.0)
    data, host_ns = reads[200]
    garbled = data[:16] + bytes(byte ^ 0x80 for byte in data[16:64]) + data[64:]
    pipe = pipeline(laser())
    batches, events = feed(pipe, [*reads[:200], (garbled, host_ns), *reads[201:]])
    assert pipe.losses["samples"] == 6000 - len(column(batches, "counter")) == 12
    assert pipe.losses["bytes"] == 48
    assert np.flatnonzero(np.diff(column(batches, "counter")) != 1).tolist() == [200 * 20 + 3]
    assert column(batches, "counter")[-1] == 5999
    assert [event.kind for event in events][:1] == ["damage"]
    (gap,) = (event for event in events if event.kind == "gap")
    assert gap.text.startswith("about 12 samples lost")
    assert "uncertain_samples" in gap.facts
    garbage = (data[:16] + bytes(48) + data[16:], host_ns)
    pipe = pipeline(laser())
    feed(pipe, [*reads[:200], garbage, *reads[201:]])  # bytes too many, no time for them: nothing is lost
    assert pipe.losses["samples"] == 0
    assert pipe.losses["bytes"] == 48


def test_another_rate_than_the_files_is_no_loss() -> None:
    pipe = pipeline(laser(1000.0))
    batches, events = feed(pipe, reads_of(np.arange(6000), 500.0))
    assert events == []
    assert len(column(batches, "counter")) == 6000


def test_a_lone_false_result_is_suspect() -> None:
    numbers = np.arange(400)
    codes = codes_of(numbers)
    codes[300] ^= 0x1000
    batches, events = feed(pipeline(laser()), [(wire.results(codes, numbers), START_NS)])
    assert np.flatnonzero(suspects(column(batches, "flags"))).tolist() == [300]
    assert [event.kind for event in events] == ["suspect"]


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"rate_Hz": 3000.0}, r"nearest is 3003\.003003 Hz, a period of 333 us"),
        ({"rate_Hz": 20_000.0}, "less than or equal to 10000"),
        ({"rate_Hz": 10.0}, "greater than or equal to 15.25"),
        ({"rate_Hz": 4000.0, "baud": 115_200}, r"need 176000 baud, the line has 115200: raise baud or set rate_Hz to"),
        ({"baud": 10_000}, "multiple of 2400"),
        ({"parity": "M"}, "'E', 'O' or 'N'"),
        ({"no_target_codes": (70_000,)}, "less than or equal to 65535"),
        ({"mode": 1}, "Extra inputs are not permitted"),
    ],
)
def test_settings_that_no_sensor_can_have_are_refused(settings_: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        RiftekLaser(**{"driver": "riftek", "port": "loop://", "axis": "y"} | settings_)
    assert RiftekLaser(driver="riftek", port="loop://", axis="y", rate_Hz=8000, no_target_codes=[3]).period_us == 125


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


TABLE = RiftekLaser.model_validate(
    {"driver": "riftek", "port": "p", "axis": "x", "rate_Hz": 1000, "baud": 460_800, "range_m": 0.025}
)
T0 = 1_700_000_000_000_000_000


class Stream:
    """A pipeline and what arrives in it."""

    def __init__(self) -> None:
        self.pipeline = DRIVER.pipeline("x", TABLE, {})
        self._now_ns, self._number = T0, 0

    def run(self, seconds: float, rate_Hz: int, read_s: float = 0.02) -> str:
        for _ in range(round(seconds / read_s)):
            count = round(rate_Hz * read_s)
            numbers = self._number + np.arange(count)
            self._number += count
            self._now_ns += round(read_s * 1e9)
            self.pipeline.feed(RX, wire.results(np.full(count, 8000), numbers % 4), self._now_ns)
        return self.pipeline.status.set_up_lost

    def wait(self, seconds: float) -> None:
        self._now_ns += round(seconds * 1e9)

    def start(self) -> None:
        self.pipeline.feed(TX, wire.request(1, wire.START), self._now_ns)


@pytest.mark.parametrize("rate_Hz", [500, 2000])
def test_another_rate_is_a_sign_until_the_stream_is_started_again(rate_Hz: int) -> None:
    stream = Stream()
    assert stream.run(10.0, 1000) == ""
    assert stream.run(4.0, rate_Hz) == ""
    assert f"arrive {rate_Hz} times a second and it was set to 1000" in stream.run(6.0, rate_Hz)
    stream.start()
    assert stream.run(10.0, 1000) == ""


def test_what_a_suspended_host_reads_late_is_no_sign() -> None:
    stream = Stream()
    stream.run(5.0, 1000)
    stream.wait(20.0)
    stream.run(0.2, 100_000)  # the results of the suspension, at once
    assert stream.run(10.0, 1000) == ""


def test_a_gap_of_some_seconds_is_no_sign() -> None:
    stream = Stream()
    stream.run(5.0, 1000)
    stream.wait(4.0)
    assert stream.run(10.0, 1000) == ""
