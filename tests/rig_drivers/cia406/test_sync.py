"""CANopen encoders: SYNCs of other nodes, late and missing answers, and periods without a SYNC."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest

from daq.items import RX, TX
from rig_drivers.cia406.sync_sender import SyncSender
from tests.rig_drivers.cia406.test_encoders import SYNC, Line, bench_of, report, settings

ALL = report(3, 1), report(4, 1), report(5, 1)


def test_an_adapter_may_echo_the_sync_but_another_sender_is_a_fault() -> None:
    line = Line()
    for _ in range(3):
        line.period(SYNC, *ALL)
    assert line.losses == {}
    line.period(SYNC, *ALL, SYNC, *ALL)
    line.period(SYNC, *ALL, SYNC, *ALL)
    assert line.losses == {"foreign_syncs": 2, "unasked": 6}
    assert len(line.batches()) == 5
    (fault,) = line.events("fault")
    assert "another node sends SYNC" in fault.text


def test_an_echo_that_is_read_late_or_lost_is_no_fault() -> None:
    line = Line()
    for number in range(40):
        line.period(*([] if number % 10 == 4 else [SYNC]), *ALL, after_ms=60.0 if number % 7 == 3 else 1.0)
        line.now_ms += 60.0 * (number % 7 == 3)
    assert {**line.losses, "unsampled": 0, "late": 0, "samples": 0} == {"unsampled": 0, "late": 0, "samples": 0}
    assert line.events("fault") == []


def test_a_lost_echo_does_not_make_the_next_one_foreign() -> None:
    line = Line()
    line.period(*ALL)
    for _ in range(5):
        line.period(SYNC, *ALL)
    assert line.losses == {}


def without_echo(**other: Any) -> Line:
    line = Line(**other)
    for _ in range(5):
        line.period(*ALL)
    return line


def test_an_adapter_that_has_not_echoed_does_not_begin_to() -> None:
    line = without_echo()
    line.period(SYNC, *ALL, *ALL)
    assert line.losses == {"foreign_syncs": 1, "unasked": 3}
    assert len(line.batches()) == 5, "the reports may belong to either SYNC"
    line.period(*ALL)
    line.period(*ALL)
    line.at(0, RX, b"")
    assert line.losses == {"foreign_syncs": 1, "unasked": 3, "samples": 1}
    assert len(line.batches()) == 7
    assert len(line.events("fault")) == 1


def test_reports_to_a_foreign_sync_before_the_own_one_are_not_used() -> None:
    """The other node's SYNC is read before this host's is sent, its reports after it."""
    line = without_echo()
    line.period(*ALL)
    line.at(-0.4, RX, SYNC + report(3, 50))
    line.period(report(4, 50) + report(5, 50), *ALL)
    line.period(*ALL)
    line.at(0, RX, b"")
    assert line.losses["samples"] == line.losses["foreign_syncs"] == 1
    counts = [int(batch.columns["count_b"][0]) for batch in line.batches()]
    assert counts == [1] * 7


def test_a_foreign_sync_that_encoders_have_answered_in_time_costs_no_sample() -> None:
    line = without_echo()
    for _ in range(10):
        line.period(*ALL)
        line.at(-5.0, RX, SYNC)
        for data in ALL:
            line.at(-4.0, RX, data)
    line.period(*ALL)
    assert line.losses == {"foreign_syncs": 10, "unasked": 30}
    assert len(line.batches()) == 16


def test_a_foreign_sync_in_step_is_found_by_double_answers() -> None:
    """From the beginning of the log, shortly after each of this host's, at an adapter that does not echo."""
    line = Line()
    for _ in range(20):
        line.period(SYNC, *ALL, *ALL)
    assert line.losses["foreign_syncs"] == 20
    assert len(line.batches()) <= 3
    assert len(line.events("fault")) == 1


