"""A clock of two processes that stops while either is late: on simulated time, and around a rig that is stopped."""

from __future__ import annotations

import os
import subprocess
import sys
import time as real_time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

import pytest
from hypothesis import given, strategies as st

from daq.acquisition.session import Session
from daq.transports import open_link, paced_clock, wires
from daq.transports.paced_clock import PacedClock
from daq.transports.wires import PtyWire
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig

RATE = 8.0
STEP_S, HOST_GONE_S, RIG_GONE_S = paced_clock._STEP_S, paced_clock._HOST_GONE_S, paced_clock._RIG_GONE_S
on_ptys = pytest.mark.skipif(sys.platform == "win32", reason="ptys and signals need POSIX")


class MadeUpTime:
    """In the place of the module `time`."""

    def __init__(self) -> None:
        self.now_s = 5000.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def _soon(condition: Callable[[], bool]) -> bool:
    """Whether it comes true; a terminal hands bytes on a moment later."""
    end = real_time.monotonic() + 5.0
    while not (met := condition()) and real_time.monotonic() < end:
        pass
    return met


class Two:
    """A host's clock and its rig's, on made-up time."""

    def __init__(self, time: MadeUpTime) -> None:
        self.time = time
        self.host = PacedClock(RATE)
        self.rig = PacedClock(RATE, self.host.path)
        self.start_ns = self.host.now_ns()

    def passed_s(self) -> float:
        """Rig time since the beginning by the rig's clock, s."""
        return (self.rig.now_ns() - self.start_ns) * 1e-9

    def go(self, wall_s: float, looks: bool = True, held_up: bool = False, steps: bool = True) -> float:
        """Some wall time in looks of 2 ms; the rig time that passed, s."""
        before = self.passed_s()
        for _ in range(round(wall_s / 0.002)):
            self.time.now_s += 0.002
            if looks:
                self.host.now_ns()
            if steps:
                self.rig.go_on(lambda: held_up)
        return self.passed_s() - before


@contextmanager
def two_clocks() -> Iterator[Two]:
    time = MadeUpTime()
    with patch.object(paced_clock, "time", time):
        two = Two(time)
        yield two
        two.rig.close()
        assert two.host.path.exists()
        two.host.close()
        assert not two.host.path.exists()


@pytest.fixture
def two() -> Iterator[Two]:
    with two_clocks() as both:
        yield both


def test_time_passes_at_its_rate_in_both_processes_while_neither_is_late(two: Two) -> None:
    assert two.go(10.0) == pytest.approx(80.0, abs=1e-6)
    assert two.host.now_ns() == two.rig.now_ns()
    assert two.host.wall_s() == pytest.approx(two.host.now_ns() * 1e-9 / RATE)


def test_time_stands_while_the_rig_is_late_and_goes_on_from_there(two: Two) -> None:
    two.go(1.0)
    assert two.go(1.0, steps=False) <= RATE * STEP_S + 1e-6
    assert two.go(1.0) == pytest.approx(RATE, rel=0.003)


def test_time_stands_while_bytes_wait_for_the_host(two: Two) -> None:
    two.go(1.0)
    assert two.go(5.0, held_up=True) <= RATE * STEP_S + 1e-6
    assert two.go(1.0) == pytest.approx(RATE, rel=0.003)


def test_time_stands_while_the_host_does_not_look_but_not_for_one_that_has_gone(two: Two) -> None:
    two.go(1.0)
    assert two.go(HOST_GONE_S - 0.01, looks=False) <= 2 * RATE * STEP_S + 1e-6
    assert two.go(2.0, looks=False) > RATE * 1.9


def test_time_passes_again_where_the_rig_has_died_and_waits_come_to_their_ends(two: Two) -> None:
    two.go(1.0)
    before = two.time.now_s
    two.host.sleep(2 * RATE)
    assert two.time.now_s - before == pytest.approx(RIG_GONE_S + 2.0, abs=0.001)


