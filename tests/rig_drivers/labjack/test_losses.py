"""LabJack: scans that the device skips, answers that are missing, streams that are started again."""

from __future__ import annotations

from typing import Any

import pytest

from daq.items import DeviceEvent
from rig_drivers.labjack import wire
from tests.rig_drivers.labjack.reads import (
    EMPTY,
    GOOD,
    MS,
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

# --- scans that the device skips -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("counts", "lost"), [(True, 7), (False, 8)])
def test_skipped_scans_advance_the_count_at_the_separator(counts: bool, lost: int) -> None:
    made = Reads(separator_counts=counts)
    made.answer(GOOD * 10)
    made.answer(GOOD * 3 + EMPTY + GOOD * 4, 6 * MS, status=2941, info=7)
    assert numbers(made.items) == [*range(13), *range(13 + lost, 17 + lost)]
    (gap,) = events(made.items)
    assert (gap.kind, gap.facts["samples"]) == ("gap", lost)
    assert made.lost == {"samples": lost}
    ticks = [int(tick) for batch in batches(made.items) for tick in batch.columns["device_ticks"]]
    assert ticks == [25 * number for number in numbers(made.items)]


@pytest.mark.parametrize(
    ("first", "second", "found"),
    [
        (GOOD * 2 + EMPTY + GOOD + EMPTY + GOOD, [], [0, 1, 9, 10, 11]),  # the first one separates
        (GOOD * 3, [], [7, 8, 9]),  # none
        ([40000, 41000, 0xFFFF, 41000, *EMPTY, *GOOD], [], [0, 1, 9]),  # one input above its range
        ([40000, 41000, 0xFFFF], [0xFFFF, 40001, 41001], [0, 8]),  # divided between two answers
    ],
)
def test_the_separator_is_the_first_scan_without_a_value(first: list[int], second: list[int], found: list[int]) -> None:
    made = Reads()
    made.answer(first, backlog=2 * bool(second), status=2941, info=7)
    if second:
        made.answer(second, 2 * MS)
    assert numbers(made.items) == found
    assert events(made.items)[0].kind == "gap"


def test_more_skipped_scans_than_the_device_counts_follow_from_the_host_s_time() -> None:
    """From the separator on 3 scans and 3 that wait; the last scan before it was measured at 3 periods."""
    made = Reads(**THREE)
    made.now_ns = 2 * PERIOD_NS
    made.answer(THREE_SAMPLES * 2)
    scans = THREE_SAMPLES + [0xFFFF] * 3 + THREE_SAMPLES * 2
    (gap,) = events(made.answer(scans, round(100.6 * PERIOD_NS), 20, status=2943, info=9))
    assert gap.facts == {"samples": 94, "span_s": pytest.approx(0.0235), "uncertain_samples": 94}
    assert gap.text == "about 94 scans skipped by the device: more than it counts"


@pytest.mark.parametrize("first", [True, False])
def test_no_scans_are_skipped_if_there_was_no_time_for_them(first: bool) -> None:
    made = Reads()
    if not first:
        made.answer(GOOD)
    items = made.answer(EMPTY + GOOD, PERIOD_NS, 400, status=2943, info=9)
    assert events(items)[0].facts["samples"] == 0
    assert made.lost == {}
    assert numbers(items) == [1 - first]


def test_more_skipped_scans_than_were_possible_are_estimated() -> None:
    """The device was full for 1 s, and states 65 535 skipped scans, which are 16 s."""
    made = Reads()
    made.answers(100)
    made.answer(GOOD * 40, 990 * MS, 0, 2940)
    made.answer(EMPTY + GOOD * 40, 10 * MS, 0, 2941, 65_535)
    assert made.lost["samples"] == pytest.approx(3920, abs=1)
    assert "it states 65535" in events(made.items, "gap")[0].text
    assert last_ns(made.items) == pytest.approx(START + 2 * S, abs=1e6)


# --- missing answers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("missing", "periods", "status", "lost"),
    [
        (1, 40.6, 0, 39),
        (-1, 40.6, 0, 39),
        (0, 40.6, 0, 0),
        (1, 2.4, 0, 0),
        (1, 3.4, 0, 1),
        (1, 1.4, 0, 0),
        (1, 40.6, 2940, 0),
        (1, 40.6, 2941, 39),
    ],
)
def test_scans_of_missing_answers_follow_from_the_host_s_time(
    missing: int, periods: float, status: int, lost: int
) -> None:
    """3 scans waited behind the answer before, and 5 come and wait with this one."""
    made = Reads(**THREE)
    made.now_ns = 3 * PERIOD_NS  # small times: their differences are those of large ones
    made.answer([*THREE_SAMPLES, *THREE_SAMPLES[:2]], backlog=20)
    made.number += missing
    items = made.answer([*THREE_SAMPLES, 40000], round(periods * PERIOD_NS), 22, status)
    found = [(e.text, e.facts) for e in events(items, "gap") if "uncertain_samples" in e.facts]
    facts = {"samples": lost, "span_s": pytest.approx(lost * 250e-6), "uncertain_samples": lost}
    text = f"about {lost} scan{'s' * (lost != 1)} lost: answers are missing"
    assert found == [(text, facts)] * (lost > 0)


