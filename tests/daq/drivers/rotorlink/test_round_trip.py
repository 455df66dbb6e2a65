"""The delay of a node's stamps, from the round trip of requests to it."""

from __future__ import annotations

import queue
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, strategies as st

from daq.acquisition.device_check import device_checks
from daq.drivers.checks import DeviceCheck
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.rotorlink.locks import NodeLocks
from daq.items import RX, DeviceEvent
from daq.transports.host_clock import HostClock
from rig_configs import load_rig
from rig_configs.schema import Rig
from tests.daq.acquisition.test_device_check import healthy
from tests.daq.drivers.rotorlink.test_rotorlink_limits import START_NS, Line, mark

MS = 1_000_000


def delay(round_trip_s: float | None, least_delay_s: float = 0.0, rig_name: str = "virtual") -> DeviceCheck | None:
    """The check of a rig file with this stated delay."""
    rig: Rig = load_rig(rig_name, settings=[f"devices.encoder.least_delay_s={least_delay_s}"] if least_delay_s else [])
    return device_checks(rig, replace(healthy(), round_trip_s=round_trip_s))["encoder"].get("delay_ms")


class Far:
    """A node whose clock starts at START_NS, behind a radio with these delays; it loses some of the requests."""

    def __init__(self, there_ns: int, back_ns: int, lost: frozenset[int] = frozenset()) -> None:
        self.line, self.there_ns, self.back_ns, self.lost, self.pings = Line(), there_ns, back_ns, lost, 0
        self.now_ns, self.seq = START_NS, 0
        self.clock = Wound(self)
        self.locks = NodeLocks(self.receive, self.clock, 1)
        for _ in range(50):
            self.seq, self.now_ns = self.seq + 1, self.now_ns + 20 * MS
            self.answer(mark(self.seq, (self.now_ns - START_NS) // 1000), self.back_ns)

    def answer(self, payload: bytes, after_ns: int) -> None:
        for item in self.line.pipeline.feed(RX, rotorlink.wire(payload), self.now_ns + after_ns):
            if isinstance(item, DeviceEvent) and "ping_seq" in item.facts:
                self.locks.heard(item)

    def receive(self, data: bytes) -> None:
        (frame,) = FrameDecoder().feed(data).frames
        assert isinstance(frame, rotorlink.Ping)
        self.pings += 1
        if self.pings in self.lost:
            return
        self.seq += 1
        us = (self.now_ns + self.there_ns - START_NS) // 1000
        pong = rotorlink.Pong(1, self.seq, us, us + 40, frame.seq).pack()
        self.answer(pong, self.there_ns + self.back_ns + 40_000 * self.pings)  # answers wait more and more


class Impatient(queue.Queue[Any]):
    """A queue whose `get` does not wait."""

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        del block, timeout
        return super().get(block=False)


class Wound(HostClock):
    """A clock that passes when something waits on it."""

    def __init__(self, far: Far) -> None:
        super().__init__()
        self._far = far

    def now_ns(self) -> int:
        return self._far.now_ns

    def now_s(self) -> float:
        self._far.now_ns += MS
        return self._far.now_ns * 1e-9

    def queue(self) -> Any:
        return Impatient()


@given(there_ms=st.floats(0.1, 20), back_ms=st.floats(0.1, 20), lost=st.frozensets(st.integers(1, 20), max_size=19))
def test_the_round_trip_is_the_sum_of_both_ways(there_ms: float, back_ms: float, lost: frozenset[int]) -> None:
    found = Far(round(there_ms * MS), round(back_ms * MS), lost).locks.measure_round_trip()
    assert found == pytest.approx(1e-3 * (there_ms + back_ms), abs=1e-4)


def test_without_an_answer_there_is_no_round_trip() -> None:
    assert Far(MS, MS, frozenset(range(100))).locks.measure_round_trip() is None


@pytest.mark.parametrize(("round_trip_s", "least_delay_s"), [(0.9e-3, 0.0), (0.4e-3, 0.5e-3), (1e-4, 4e-4)])
def test_a_short_way_or_a_well_stated_one_passes(round_trip_s: float, least_delay_s: float) -> None:
    found = delay(round_trip_s, least_delay_s)
    assert found is not None
    assert found.passed is True
    assert abs(found.value) <= 1.0


def test_a_long_way_is_named_with_its_angle() -> None:
    found = delay(12e-3)
    assert found is not None
    assert found.passed is None
    assert found.value == 6.0
    assert all(words in found.note for words in ("± 6", "86° of the phase at 1200 rpm", "least_delay_s"))


def test_a_stated_delay_above_the_whole_round_trip_fails() -> None:
    found = delay(3e-3 - 20e-3, least_delay_s=20e-3)
    assert found is not None
    assert found.passed is False
    assert found.value == pytest.approx(-18.5)
    assert "least_delay_s = 0.02 exceeds the whole round trip" in found.note


def test_answers_before_their_request_are_no_measure_of_the_way() -> None:
    """The clock map of a host under load is late by more than the way; 0 ± 0 ms was stated."""
    found = delay(-21e-3, least_delay_s=20e-3)
    assert found is not None
    assert (found.passed, found.value) == (None, None)
    assert "requests came 1 ms before they were sent" in found.note


def test_a_way_that_was_not_measured_is_not_resolved() -> None:
    found = delay(None)
    assert found is not None
    assert found.passed is None
    assert "not measured" in found.note


def test_marks_and_displacements_with_one_clock_have_no_shift() -> None:
    rig = load_rig("analogue_lasers")
    look = replace(
        healthy(),
        displacements={d.topic: healthy().displacements["laser/x"] for d in rig.roles.displacements},
        rates={**healthy().rates, **{d.topic: None for d in rig.roles.displacements}},
        host_rates_Hz={},
    )
    assert "delay_ms" not in device_checks(rig, look)["daq_box"]
