"""Clock maps are continuous, strictly increasing and accurate; the intervals of the rates contain the true rates."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from daq.clock import ClockMap, ClockSeed, Unwrap, fit_line
from daq.errors import DeviceError


def reads(rng: np.random.Generator, seconds: float, drift: float, delay_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Device time and host time of the last sample of each read, s: host = device/(1+drift) + delay."""
    true = np.cumsum(rng.uniform(0.002, 0.02, int(seconds / 0.011)))
    return (1 + drift) * true, true + 3e-4 + rng.exponential(delay_s, len(true))


@given(
    drift=st.floats(-2e-4, 2e-4),
    delay_s=st.floats(1e-5, 2e-2),
    seed=st.integers(0, 2**32 - 1),
)
def test_map_is_strictly_increasing_and_close(drift: float, delay_s: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    device_s, host_s = reads(rng, 20.0, drift, delay_s)
    clock = ClockMap(tolerance_ppm=50.0)
    start = 1_700_000_000_000_000_000
    mapped, last = [], 0
    for d, h in zip(device_s, host_s, strict=True):
        samples = np.arange(last + 250_000, int(d * 1e9) + 1, 250_000)
        if len(samples):
            mapped.append((samples, clock.map(samples, start + int(h * 1e9))))
            last = int(samples[-1])
    times = np.concatenate([m for _, m in mapped])
    true = np.concatenate([s for s, _ in mapped]) / (1 + drift)
    assert np.all(np.diff(times) > 0)
    late = true > 5e9  # after the first seconds only the constant floor and little of the jitter remain
    error = times[late] - start - true[late] - 3e5
    assert np.max(np.abs(error)) < 1e9 * (0.5 * delay_s + 3e-4)


@given(
    count=st.integers(2, 2000),
    gap_s=st.floats(0.4, 60.0),
    late_s=st.floats(0.0, 0.2),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_correction_ends_in_a_gap(count: int, gap_s: float, late_s: float, seed: int) -> None:
    """A first read that came late is made good in time; not again and again while the stream is broken off."""
    rng = np.random.default_rng(seed)
    device_s, host_s = (times[:count] for times in reads(rng, 25.0, 2e-5, 1e-3))
    host_s[0] += late_s
    clock = ClockMap(tolerance_ppm=30.0)
    for d, h in zip(device_s, np.maximum.accumulate(host_s), strict=True):
        clock.map(np.array([int(d * 1e9)]), int(h * 1e9))
    behind_s = device_s[-1] + gap_s + np.arange(0.0, 0.01, 2.5e-4)
    times_ns = clock.map((behind_s * 1e9).astype(np.int64), int((behind_s[-1] / (1 + 2e-5) + 1e-3) * 1e9))
    early_s = behind_s / (1 + 2e-5) - times_ns * 1e-9
    assert np.all(np.diff(times_ns) > 0)
    assert np.max(early_s) < 1.7e-4 * gap_s + 1e-3, "no farther off than a clock at its limit of rate would be"


@given(
    late_s=st.floats(0.0, 0.2), drift=st.floats(-5e-5, 5e-5), wraps=st.integers(0, 3), seed=st.integers(0, 2**32 - 1)
)
def test_a_map_goes_on_where_the_one_before_it_was(late_s: float, drift: float, wraps: int, seed: int) -> None:
    """The next log's first read may come late, by a clock that has begun again meanwhile: its times are right."""
    rng = np.random.default_rng(seed)
    wrap_ns, start = 40_000_000_000, 1_700_000_000_000_000_000
    device_s, host_s = reads(rng, 12.0, drift, 1e-3)
    before, after = ClockMap(50.0), 3.0
    for d, h in zip(device_s, host_s, strict=True):
        before.map(np.array([int(d * 1e9)]), start + int(h * 1e9))
    known = before.seed(wrap_ns)
    assert known is not None
    assert ClockSeed.of({"clock_seed": json.loads(json.dumps(asdict(known)))}) == known
    at_s = device_s[-1] + after + 40.0 * wraps
    first = ClockMap(50.0, seed=known)
    times = first.map(np.array([int(at_s * 1e9) % wrap_ns]), start + int((at_s / (1 + drift) + 3e-4 + late_s) * 1e9))
    off_s = (int(times[0]) - start) * 1e-9 - at_s / (1 + drift) - 3e-4
    assert abs(off_s) < 1.5e-3 + 1e-5 * after + 6e-5 * 40.0 * wraps


def test_a_seed_of_another_clock_counts_for_nothing() -> None:
    known = ClockSeed(10**12, 1_700_000_000_000_000_000, 0.0, 2**32 * 1000)
    first = ClockMap(50.0, seed=known)
    host_ns = 1_700_000_005_000_000_000
    assert first.map(np.array([123_456_789]), host_ns).tolist() == [host_ns]


LARGEST = {"device_ns": 2**63 - 1, "host_ns": 1 - 2**63, "rate": -0.49, "wrap_ns": 1}


@pytest.mark.parametrize(
    "seed",
    [
        3,
        {},
        {"device_ns": 1, "host_ns": 1, "rate": 0.0},
        LARGEST | {"other": 1},
        LARGEST | {"rate": 2.0},
        LARGEST | {"rate": -2.0},
        LARGEST | {"rate": 0},
        LARGEST | {"rate": float("nan")},
        LARGEST | {"device_ns": 1.5},
        LARGEST | {"device_ns": 2**63},
        LARGEST | {"host_ns": -(2**63)},
        LARGEST | {"host_ns": True},
        LARGEST | {"wrap_ns": 2**63},
        LARGEST | {"wrap_ns": 0},
        LARGEST | {"wrap_ns": -1},
    ],
)
def test_a_seed_that_no_clock_can_have_is_refused(seed: object) -> None:
    with pytest.raises(DeviceError, match=r"clocks\.json: expected device_ns"):
        ClockSeed.of({"clock_seed": seed})
    assert asdict(ClockSeed.of({"clock_seed": LARGEST})) == LARGEST
    assert ClockSeed.of({}) is None


def test_samples_that_come_behind_newer_ones_change_nothing() -> None:
    """Across a boundary of the bins, which are in order."""
    alone, mixed = ClockMap(30.0), ClockMap(30.0)
    rng = np.random.default_rng(3)
    for k in range(200):
        device_ns = np.array([k * 50_000_000], np.int64)
        host_ns = 10**18 + int(device_ns[0]) + int(rng.exponential(2e6))
        if k % 5 == 0 and k:
            late = mixed.map(device_ns - 80_000_000, host_ns - 10_000_000)
            assert late[0] == pytest.approx(10**18 + int(device_ns[0]) - 80_000_000, abs=3e6)
        assert mixed.map(device_ns, host_ns) == alone.map(device_ns, host_ns)


@pytest.mark.parametrize("kind", [np.uint8, np.int64])
@given(st.lists(st.integers(-(2**7), 2**7 - 1), min_size=1, max_size=50), st.integers(0, 2**8 - 1), st.data())
def test_unwrap_continues_a_wrapping_counter(kind: type, steps: list[int], start: int, data: st.DataObject) -> None:
    """Each value is the nearest continuation of the one before it; half a turn is one backwards."""
    true = start + np.cumsum([0, *steps])
    cut = data.draw(st.integers(0, len(true)))
    unwrap = Unwrap(2**8)
    found = np.concatenate([unwrap.feed((part % 2**8).astype(kind)) for part in (true[:cut], true[cut:])])
    assert np.array_equal(found, true)


def test_a_line_without_jitter_has_the_rate_and_the_offset_of_the_record() -> None:
    device_s = 100.0 + np.arange(0.0, 100.0, 0.05)
    line = fit_line(device_s, 3.0 + device_s * (1 + 2e-5), 50.0)
    assert line.rate == pytest.approx(2e-5, rel=1e-4)
    assert line.host_s(device_s) == pytest.approx(3.0 + device_s * (1 + 2e-5), abs=1e-8)
    assert line.jitter_s == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < line.rate_std < 1e-8


def test_a_record_within_one_sample_period_determines_the_rate_to_half_of_the_error_by_a_step() -> None:
    """A step of one period in its middle turns the line of a record with equal bins by 1.5 periods over its length."""
    device_s = 100.0 + np.arange(0.0, 100.0, 0.05)
    line = fit_line(device_s, 3.0 + device_s * (1 + 2e-5), 50.0, step_s=0.01)
    own, prior = 0.5 * 1.5 * 0.01 / 100, 50e-6
    assert line.rate_std == pytest.approx((prior**-2 + own**-2) ** -0.5, rel=0.1)
    assert line.rate == pytest.approx(2e-5 * prior**2 / (prior**2 + own**2), rel=0.1)
    assert line.shared_std == pytest.approx(prior * own**2 / (prior**2 + own**2), rel=0.1)


@pytest.mark.parametrize("seconds", [6.0, 40.0])
def test_rate_intervals_hold(seconds: float) -> None:
    rng = np.random.default_rng(11)
    z = []
    for _ in range(120):
        drift = 30e-6 * rng.standard_normal()
        line = fit_line(*reads(rng, seconds, drift, 1.5e-3), tolerance_ppm=30.0)
        z.append((line.rate - (1 / (1 + drift) - 1)) / line.rate_std)
        assert line.rate_std <= 30e-6
    # conservative where delays are ideal; a loaded host's delays come in spells
    assert np.mean(np.abs(z) < 1) > 0.6
    assert np.max(np.abs(z)) < 4
    assert seconds < 30 or line.rate_std < 10e-6


def test_records_of_one_clock_share_what_neither_has_read_of_its_rate() -> None:
    rng = np.random.default_rng(14)
    apart, product, alike = [], [], []
    for _ in range(400):
        drift = 30e-6 * rng.standard_normal()
        one, two = (fit_line(*reads(rng, 12.0, drift, 15e-3), tolerance_ppm=30.0) for _ in range(2))
        first, second = (line.rate - (1 / (1 + drift) - 1) for line in (one, two))
        own = sum(line.rate_std**2 - line.shared_std**2 for line in (one, two))
        apart.append((first - second) / np.sqrt(own))
        product.append(first * second)
        alike.append(one.shared_std * two.shared_std)
    assert 0.3 < np.sqrt(np.mean(np.square(apart))) < 1.2  # exponential delays are kinder than what is assumed
    assert 0.7 < np.mean(product) / np.mean(alike) < 1.3


def in_step(
    rng: np.random.Generator, seconds: float, drift: float, step_s: float, grid_s: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Reads of samples that are handed over on a grid of the host's: as by a bus that it polls."""
    device_s = np.arange(int(seconds / step_s)) * step_s
    handed_over_s = np.ceil((device_s * (1 + drift) + rng.uniform(0, step_s)) / grid_s) * grid_s
    read_s = np.sort(rng.uniform(0.1, seconds, int(100 * seconds)))
    last = np.unique(np.searchsorted(handed_over_s, read_s, side="right") - 1)
    return device_s[last], handed_over_s[last] + np.abs(rng.normal(0, 1e-4, len(last)))


@pytest.mark.parametrize("seconds", [4.7, 12.7, 41.0])
@pytest.mark.parametrize("grid_s", [2.5e-4, 1e-3, 1e-2])
def test_rate_intervals_hold_where_the_host_polls_in_step_with_the_samples(seconds: float, grid_s: float) -> None:
    rng = np.random.default_rng(12)
    z = []
    for _ in range(60):
        drift = 30e-6 * rng.standard_normal()
        line = fit_line(*in_step(rng, seconds, drift, 2.5e-4, grid_s), tolerance_ppm=30.0, step_s=2.5e-4)
        z.append((line.rate - drift) / line.rate_std)
    assert np.mean(np.abs(z) < 1.96) >= 0.85
    assert np.max(np.abs(z)) < 4


def test_a_line_without_stairs_over_more_than_a_period_is_known_as_well_as_its_reads_are() -> None:
    rng = np.random.default_rng(13)
    found = []
    for _ in range(30):
        line = fit_line(*in_step(rng, 41.0, 25e-6, 2.5e-4, 1e-9), tolerance_ppm=30.0, step_s=2.5e-4)
        assert line.rate_std < 1e-6
        found.append((line.rate - 25e-6) / line.rate_std)
    assert np.max(np.abs(found)) < 4


def test_a_short_record_adds_nothing_to_the_data_sheet() -> None:
    line = fit_line(np.array([0.0, 0.1, 0.2]), np.array([0.001, 0.1012, 0.2011]), tolerance_ppm=50.0)
    assert line.rate == 0.0
    assert line.rate_std == line.shared_std == pytest.approx(50e-6)


def test_times_after_a_new_start_of_the_device_are_later_than_those_before() -> None:
    """The last read before was early, as after a host's clock that was set back."""
    clock, start_ns, ms = ClockMap(50.0), 1_700_000_000_000_000_000, 1_000_000
    (last,) = clock.map(np.array([5000 * ms]), start_ns).tolist()
    clock.restart()
    assert clock.map(np.array([0, ms]), start_ns - 4 * ms).tolist() == [last + 1, last + 2]
    assert clock.map(np.array([2 * ms]), start_ns - 3 * ms).tolist() == [last + 3]
    assert clock.map(np.array([10 * ms]), start_ns + 5 * ms).tolist() == [start_ns + 5 * ms]