@pytest.mark.parametrize("first", [0x8003, 0xFFFF])
def test_a_late_answer_with_the_next_number_is_no_loss(first: int) -> None:
    """The network delays an answer by a second; the scans since then follow."""
    made = Reads()
    made.number = first
    made.answer(GOOD * 40)
    made.answer(GOOD * 40, S)
    made.answer(GOOD * 118, 0, 15_000)
    assert numbers(made.items) == [*range(198)]
    assert (events(made.items), made.lost) == ([], {})


def test_the_clock_begins_again_after_missing_answers() -> None:
    made = Reads()
    made.answer(GOOD * 40)
    made.number += 2
    items = made.answer(GOOD * 40, 40 * MS)
    assert made.lost == {"samples": 120}
    assert numbers(items)[0] == 160
    assert last_ns(items) == START + 40 * MS


def test_scans_of_an_answer_missing_after_a_late_one_are_all_counted() -> None:
    """The 100th answer is 0.3 s late, the one with the scans of these 0.3 s is missing."""
    made = Reads()
    made.answers(99)
    made.answer(GOOD * 40, 310 * MS)
    made.number += 1
    items = made.answer(GOOD * 40, 10 * MS)
    assert made.lost == {"samples": 1200}
    assert last_ns(items) == pytest.approx(START + 1310 * MS, abs=1e6)


# --- new starts ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("started_ms", "scans", "status", "lost", "text"),
    [
        (1000, 20, 0, 4020, "about 4020 scans lost (1005 ms)"),
        (1000, 80, 0, 3999, "about 3999 scans lost (1000 ms)"),
        (1000, 20, 2940, 3999, "about 3999 scans lost (1000 ms)"),
        (1000, 20, 2941, 4020, "about 4020 scans lost (1005 ms)"),
        (0, 80, 0, 0, "about 0 scans lost (0 ms)"),
    ],
)
def test_the_scans_before_a_new_start_follow_from_its_first_answer(
    started_ms: int, scans: int, status: int, lost: int, text: str
) -> None:
    """It arrives 10 ms after the start, or its scans were measured from the start on."""
    made = Reads()
    made.answer(GOOD)
    made.now_ns = START + started_ms * MS
    made.command()
    made.reply()
    made.number += 7
    items = made.answer(GOOD * scans, 10 * MS, 0, status, 5)
    gap = events(items, "gap")[0]
    assert gap.text == f"its stream was started again: {text}"
    assert gap.facts == {"samples": lost, "span_s": pytest.approx(lost * 250e-6), "uncertain_samples": lost}
    assert made.pipeline.losses["samples"] == lost + 5 * (status == 2941)
    assert numbers(items)[0] == 1 + lost + 5 * (status == 2941)
    if status == 2940:  # the times of the scans after the buffer was full do not depend on those before
        assert last_ns(made.answer(EMPTY + GOOD, 5 * S, 0, 2941, 100)) == made.now_ns
    elif lost:
        assert last_ns(items) == made.now_ns


def test_only_the_answer_to_the_start_begins_a_new_stream() -> None:
    made = Reads()
    (reply,) = made.reply(4)
    assert isinstance(reply, DeviceEvent)
    assert (reply.kind, reply.text) == ("reply", wire.encode(wire.Message(4, wire.FEEDBACK, b"\x45\x7a\0\0")).hex())
    made.command(3, on=0)
    made.reply(3)
    made.answer(GOOD)
    made.command(300)
    made.reply(299)
    made.reply(301)
    assert events(made.answer(GOOD, PERIOD_NS)) == []
    made.reply(300, wire.REFUSED)
    made.reply(300)
    assert events(made.answer(GOOD, PERIOD_NS)) == []
    made.command(300)
    made.reply(300)
    assert [event.kind for event in events(made.answer(GOOD, S))] == ["gap"]


def test_a_new_stream_begins_with_its_first_input() -> None:
    made = Reads()
    made.answer([40000, 41000, 40000], backlog=2)
    made.command()
    made.reply()
    (batch,) = batches(made.answer([40001, 41001], 2 * MS, 2))
    assert batch.columns["code"].tolist() == [40001]


def test_a_stream_that_is_started_again_while_scans_are_skipped_has_a_clock_again() -> None:
    made = Reads()
    made.answer(GOOD, status=2940)
    made.now_ns += S
    made.command()
    made.reply()
    late: dict[str, Any] = {"after_ns": 60 * MS}
    made.answer(GOOD * 40, **late)
    made.now_ns -= 50 * MS
    assert last_ns(made.answers(28)) == pytest.approx(START + S + 290 * MS, abs=25 * MS)