def test_a_sleep_lasts_its_duration_in_rig_time(two: Two) -> None:
    two.go(1.0)
    begun_ns = two.host.now_ns()
    two.host.sleep(1.0)  # no word of the rig: 0.2 s pass, then it takes until the rig counts as gone
    assert two.host.now_ns() - begun_ns == pytest.approx(1e9, abs=1e7)
    two.host.sleep(-1.0)


def test_time_does_not_stop_for_programs_that_do_not_share_it(two: Two) -> None:
    two.go(1.0)
    two.go(HOST_GONE_S + 0.1, looks=False)
    assert two.go(1.0, looks=False, held_up=True) == pytest.approx(RATE)
    assert two.go(0.5, looks=False, steps=False) == pytest.approx(0.5 * RATE)  # its rig catches up, too


@given(st.lists(st.tuples(st.floats(0.0, 4.0), st.sampled_from(["look", "go on", "held up", "both"])), max_size=60))
def test_time_never_steps_back_nor_runs_faster_than_its_rate(steps: list[tuple[float, str]]) -> None:
    with two_clocks() as two:
        last_ns, last_s = two.rig.now_ns(), two.time.now_s
        for wall_s, what in steps:
            two.time.now_s += wall_s
            if what in {"look", "both"}:
                assert two.host.now_ns() == two.rig.now_ns()
            if what != "look":
                before = two.rig.now_ns()
                two.rig.go_on(lambda: what == "held up")  # noqa: B023 (called at once)
                assert abs(two.rig.now_ns() - before) <= 1
            now_ns = two.rig.now_ns()
            assert -1 <= now_ns - last_ns <= RATE * 1e9 * (two.time.now_s - last_s) + 10
            last_ns, last_s = now_ns, two.time.now_s


@on_ptys
def test_a_cable_holds_time_up_until_its_host_has_fetched_all_or_does_not_fetch() -> None:
    time = MadeUpTime()
    with patch.object(wires, "time", time):
        wire = PtyWire()
        link = open_link(wire.port, 921_600)
        assert not wire.held_up()
        wire.send(b"x" * 100_000)
        assert wire.held_up()
        fetched = 0
        while fetched < 100_000:
            fetched += len(link.read(1.0))
            wire.send(b"")
        assert not wire.held_up()
        wire.send(b"y")
        assert _soon(wire.held_up)
        time.now_s += 0.6  # no program reads it …
        assert not wire.held_up()
        wire.send(b"z")
        assert not wire.held_up()
        fetched = 0
        while fetched < 2:
            fetched += len(link.read(1.0))
        assert not wire.held_up()
        wire.send(b"z")
        assert _soon(wire.held_up)  # … until one does
        link.close()
        wire.close()


@on_ptys
@pytest.mark.parametrize("late", ["rig", "host"])
def test_a_process_that_gets_no_processor_for_a_while_stops_no_rotor(late: str) -> None:
    """1.2 s at eightfold speed: 9.6 s of silence, or without a heartbeat, where time does not wait."""
    with VirtualRigProcess("virtual", ["virtual.seed=3"], RATE, waits=True) as far:
        rig = load_rig("virtual", settings=far.port_settings())
        with Session(rig, far.clock) as session:
            session.drive.enable()
            session.drive.set_speed(300.0)
            session.wait_for(lambda: session.drive.actual_rpm > 250.0, 10.0, "the rotor to turn")
            before_s = far.clock.now_s()
            stopped = far._process.pid if late == "rig" else os.getpid()
            begun_s = real_time.monotonic()
            script = f"kill -STOP {stopped}; sleep 1.2; kill -CONT {stopped}"
            subprocess.run(["sh", "-c", script], check=True)
            session.wait_for(lambda: far.clock.now_s() > before_s + 5.0, 10.0, "five seconds of rig time")
            session.check()
            assert session.notices == []
            wall_s = real_time.monotonic() - begun_s
            assert far.clock.now_s() - before_s < RATE * (wall_s - 0.9)
