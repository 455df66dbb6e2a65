"""Pipeline of CANopen encoders at its limits: numbers, times and events to the last unit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.cia406.stream import EncoderPipeline
from tests.daq.can_text import rx
from tests.rig_drivers.test_cia406 import MS, PERIOD_NS, SYNC, Line, free, identity, report, settings, turning

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


@pytest.mark.parametrize(("delay_s", "delay_ns"), [(0.04999999948, 49_999_999), (0.04999999952, 50_000_000)])
def test_a_delay_is_rounded_to_whole_nanoseconds(delay_s: float, delay_ns: int) -> None:
    line = Line(sync_delay_s=delay_s)
    line.all_answer()
    assert times(line.items) == [delay_ns]


@pytest.mark.parametrize(("rate_Hz", "period_ns"), [(14, 71_428_571), (54, 18_518_519), (100, 10_000_000)])
def test_the_span_of_missing_samples_is_whole_periods(rate_Hz: int, period_ns: int) -> None:
    pipeline = EncoderPipeline("encoders", settings(rate_Hz=rate_Hz), identity())
    items = fed(pipeline, *((k * period_ns, TX, SYNC) for k in range(4)), (3 * period_ns + MS, RX, b"".join(ALL)))
    items += fed(pipeline, (3 * period_ns + MS, RX, b""))
    (gap,) = [item for item in items if isinstance(item, DeviceEvent) and "samples" in item.facts]
    assert gap.facts == {
        "samples": 3,
        "span_s": pytest.approx(3 * period_ns * 1e-9, rel=1e-12),
        "time_ns": times(items)[0],
    }
    assert gap.text == "3 samples lost"


@pytest.mark.parametrize(
    ("lateness_s", "late_ns", "waits"),
    [
        (0.003, 3_000_000, False),
        (0.003, 3_000_001, True),
        (0.003000000498, 3_000_001, True),
        (0.003000000502, 3_000_001, False),
    ],
)
def test_a_first_report_is_late_beyond_the_limit_to_the_nanosecond(
    lateness_s: float, late_ns: int, waits: bool
) -> None:
    """Both angles then wait for the report of the shaft."""
    pipeline = EncoderPipeline("encoders", settings(max_lateness_s=lateness_s), identity())
    for k in range(3):
        fed(pipeline, (k * PERIOD_NS, TX, SYNC), (k * PERIOD_NS + MS, RX, b"".join(ALL)))
    items = fed(pipeline, (3 * PERIOD_NS, TX, SYNC), (3 * PERIOD_NS + MS + late_ns, RX, ALL[0] + ALL[1]))
    assert topics(items) == ([] if waits else ["pendulums"])
    items = fed(pipeline, (3 * PERIOD_NS + 6 * MS, RX, ALL[2]))
    assert topics(items) == (["pendulums"] if waits else [])


@pytest.mark.parametrize(("limit_s", "late"), [(0.003000000001, 0), (0.002999999999, 1)])
@pytest.mark.parametrize("counts", [120, -120])
def test_a_shaft_that_turned_by_more_than_the_limit_shows_a_late_sync(limit_s: float, late: int, counts: int) -> None:
    """120 counts are 3 ms; the reports come 5 ms later than usual."""
    line = Line(max_lateness_s=limit_s)
    for number in range(12):
        line.period(*ALL[:2], report(5, 400 * number % 4096))
    line.period(*ALL[:2], report(5, (4800 + counts) % 4096), after_ms=6.0)
    assert line.losses == ({"late": 1, "samples": 1} if late else {})
    assert len(line.batches()) == 13 - late


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


def test_node_times_are_whole_microseconds_of_the_instant() -> None:
    pipeline, items = EncoderPipeline("encoders", settings(), identity()), list[Batch | DeviceEvent]()
    begin_ns = 1_700_000_000_000_000_999
    for number in range(150):
        host_ns = begin_ns + number * PERIOD_NS
        position = round(4096 * (0.3 * number + 0.1)) % 4096
        items += fed(
            pipeline, (host_ns, TX, SYNC), (host_ns + MS, RX, report(3, 1) + report(4, 1) + report(5, position))
        )
    for topic in ("pendulums", "tacho"):
        found = [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]
        assert column(list(found), "node_time_us") == [int(item.time_ns[0]) // 1000 for item in found]
        assert any(int(item.time_ns[0]) % 1000 >= 875 for item in found)
    assert times(items) == [begin_ns + number * PERIOD_NS for number in range(150)]


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


@pytest.mark.parametrize(("more_ns", "faults"), [(0, 1), (1, 2)])
def test_syncs_of_another_node_are_reported_again_after_a_second(more_ns: int, faults: int) -> None:
    pipeline = EncoderPipeline("encoders", settings(), identity())
    for k in range(5):
        fed(pipeline, (k * PERIOD_NS, TX, SYNC), (k * PERIOD_NS + MS, RX, b"".join(ALL)))
    foreign_ns = 5 * PERIOD_NS
    items = fed(pipeline, (foreign_ns, RX, SYNC), (foreign_ns + S // 2, RX, SYNC), (foreign_ns + S + more_ns, RX, SYNC))
    found = [item for item in items if isinstance(item, DeviceEvent) and item.kind == "fault"]
    assert [event.facts for event in found] == [{"foreign_syncs": 1}, {"foreign_syncs": 3}][:faults]
    items = fed(pipeline, (foreign_ns + 4 * S, TX, SYNC), (foreign_ns + 4 * S + MS, RX, b"".join(ALL)))
    assert "fault" not in topics(items), "no other SYNC has come"


def test_double_answers_that_another_sync_explains_do_not_make_the_echo_foreign() -> None:
    line = Line()
    for _ in range(14):
        line.period(SYNC, *ALL, SYNC, *ALL)
    assert line.losses == {"foreign_syncs": 14, "unasked": 42}


@pytest.mark.parametrize(("more_ms", "reports"), [(0.0, 1), (0.000001, 2)])
def test_late_syncs_are_reported_again_after_a_second(more_ms: float, reports: int) -> None:
    line = turning({12: 8.0, 60: 7.0, 112: 8.0 + more_ms})
    found = [event.facts for event in line.events("gap") if "late" in event.facts]
    assert found == [{"late": 1}, {"late": 3}][:reports]
    assert line.losses == {"late": 3, "samples": 3}


@pytest.mark.parametrize(("more_ns", "reports"), [(0, 1), (1, 2)])
def test_periods_without_a_sync_are_reported_again_after_a_second(more_ns: int, reports: int) -> None:
    pipeline = EncoderPipeline("encoders", settings(), identity())
    at_ns = [k * PERIOD_NS for k in range(300)]  # for longer than a second all is well
    at_ns += [4 * S, 4 * S + S // 2, 5 * S + more_ns]
    items = fed(pipeline, *((host_ns + d * MS, d ^ 1, (SYNC, b"".join(ALL))[d]) for host_ns in at_ns for d in (0, 1)))
    found = [item.facts for item in items if isinstance(item, DeviceEvent)]
    counted = [{"unsampled": 99, "span_s": pytest.approx(0.99)}, {"unsampled": 98, "span_s": pytest.approx(0.98)}]
    assert found == counted[:reports]
    assert pipeline.losses["unsampled"] == 197
    rest = fed(pipeline, (6 * S, RX, b""))
    assert [item.facts for item in rest if isinstance(item, DeviceEvent)] == counted[reports:]


def test_a_silent_encoder_and_a_missing_shaft_have_their_facts() -> None:
    line = Line()
    for _ in range(40):
        line.period(ALL[0], ALL[2])
    (silent,) = line.events("network")
    assert silent.facts == {"encoder": "b", "operational": False}
    assert "the adapter" not in silent.text
    line = Line()
    line.period(ALL[0], ALL[1])
    line.period(ALL[2])
    line.period(*ALL)
    line.at(0.0, RX, b"")
    gaps = line.events("gap")
    assert [event.facts for event in gaps[:1]] == [{"reports": 1}]
    assert [event.facts["samples"] for event in gaps[1:]] == [1]
    assert line.losses == {"reports": 3, "samples": 1}


# --- reports ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("position", "invalid"), [(4095, 0), (4096, 1), (4097, 1), (2**32 - 1, 1)])
def test_positions_are_those_below_the_number_of_positions(position: int, invalid: int) -> None:
    line = Line()
    line.period(report(3, position), ALL[1], ALL[2])
    assert line.losses == ({"invalid": 1} if invalid else {})
    assert column(line.items, "count_a") == ([] if invalid else [-1])
    assert [event.facts for event in line.events("damage")] == [{"lines": 1}] * invalid


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
