"""LabJack: samples and their times, scans that begin within an answer, refused reads, the pace of the scans."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import pytest

from daq.items import TX
from rig_drivers.labjack import wire
from rig_testing.bench import Items
from tests.rig_drivers.labjack.reads import (
    EMPTY,
    GOOD,
    LASERS,
    MS,
    OTHER,
    PERIOD_NS,
    START,
    THREE,
    Reads,
    S,
    batches,
    events,
    last_ns,
    numbers,
)

THREE_SAMPLES = [40000, 41000, 42000]
SCALE = {"zero": 100.0, "above_V": 1e-3, "below_V": 1e-3}  # 1 mV a count


def scale(name: str) -> dict[str, float]:
    return {f"{name}_{key}": value for key, value in SCALE.items()}


# --- samples ----------------------------------------------------------------------------------------------------------


def test_what_the_host_writes_gives_no_samples() -> None:
    assert Reads().feed(struct.pack(">HHHBB4H", 0x8000, 0, 10, 1, 0x4C, 0, 0, 0, 0), direction=TX) == []


def test_scans_that_wait_are_newer_than_those_of_the_answer() -> None:
    """10 samples wait: the rest of the second scan, and three more."""
    made = Reads(**THREE)
    assert last_ns(made.answer([*THREE_SAMPLES, 40001, 41001], backlog=20)) == START - 3 * PERIOD_NS
    (batch,) = batches(made.answer([42001, 40002, 41002, 42002], 2 * PERIOD_NS, 12))
    assert batch.columns["code"].tolist() == [40001, 40002]
    assert batch.columns["device_ticks"].tolist() == [25, 50]
    assert np.diff(batch.time_ns).tolist() == [PERIOD_NS]


@pytest.mark.parametrize(("rate", "period_ns"), [(2000.0, 500_000), (1.0, S), (0.0, 250_000), (-0.5, 250_000)])
def test_the_rate_is_that_of_the_identity_if_it_is_one(rate: float, period_ns: int) -> None:
    (batch,) = batches(Reads({"scan_rate_Hz": rate}).answer(GOOD * 3))
    assert np.diff(batch.time_ns).tolist() == [period_ns] * 2


def test_displacement_is_the_share_of_the_output_in_the_range() -> None:
    laser = {"axis": "x", "input": "AIN0", "near_V": 9.0, "far_V": 1.0, "range_m": 0.02, "lever_ratio": 2.0}
    made = Reads(scale("AIN0"), lasers={"east": laser})
    codes = [100 + round(1000 * volts) for volts in (9.0, 1.0, 5.0, 3.0, 0.9, 9.1)]
    (batch,) = batches(made.answer(codes))
    assert batch.columns["displacement_m"][:4] == pytest.approx([-0.005, 0.005, 0.0, 0.0025], abs=1e-6)
    assert np.isnan(batch.columns["displacement_m"][4:]).all()
    assert batch.columns["code"].tolist() == codes
    assert made.lost == {"invalid": 2}


def test_other_quantities_have_a_voltage_of_their_zero() -> None:
    other = {"input": "AIN3", "quantity": "force_N", "per_V": 3.0, "zero_V": 0.5}
    (batch,) = batches(Reads(scale("AIN3"), lasers={}, others={"f": other}).answer([600, 1100]), "analogue/f")
    assert batch.columns["force_N"] == pytest.approx([0, 1.5])
    assert batch.columns["scan"].tolist() == batch.sequence.tolist() == [0, 1]


def test_an_input_above_its_range_is_invalid_and_its_scans_count() -> None:
    """Only its own samples are invalid. Scans without any value count too, and are reported once."""
    made = Reads(**THREE)
    over = [[0xFFFF, 41000, 42000]] * 2 + [[40000, 0xFFFF, 42000], [40000, 41000, 0xFFFF]]
    items = made.answer([code for scan in over for code in scan])
    items += made.answer([0xFFFF] * 3 * 20 + THREE_SAMPLES, 21 * PERIOD_NS)
    (damage,) = events(items)
    assert (damage.kind, damage.facts) == ("damage", {"samples": 20})
    assert damage.text == "scans without a value at any input (FFFFh), and no number of skipped scans"
    empty, invalid = [*range(4, 24)], dict[str, list[int]]()
    for topic, name in (
        ("laser/x", "displacement_m"),
        ("laser/y", "displacement_m"),
        ("analogue/a", OTHER["quantity"]),
    ):
        assert numbers(items, topic) == [*range(25)]
        values = np.concatenate([batch.columns[str(name)] for batch in batches(items, topic)])
        invalid[topic] = np.flatnonzero(np.isnan(values)).tolist()
    assert invalid == {"laser/x": [0, 1, *empty], "laser/y": [2, *empty], "analogue/a": [3, *empty]}
    assert made.lost == {"invalid": 43}


def test_a_single_input_above_its_range_is_no_scan_without_a_value() -> None:
    made = Reads(lasers={"east": LASERS["east"]})
    assert events(made.answer([40000, 0xFFFF])) == []


# --- index marks ------------------------------------------------------------------------------------------------------

LOW, HIGH, NO_SCAN = [40000, 41000, 33523], [40000, 41000, 48000], [0xFFFF] * 3


def test_the_digital_line_of_a_tachometer_is_the_last_sample_of_a_scan() -> None:
    made = Reads(tacho={"input": "EIO3"}, scan_rate_Hz=1000.0)
    low, high = [0xFE08, 0xFE08, 0xFE00], [0xFE00, 0xFE00, 0xFE08]
    (batch,) = batches(made.answer([*low, *high, *high, *low, *high]), "tacho")
    assert batch.columns["node_time_us"].tolist() == [500, 3500]
    assert batch.columns["revolutions"].tolist() == [0, 1]


def test_an_index_mark_after_scans_without_a_value_is_at_its_edge() -> None:
    made = Reads(tacho={"input": "AIN2"}, scan_rate_Hz=1000.0)
    (batch,) = batches(made.answer(LOW * 5 + NO_SCAN * 4 + LOW * 5 + HIGH * 2), "tacho")
    (at_us,) = batch.columns["node_time_us"]
    assert 13_000 < at_us < 14_000


def test_marks_are_numbered_and_those_lost_with_scans_are_counted() -> None:
    """A pulse every 20 scans; an overflow skips 50 scans, and with them two pulses."""
    made = Reads(lasers={}, tacho={"input": "AIN2"}, scan_rate_Hz=1000.0)
    scans = ([33523] * 15 + [49356] * 5) * 8
    made.answer(scans[:60])
    made.answer([0xFFFF, *scans[110:]], 110 * MS, status=2941, info=50)
    marks = batches(made.items, "tacho")
    turns = [int(n) for batch in marks for n in batch.columns["revolutions"]]
    assert turns == [0, 1, 2, 5, 6, 7]
    own_us = [int(us) for batch in marks for us in batch.columns["node_time_us"]]
    assert [own - 20_000 * turn for own, turn in zip(own_us, turns, strict=True)] == [14_500] * 6


def test_a_pulse_that_bounces_is_one_mark() -> None:
    made = Reads(lasers={}, tacho={"input": "AIN2"}, scan_rate_Hz=1000.0)
    pulse = [33523] * 90 + [49356, 33523, 33523, 49356, 49356] + [33523] * 5
    for _ in range(6):
        made.answer(pulse, 100 * MS)
    assert made.lost == {"doubled_marks": 5}
    turns = [int(n) for batch in batches(made.items, "tacho") for n in batch.columns["revolutions"]]
    assert turns == [0, 1, 2, 3, 4, 5, 6], "nothing shows the first bounce"


# --- scans within answers ---------------------------------------------------------------------------------------------


def test_an_answer_may_end_within_a_scan() -> None:
    made = Reads()
    made.answer([40000, 41000, 40001], backlog=2, padding=20)
    made.answer([41001], PERIOD_NS)
    codes = [batch.columns["code"].tolist() for topic in ("laser/x", "laser/y") for batch in batches(made.items, topic)]
    assert codes == [[40000], [40001], [41000], [41001]]


@pytest.mark.parametrize("lost", [False, True])
def test_an_answer_may_begin_within_a_scan(lost: bool) -> None:
    """A log begins, or an answer is missing, within a scan: the number of samples that wait gives the place."""
    made = Reads(**THREE)
    if lost:
        made.answer(THREE_SAMPLES * 2)
        made.number += 2
    items = made.answer([41000, 42000, 40000, 41000], S, 2)
    items += made.answer([42000, 40000], backlog=4)
    items += made.answer([41000, 42000, *THREE_SAMPLES])
    assert {int(code) for batch in batches(items) for code in batch.columns["code"]} == {40000}
    assert len(numbers(items)) == 3


@pytest.mark.parametrize("after_missing", [False, True])
def test_answers_of_whole_scans_are_dropped_until_their_place_in_the_buffer_is_certain(after_missing: bool) -> None:
    """Part of a scan waits behind whole scans: the device divides scans, or it stores its samples one by one."""

    def begun() -> Reads:
        made = Reads()
        if after_missing:
            made.answer(GOOD)
            made.number += 1
        return made

    made = begun()
    for _ in range(3):
        assert not made.answer([41000, 40000], backlog=6)
    assert len(numbers(made.answer([41000, 40000, 41000]))) == 1
    made = begun()
    found = [len(numbers(made.answer(GOOD, backlog=6))) for _ in range(21)]
    assert found == [0] * 20 + [1]


def read_samples(made: Reads, taken: Sequence[tuple[int, int]]) -> None:
    """Feed answers with these samples of one endless stream, which are (first, last + 1), and the rest that waits."""
    for place, (first, end) in enumerate(taken):
        codes = [10_000 * (1 + at % 3) + at // 3 % 5000 for at in range(first, end)]
        made.answer(codes, 20 * PERIOD_NS, 2 * (60 * (place + 1) - end))


def whole(first: int, end: int) -> list[tuple[int, int]]:
    return [(60 * each, 60 * each + 60) for each in range(first, end)]


def test_a_sample_that_another_program_has_read_does_not_exchange_the_inputs() -> None:
    """60 samples an answer; from sample 1800 on one is missing, and the answers end within a scan."""
    made = Reads(**THREE)
    read_samples(made, [*whole(0, 30), (1801, 1860), *whole(31, 50)])
    x, y = (
        np.concatenate([batch.columns["code"] for batch in batches(made.items, topic)])
        for topic in ("laser/x", "laser/y")
    )
    assert [np.unique(each // 10_000).tolist() for each in (x, y)] == [[1], [2]]
    damage, gap = events(made.items)
    assert (damage.kind, gap.kind, damage.facts["samples"]) == ("damage", "gap", 179)
    assert "another program" in damage.text
    assert numbers(made.items) == [*range(600), *range(600 + gap.facts["samples"], 1000)]
    assert x.tolist() == [10_000 + number for number in numbers(made.items)]
    assert made.pipeline.losses["samples"] == gap.facts["samples"]


@pytest.mark.parametrize("waiting", [1, 2])
def test_an_answer_during_a_scan_is_no_sign_of_missing_samples(waiting: int) -> None:
    """The device has stored one or two samples of a scan when it answers: the answer is decoded with the next one."""
    made = Reads(**THREE)
    found = [len(numbers(made.answer(THREE_SAMPLES * 20, 5 * MS, 2 * waiting * (place == 30)))) for place in range(40)]
    assert found == [20] * 30 + [0, 40] + [20] * 8
    assert numbers(made.items) == [*range(800)]
    assert (events(made.items), made.lost) == ([], {})


def test_a_device_that_often_answers_during_a_scan_is_not_doubted() -> None:
    made = Reads(**THREE)
    for place in range(60):
        assert len(numbers(made.answer(THREE_SAMPLES * 20, 5 * MS, 2 * (place % 3)))) == 20
    assert made.lost == {}


def test_a_new_start_ends_the_doubt_about_answers() -> None:
    made = Reads(**THREE)
    read_samples(made, [*whole(0, 30), (1801, 1860)])
    made.command()
    made.reply()
    items = made.answer(THREE_SAMPLES * 20, 50 * MS)
    assert [event.kind for event in events(items)] == ["gap"]
    (batch,) = batches(items)
    assert np.unique(batch.columns["code"]).tolist() == [40000]


def test_bytes_of_a_message_that_began_before_the_log_are_no_damage() -> None:
    data = b"".join(_data(number, GOOD * 30) for number in (0x8000, 0x8001))
    made = Reads()
    assert numbers(made.feed(data[50:])) == [*range(30)]
    assert made.lost == {}
    later = made.feed(bytes(5) + _data(0x8002, GOOD), 1)
    assert [event.kind for event in events(later)] == ["damage"]
    assert made.lost == {"bytes": 5}


def _data(number: int, samples: list[int]) -> bytes:
    body = struct.pack(f">4H{len(samples)}H", len(samples), 0, 0, 0, *samples)
    return wire.encode(wire.Message(number, wire.FEEDBACK, body))


def test_more_bytes_than_those_of_a_message_are_damage_at_the_start_of_a_log() -> None:
    made = Reads()
    made.feed(b"\xff" * 1000 + _data(0x8002, GOOD))
    assert made.lost == {"bytes": 1000 - 518}


# --- state of the stream ----------------------------------------------------------------------------------------------


def kinds(items: Items) -> list[str]:
    return [event.kind for event in events(items)]


def test_a_filling_buffer_is_reported_once_until_it_is_nearly_empty() -> None:
    made = Reads()
    found = [kinds(made.answer(GOOD, PERIOD_NS, backlog)) for backlog in (16_384, 16_386, 4098, 20_000, 4096, 16_386)]
    assert found == [[], ["backlog"], [], [], [], ["backlog"]]
    (full,) = events(made.answer(GOOD, PERIOD_NS, 32_764, 2940))
    assert full.text == "its buffer was full: it skips scans until the buffer has been read"
    assert full.facts == {"backlog_bytes": 32_764}
    assert made.lost == {}


@pytest.mark.parametrize(
    ("status", "words"), [(2942, "Lower scan_rate_Hz"), (2620, "the stream has ended"), (9999, "ended")]
)
def test_a_stream_that_stops_is_a_fault_once(status: int, words: str) -> None:
    made = Reads()
    found = [events(made.answer(GOOD, PERIOD_NS, status=each)) for each in (status, 2944, 0, status)]
    assert [[event.kind for event in each] for each in found] == [["fault"], [], [], ["fault"]]
    assert f"status {status} of the stream" in found[0][0].text
    assert words in found[0][0].text
    assert found[0][0].facts == {"status": status}


def test_refused_reads_in_a_row_are_a_fault_once() -> None:
    made = Reads()
    for _ in range(2):
        found = [events(made.refuse()) for _ in range(4)]
        assert [[event.kind for event in each] for each in found] == [["refused"], [], ["fault"], []]
        assert (found[0][0].text, found[0][0].facts) == ("it refuses to be read (exception 4)", {"exception": 4})
        assert "times in a row (exception 4)" in found[2][0].text
        assert made.detail(struct.pack(">H", 2620)) == []  # a fault is standing
        assert events(made.answer(GOOD)) == []
    assert kinds(made.refuse(b"")) == ["refused"]
    assert made.lost == {"refused": 9}


@pytest.mark.parametrize(
    ("function", "body", "kinds_", "words"),
    [
        (wire.FEEDBACK, struct.pack(">H", 3000), ["refused"], "error 3000"),
        (wire.FEEDBACK, struct.pack(">H", 2620), ["fault"], "no stream runs"),
        (wire.FEEDBACK, b"\x0a", [], ""),
        (wire.FEEDBACK, b"\x0a\x3c\x00", [], ""),
        (wire.REFUSED, struct.pack(">H", 2620), [], ""),
    ],
)
def test_the_error_of_a_refused_read_is_explained_once(
    function: int, body: bytes, kinds_: list[str], words: str
) -> None:
    made = Reads()
    assert made.detail(body, function) == []
    made.refuse()
    found = events(made.detail(body, function))
    assert [event.kind for event in found] == kinds_
    assert all(words in event.text and event.facts == {"error": int.from_bytes(body, "big")} for event in found)
    assert made.detail(body, function) == []


# --- pace -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_Hz", [1000, 3600, 8000])
def test_a_stream_that_another_program_has_set_up_is_recognised(rate_Hz: int) -> None:
    """From the 100th answer on the scans come at another rate. The device must be set up again."""
    made = Reads()
    made.answers(100)
    made.answers(300, rate_Hz // 100)
    assert not made.pipeline.status.set_up_lost
    made.answers(600, rate_Hz // 100)
    assert f"{rate_Hz} Hz instead of 4000" in made.pipeline.status.set_up_lost
    assert "another program" in made.pipeline.status.set_up_lost
    made.command()
    made.reply()
    assert not made.pipeline.status.set_up_lost


def test_late_answers_missing_answers_and_skipped_scans_are_no_other_rate() -> None:
    """The network is 0.3 s late for some seconds, answers are missing, and the buffer overflows."""
    made = Reads()
    for second in range(12):
        for part in range(20):
            made.number += second == 4
            made.now_ns = START + second * S + part * 50 * MS + (300 * MS if 6 <= second < 8 else 0)
            full = second == 9
            made.answer(GOOD * (20 if full else 200), status=2940 if full else 0)
            assert not made.pipeline.status.set_up_lost


def test_times_increase_when_a_stream_that_was_too_fast_is_started_again() -> None:
    """Another program doubled the rate, so that the times are ahead of the host's; then the host starts the stream."""
    made = Reads()
    made.answers(100)
    made.answers(100, 80)
    made.command()
    made.reply()
    made.number += 1
    made.answers(400)
    times = np.concatenate([batch.time_ns for batch in batches(made.items)])
    assert np.min(np.diff(times)) > 0
    assert abs(int(times[-1]) - made.now_ns) < 1e6
    assert [event.kind for event in events(made.items, "gap")] == ["gap"]


