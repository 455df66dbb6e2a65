"""Polling of a device: the times of its requests, with answers, without them, and after the end."""

from __future__ import annotations

from itertools import pairwise

import pytest

from daq.drivers.polling import Request, RequestLoop
from daq.errors import LinkLost
from daq.lockstep.clock import SimulatedClock

START_NS = 1_700_000_000_000_000_000


class Line:
    """A device that answers after a time, on a simulated clock; a `delay_s` of None is no answer."""

    def __init__(self, delay_s: float | None, period_s: float = 0.1) -> None:
        self.clock = SimulatedClock(START_NS)
        self.delay_s = delay_s
        self.asked_s: list[float] = []
        self.is_there = True
        self.loop = RequestLoop(Request(lambda _: b"M1\r", b"\r", period_s, 0.5), self.send, self.clock)

    def send(self, data: bytes) -> None:
        if not self.is_there:
            raise LinkLost("gone")
        assert data == b"M1\r"
        self.asked_s.append(self.clock.now_s())
        if self.delay_s is not None:
            self.clock.after(self.delay_s, lambda: self.loop.heard(b"M1,+01.0000\r"))

    def run(self, seconds: float) -> list[float]:
        before = len(self.asked_s)
        self.clock.wait(seconds)
        return self.asked_s[before:]


def test_requests_follow_at_their_period() -> None:
    line = Line(0.003)
    line.loop.start()
    asked = line.run(10.0)
    assert len(asked) == pytest.approx(100, abs=1)
    assert asked[-1] - asked[0] == pytest.approx(0.1 * (len(asked) - 1), abs=0.03)


def test_a_slow_device_is_asked_as_soon_as_it_has_answered() -> None:
    line = Line(0.25)
    line.loop.start()
    asked = line.run(5.0)
    assert [b - a for a, b in pairwise(asked)] == pytest.approx([0.25] * (len(asked) - 1), abs=0.001)


def test_a_hurried_request_does_not_wait_for_its_period() -> None:
    line = Line(0.003, period_s=0.4)
    line.loop.start()
    line.run(1.05)
    line.loop.hurry()
    assert len(line.run(0.15)) == 1
    assert line.run(0.15) == []


def test_an_answer_in_parts_counts_with_its_end() -> None:
    line = Line(None)
    line.loop.start()
    assert len(line.run(0.2)) == 1
    line.loop.heard(b"M1,+0")
    assert line.run(0.1) == []
    line.loop.heard(b"1.0000\r")
    assert len(line.asked_s) == 2


@pytest.mark.parametrize("parts", [[b"M1\r"], [b"\nM", b"1", b"\r"], [b"M", b"1\rM"]])
def test_the_echo_of_a_request_is_no_answer(parts: list[bytes]) -> None:
    line = Line(None)
    line.loop.start()
    assert len(line.run(0.05)) == 1
    for part in parts:
        line.loop.heard(part)
    assert line.run(0.3) == [], "the answer is still to come"
    line.loop.heard(b"M1,+01.0000\r"[parts[-1].endswith(b"M") :])
    assert len(line.asked_s) == 2


def test_an_answer_that_begins_like_the_request_is_one() -> None:
    line = Line(None)
    line.loop.start()
    line.run(0.2)
    line.loop.heard(b"M1")
    line.loop.heard(b",+01.0000\r")
    assert len(line.asked_s) == 2


def test_a_request_without_an_answer_is_given_up() -> None:
    line = Line(None)
    line.loop.start()
    asked = line.run(5.0)
    assert [b - a for a, b in pairwise(asked)] == pytest.approx([0.5] * (len(asked) - 1), abs=0.03)
    assert len(asked) == pytest.approx(10, abs=1)


def test_a_lost_link_is_polled_again_when_it_is_back() -> None:
    line = Line(0.003)
    line.loop.start()
    line.is_there = False
    assert line.run(2.0) == []
    line.is_there = True
    assert len(line.run(2.0)) > 10


def test_nothing_is_sent_before_the_start_and_after_the_end() -> None:
    line = Line(0.003)
    assert line.run(1.0) == []
    line.loop.start()
    line.loop.start()  # a second start does not double the requests
    assert len(line.run(1.0)) == pytest.approx(10, abs=1)
    line.loop.stop()
    line.loop.heard(b"\r")
    assert line.run(1.0) == []


def test_requests_are_numbered_from_zero_and_a_new_start_continues() -> None:
    clock, numbers = SimulatedClock(START_NS), list[int]()
    loop = RequestLoop(Request(lambda number: bytes([number]), b"", 0.1, 0.5), numbers.extend, clock)
    for _ in range(2):
        loop.start()
        for _ in range(3):
            clock.wait(0.11)
            loop.heard(b"any bytes")
        loop.stop()
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 6
