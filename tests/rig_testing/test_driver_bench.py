"""A simulated device of the kit: what it starts ends with it."""

from __future__ import annotations

import threading

import pytest

from daq.drivers.registry import driver
from rig_testing.bench import DriverBench


@pytest.mark.parametrize("name", ["labjack", "vesc", "cia402", "modbus_converter"])
def test_threads_of_polls_and_commands_end_with_the_simulated_time(name: str) -> None:
    """Those of earlier benches took a third of the time of a whole run of the tests."""
    before = set(threading.enumerate())
    bench = DriverBench(driver(name))
    with bench.running():
        bench.begin()
        begun = set(threading.enumerate()) - before
    assert begun, "this driver starts a thread"
    assert not any(thread.is_alive() for thread in begun)


def test_threads_end_also_if_the_test_fails() -> None:
    before = set(threading.enumerate())

    def fail() -> None:
        bench = DriverBench(driver("labjack"))
        with bench.running():
            bench.begin()
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert set(threading.enumerate()) <= before
