"""The pipeline of a polled displacement sensor at its limits, with every field of its samples and events."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from daq.channels import displacement_channel
from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.polled_laser.settings import PolledLaser
from rig_drivers.polled_laser.stream import PolledPipeline

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
NO_LOSSES = dict.fromkeys(("samples", "damaged_lines", "unasked", "refused", "invalid"), 0)
Items = list[Batch | DeviceEvent]


def pipeline(**settings: Any) -> PolledPipeline:
    table = {"driver": "polled_laser", "port": "p", "axis": "x", "dialect": "LK-G", **settings}
    return PolledPipeline("gauge", PolledLaser.model_validate(table), {})


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


def events(items: Items) -> list[tuple[str, str, dict[str, Any]]]:
    return [(item.kind, item.text, dict(item.facts)) for item in items if isinstance(item, DeviceEvent)]


def asked(line: PolledPipeline, answer: bytes, at_ns: int, request: bytes = b"M1\r") -> Items:
    """The items of a request and its answer 2 ms later."""
    return line.feed(TX, request, at_ns) + line.feed(RX, answer + b"\r", at_ns + 2 * MS)


def test_every_field_of_a_sample() -> None:
    """The times are odd numbers of ns, which have no exact float; a tick of the log is 10 µs."""
    line = pipeline()
    assert line.losses == NO_LOSSES
    line.feed(TX, b"M1\r", START_NS + 9_001)
    found = line.feed(RX, b"M1,+01.0000\r", START_NS + 10_998)
    assert events(found) == [("reply", "M1,+01.0000", {})]
    (batch,) = batches(found)
    assert batch.channel == displacement_channel("laser/x")
    assert batch.time_ns.tolist() == [START_NS + 9_999]
    assert (batch.time_ns.dtype, batch.sequence.dtype) == (np.int64, np.uint32)
    assert batch.columns["displacement_m"].tolist() == [pytest.approx(1e-3)]
    whole = {name: column.tolist() for name, column in batch.columns.items() if name != "displacement_m"}
    assert whole == {"code": [0], "counter": [0], "device_ticks": [START_NS // 10_000], "flags": [0]}
    (second,) = batches(asked(line, b"M1,+01.0000", START_NS + 20 * MS))
    assert (second.columns["counter"].tolist(), second.sequence.tolist()) == ([1], [1])


def test_the_delay_is_subtracted_to_the_nanosecond() -> None:
    (batch,) = batches(asked(pipeline(delay_s=1.0), b"M1,+01.0000", START_NS))
    assert batch.time_ns.tolist() == [START_NS - 999 * MS]


def test_times_are_positive_and_increase_by_at_least_a_nanosecond() -> None:
    line = pipeline(delay_s=0.01)
    times = [batches(asked(line, b"M1,+01.0000", at))[0].time_ns[0] for at in (0, 0, 0, 0, 20 * MS, 0, 0)]
    assert times == [1, 2, 3, 4, 11 * MS, 11 * MS + 1, 11 * MS + 2]


@pytest.mark.parametrize(("text", "invalid"), [(b"+25.0000", 0), (b"-25.0000", 0), (b"+25.0001", 1), (b"-25.0001", 1)])
def test_the_end_of_the_range_is_a_reading(text: bytes, invalid: int) -> None:
    line = pipeline(range_m=0.025)
    for count in (1, 2):
        (batch,) = batches(asked(line, b"M1," + text, count * 10 * MS))
        assert np.isnan(batch.columns["displacement_m"]).tolist() == [bool(invalid)]
        assert line.losses == NO_LOSSES | {"invalid": invalid * count}


def test_the_number_of_a_sample_begins_again_after_32_bits() -> None:
    """After 2.7 years at 50 Hz."""
    line = pipeline()
    vars(line)["_counter"] = 2**32 - 2
    found = [batches(asked(line, b"M1,+01.0000", n * 10 * MS))[0].sequence[0] for n in range(4)]
    assert found == [2**32 - 2, 2**32 - 1, 0, 1]


def test_every_gap_is_reported_once_and_each_missing_answer_is_counted() -> None:
    line = pipeline()
    text = "no answer to a request; the time of the next sample is that of its own request"
    numbers: list[int] = []
    for round_ in (1, 2):
        at = round_ * 1000 * MS
        assert line.feed(TX, b"M1\r", at) == []
        assert events(line.feed(TX, b"M1\r", at + 10 * MS)) == [("gap", text, {"samples": 1})]
        assert line.feed(TX, b"M1\r", at + 20 * MS) == []
        numbers += [b.sequence[0] for b in batches(line.feed(RX, b"M1,+01.0000\r", at + 22 * MS))]
        assert line.losses == NO_LOSSES | {"samples": 2 * round_}
    assert numbers == [2, 5]


@pytest.mark.parametrize("other", [b"M0\r", b"M3\r", b"M1", b"M1\r\r", b"A\r", b"Z\r"])
def test_other_bytes_of_the_host_are_no_request(other: bytes) -> None:
    line = pipeline()
    assert line.feed(TX, other, 0) == []
    line.feed(TX, b"M1\r", 10 * MS)
    assert line.feed(TX, other, 12 * MS) == []
    (batch,) = batches(line.feed(RX, b"M1,+01.0000\r", 14 * MS))
    assert batch.time_ns.tolist() == [12 * MS]
    assert line.losses == NO_LOSSES


def test_an_answer_without_a_request_or_too_late_is_reported_with_its_beginning() -> None:
    line = pipeline(dialect="IL", output=6)
    answer = b"M0" + 7 * b",+01.234"
    assert len(answer) == 58
    text = f"an answer too late, or without a request: {answer[:40]!r}"
    request = START_NS + 1
    assert batches(asked(line, answer, START_NS, b"M0\r"))[0].sequence.tolist() == [0]
    for number in (1, 2):
        assert events(line.feed(RX, answer + b"\r", START_NS + 3 * MS)) == [("damage", text, {"lines": 1})]
        assert line.losses == NO_LOSSES | {"unasked": number}
    line.feed(TX, b"M0\r", request)
    assert events(line.feed(RX, answer + b"\r", request + 500 * MS + 1)) == [("damage", text, {"lines": 1})]
    line.feed(TX, b"M0\r", request + 1000 * MS)
    (batch,) = batches(line.feed(RX, answer + b"\r", request + 1500 * MS))
    assert (batch.sequence.tolist(), batch.time_ns.tolist()) == ([2], [request + 1250 * MS])
    assert line.losses == NO_LOSSES | {"unasked": 3}


def test_three_refusals_at_the_begin_of_a_log_are_a_fault_and_have_numbers() -> None:
    line = pipeline()
    found = [[kind for kind, *_ in events(asked(line, b"ER,M1,01", n * 1000 * MS))] for n in range(5)]
    assert found == [["reply"], ["reply"], ["reply", "fault"], ["reply"], ["reply"]]
    (batch,) = batches(asked(line, b"M1,+01.0000", 5000 * MS))
    assert batch.sequence.tolist() == [5]
    found = [[kind for kind, *_ in events(asked(line, b"ER,M1,01", n * 1000 * MS))] for n in range(6, 9)]
    assert found == [["reply"], ["reply"], ["reply", "fault"]]
    assert line.losses == NO_LOSSES | {"refused": 8}


@pytest.mark.parametrize("line_bytes", [b"M0", b"M1,+0?.0000" + 40 * b"y", b"M2", b"zz"])
def test_a_line_after_the_first_request_that_is_no_answer_is_damage(line_bytes: bytes) -> None:
    line = pipeline()
    line.feed(TX, b"M1\r", 0)
    for count in (1, 2):
        found = line.feed(RX, line_bytes + b"\r", MS)
        damage = ("damage", f"not an answer: {line_bytes[:40]!r}", {"lines": 1})
        assert events(found) == [damage, ("reply", line_bytes[:40].decode(), {})], "until the first answer"
        assert line.losses == NO_LOSSES | {"damaged_lines": count}
    assert line.feed(RX, b"M1\r\r\n\r", 2 * MS) == [], "the echo of the request, and empty lines"
    assert len(batches(line.feed(RX, b"M1,+01.0000\r", 3 * MS))) == 1


def test_a_log_may_begin_with_a_cut_answer_and_the_answer_to_an_earlier_request() -> None:
    line = pipeline()
    assert line.feed(RX, b"0000\rM1,+01.0000\r", 0) == []
    assert line.losses == NO_LOSSES
    assert [kind for kind, *_ in events(line.feed(RX, b"0000\rM1,+01.0000\r", 20 * MS))] == ["damage", "damage"]
    assert line.losses == NO_LOSSES | {"damaged_lines": 1, "unasked": 1}


@pytest.mark.parametrize("piece", [1, 7, 60, 121])
@pytest.mark.parametrize(("last", "metres"), [(b"1.2", 1.2e-3), (b"01.2", 1.2e-3), (b"01.23", None), (b"01.234", None)])
def test_an_answer_has_at_most_120_bytes(last: bytes, metres: float | None, piece: int) -> None:
    """The values of 15 amplifiers, in reads of any size; the answer is not accepted without its end."""
    line = pipeline(dialect="IL", output=14)
    answer = b"M0" + 14 * b",+01.234" + b",+" + last
    assert (len(answer) <= 120) == (metres is not None)
    line.feed(TX, b"M0\r", 0)
    found: Items = []
    for at in range(0, len(answer), piece):
        found += line.feed(RX, answer[at : at + piece], MS)
    assert found == []
    found = line.feed(RX, b"\r", 2 * MS)
    values = [value for batch in batches(found) for value in batch.columns["displacement_m"].tolist()]
    assert values == ([] if metres is None else [pytest.approx(metres)])
    assert line.losses["damaged_lines"] == (metres is None)


def test_text_without_an_end_is_not_kept() -> None:
    line = pipeline()
    tracemalloc.start()
    try:
        for _ in range(4000):
            line.feed(RX, 50 * b"x", 0)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 50_000