@pytest.mark.parametrize("step_ms", [0.0, 0.37, 3.0, 4.99])
@pytest.mark.parametrize("period_ms", [9.991, 23.0, 10.0])
def test_no_angle_of_a_drifting_foreign_sync_gets_the_time_of_an_own_one(period_ms: float, step_ms: float) -> None:
    """The encoders turn at 100 counts/ms and answer each SYNC after 0.9 ms."""
    own = [10.0 * number for number in range(300)]
    other = [step_ms + period_ms * number for number in range(int(2990 / period_ms))]
    frames = [(at + 0.1, TX, at) for at in own] + [(at + 0.2, RX, at) for at in other]
    answers = [(bus + 0.9, number) for number, (bus, _, _) in enumerate(sorted(frames))]
    line = Line()
    events: list[tuple[float, int, bytes]] = [(at, TX, SYNC) for at in own]
    events += [(at + 0.25, RX, SYNC) for at in other]
    for (at, _), (bus, _, _) in zip(answers, sorted(frames), strict=True):
        raw = int(bus * 100) % 4096
        events += [(at + 0.1 * (node - 3), RX, report(node, raw)) for node in (3, 4, 5)]
    for at, direction, data in sorted(events, key=lambda event: event[0]):
        line.at(at, direction, data)
    line.at(3000.0, RX, b"")
    errors = [
        math.remainder(int(batch.columns["count_a"][0]) - int(batch.time_ns[0]) / 10_000 - 10, 4096)
        for batch in line.batches()
    ]
    wrong = [error for error in errors if abs(error) > 1]
    assert len(wrong) <= 3, "only of the first SYNCs of a log"
    assert line.losses["foreign_syncs"] == len(other)
    assert line.losses.get("samples", 0) + len(line.batches()) >= len(own) - 1


class Host:
    """A sender of SYNC on simulated time, whose SYNCs are answered by hand."""

    def __init__(self) -> None:
        self.bench, _ = bench_of()
        self.sent_s: list[float] = []
        self.sender = SyncSender(
            settings(), lambda data: self.sent_s.append(self.bench.clock.now_s()), self.bench.clock
        )

    def rounds(self, number: int, first_s: float = 0.001, last_s: float = 0.001) -> None:
        for _ in range(number):
            self.until_next()
            self.bench.clock.wait(first_s)
            self.sender.heard(report(3, 1) + report(4, 1))
            self.bench.clock.wait(last_s)
            self.sender.heard(report(5, 1))

    def until_next(self) -> float:
        """Wait for the next SYNC; return the time since the one before, s."""
        count = len(self.sent_s)
        while len(self.sent_s) == count:
            self.bench.clock.wait(0.001)
        return self.sent_s[-1] - self.sent_s[-2] if count else 0.0


@pytest.mark.parametrize(
    ("last_s", "first_s", "answers", "pause_s"),
    [
        (0.001, 0.001, (3, 4), 0.013),  # one report is lost
        (0.001, 0.001, (), 0.2),  # nothing has answered: the host may be late
        (0.001, 0.006, (3, 4), 0.2),  # the SYNC may have left late: the report of the shaft is waited for
        (0.02, 0.001, (3, 4), 0.041),  # an adapter that passes reports on rarely
    ],
)
def test_the_wait_for_an_answer_follows_from_the_usual_ones(
    last_s: float, first_s: float, answers: tuple[int, ...], pause_s: float
) -> None:
    host = Host()
    host.sender.start()
    host.rounds(20, last_s=last_s)
    host.until_next()
    host.bench.clock.wait(first_s)
    host.sender.heard(b"".join(report(node, 1) for node in answers))
    pause = host.until_next()
    host.sender.stop()
    assert pause == pytest.approx(pause_s, abs=0.004)


def test_reports_that_come_after_they_were_given_up_make_the_wait_longer() -> None:
    host = Host()
    pauses: list[float] = []
    host.sender.start()
    host.rounds(20)
    for _ in range(12):
        host.until_next()
        host.bench.clock.wait(0.001)
        host.sender.heard(report(3, 1) + report(4, 1))
        pauses.append(host.until_next())
        host.sender.heard(report(5, 1))  # of the SYNC before
        host.bench.clock.wait(0.001)
        host.sender.heard(report(3, 1) + report(4, 1) + report(5, 1))
    host.sender.stop()
    assert pauses[0] == pytest.approx(0.013, abs=0.004)
    assert pauses[-1] > 0.02


