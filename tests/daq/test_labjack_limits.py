"""Pipeline of a LabJack at its limits: exact counts of what is lost, the state of its buffer, refusals, the clock."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from daq.drivers.labjack import wire
from daq.items import RX, TX, DeviceEvent
from rig_basics.texts import number_of
from tests.daq.test_labjack import LASERS, START, S, answer, batches, events, numbers, pipeline
from tests.daq.test_labjack_stream import OTHER, start_answer, start_command

GOOD, EMPTY = [40000, 41000], [0xFFFF, 0xFFFF]
PERIOD_NS = 250_000
THREE = {"others": {"a": {"input": "AIN3", **OTHER}}}  # three inputs with the two lasers
MS = 1_000_000


def refusal(number: int, body: bytes = b"\x04") -> bytes:
    return wire.encode(wire.Message(number, wire.REFUSED, body))


def last_ns(items: Any) -> int:
    return int(batches(items, "laser/x")[-1].time_ns[-1])


# --- scans -----------------------------------------------------------------------------------------------------------


def test_scans_that_wait_are_newer_than_those_of_the_answer() -> None:
    """10 samples wait: the rest of the second scan, and three more."""
    made = pipeline(**THREE)
    items = made.feed(RX, answer(0x8000, [40000, 41000, 42000, 40001, 41001], 20), START)
    assert last_ns(items) == START - 3 * PERIOD_NS
    items = made.feed(RX, answer(0x8001, [42001, 40002, 41002, 42002], 12), START + 2 * PERIOD_NS)
    (batch,) = batches(items, "laser/x")
    assert batch.columns["code"].tolist() == [40001, 40002]
    assert batch.columns["flags"].tolist() == [0, 0]
    assert batch.columns["device_ticks"].tolist() == [25, 50]
    assert np.diff(batch.time_ns).tolist() == [PERIOD_NS]


@pytest.mark.parametrize(("rate", "period_ns"), [(2000.0, 500_000), (1.0, S), (0.0, 250_000), (-0.5, 250_000)])
def test_the_rate_is_that_of_the_identity_if_it_is_one(rate: float, period_ns: int) -> None:
    (batch,) = batches(pipeline({"scan_rate_Hz": rate}).feed(RX, answer(0x8000, GOOD * 3), START), "laser/x")
    assert np.diff(batch.time_ns).tolist() == [period_ns] * 2


def test_an_output_half_a_percent_beyond_its_ends_is_a_reading() -> None:
    """1 mV a count above and below the count 100: the output is 0 to 1 V."""
    scale = {"AIN0_zero": 100.0, "AIN0_above_V": 1e-3, "AIN0_below_V": 1e-3}
    made = pipeline(scale, lasers={"east": {"axis": "x", "input": "AIN0", "far_V": 1.0, "range_m": 0.1}})
    (batch,) = batches(made.feed(RX, answer(0x8000, [97, 98, 100, 600, 1101, 1103, 0xFFFF]), START), "laser/x")
    found = batch.columns["displacement_m"]
    assert np.isnan(found).tolist() == [True, False, False, False, False, True, True]
    assert found[1:5] == pytest.approx([-0.0502, -0.05, 0, 0.0501])
    assert made.losses["invalid"] == 3


def test_other_quantities_have_a_voltage_of_their_zero() -> None:
    scale = {"AIN3_zero": 100.0, "AIN3_above_V": 1e-3, "AIN3_below_V": 1e-3}
    other = {"input": "AIN3", "quantity": "force_N", "per_V": 3.0, "zero_V": 0.5}
    (batch,) = batches(
        pipeline(scale, lasers={}, others={"f": other}).feed(RX, answer(0x8000, [600, 1100]), START), "analogue/f"
    )
    assert batch.columns["force_N"] == pytest.approx([0, 1.5])
    assert batch.columns["scan"].tolist() == batch.sequence.tolist() == [0, 1]


def test_the_digital_line_of_a_tachometer_is_the_last_sample_of_a_scan() -> None:
    made = pipeline(tacho={"input": "EIO3"}, scan_rate_Hz=1000.0)
    low, high = [0xFE08, 0xFE08, 0xFE00], [0xFE00, 0xFE00, 0xFE08]
    scans = [low, high, high, low, high]
    (batch,) = batches(made.feed(RX, answer(0x8000, [code for scan in scans for code in scan]), START), "tacho")
    assert batch.columns["node_time_us"].tolist() == [500, 3500]
    assert batch.columns["revolutions"].tolist() == [0, 1]


def test_an_index_mark_after_scans_without_a_value_is_at_its_edge() -> None:
    made = pipeline(tacho={"input": "AIN2"}, scan_rate_Hz=1000.0)
    low, high, empty = [40000, 41000, 33523], [40000, 41000, 48000], [0xFFFF] * 3
    scans = [low] * 5 + [empty] * 4 + [low] * 5 + [high] * 2
    items = made.feed(RX, answer(0x8000, [code for scan in scans for code in scan]), START)
    (batch,) = batches(items, "tacho")
    assert 13_000 < batch.columns["node_time_us"][0] < 14_000


def test_a_scan_without_any_value_is_damage_from_two_inputs_on() -> None:
    (damage,) = events(pipeline().feed(RX, answer(0x8000, [*GOOD, *EMPTY]), START))
    assert (damage.kind, damage.facts) == ("damage", {"samples": 1})
    assert damage.text == "scans without a value at any input (FFFFh), and no number of skipped scans"
    one = pipeline(lasers={"east": LASERS["east"]})
    items = one.feed(RX, answer(0x8000, [40000, 0xFFFF]), START)
    assert (events(items), one.losses["invalid"]) == ([], 1)


# --- scans that the device skips -------------------------------------------------------------------------------------


def test_skipped_scans_have_their_exact_span() -> None:
    made = pipeline()
    items = made.feed(RX, answer(0x8000, GOOD * 2 + EMPTY + GOOD, status=2941, info=60_000), START)
    (gap,) = events(items)
    assert gap.text == "60000 scans skipped by the device, whose buffer was full (15000.0 ms)"
    assert gap.facts == {"samples": 60_000, "span_s": pytest.approx(15.0, rel=1e-11)}
    assert numbers(items) == [0, 1, 60_002]
    assert last_ns(items) == START  # the scans before the separator have an unknown age
    odd = pipeline(scan_rate_Hz=3000.0)
    items = odd.feed(RX, answer(0x8000, EMPTY + GOOD, status=2941, info=60_000), START)
    assert events(items)[0].facts["span_s"] == pytest.approx(20.0, rel=1e-11)
    few = pipeline()
    items = few.feed(RX, answer(0x8000, GOOD + EMPTY + GOOD, status=2941, info=8), START)
    assert "(2.0 ms)" in events(items)[0].text


def test_the_separator_is_the_first_scan_without_a_value() -> None:
    made = pipeline()
    items = made.feed(RX, answer(0x8000, GOOD * 2 + EMPTY + GOOD + EMPTY + GOOD, status=2941, info=7), START)
    assert numbers(items) == [0, 1, 9, 10, 11]
    without = pipeline()
    assert numbers(without.feed(RX, answer(0x8000, GOOD * 3, status=2941, info=7), START)) == [7, 8, 9]


def test_more_skipped_scans_than_the_device_counts_follow_from_the_host_s_time() -> None:
    """From the separator on 3 scans and 3 that wait; the last scan before it was measured at 3 periods."""
    made = pipeline(**THREE)
    three = [40000, 41000, 42000]
    made.feed(RX, answer(0x8000, three * 2), 2 * PERIOD_NS)
    scans = three + [0xFFFF] * 3 + three * 2
    items = made.feed(RX, answer(0x8001, scans, 20, status=2943, info=9), round(102.6 * PERIOD_NS))
    (gap,) = events(items)
    assert gap.facts == {"samples": 94, "span_s": pytest.approx(0.0235), "uncertain_samples": 94}
    assert gap.text == "about 94 scans skipped by the device: more than it counts"


@pytest.mark.parametrize("first", [True, False])
def test_no_scans_are_skipped_if_there_was_no_time_for_them(first: bool) -> None:
    made = pipeline()
    if not first:
        made.feed(RX, answer(0x8000, GOOD), START)
    items = made.feed(RX, answer(0x8001, EMPTY + GOOD, 400, status=2943, info=9), START + PERIOD_NS)
    assert events(items)[0].facts["samples"] == made.losses["samples"] == 0
    assert numbers(items) == [1 - first]


def test_the_age_of_skipped_scans_is_not_taken_for_known() -> None:
    """Else the samples of a full buffer would determine the clock, from which later ones have their times."""
    made = pipeline()
    made.feed(RX, answer(0x8000, GOOD, 0, 2940), START)
    items = made.feed(RX, answer(0x8001, EMPTY + GOOD, 0, 2941, 9000), START + 9 * S)
    assert last_ns(items) == START + 9 * S


def test_a_stream_that_has_stopped_with_an_error_still_corrects_its_clock() -> None:
    made = pipeline()
    made.feed(RX, answer(0x8000, GOOD * 40, status=2942), START + 50 * MS)
    for number in range(1, 30):
        items = made.feed(RX, answer(0x8000 + number, GOOD * 40), START + number * 10 * MS)
    assert last_ns(items) == pytest.approx(START + 290 * MS, abs=25 * MS)


# --- missing answers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "periods", "status", "lost"),
    [
        (0x8005, 40.6, 0, 39),
        (0x8003, 40.6, 0, 39),
        (0x8004, 40.6, 0, 0),
        (0x8005, 2.4, 0, 0),
        (0x8005, 3.4, 0, 1),
        (0x8005, 1.4, 0, 0),
        (0x8005, 40.6, 2940, 0),
        (0x8005, 40.6, 2941, 39),
    ],
)
def test_scans_of_missing_answers_follow_from_the_host_s_time(
    number: int, periods: float, status: int, lost: int
) -> None:
    """3 scans waited behind the answer before, and 5 come and wait with this one."""
    made, early_ns = pipeline(**THREE), 3 * PERIOD_NS  # small times: their differences are those of large ones
    three = [40000, 41000, 42000]
    made.feed(RX, answer(0x8003, [*three, *three[:2]], 20), early_ns)
    items = made.feed(RX, answer(number, [*three, 40000], 22, status), early_ns + round(periods * PERIOD_NS))
    found = [event for event in events(items, "gap") if "uncertain_samples" in event.facts]
    span = pytest.approx(lost * 250e-6)
    assert [event.facts for event in found] == [{"samples": lost, "span_s": span, "uncertain_samples": lost}] * (
        lost > 0
    )
    assert [event.text for event in found] == [f"about {number_of(lost, 'scan')} lost: answers are missing"] * (
        lost > 0
    )


@pytest.mark.parametrize(("first", "second"), [(0x8003, 0x8004), (0xFFFF, 0x8000)])
def test_a_late_answer_with_the_next_number_is_no_loss(first: int, second: int) -> None:
    made = pipeline()
    made.feed(RX, answer(first, GOOD * 40), START)
    assert events(made.feed(RX, answer(second, GOOD * 40), START + S)) == []


# --- new starts ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("started_ms", "scans", "status", "lost", "text"),
    [
        (1000, 20, 0, 4019, "about 4019 scans lost (1005 ms)"),
        (1000, 80, 0, 3999, "about 3999 scans lost (1000 ms)"),
        (1000, 20, 2940, 3999, "about 3999 scans lost (1000 ms)"),
        (1000, 20, 2941, 4019, "about 4019 scans lost (1005 ms)"),
        (0, 80, 0, 0, "about 0 scans lost (0 ms)"),
    ],
)
def test_the_scans_before_a_new_start_follow_from_its_first_answer(
    started_ms: int, scans: int, status: int, lost: int, text: str
) -> None:
    """It arrives 10 ms after the start, or its scans were measured from the start on."""
    made = pipeline()
    made.feed(RX, answer(0x8000, GOOD), START)
    start_ns = START + started_ms * MS
    made.feed(TX, start_command(300), start_ns)
    made.feed(RX, start_answer(300), start_ns + MS)
    items = made.feed(RX, answer(0x8007, GOOD * scans, 0, status, 5), start_ns + 10 * MS)
    gap = events(items, "gap")[0]
    assert gap.text == f"its stream was started again: {text}"
    assert gap.facts == {"samples": lost, "span_s": pytest.approx(lost * 250e-6), "uncertain_samples": lost}
    assert made.losses["samples"] == lost + 5 * (status == 2941)
    if status == 2940:  # the times of the scans after the buffer was full do not depend on those before
        later = made.feed(RX, answer(0x8008, EMPTY + GOOD, 0, 2941, 100), start_ns + 5 * S)
        assert last_ns(later) == start_ns + 5 * S


def test_only_the_answer_to_the_start_begins_a_new_stream() -> None:
    made = pipeline()
    (reply,) = made.feed(RX, start_answer(4), START)
    assert isinstance(reply, DeviceEvent)
    assert (reply.kind, reply.text) == ("reply", start_answer(4).hex())
    made.feed(RX, answer(0x8000, GOOD), START)
    made.feed(TX, start_command(300), START)
    for number in (299, 301):
        made.feed(RX, start_answer(number), START)
    assert events(made.feed(RX, answer(0x8001, GOOD), START + PERIOD_NS)) == []
    made.feed(RX, start_answer(300), START + PERIOD_NS)
    assert [event.kind for event in events(made.feed(RX, answer(0x8002, GOOD), START + S))] == ["gap"]


def test_a_stream_that_is_started_again_while_scans_are_skipped_has_a_clock_again() -> None:
    made = pipeline()
    made.feed(RX, answer(0x8000, GOOD, 0, 2940), START)
    made.feed(TX, start_command(9), START + S)
    made.feed(RX, start_answer(9), START + S)
    for number in range(1, 30):
        late = 50 * MS * (number == 1)
        items = made.feed(RX, answer(0x8000 + number, GOOD * 40), START + S + number * 10 * MS + late)
    assert last_ns(items) == pytest.approx(START + S + 290 * MS, abs=25 * MS)


# --- state of the stream ---------------------------------------------------------------------------------------------


def test_a_buffer_fills_from_half_and_is_empty_at_an_eighth() -> None:
    made = pipeline()
    backlogs = [16_384, 16_386, 16_390, 4098, 16_386, 4096, 16_386]
    found = [
        events(made.feed(RX, answer(0x8000 + number, GOOD, backlog), START + number * PERIOD_NS))
        for number, backlog in enumerate(backlogs)
    ]
    assert [[event.kind for event in each] for each in found] == [[], ["backlog"], [], [], [], [], ["backlog"]]
    assert found[1][0].text == "16386 of 32768 bytes wait in its buffer: the host or the network is late"
    assert found[1][0].facts == {"backlog_bytes": 16_386}
    (full,) = events(made.feed(RX, answer(0x8007, GOOD, 32_764, 2940), START + 7 * PERIOD_NS))
    assert full.text == "its buffer was full: it skips scans until the buffer has been read"
    assert full.facts == {"backlog_bytes": 32_764}


def test_the_status_of_a_stream_that_ended_is_reported_once() -> None:
    made = pipeline()
    (fault,) = events(made.feed(RX, answer(0x8000, GOOD, status=2620), START))
    assert (fault.text, fault.facts) == ("status 2620 of the stream: the stream has ended", {"status": 2620})
    assert events(made.feed(RX, answer(0x8001, GOOD, status=2942), START + PERIOD_NS)) == []
    assert events(made.feed(RX, answer(0x8002, GOOD), START + 2 * PERIOD_NS)) == []
    (fault,) = events(made.feed(RX, answer(0x8003, GOOD, status=2942), START + 3 * PERIOD_NS))
    assert fault.text == (
        "status 2942 of the stream: a scan began before the previous one had ended. Lower scan_rate_Hz"
    )


def test_three_refused_reads_in_a_row_are_a_fault() -> None:
    made = pipeline()
    found = [events(made.feed(RX, refusal(0x8000 + n), START)) for n in range(4)]
    assert [[event.kind for event in each] for each in found] == [["refused"], [], ["fault"], []]
    assert (found[0][0].text, found[0][0].facts) == ("it refuses to be read (exception 4)", {"exception": 4})
    assert (found[2][0].text, found[2][0].facts) == ("it refuses to be read: 3 times in a row (exception 4)", {})
    detail = wire.encode(wire.Message(wire.ERROR_NUMBER, wire.FEEDBACK, struct.pack(">H", 2620)))
    assert made.feed(RX, detail, START) == []  # a fault is standing
    made.feed(RX, answer(0x8004, GOOD), START)
    found = [events(made.feed(RX, refusal(0x8005 + n, body), START)) for n, body in enumerate((b"", b"", b"\x06\x07"))]
    assert [[event.kind for event in each] for each in found] == [["refused"], [], ["fault"]]
    assert found[0][0].text == "it refuses to be read (exception 0)"
    assert found[2][0].text == "it refuses to be read: 3 times in a row (exception 6)"


@pytest.mark.parametrize(
    ("function", "body", "kinds"),
    [
        (wire.FEEDBACK, struct.pack(">H", 3000), ["refused"]),
        (wire.FEEDBACK, struct.pack(">H", 2620), ["fault"]),
        (wire.FEEDBACK, b"\x0a", []),
        (wire.FEEDBACK, b"\x0a\x3c\x00", []),
        (wire.REFUSED, struct.pack(">H", 2620), []),
    ],
)
def test_the_error_of_a_refused_read_has_two_bytes(function: int, body: bytes, kinds: list[str]) -> None:
    made = pipeline()
    made.feed(RX, refusal(0x8000), START)
    found = events(made.feed(RX, wire.encode(wire.Message(wire.ERROR_NUMBER, function, body)), START))
    assert [event.kind for event in found] == kinds
    assert [event.facts for event in found] == [{"error": int.from_bytes(body, "big")}] * len(kinds)


# --- the clock -------------------------------------------------------------------------------------------------------


def step_of(rate_Hz: float, scans: int, step_ns: int, after: int) -> list[DeviceEvent]:
    """Events of reads that are all later by a step from the 40th on."""
    made = pipeline(scan_rate_Hz=rate_Hz)
    found: list[DeviceEvent] = []
    for number in range(40 + after):
        host_ns = START + round(number * scans * S / rate_Hz) + step_ns * (number >= 40)
        found += events(made.feed(RX, answer(0x8000 + number, GOOD * scans), host_ns))
    return found


@pytest.mark.parametrize(
    ("rate_Hz", "reads", "step_ns", "scans"),
    [(4000.0, 40, -19_999_999, None), (4000.0, 40, -20_000_000, -80), (10.0, 1, -20_000_000, 0)],
)
def test_a_step_of_the_clock_is_reported_from_20_ms_on(
    rate_Hz: float, reads: int, step_ns: int, scans: int | None
) -> None:
    found = step_of(rate_Hz, reads, step_ns, 1)
    assert [event.facts for event in found] == [{"step_s": pytest.approx(-0.02), "scans": scans}] * (scans is not None)
    for event in found:
        assert event.text == "its scans arrive 20 ms earlier than before: the clock of the host was set"


def test_a_step_of_one_scan_may_be_a_missing_scan() -> None:
    (event,) = step_of(40.0, 1, 25_000_000, 60)
    assert event.facts == {"step_s": pytest.approx(0.025), "scans": 1}
    assert event.text.endswith(
        "was set, or about 1 scan is missing without a report (another program reads the stream)"
    )
