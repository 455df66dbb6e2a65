"""Set-up of the reports of CANopen encoders that refuse parts of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.cia406.far_end import PlayedEncoders
from rig_drivers.cia406.stream import EncoderPipeline
from rig_testing.bench import DriverBench
from tests.daq.can_text import rx, tx
from tests.rig_drivers.cia406.test_encoders import (
    MS,
    PERIOD_NS,
    SYNC,
    Line,
    bench_of,
    free,
    identity,
    report,
    settings,
    turning,
)

POSITION, SPEED = 0x6004_0020, 0x6030_0110


def with_encoder(
    fixed: set[tuple[int, int]], mapped: list[int] | None = None, kind: int = 254, **other: Any
) -> DriverBench:
    """Encoders of which B refuses to change some objects, with a mapping and a transmission type of TPDO1."""
    bench, far = bench_of(**other)
    encoder = far.encoders[1]
    encoder.fixed.update(fixed)
    encoder.objects[0x6030, 1] = (0x1234, "<H")
    encoder.objects[0x1800, 2] = (kind, "<B")
    for sub, entry in enumerate(mapped or [], 1):
        encoder.objects[0x1A00, sub] = (entry, "<I")
    encoder.objects[0x1A00, 0] = (len(mapped or [1]), "<B")
    return bench


def objects_of(bench: DriverBench) -> dict[tuple[int, int], int]:
    far: Any = bench.far
    return {place: value for place, (value, _) in far.encoders[1].objects.items() if 0x1800 <= place[0] < 0x1B00}


FIXED_MAPPING = {(0x1A00, 0), (0x1A00, 1), (0x1A00, 2)}


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        (with_encoder({(0x1800, 2)}), "encoder b: refused 1 at 1800h sub 2.*type 254.*Set sync = false"),
        (with_encoder({(0x1800, 2)}, kind=1, sync=False, rate_Hz=100), "type 1,.*Set sync = true"),
        (with_encoder({(0x6200, 0)}, sync=False, rate_Hz=100), "refused 10 at 6200h.*Reduce rate_Hz"),
        (
            with_encoder(FIXED_MAPPING, [SPEED]),
            "refused 0 at 1A00h.*contains 6030h sub 1, 16 bits: expected the position",
        ),
        (with_encoder(FIXED_MAPPING, [0x2000_0004, POSITION]), "contains 2000h sub 0, 4 bits . 6004h sub 0, 32 bits"),
    ],
)
def test_a_refusal_has_a_remedy_and_leaves_the_reports_as_they_were(bench: DriverBench, words: str) -> None:
    before = objects_of(bench)
    with pytest.raises(DeviceError, match=words):
        bench.begin()
    assert objects_of(bench) == before


@pytest.mark.parametrize(
    ("mapped", "fixed", "offset"),
    [
        ([POSITION, SPEED], FIXED_MAPPING, 0),
        ([SPEED, POSITION], FIXED_MAPPING, 2),
        ([SPEED, POSITION], {(0x1A00, 1)}, 2),  # refused after the mapping was switched off
        ([SPEED, POSITION], set[tuple[int, int]](), 0),
    ],
)
def test_a_fixed_mapping_with_the_position_is_accepted(
    mapped: list[int], fixed: set[tuple[int, int]], offset: int
) -> None:
    bench = with_encoder(fixed, mapped)
    bench.begin()
    bench.clock.wait(0.3)
    assert bench.identity["b_offset"] == offset
    assert objects_of(bench)[0x1A00, 0] == (2 if fixed else 1)
    assert bench.pipeline.losses["invalid"] == 0
    counts = np.concatenate(
        [i.columns["count_b"] for i in bench.items if isinstance(i, Batch) and "count_b" in i.columns]
    )
    far: Any = bench.far
    assert len(counts) > 20
    assert int(counts[-1]) % 4096 == far.encoders[1]._position % 4096


def test_a_transmission_type_that_is_right_is_not_written() -> None:
    bench = with_encoder({(0x1800, 2)}, kind=1)
    bench.begin()


def test_the_stand_in_for_a_log_keeps_the_place_of_the_position() -> None:
    played = PlayedEncoders(settings(), {**identity(), "b_offset": 2})
    played.hear(tx(b"O\r"))
    assert played.hear(tx(b"t604840001A0000000000\r")) == rx(b"t58484F001A0002000000\r")
    assert played.hear(tx(b"t60482F001A0000000000\r"))[:4] == rx(b"t584880001A0000000000\r")[:4]
    assert played.hear(tx(b"t604840001A0100000000\r")) == rx(b"t584843001A0110000020\r")


def test_reports_are_decoded_at_the_place_in_the_identity() -> None:
    pipeline = EncoderPipeline("encoders", settings(shaft_node=None), {**identity(), "b_offset": 2})
    pipeline.feed(TX, SYNC, 0)
    items = pipeline.feed(RX, rx(b"t183401000000\rt184634120A000000\r"), 1_000_000)
    (batch,) = [item for item in items if isinstance(item, Batch)]
    assert int(batch.columns["count_b"][0]) == 10
    (event,) = pipeline.feed(RX, rx(b"t18440A000000\r"), 2_000_000)
    assert "a report of 4 bytes, expected 6" in str(event)


@pytest.mark.parametrize("offset", [-1, 5, "2", 1.0])
def test_an_impossible_place_is_refused(offset: object) -> None:
    with pytest.raises(DeviceError, match="encoder b: expected a place of the position from 0 to 4 bytes"):
        EncoderPipeline("encoders", settings(), {"b_offset": offset})


ALL = report(3, 1), report(4, 1), report(5, 1)
S = 1_000_000_000
Items = list[Batch | DeviceEvent]


def topics(items: Items) -> list[str]:
    """The topics of the batches in their order, and the kinds of the events."""
    return [item.channel.topic if isinstance(item, Batch) else item.kind for item in items]


def times(items: Items, topic: str = "pendulums") -> list[int]:
    return [int(item.time_ns[0]) for item in items if isinstance(item, Batch) and item.channel.topic == topic]


def column(items: Items, name: str) -> list[Any]:
    return [item.columns[name][0].item() for item in items if isinstance(item, Batch) and name in item.columns]


def fed(pipeline: EncoderPipeline, *parts: tuple[int, int, bytes]) -> Items:
    return [item for host_ns, direction, data in parts for item in pipeline.feed(direction, data, host_ns)]


# --- settings in ns --------------------------------------------------------------------------------------------


def test_without_an_encoder_of_the_shaft_angles_do_not_wait() -> None:
    line = Line(shaft_node=None)
    for _ in range(3):
        line.period(ALL[0] + ALL[1])
    line.period(ALL[0] + ALL[1], after_ms=9.0)
    assert len(line.batches()) == 4
    assert line.losses == {}


def test_angles_come_with_the_report_of_the_shaft_even_if_it_was_the_first() -> None:
    line = turning({})
    for order in ((5, 3, 4), (4, 5, 3)):
        count = len(line.batches())
        line.at(0.0, TX, SYNC)
        shaft = round(line.now_ms * 1e-3 * 1000 / 60 * 4096) % 4096
        for node in order:
            line.at(8.0, RX, report(node, shaft if node == 5 else 1))
        assert len(line.batches()) == count + 1
        line.now_ms += 10.0
    assert line.losses == {}


# --- times that never run back ---------------------------------------------------------------------------------


def test_samples_and_marks_keep_their_order_if_the_host_s_clock_is_set_back() -> None:
    pipeline, items = EncoderPipeline("encoders", settings(), identity()), list[Batch | DeviceEvent]()
    for number in range(120):
        host_ns = 9 * S + number * PERIOD_NS - (5 * S if number >= 60 else 0)
        position = round(4096 * (0.05 * number + 0.013)) % 4096
        items += fed(
            pipeline, (host_ns, TX, SYNC), (host_ns + MS, RX, report(3, 1) + report(4, 1) + report(5, position))
        )
    samples, marks = times(items), times(items, "tacho")
    assert samples[:60] == [9 * S + number * PERIOD_NS for number in range(60)]
    assert samples[60:] == [samples[59] + 1 + number for number in range(60)]
    assert np.diff(marks).tolist() == [pytest.approx(0.2 * S, rel=1e-3), 1, 1]
    sequence = [int(i.sequence[0]) for i in items if isinstance(i, Batch) and i.channel.topic == "tacho"]
    assert sequence == list(range(len(marks)))


def test_reports_of_a_timer_that_arrive_together_keep_their_distance() -> None:
    pipeline = free()
    items = fed(pipeline, (S, RX, report(4, 7)), (S + MS, RX, report(3, 1)))
    items += fed(pipeline, (S + MS, RX, report(3, 2) + report(4, 7) + report(3, 3)))
    assert np.diff(times(items)) == pytest.approx([PERIOD_NS] * 2, rel=0.1)
    assert column(items, "count_a") == [1, 2, 3]


# --- frames that are not the encoders' -------------------------------------------------------------------------


def test_only_the_identifier_of_sync_is_one() -> None:
    line = Line()
    for data in map(rx, (b"t00020103\r", b"t07F0\r", b"t0810\r", b"t60384017100000000000\r")):
        line.at(0.0, TX, data)
        line.at(0.0, RX, data)
    assert line.pipeline.syncs == 0
    line.all_answer()
    for data in map(rx, (b"t00020103\r", b"t07F0\r", b"t0810\r")):
        line.at(0.0, RX, data)
    line.all_answer()
    assert line.pipeline.syncs == 2
    assert line.losses == {}
    assert line.pipeline.status.has_reported


def test_without_sync_those_of_the_bus_have_no_effect() -> None:
    pipeline, items = free(), list[Batch | DeviceEvent]()
    for number in range(3):
        host_ns = number * 5 * PERIOD_NS
        for direction in (TX, RX):
            items += fed(pipeline, (host_ns, direction, SYNC))
    for number in range(20):
        items += fed(pipeline, (S + number * PERIOD_NS, RX, report(4, 10) + report(3, 1) + report(5, 20)))
    assert pipeline.syncs == 0
    assert {kind: count for kind, count in pipeline.losses.items() if count} == {}
    assert column(items, "count_b") == [10] * 20


# --- events that repeat ----------------------------------------------------------------------------------------


def test_double_answers_that_another_sync_explains_do_not_make_the_echo_foreign() -> None:
    line = Line()
    for _ in range(14):
        line.period(SYNC, *ALL, SYNC, *ALL)
    assert line.losses == {"foreign_syncs": 14, "unasked": 42}


# --- reports ---------------------------------------------------------------------------------------------------


def test_heartbeats_are_no_complaint_and_the_first_encoder_that_starts_again_is_named() -> None:
    line = Line()
    line.at(0.0, RX, rx(b"t703105\rt704105\r"))
    assert line.pipeline.status.complaint == ""
    for node in (b"t7041", b"t7031"):
        line.at(1.0, RX, rx(node + b"00\r"))
    assert line.pipeline.status.complaint == "encoder b (node 4) started again: its set-up is gone. Open the rig again"
    assert [event.facts["encoder"] for event in line.events("restart")] == ["b", "a"]


def test_flags_are_those_of_each_encoder() -> None:
    line = Line()
    for emergencies in ((), (b"t0838",), (b"t0838", b"t0848"), (b"t0848", b"t0858")):
        for each in (b"t0838", b"t0848"):
            code = b"0050" + b"21" if each in emergencies else b"000000"
            line.at(0.0, RX, rx(each + code + b"00" * 5 + b"\r"))
        line.all_answer()
    assert column(line.items, "flags") == [0, 1, 3, 2]


def test_held_reports_of_the_shaft_come_before_the_angles_of_their_sync() -> None:
    line = Line()
    for position in (3900, 4000):
        line.period(report(3, 1) + report(4, 1) + report(5, position))
    line.period()  # no answer in time
    line.period(b"".join(report(node, position) for position in (4050, 150) for node in (3, 4, 5)))
    before = len(line.items)
    line.period(b"".join(ALL))
    assert topics(line.items[before:])[:3] == ["tacho", "gap", "pendulums"]
    assert column(line.items, "revolutions") == [0]


# --- encoders' own timers --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("node", "gaps"),
    [
        (3, [{"samples": 4, "span_s": pytest.approx(0.04)}]),
        (4, [{"samples": 3, "span_s": pytest.approx(0.03)}, {"reports": 4}]),
        (5, [{"reports": 4}]),
    ],
)
def test_missing_reports_of_a_timer_have_one_event(node: int, gaps: list[dict[str, Any]]) -> None:
    pipeline, items = free(), list[Batch | DeviceEvent]()
    for number in range(40):
        for each, position in ((4, 70), (3, 7), (5, 700 + number)):
            if each != node or not 20 <= number < 24:
                items += fed(pipeline, (S + number * PERIOD_NS + each * 100_000, RX, report(each, position)))
    items += fed(pipeline, (S + 41 * PERIOD_NS, RX, b""))
    found = [item for item in items if isinstance(item, DeviceEvent)]
    own = [{key: value for key, value in event.facts.items() if key != "time_ns"} for event in found]
    assert own == gaps
    assert set(column(items, "count_b")) == {70}
    assert set(column(items, "count_a")) == {7}


def test_a_report_of_a_before_any_of_b_gives_no_sample() -> None:
    pipeline = free()
    assert fed(pipeline, (S, RX, report(3, 1))) == []
    items = fed(pipeline, (S + 9 * MS, RX, report(4, 5)), (S + 10 * MS, RX, report(3, 2)))
    assert topics(items) == ["pendulums"]
    assert (column(items, "count_a"), column(items, "count_b"), column(items, "index")) == ([2], [5], [1])


def test_reports_that_wait_come_at_the_end_of_the_log() -> None:
    pipeline = free()
    items = fed(pipeline, *((S + k * PERIOD_NS, RX, report(4, 5) + report(3, k)) for k in (0, 1, 2)))
    late = fed(pipeline, *((S + k * PERIOD_NS, RX, report(4, 5) + report(3, k)) for k in (5, 6)))
    assert topics(late) == []
    rest = fed(pipeline, (S + 6 * PERIOD_NS, RX, b""))
    assert sorted(topics(rest)) == ["gap", "gap", "pendulums", "pendulums"]
    assert column(items + rest, "index") == [0, 1, 2, 5, 6]
    assert pipeline.losses["samples"] == 2
    assert pipeline.losses["reports"] == 4