# --- the clock --------------------------------------------------------------------------------------------------------


def test_a_stream_that_has_stopped_with_an_error_still_corrects_its_clock() -> None:
    made = Reads()
    made.answer(GOOD * 40, 50 * MS, status=2942)
    made.now_ns = START
    assert last_ns(made.answers(29)) == pytest.approx(START + 290 * MS, abs=25 * MS)


def test_reads_of_a_full_buffer_do_not_change_the_clock() -> None:
    """Stall of 2.4 s: the buffer holds old data, whose age is unknown. There is no step of the clock."""
    made = Reads()
    made.answers(200)
    made.now_ns += 2400 * MS
    scans, late_ns = 8000, [0]
    for left in reversed(range(80)):
        items = made.answer(GOOD * 100, 2 * MS, 400 * left, 2940)
        scans += 100
        late_ns.append(last_ns(items) - START - scans * PERIOD_NS)
    lost = round((made.now_ns - START) / PERIOD_NS) - scans
    items = made.answer(EMPTY + GOOD * 20, 20 * PERIOD_NS, 0, 2941, lost)
    assert kinds(items) == ["gap"]
    late_ns.append(last_ns(items) - START - (scans + lost + 20) * PERIOD_NS)
    assert max(map(abs, late_ns)) < 1e5


def test_a_log_that_begins_with_a_full_buffer_has_right_times_after_it() -> None:
    made = Reads()
    for _ in range(10):
        made.answer(GOOD * 100, 10 * MS, status=2940)
    made.now_ns = START + S
    assert last_ns(made.answer(EMPTY + GOOD * 20, 0, 0, 2941, 9000)) == START + S
