"""Rates of devices against the rig file: wrong rates are reported despite an irregular line, correct rates are not."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq import channels
from daq.acquisition.rate_watch import RateWatch, RateWatches
from daq.drivers.contract import SampleClock
from daq.drivers.optoncdt import wire as optoncdt
from daq.items import Batch, DeviceEvent
from rig_configs import load_rig

DEVICES = load_rig("virtual").devices
T0 = 1_700_000_000_000_000_000


def laser(
    watches: RateWatches,
    rate_Hz: float,
    clock: float,
    seconds: float,
    seed: int = 0,
    stalls: tuple[tuple[float, float], ...] = (),
    delay_s: float = 2e-3,
    start_s: float = 0.0,
) -> list[DeviceEvent]:
    """Reads every 20 ms of a sensor that makes `rate_Hz` samples a host second, its clock `clock` times ours."""
    rng = np.random.default_rng(seed)
    events: list[DeviceEvent] = []
    before = int(start_s * rate_Hz)
    for at in start_s + 0.02 * np.arange(1, round(seconds / 0.02) + 1):
        if any(begin < at - start_s < begin + length for begin, length in stalls):
            continue  # the host dozes: all comes at once afterwards
        upto = int(at * rate_Hz)
        if upto == before:
            continue
        number = np.arange(before, upto)
        before = upto
        ticks = np.rint(number / rate_Hz * clock * 1e5).astype(np.uint64)
        counter = (number % optoncdt.COUNTER_WRAP).astype(np.uint32)
        columns = {"device_ticks": ticks, "counter": counter}
        host_ns = T0 + int((at + rng.exponential(delay_s)) * 1e9)
        batch = Batch(channels.LASER_X, T0 + ticks.astype(np.int64) * 10_000, counter, columns)
        events += watches.feed([batch], host_ns)
    return events


@settings(max_examples=25)
@given(
    ppm=st.floats(-80, 80),
    seed=st.integers(0, 2**31),
    stall=st.floats(0, 15),
    length=st.floats(0, 2.5),
    delay_s=st.floats(1e-4, 2e-2),
)
def test_a_clock_within_its_tolerance_is_never_called_wrong(ppm, seed, stall, length, delay_s) -> None:
    watches = RateWatches(DEVICES)
    clock = 1 + ppm * 1e-6
    assert laser(watches, 4000 * clock, clock, 18.0, seed, ((stall, length),), delay_s) == []
    assert watches.summary() == ""
    rate = watches.rates()["laser/x"]
    assert rate.ok
    assert abs(rate.clock_ppm - ppm) < rate.bound_ppm


@pytest.mark.parametrize(
    ("rate_Hz", "clock", "words"),
    [
        (3656.0, 0.914, "Hz instead of 4000 Hz"),  # the sensor's clock is slow and its samples with it
        (4090.0, 1.0225, "Hz instead of 4000 Hz"),
        (4090.0, 1.0, "Hz instead of 4000 Hz"),  # its clock is right, its rate is not
        (7911.0, 1.97775, "Hz instead of 4000 Hz"),
        (4008.0, 1.002, "Hz instead of 4000 Hz"),
        (4000.0, 1.002, "its clock runs"),  # its clock is wrong, its rate is not
    ],
)
def test_a_wrong_rate_or_clock_is_an_event_and_counted(rate_Hz: float, clock: float, words: str) -> None:
    watches = RateWatches(DEVICES)
    events = laser(watches, rate_Hz, clock, 20.0)
    assert [(e.kind, e.device) for e in events] == [("rate", "host")]  # once, and never for a replay to make again
    assert words in events[0].text
    assert events[0].text.startswith("laser/x: ")
    assert events[0].facts["rate_Hz"] == pytest.approx(rate_Hz, rel=1e-3)
    assert words in watches.now()
    assert words in watches.summary()


def test_a_rate_that_comes_back_is_reported_too() -> None:
    watches = RateWatches(DEVICES)
    assert len(laser(watches, 4400.0, 1.1, 12.0)) == 1
    back = laser(watches, 4000.0, 1.0, 50.0, start_s=100.0)
    assert len(back) == 1
    assert back[0].text.startswith("laser/x: back at ")
    assert back[0].facts["rate_Hz"] == pytest.approx(4000, rel=2e-3)
    assert watches.now() == ""
    assert "laser/x: 44" in watches.summary()


def test_two_seconds_show_twice_the_rate_and_admit_what_they_do_not_show() -> None:
    watches = RateWatches(DEVICES)
    laser(watches, 7911.0, 1.97775, 2.0)
    rate = watches.rates()["laser/x"]
    assert not rate.rate_ok
    assert rate.rate_Hz == pytest.approx(7911, rel=5e-3)
    watches = RateWatches(DEVICES)
    laser(watches, 4000.0, 1.0, 2.0)
    rate = watches.rates()["laser/x"]
    assert rate.ok
    assert not rate.certain
    assert RateWatches(DEVICES).rates()["laser/x"] is None


def reads_of(device_s: Callable[[float], float], seconds: float) -> Iterator[tuple[Batch, int]]:
    """Yield a batch and its host time, ns, every 20 ms: the samples up to a time of the device, at 4 kHz."""
    count = 0
    for read in range(1, round(seconds / 0.02)):
        numbers = np.arange(count, int(4000 * device_s(0.02 * read)))
        if len(numbers):
            count = int(numbers[-1]) + 1
            counter = (numbers % optoncdt.COUNTER_WRAP).astype(np.uint32)
            columns = {"device_ticks": (25 * numbers).astype(np.uint64)}
            yield Batch(channels.LASER_X, 250_000 * numbers, counter, columns), 20_000_000 * read


def test_a_host_that_catches_up_is_no_wrong_rate() -> None:
    """It is half a second behind, and makes up for it in another half."""
    watches = RateWatches(DEVICES)
    late = reads_of(lambda host_s: max(0.0, min(host_s, 2 * (host_s - 0.5))), 8.0)
    assert [event for batch, host_ns in late for event in watches.feed([batch], host_ns)] == []


def test_a_restart_begins_the_rate_again() -> None:
    """A counter that did not count while the device was set up again does not make its rate wrong."""
    watches, found = RateWatches(DEVICES), list[DeviceEvent]()
    for batch, host_ns in reads_of(lambda host_s: host_s, 15.0):
        found += watches.feed([batch], host_ns)
    found += watches.feed([DeviceEvent("restart", "laser_x", "its counter restarts")], 15 * 10**9)
    for batch, host_ns in reads_of(lambda host_s: host_s, 15.0):
        batch.columns["device_ticks"] += np.uint64(25 * 4000 * 15 + 250_000)
        found += watches.feed([batch], host_ns + 17_500_000_000)
    assert found == []
    assert watches.rates()["laser/x"].rate_Hz == pytest.approx(4000.0, rel=1e-4)


def test_a_counter_that_begins_again_several_times_in_one_read_counts_all_samples() -> None:
    """A counter of four bits in a CAN message; the host reads 40 frames at once."""
    watch = RateWatch(SampleClock("laser/x", 1000.0, 30.0, "device_ticks", 10_000, 16))
    for read in range(500):
        numbers = np.arange(40 * read, 40 * read + 40)
        columns = {"device_ticks": (100 * numbers).astype(np.uint64)}
        batch = Batch(channels.LASER_X, 1_000_000 * numbers, (numbers % 16).astype(np.uint32), columns)
        watch.feed(batch, 40_000_000 * read)
    rate = watch.rate()
    assert rate.rate_Hz == pytest.approx(1000.0, rel=1e-4)
    assert rate.ok
