"""What a clock map does with late reads, gaps, seeds and steps of the host's clock, and which uncertainty it states."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.clock import ClockMap, ClockSeed, lower_line
from tests.effort import cases

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
DEVICE0_NS = 77_000 * MS
TOLERANCE = 50e-6
IN_TIME = ClockSeed(DEVICE0_NS, START_NS, 0.0, 2**50)


def mapped(clock: ClockMap, device_ms: float, late_ms: float = 0.0) -> float:
    """How much later than without delay the map places a sample at a device time, ms."""
    device_ns = DEVICE0_NS + round(device_ms * MS)
    host_ns = START_NS + round((device_ms + late_ms) * MS)
    return (int(clock.map(np.array([device_ns]), host_ns)[0]) - START_NS) / MS - device_ms


def fed(
    late_ms: Iterable[float], every_ms: float = 10.0, seed: ClockSeed | None = None
) -> tuple[ClockMap, list[float]]:
    """A map after reads at even distances that were late by these times, and how late it places their samples, ms."""
    clock = ClockMap(1e6 * TOLERANCE, seed)
    return clock, [mapped(clock, every_ms * k, late) for k, late in enumerate(late_ms)]


def line_of(clock: ClockMap) -> tuple[float, float]:
    """Lateness at device time 0, ms, and rate of the line that the map follows."""
    seed = clock.seed(2**50)
    at_ns = seed.device_ns - DEVICE0_NS
    return (seed.host_ns - START_NS - at_ns - seed.rate * at_ns) / MS, seed.rate


@settings(max_examples=cases(20, 60))
@given(st.integers(1, 500), st.integers(2, 40))
def test_the_error_of_a_late_first_read_decays_without_overshoot_at_half_the_clock_s_rate_at_most(
    late_ms: int, every_ms: int
) -> None:
    settled_ms = 2 * late_ms + 2000.0
    _, errors = fed([late_ms, *[0.0] * int(settled_ms / every_ms)], every_ms)
    assert errors[0] == pytest.approx(late_ms, abs=1e-6)
    assert np.diff(errors).max() <= 1e-5
    assert np.diff(errors).min() >= -0.5 * every_ms - 1e-5
    assert -1e-2 <= errors[-1] < 0.01 * late_ms


@pytest.mark.parametrize("seed", [None, IN_TIME])
def test_one_read_in_time_determines_the_map_for_some_seconds_and_not_for_ever(seed: ClockSeed | None) -> None:
    late = [4.0] * 240
    _, errors = fed(late if seed else [0.0, *late], 250.0, seed)
    assert errors[:4] == pytest.approx([0.0] * 4, abs=1e-6)
    assert max(errors[:40]) < 3.0
    assert errors[-1] == pytest.approx(4.0, abs=0.1)


def test_a_sample_before_a_gap_is_mapped_as_without_the_gap() -> None:
    times: list[int] = []
    for later in ([], [DEVICE0_NS + 900 * MS]):
        clock, _ = fed([400.0, 0.0])
        times.append(int(clock.map(np.array([DEVICE0_NS + 20 * MS, *later]), START_NS + 1000 * MS)[0]))
    assert times[0] == times[1]


@given(st.floats(-8e-4, 1e-3))  # at -9.2e-4 the reads of a quarter of a second are 0.2 ms early, which is a step
def test_the_line_lies_below_all_reads_and_has_a_rate_within_five_tolerances(drift: float) -> None:
    late_ms = [drift * 50.0 * k for k in range(50)]
    offset, rate = line_of(fed(late_ms, 50.0)[0])
    assert rate == pytest.approx(float(np.clip(drift, -5 * TOLERANCE, 5 * TOLERANCE)), rel=1e-3, abs=1e-8)
    above = [late - offset - rate * 50.0 * k for k, late in enumerate(late_ms)]
    assert -1e-3 < min(above[:45]) < 1e-3  # of the reads in complete quarters of a second


def test_the_least_delayed_read_of_each_time_counts() -> None:
    clock, _ = fed([5.0, 1.0, 3.0] * 60, 80.0)
    assert line_of(clock) == pytest.approx((1.0, 0.0), abs=1e-6)


# --- seeds -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("early_ms", "lateness", "used"),
    [(0.0, 0.0, True), (500.0, 0.0, True), (-2.0, -2.0, True), (5000.0, 5000.0, False), (-500.0, -500.0, False)],
)
def test_a_seed_holds_unless_the_first_read_contradicts_it(early_ms: float, lateness: float, used: bool) -> None:
    clock = ClockMap(50.0, seed=ClockSeed(DEVICE0_NS, START_NS, 1e-4, 2**50))
    device_ns = np.array([DEVICE0_NS - 1000 * MS, DEVICE0_NS])
    before, at = clock.map(device_ns, START_NS + round(early_ms * MS)).tolist()
    assert (at - START_NS) / MS == pytest.approx(lateness, abs=1e-6)
    assert (at - before) / (1000 * MS) - 1 == pytest.approx(1e-4 if used else 0.0, abs=1e-9)


def test_a_seed_is_the_time_without_delay_and_its_rate_that_of_the_line() -> None:
    assert ClockMap(50.0).seed(5) is None
    seed = fed([7.0 + 0.005 * k for k in range(200)], 50.0)[0].seed(123_456)
    assert (seed.device_ns, seed.wrap_ns) == (DEVICE0_NS + 9950 * MS, 123_456)
    assert seed.host_ns == pytest.approx(START_NS + 9950 * MS + 7.995 * MS, abs=200)
    assert seed.rate == pytest.approx(1e-4, rel=1e-6)


@given(st.integers(-3, 7), st.integers(-4000, 4000), st.floats(-0.45, 0.45))
def test_a_seed_s_time_continues_over_wraps_with_its_rate(wraps: int, ahead_ns: int, off: float) -> None:
    seed = ClockSeed(1000, 5_000_000, 0.25, 4000)  # a wrap takes 5000 ns of the common clock
    expected = 5_000_000 + ahead_ns + round(0.25 * ahead_ns) + 5000 * wraps
    assert seed.host_at(1000 + ahead_ns, expected + round(5000 * off)) == expected


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=2, max_size=8, unique_by=lambda p: p[0]))
def test_the_line_below_all_points_has_the_least_sum_of_distances(points: list[tuple[int, int]]) -> None:
    x, y = np.array(sorted(points), float).T
    offset, slope = lower_line(x, y)
    assert np.all(offset + slope * x <= y + 1e-9)
    edges = [((y[j] - y[i]) / (x[j] - x[i]), i) for i, j in combinations(range(len(x)), 2)]
    below = [y[i] + a * (x.mean() - x[i]) for a, i in edges if np.all(y[i] + a * (x - x[i]) <= y + 1e-9)]
    assert offset + slope * x.mean() == pytest.approx(max(below), abs=1e-6)


# --- steps of the host's clock ---------------------------------------------------------------------------------------


def with_step(step_ms: float, seconds: float = 20.0) -> tuple[ClockMap, np.ndarray]:
    """Errors of the mapped times, ms, with 1 ms of jitter; the host's clock steps by `step_ms` after 10 s."""
    shown_ms = np.where(np.arange(round(100 * seconds)) >= 1000, step_ms, 0.0)
    clock, errors = fed(shown_ms + np.random.default_rng(1).exponential(1.0, len(shown_ms)))
    return clock, errors - shown_ms


