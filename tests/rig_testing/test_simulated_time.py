"""Simulated time: waits cost nothing, threads take turns, and afterwards everything is as it was."""

from __future__ import annotations

import itertools
import queue
import threading
import time
from dataclasses import replace
from typing import Any

import pytest

import rig_testing
from daq.drivers.rotorlink.driver import DRIVER
from rig_testing import examination
from rig_testing.simulated_time import EndlessWait, SimulatedTime

MINUTE_S = 60.0


def real() -> list[Any]:
    return [
        time.sleep,
        time.monotonic,
        time.monotonic_ns,
        threading.Thread.start,
        threading.Thread.join,
        threading.Event.wait,
        queue.Queue.get,
    ]


def test_waits_of_minutes_take_no_time_and_the_rig_moves_meanwhile() -> None:
    moved: list[float] = []
    simulated, before, began = SimulatedTime(moved.append), real(), time.perf_counter()
    with simulated.running():
        time.sleep(MINUTE_S)
        assert simulated.now_s == pytest.approx(MINUTE_S)
        assert not threading.Event().wait(MINUTE_S)
        with pytest.raises(queue.Empty):
            queue.Queue[int]().get(timeout=MINUTE_S)
        deadline = time.monotonic() + 0.5
        while time.monotonic() < deadline:  # a loop around the clock alone ends too
            pass
    assert time.perf_counter() - began < MINUTE_S
    assert moved == sorted(moved)
    assert max(b - a for a, b in itertools.pairwise([0.0, *moved])) < 0.02
    assert real() == before


def test_what_never_comes_is_an_error_not_a_hang() -> None:
    with SimulatedTime(lambda now: None).running(), pytest.raises(EndlessWait):
        queue.Queue[int]().get()


def beats(seconds: float) -> list[tuple[str, float]]:
    """What two threads and their starter did, and when."""
    out: list[tuple[str, float]] = []
    simulated = SimulatedTime(lambda now: None)
    with simulated.running():
        ending = threading.Event()

        def by_sleep() -> None:
            while not ending.is_set():
                out.append(("sleeps", simulated.now_s))
                time.sleep(0.03)

        def by_event() -> None:
            while not ending.wait(0.05):
                out.append(("waits", simulated.now_s))

        threads = [threading.Thread(target=act, daemon=True) for act in (by_sleep, by_event)]
        for thread in threads:
            thread.start()
        for _ in range(round(seconds / 0.1)):
            out.append(("main", simulated.now_s))
            time.sleep(0.1)
        ending.set()
        for thread in threads:
            thread.join(timeout=2.0)
        assert not any(thread.is_alive() for thread in threads)
    return out


def test_threads_take_turns_the_same_way_each_time() -> None:
    first = beats(1.0)
    assert sum(who == "sleeps" for who, _ in first) == pytest.approx(33, abs=2)
    assert sum(who == "waits" for who, _ in first) == pytest.approx(20, abs=2)
    assert all(beats(1.0) == first for _ in range(5))


def test_a_foreign_thread_keeps_the_real_time() -> None:
    slept: list[float] = []
    go = threading.Event()

    def stranger() -> None:
        go.wait()
        began = time.perf_counter()
        time.sleep(0.05)
        slept.append(time.perf_counter() - began)

    thread = threading.Thread(target=stranger)
    thread.start()
    with SimulatedTime(lambda now: None).running():
        go.set()
        time.sleep(MINUTE_S)
    thread.join()
    assert slept[0] >= 0.05


def test_a_thread_that_is_left_over_goes_on_in_real_time() -> None:
    ended = threading.Event()

    def left() -> None:
        time.sleep(MINUTE_S)
        ended.set()

    with SimulatedTime(lambda now: None).running():
        threading.Thread(target=left, daemon=True).start()
    assert ended.wait(5.0)


@pytest.mark.skipif(not hasattr(examination.signal, "setitimer"), reason="nothing here can end what hangs")
def test_a_driver_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(device: str, settings: Any, talk: Any) -> dict[str, Any]:
        while True:
            pass

    monkeypatch.setattr(examination, "_LONGEST_S", 0.3)
    (case,) = [case for case in rig_testing.cases(replace(DRIVER, open=endless)) if case.name == "opening dialogue"]
    outcome = case.run()
    assert not outcome.passed
    assert "it hangs" in outcome.why