@pytest.mark.parametrize("answers", [(3, 4), ()])
def test_a_report_that_is_missing_is_waited_for_after_the_next_sync_too(answers: tuple[int, ...]) -> None:
    """Of two reports the second one is the answer: with a SYNC between them, the first one would be taken for it."""
    host = Host()
    everyone = report(3, 1) + report(4, 1) + report(5, 1)
    host.sender.start()
    host.rounds(20)
    host.until_next()
    host.bench.clock.wait(0.001)
    host.sender.heard(b"".join(report(node, 1) for node in answers))
    host.until_next()
    count = len(host.sent_s)
    host.sender.heard(everyone)  # the shaft's first report is late, or all are
    host.bench.clock.wait(0.01)
    assert len(host.sent_s) == count, "the second report has not come yet"
    host.sender.heard(report(5, 1) if answers else everyone)
    assert len(host.sent_s) == count + 1
    host.sender.stop()


def test_a_report_that_never_comes_delays_two_syncs_by_the_shortest_wait() -> None:
    host = Host()
    host.sender.start()
    host.rounds(20)
    host.until_next()
    host.bench.clock.wait(0.001)
    host.sender.heard(report(3, 1) + report(4, 1))
    count = len(host.sent_s)
    for _ in range(2):
        host.until_next()
        host.bench.clock.wait(0.001)
        host.sender.heard(report(3, 1) + report(4, 1) + report(5, 1))
    host.sender.stop()
    pauses = [after - before for before, after in pairwise(host.sent_s[count - 1 :])]
    assert pauses == pytest.approx([0.014, 0.014, 0.001], abs=0.002), "the last one is overdue"


def test_periods_without_a_sync_are_counted() -> None:
    line = Line()
    line.all_answer()
    line.now_ms += 200.0
    line.period(*ALL)
    line.now_ms -= 8.0  # the SYNC after a late one comes at once
    for _ in range(21):
        line.all_answer()
    for _ in range(100):  # 13 ms instead of 10 ms
        line.now_ms += 3.0
        line.all_answer()
    line.at(0, RX, b"")
    periods = round(line.now_ms / 10.0)
    assert line.losses == {"unsampled": pytest.approx(periods - 123, abs=1)}
    gaps = line.events("gap")
    assert sum(event.facts["unsampled"] for event in gaps) == line.losses["unsampled"]
    assert (gaps[0].facts["unsampled"], gaps[0].facts["span_s"]) == (19, pytest.approx(0.19))


def test_a_host_that_is_late_by_less_than_a_period_has_sent_all_syncs() -> None:
    line = Line()
    for number in range(3000):
        late = 9.0 if number % 50 == 49 else 0.001 * (number % 3)
        line.at(late, TX, SYNC)
        line.at(late + 0.5, RX, b"".join(ALL))
        line.now_ms += 10.0001
    assert line.losses == {}


def test_a_report_that_comes_after_the_next_sync_does_not_get_its_time() -> None:
    line = Line()
    for _ in range(3):
        line.all_answer(100)
    line.period(report(3, 200), report(5, 200))
    line.period(report(4, 200), report(3, 300) + report(4, 300) + report(5, 300))  # B's first one is late
    line.all_answer(400)
    counts = [(int(batch.sequence[0]), int(batch.columns["count_b"][0])) for batch in line.batches()]
    assert counts == [(0, 100), (1, 100), (2, 100), (4, 300), (5, 400)]
    assert line.losses == {"samples": 1, "reports": 1, "unasked": 1}


def test_answers_from_before_a_stall_do_not_get_the_time_of_the_sync_after_it() -> None:
    """The host is suspended, or the adapter stands still, for longer than the host waits for answers."""
    line = Line()
    for _ in range(3):
        line.all_answer(100)
    line.period()
    line.now_ms += 340.0
    before, after = (b"".join(report(node, position) for node in (3, 4, 5)) for position in (200, 300))
    line.period(before, after)
    line.all_answer(400)
    counts = [(int(batch.sequence[0]), int(batch.columns["count_a"][0])) for batch in line.batches()]
    assert counts == [(0, 100), (1, 100), (2, 100), (4, 300), (5, 400)]
    assert {**line.losses, "unsampled": 0} == {"samples": 1, "reports": 3, "unasked": 3, "unsampled": 0}