@pytest.mark.parametrize("step_ms", [-300.0, -4.0, 40.0, 300.0])
def test_a_step_is_followed_and_the_mapped_time_ascends(step_ms: float) -> None:
    """A step forward at once when it is sure, a step back at half the clock's rate."""
    _, errors = with_step(step_ms)
    assert abs(errors[1000] + step_ms) < 1.0
    assert max(abs(errors[1150 + round(max(0.0, -step_ms) / 2) :])) < 0.2
    shown = 10.0 * np.arange(len(errors)) + errors + np.where(np.arange(len(errors)) >= 1000, step_ms, 0.0)
    assert min(np.diff(shown)) > 0


def test_lateness_that_may_be_a_delay_is_no_step_and_is_part_of_the_stated_uncertainty() -> None:
    """A busy host delays reads by milliseconds, also for seconds."""
    clock, errors = with_step(15.0, seconds=11.0)
    assert errors[-1] == pytest.approx(-15.0, abs=1.0)
    assert clock.std_ns > 14 * MS


@pytest.mark.parametrize(
    "late_ms",
    [
        [max(0.1, 1500.0 - 9.0 * k) for k in range(200)],  # a backlog is read
        [40.0 + 20.0 * (k // 50 % 2) for k in range(200)],
        [40.0 if k % 10 else 0.0 for k in range(200)],
    ],
)
def test_reads_that_are_late_by_different_times_are_no_step(late_ms: list[float]) -> None:
    _, errors = fed([0.1] * 1000 + late_ms)
    assert max(map(abs, errors)) < 1.0


def test_a_map_states_the_step_that_its_newest_read_has_shown() -> None:
    clock, _ = fed([0.0] * 100)
    assert clock.step_ns == 0
    for at_ms, late_ms, step_ms in ((1000.0, -0.05, 0), (1010.0, -5.0, -5), (1020.0, -5.0, 0)):
        mapped(clock, at_ms, late_ms)
        assert clock.step_ns == pytest.approx(step_ms * MS, abs=0.1 * MS * bool(step_ms))


def test_an_early_read_among_the_first_ones_is_no_step() -> None:
    """They may all have been late."""
    clock, errors = fed([10.0] * 3 + [0.0] * 300)
    assert clock.step_ns == 0
    assert abs(errors[-1]) < 0.1


def test_after_a_step_the_mapped_time_is_that_of_the_least_lag_at_once() -> None:
    """The device clock drifts by 200 ppm and reads come every 40 ms: no part of the old rate is added twice."""
    late_ms = [2e-4 * 40.0 * k + (40.0 if k >= 500 else 0.0) for k in range(530)]
    _, errors = fed(late_ms, 40.0)
    jump = next(k for k in range(500, 530) if errors[k] > 30.0)
    assert min(abs(errors[jump] - late) for late in late_ms[500:jump]) < 1e-3


# --- the stated uncertainty ------------------------------------------------------------------------------------------


@settings(max_examples=cases(10, 60))
@given(st.floats(0.01, 5.0), st.integers(0, 2**31))
def test_the_stated_uncertainty_holds_and_falls_with_the_reads(jitter_ms: float, seed: int) -> None:
    late_ms = np.random.default_rng(seed).exponential(jitter_ms, 3000)
    stated = list[float]()
    for count in (1, 30, 300, 3000):
        clock, errors = fed(late_ms[:count])
        stated.append(clock.std_ns / MS)
        assert abs(errors[-1]) < 8 * stated[-1]
    assert stated[0] == max(stated)
    assert stated[-1] < 0.02 + 0.1 * jitter_ms


def test_a_seed_leaves_less_uncertainty_until_a_step_makes_it_invalid() -> None:
    clock, _ = fed([0.0], seed=IN_TIME)
    assert clock.std_ns < 0.1 * fed([0.0])[0].std_ns
    mapped(clock, 10.0, -4.0)
    assert clock.std_ns > 4 * MS


def test_a_read_in_time_ends_a_sequence_of_late_reads() -> None:
    late = [0.0] * 1000 + [4.0] * 30
    assert fed(late)[0].std_ns > 4 * MS
    assert fed([*late, 0.0])[0].std_ns < 0.1 * MS


def test_without_a_rate_the_uncertainty_grows_by_the_tolerance_since_the_least_late_read() -> None:
    soon, later = (fed([0.01] * at + [0.0] + [0.01] * (150 - at))[0].std_ns for at in (10, 130))
    assert soon - later == pytest.approx(TOLERANCE * 1200 * MS, rel=0.1)


def test_a_read_with_newer_and_older_samples_is_learned() -> None:
    clock, _ = fed([0.0] * 100)
    clock.map(np.array([DEVICE0_NS + 985 * MS, DEVICE0_NS + 995 * MS]), START_NS + 995 * MS - 3 * MS)
    assert clock.std_ns > 1e6  # an early read: the correction is in progress
