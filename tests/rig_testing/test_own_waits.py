"""Waits that bypass the given clock are found; a driver that hangs is ended."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

import rig_testing
from daq.drivers.rotorlink.driver import DRIVER
from daq.lockstep.clock import SimulatedClock
from daq.transports import HostClock
from rig_testing import examination
from rig_testing.own_waits import own_waits

CLOCK, LOCK = SimulatedClock(), threading.Lock()


def waits_for_an_answer() -> None:
    with pytest.raises(queue.Empty):
        queue.Queue[int]().get(timeout=0.001)


@pytest.mark.parametrize(
    ("act", "name"),
    [
        (lambda: time.sleep(0.001), "time.sleep"),
        (time.monotonic, "time.monotonic"),
        (time.time, "time.time"),
        (lambda: threading.Event().wait(0.001), "threading.Event.wait"),
        (waits_for_an_answer, "queue.Queue.get"),
        (lambda: threading.Timer(0.0, int).start(), "threading.Thread.start"),
    ],
)
def test_a_call_is_found_with_its_place(act: Callable[[], object], name: str) -> None:
    with own_waits() as found:
        act()
    assert found[0].startswith(f"{name} at test_own_waits.py:")


def test_the_hosts_clock_is_found_as_well() -> None:
    clock = HostClock()
    with own_waits() as found:
        clock.wait(0.001)
    assert found[0].startswith("time.sleep at host_clock.py:")


def test_what_waits_on_the_simulated_clock_is_not_found() -> None:
    with own_waits() as found:
        CLOCK.wait(60.0)
        with pytest.raises(queue.Empty):
            CLOCK.queue().get(timeout=60.0)
        with LOCK:
            logging.getLogger("rig_testing.own_waits").error("a record of the log has a time")
    assert found == []


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
