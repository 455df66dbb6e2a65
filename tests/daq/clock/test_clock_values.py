"""Clock maps and lines with values that follow from their definitions: time constants, limits, windows, seeds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from daq.clock import (
    ClockMap,
    ClockSeed,
    Unwrap,
    fit_line,
    lower_line,
    steps_from,
)
from daq.errors import DeviceError

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
DEVICE0_NS = 77_000 * MS


def mapped(clock: ClockMap, device_ms: float, late_ms: float = 0.0) -> float:
    """How much later than without delay the map places a sample at a device time, ms."""
    device_ns = DEVICE0_NS + round(device_ms * MS)
    host_ns = START_NS + round((device_ms + late_ms) * MS)
    return (int(clock.map(np.array([device_ns]), host_ns)[0]) - START_NS) / MS - device_ms


def rate_after(clock: ClockMap) -> float:
    seed = clock.seed(2**40)
    assert seed is not None
    return seed.rate


def test_an_error_of_the_first_read_decays_with_a_time_constant_of_300_ms() -> None:
    """Reads every 10 ms: a thirtieth of the error is corrected between two reads."""
    clock = ClockMap(50.0)
    assert mapped(clock, 0.0, 50.0) == pytest.approx(50.0, abs=1e-6)
    found = [mapped(clock, 10.0 * k) for k in range(1, 40)]
    assert found == pytest.approx([50.0 * (29 / 30) ** k for k in range(39)], abs=1e-4)


def test_a_large_error_is_corrected_with_half_the_clock_s_rate_at_most() -> None:
    clock = ClockMap(50.0)
    mapped(clock, 0.0, 400.0)
    found = [mapped(clock, 10.0 * k) for k in range(1, 51)]
    assert found == pytest.approx([400.0 - 5.0 * k for k in range(50)], abs=1e-4)


def test_an_early_map_is_delayed_with_half_the_clock_s_rate_at_most() -> None:
    """The seed of a clock that has been set back since: its first reads come up to 1 s late, and all others too."""
    clock = ClockMap(50.0, seed=ClockSeed(DEVICE0_NS, START_NS, 0.0, 2**50))
    late = [mapped(clock, 10.0 * k, 900.0) for k in range(4)]
    assert late == pytest.approx([0.0] * 4, abs=1e-6)  # the seed's time counts as a read without delay
    for k in range(1, 122):
        mapped(clock, 40.0 + 250.0 * k, 900.0)
    assert mapped(clock, 40.0 + 250.0 * 122, 900.0) > 100.0


def test_a_correction_ends_after_its_time_constant() -> None:
    clock = ClockMap(50.0)
    mapped(clock, 0.0, 50.0)
    mapped(clock, 10.0)
    assert mapped(clock, 1010.0) == pytest.approx(0.0, abs=1e-4)


def test_older_samples_do_not_change_the_map() -> None:
    plain, disturbed = ClockMap(50.0), ClockMap(50.0)
    for k in range(3):
        mapped(plain, 10.0 * k)
        mapped(disturbed, 10.0 * k)
    mapped(disturbed, 5.0, -20.0)
    assert mapped(plain, 40.0) == mapped(disturbed, 40.0)


@pytest.mark.parametrize(("drift", "rate"), [(1e-4, 1e-4), (-1e-4, -1e-4), (1e-3, 2.5e-4), (-1e-3, -2.5e-4)])
def test_the_rate_is_fitted_after_two_seconds_and_limited_to_five_tolerances(drift: float, rate: float) -> None:
    """A line needs eight complete bins of 0.25 s."""
    clock = ClockMap(50.0)
    for k in range(40):
        mapped(clock, 50.0 * k, drift * 50.0 * k)
    assert rate_after(clock) == 0.0
    mapped(clock, 2000.0, drift * 2000.0)
    assert rate_after(clock) == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize(("drift", "lag_ms"), [(1e-3, 2.5e-4 * 2000), (-1e-3, -1e-3 * 1950 - 2.5e-4 * 50)])
def test_the_line_at_the_limit_of_the_rate_lies_below_all_reads(drift: float, lag_ms: float) -> None:
    """The clock drifts by 1000 ppm and the limit is 250 ppm: the line goes through the first read, or the last one.

    The last one of a complete bin comes at 1950 ms, the state is that at 2000 ms.
    """
    clock = ClockMap(50.0)
    for k in range(41):
        mapped(clock, 50.0 * k, drift * 50.0 * k)
    seed = clock.seed(2**50)
    assert seed is not None
    assert (seed.host_ns - START_NS) - (seed.device_ns - DEVICE0_NS) == pytest.approx(lag_ms * MS, abs=100)


@pytest.mark.parametrize(("bins", "seen"), [(120, True), (121, False)])
def test_a_read_counts_for_thirty_seconds(bins: int, seen: bool) -> None:
    """One read without delay among late ones determines the line until its bin is the 121st."""
    clock = ClockMap(50.0)
    for k in range(bins + 1):
        mapped(clock, 250.0 * k, 0.0 if k == 0 else 4.0)
    assert (rate_after(clock) != 0.0) is seen


def test_the_least_delayed_read_of_a_bin_counts() -> None:
    first, second = ClockMap(50.0), ClockMap(50.0)
    for k in range(12):
        for at, late in ((0.0, 5.0), (10.0, 1.0), (20.0, 3.0)):
            mapped(first, 250.0 * k + at, late)
        mapped(second, 250.0 * k + 10, 1.0)
    a, b = first.seed(2**50), second.seed(2**50)
    assert a is not None
    assert b is not None
    assert a.rate == pytest.approx(b.rate, abs=1e-9) == 0.0
    assert a.host_ns - a.device_ns == b.host_ns - b.device_ns == START_NS - DEVICE0_NS + MS


@pytest.mark.parametrize(("reads", "step_ms"), [(1, 0), (19, 0), (20, -10), (21, -10)])
def test_an_early_read_is_a_step_back_only_after_twenty_reads(reads: int, step_ms: int) -> None:
    """Before, the first reads may all have been late."""
    clock = ClockMap(50.0)
    for k in range(reads):
        mapped(clock, 10.0 * k, 10.0)
    mapped(clock, 10.0 * reads, 0.0)
    assert clock.step_ns == step_ms * MS


@pytest.mark.parametrize("late_ms", [40.0, 400.0])
def test_a_sample_before_a_gap_is_mapped_as_without_the_gap(late_ms: float) -> None:
    """A correction is in progress: of 0.13 and 0.5 of the clock's rate."""
    for device_ns in range(DEVICE0_NS + 20 * MS, DEVICE0_NS + 20 * MS + 8):
        times: list[int] = []
        for later in ([], [DEVICE0_NS + 900 * MS]):
            clock = ClockMap(50.0)
            mapped(clock, 0.0, late_ms)
            mapped(clock, 10.0)
            times.append(int(clock.map(np.array([device_ns, *later]), START_NS + 1000 * MS)[0]))
        assert times[0] == times[1]


def test_a_clock_with_a_seed_has_its_line_from_the_eighth_bin_on_of_which_the_seed_is_one() -> None:
    clock = ClockMap(50.0, seed=ClockSeed(DEVICE0_NS, START_NS, 0.0, 2**50))
    assert clock.step_ns == 0
    for k in range(9):
        mapped(clock, 250.0 * k, 0.01 * k)
        assert (rate_after(clock) != 0.0) is (k > 6), k  # a bin ends with the first read of the next one


def seeded(early_ms: float, rate: float = 1e-4) -> tuple[float, float]:
    """Lateness of the first sample, ms, and the mapped rate minus 1, of a map with a seed at the first read."""
    clock = ClockMap(50.0, seed=ClockSeed(DEVICE0_NS, START_NS, rate, 2**50))
    device_ns = np.array([DEVICE0_NS - 1000 * MS, DEVICE0_NS])
    before, at = clock.map(device_ns, START_NS + round(early_ms * MS)).tolist()
    return (at - START_NS) / MS, (at - before) / (1000 * MS) - 1


@pytest.mark.parametrize(
    ("early_ms", "lateness", "used"),
    [
        (0.0, 0.0, True),
        (999.0, 0.0, True),
        (1000.0, 1000.0, False),
        (-4.999999, -4.999999, True),
        (-5.0, -5.0, False),
        (20.0, 0.0, True),
    ],
)
def test_a_seed_holds_for_a_read_up_to_5_ms_early_and_1_s_late(early_ms: float, lateness: float, used: bool) -> None:
    found, rate = seeded(early_ms)
    assert found == pytest.approx(lateness, abs=1e-6)
    assert rate == pytest.approx(1e-4 if used else 0.0, abs=1e-9)


def test_a_seed_is_the_time_without_delay_and_its_rate_that_of_the_line() -> None:
    clock = ClockMap(50.0)
    assert clock.seed(5) is None
    for k in range(200):
        mapped(clock, 50.0 * k, 7.0 + 0.005 * k)
    seed = clock.seed(123_456)
    assert seed is not None
    assert (seed.device_ns, seed.wrap_ns) == (DEVICE0_NS + 9950 * MS, 123_456)
    assert seed.host_ns == pytest.approx(START_NS + 9950 * MS + 7.995 * MS, abs=200)
    assert seed.rate == pytest.approx(1e-4, rel=1e-6)


def test_a_seed_s_time_continues_over_wraps_with_its_rate() -> None:
    seed = ClockSeed(1000, 5_000_000, 0.25, 4000)  # a wrap takes 5000 ns of the common clock
    for wraps in (-2, -1, 0, 1, 7):
        for device_ns, at_ns in ((1000, 5_000_000), (1400, 5_000_500), (200, 4_999_000)):
            expected = at_ns + 5000 * wraps
            for near in (expected - 2400, expected, expected + 2400):
                assert seed.host_at(device_ns, near) == expected


@pytest.mark.parametrize(
    ("change", "accepted"),
    [
        ({}, True),
        ({"rate": 0.49999}, True),
        ({"rate": -0.49999}, True),
        ({"rate": 0.5}, False),
        ({"rate": -0.5}, False),
        ({"rate": 0}, False),
        ({"wrap_ns": 1}, True),
        ({"wrap_ns": -1}, False),
        ({"device_ns": 2**63 - 1}, True),
        ({"device_ns": 2**63}, False),
        ({"host_ns": -(2**63)}, False),
        ({"host_ns": True}, False),
        ({"wrap_ns": 2**63}, False),
        ({"host_ns": 2**63 + 1}, False),
        ({"other": 1}, False),
    ],
)
def test_numbers_of_a_seed(change: dict[str, Any], accepted: bool) -> None:
    values = {"device_ns": 1, "host_ns": 2, "rate": 0.0, "wrap_ns": 3} | change
    if accepted:
        assert ClockSeed.of({"clock_seed": values}) == ClockSeed(**values)
    else:
        with pytest.raises(DeviceError, match=r"clocks\.json"):
            ClockSeed.of({"clock_seed": values})
    assert ClockSeed.of({}) is None


@pytest.mark.parametrize(
    ("device", "lag", "line"),
    [
        ([3.0], [7.0], (7.0, 0.0)),
        ([1.0, 3.0], [5.0, 9.0], (3.0, 2.0)),
        ([0.0, 1.0, 2.0], [0.0, 5.0, 1.0], (0.0, 0.5)),
        ([0.0, 1.0, 2.0, 3.0, 4.0], [4.0, 1.0, 0.0, 1.0, 4.0], (2.0, -1.0)),
        ([0.0, 1.0, 2.0, 3.0, 10.0], [4.0, 1.0, 0.0, 1.0, 15.0], (-5.0, 2.0)),
        ([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0], (0.0, 1.0)),
    ],
)
def test_the_line_below_all_points_is_the_edge_at_their_mean_time(
    device: list[float], lag: list[float], line: tuple[float, float]
) -> None:
    assert lower_line(np.array(device), np.array(lag)) == pytest.approx(line)


def record(seconds: float, rate: float, jitter_s: float = 0.0, step_s: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Device and host times of reads every 50 ms, every second one late by twice the jitter."""
    device_s = 100.0 + np.arange(0.0, seconds + step_s / 2, step_s)
    late = 2 * jitter_s * (np.arange(len(device_s)) % 2)
    return device_s, 3.0 + device_s * (1 + rate) + late


def test_a_line_without_jitter_has_the_rate_and_the_offset_of_the_record() -> None:
    device_s, host_s = record(100.0, 2e-5)
    line = fit_line(device_s, host_s, 50.0)
    assert line.rate == pytest.approx(2e-5, rel=1e-4)
    assert line.host_s(device_s) == pytest.approx(host_s, abs=1e-8)
    assert line.jitter_s == pytest.approx(0.0, abs=1e-12)
    # 21 bins of 5 s and a least jitter of 1 µs: the slope of n evenly spaced points has this deviation
    assert line.rate_std == pytest.approx(1e-6 * math.sqrt(12 * 20 / (21 * 22)) / 100, rel=1e-3)
    assert line.shared_std == pytest.approx(line.rate_std**2 / 50e-6, rel=1e-2)


def test_a_record_within_one_sample_period_determines_the_rate_to_that_period() -> None:
    """A period of 10 ms over 100 s is 100 ppm; a step in the middle turns the line of 21 bins by 110/77 of it."""
    device_s, host_s = record(100.0, 2e-5)
    own, prior = 0.5 * 110 / 77 * 1e-4, 5e-5
    line = fit_line(device_s, host_s, 50.0, step_s=0.01)
    weight = prior**2 / (prior**2 + own**2)
    assert line.rate_std == pytest.approx((prior**-2 + own**-2) ** -0.5, rel=1e-4)
    assert line.rate == pytest.approx(2e-5 * weight, rel=1e-3)
    assert line.shared_std == pytest.approx(prior * own**2 / (prior**2 + own**2), rel=1e-4)
    exact = fit_line(device_s, host_s, 50.0, step_s=0.0019)  # the lags move by 2 ms, more than a period
    assert exact.rate_std < 1e-8


def test_lags_in_steps_do_not_count_as_a_straight_line() -> None:
    """Distances of 0.10 and 0.16 sample periods from the line, on the average; bins with both kinds count less."""
    device_s = np.arange(0.0, 100.25, 0.25)
    points = np.arange(len(device_s)) // 20  # one for each bin of 5 s
    for share, straight in ((0.10, True), (0.16, False)):
        late = 2 * share * 0.01 * (points % 2)
        line = fit_line(device_s, device_s * (1 + 3e-4) + late, 100.0, step_s=0.01)
        assert (line.rate_std < 4e-5) is straight


@pytest.mark.parametrize(("seconds", "fitted"), [(1.7, False), (1.8, True), (1.45, False)])
def test_a_record_needs_eight_bins_to_show_a_rate(seconds: float, fitted: bool) -> None:
    """Bins of a quarter of a second."""
    device_s, host_s = record(seconds, 1e-3, step_s=0.01)
    line = fit_line(device_s, host_s, 50.0)
    if fitted:
        assert line.rate > 0
        assert line.rate_std < 50e-6
    else:
        assert (line.rate, line.rate_std, line.shared_std) == pytest.approx((0.0, 50e-6, 50e-6))
        assert line.offset_s == pytest.approx(float(np.min(host_s - device_s)))
        assert line.jitter_s >= 0


def test_steps_and_unwrapping() -> None:
    assert steps_from(5, np.array([7, 6, 10])).tolist() == [2, -1, 4]
    unwrap = Unwrap(100)
    assert unwrap.feed(np.array([], np.uint8)).tolist() == []
    assert unwrap.feed(np.array([90, 20], np.uint8)).tolist() == [90, 120]
    assert unwrap.feed(np.array([69], np.uint8)).tolist() == [169]
    assert unwrap.feed(np.array([19], np.uint8)).tolist() == [119]  # half a turn: backwards
    assert unwrap.feed(np.array([68, 18], np.uint8)).tolist() == [168, 118]


# --- steps of the host's clock, and the stated uncertainty ----------------------------------------------------------


def with_step(step_ms: float, at_s: float = 10.0, seconds: float = 20.0) -> tuple[ClockMap, list[float]]:
    """Errors of the mapped times, ms, of reads every 10 ms with 1 ms of jitter; the host's clock steps by `step_ms`."""
    clock, rng = ClockMap(50.0), np.random.default_rng(1)
    errors: list[float] = []
    for k in range(round(100 * seconds)):
        shown_ms = step_ms if k >= 100 * at_s else 0.0
        errors.append(mapped(clock, 10.0 * k, shown_ms + rng.exponential(1.0)) - shown_ms)
    return clock, errors


def test_a_step_forward_is_followed_after_a_second() -> None:
    _, errors = with_step(300.0)
    assert min(errors[1000:1010]) < -299.0
    assert max(map(abs, errors[1140:])) < 0.1


def test_a_step_back_is_followed_at_half_the_clock_s_rate() -> None:
    _, errors = with_step(-300.0)
    assert errors[1000] == pytest.approx(300.0, abs=1.0)
    assert errors[1030] == pytest.approx(150.0, abs=10.0)
    assert max(map(abs, errors[1300:])) < 0.1


def test_lateness_that_may_be_a_delay_is_no_step() -> None:
    """A busy host delays reads by milliseconds, also for seconds."""
    _, errors = with_step(15.0)
    assert errors[1100] == pytest.approx(-15.0, abs=1.0)


def test_reads_that_are_a_little_early_are_followed_at_once() -> None:
    _, errors = with_step(-4.0)
    assert max(map(abs, errors[1150:])) < 0.2


def test_the_mapped_time_of_a_step_ascends() -> None:
    for step_ms in (300.0, -300.0):
        _, errors = with_step(step_ms)
        shown = [10.0 * k + error + (step_ms if k >= 1000 else 0.0) for k, error in enumerate(errors)]
        assert min(np.diff(shown)) > 0


def test_a_host_that_was_busy_for_a_second_is_no_step() -> None:
    """Reads that are late by less and less, as a backlog is read."""
    clock = ClockMap(50.0)
    for k in range(1000):
        mapped(clock, 10.0 * k, 0.1)
    errors = [mapped(clock, 10_000.0 + 10.0 * k, max(0.1, 1500.0 - 9.0 * k)) for k in range(200)]
    assert max(map(abs, errors)) < 1.0


def test_the_stated_uncertainty_falls_with_the_reads_and_rises_with_the_jitter() -> None:
    rng = np.random.default_rng(2)

    def std_us(jitter_ms: float, reads: int) -> float:
        clock = ClockMap(50.0)
        for k in range(reads):
            mapped(clock, 10.0 * k, rng.exponential(jitter_ms))
        return clock.std_ns / 1e3

    assert ClockMap(50.0).std_ns == 10e6
    assert std_us(1.0, 5) > 500.0
    assert std_us(1.0, 3000) < 12.0
    assert std_us(5.0, 3000) > 3 * std_us(0.5, 3000)


def test_reads_that_are_all_late_are_part_of_the_stated_uncertainty() -> None:
    clock, errors = with_step(15.0, seconds=11.0)
    assert abs(errors[-1]) > 14.0
    assert clock.std_ns > 14e6


def in_time(reads: int = 1000) -> ClockMap:
    """Clock after reads every 10 ms without any delay."""
    clock = ClockMap(50.0)
    for k in range(reads):
        mapped(clock, 10.0 * k)
    return clock


def test_the_stated_uncertainty_is_eight_mean_latenesses_over_the_number_of_reads() -> None:
    """The mean has a weight of 1/64 for a read, or 1/n of the first reads; it counts as 20 µs at least."""
    clock = in_time()
    assert clock.std_ns == pytest.approx(3e3 + 8 * 20e3 / 1000, abs=0.1)
    for k in range(9):
        mapped(clock, 10_000.0 + 10 * k, 4.0)
    assert clock.std_ns == pytest.approx(3e3 + 8 * 4e6 * (1 - (63 / 64) ** 9) / 1009, abs=0.1)
    first = in_time(30)
    for k in range(9):
        mapped(first, 300.0 + 10 * k, 4.0)
    without_rate = 50e-6 * 380 * MS  # no line yet: the rate is uncertain by the tolerance since the least late read
    assert first.std_ns == pytest.approx(3e3 + 8 * 9 * 4e6 / 39 / 39 + without_rate, abs=0.1)


@pytest.mark.parametrize(("reads", "late_ms", "added_ms"), [(9, 4.0, 0.0), (10, 4.0, 4.0), (20, 4.0, 4.0)])
def test_ten_late_reads_in_sequence_are_part_of_the_stated_uncertainty(
    reads: int, late_ms: float, added_ms: float
) -> None:
    clock = in_time()
    for k in range(reads):
        mapped(clock, 10_000.0 + 10 * k, late_ms)
    assert clock.std_ns / MS == pytest.approx(added_ms, abs=0.02)


def test_a_read_in_time_ends_a_sequence_of_late_reads() -> None:
    clock = in_time()
    for k in range(30):
        mapped(clock, 10_000.0 + 10 * k, 4.0 if k % 10 else 0.0)
    assert clock.std_ns / MS < 0.02


def test_a_read_is_late_above_half_the_mean_lateness() -> None:
    """Every second read is late by 8 ms, so the mean is 4 ms; then all reads are late by 1.9 ms, or by 2.2 ms."""
    for late_ms, added in ((1.9, False), (2.2, True)):
        clock = ClockMap(50.0)
        for k in range(1000):
            mapped(clock, 10.0 * k, 8.0 * (k % 2))
        mapped(clock, 10_000.0)
        for k in range(1, 11):
            mapped(clock, 10_000.0 + 10 * k, late_ms)
        assert (clock.std_ns / MS > late_ms) is added


@pytest.mark.parametrize(("early_ms", "again"), [(0.19, False), (0.2, False), (0.200001, True)])
def test_a_read_of_a_precise_clock_is_a_step_back_if_it_is_200_us_early(early_ms: float, again: bool) -> None:
    """After a step the estimate rests on this read alone."""
    clock = in_time()
    mapped(clock, 10_000.0, -early_ms)
    assert (clock.std_ns > 100e3) is again


@pytest.mark.parametrize(("stds", "again"), [(4.9, False), (5.1, True)])
def test_a_read_is_a_step_back_if_it_is_five_standard_uncertainties_early(stds: float, again: bool) -> None:
    clock = ClockMap(50.0)
    for k in range(500):
        mapped(clock, 10.0 * k, 10.0 * (k % 2))
    std_ms = clock.std_ns / MS
    assert 5 * std_ms > 0.25
    mapped(clock, 5000.0, -stds * std_ms)
    assert (clock.std_ns > 10e6) is again


@pytest.mark.parametrize(
    ("least_ms", "reads", "stepped"),
    [
        ((40.0, 40.0, 40.0, 40.0), 5, True),
        ((40.0, 40.0, 40.0), 20, False),  # bins of a quarter of a second
        ((40.0, 40.0, 40.0, 40.0), 4, False),  # 16 reads
        ((20.1, 20.1, 20.1, 20.1), 5, True),
        ((20.0, 20.0, 20.0, 20.0), 5, False),
        ((40.0, 49.9, 40.0, 40.0), 5, True),
        ((40.0, 50.0, 40.0, 40.0), 5, False),
        ((50.0, 50.0, 40.0, 50.0), 5, False),
    ],
)
def test_a_step_forward_has_four_bins_twenty_reads_20_ms_and_equal_least_lags(
    least_ms: tuple[float, ...], reads: int, stepped: bool
) -> None:
    """Between the least lags a quarter of the step is allowed."""
    clock = in_time()
    for number, lag_ms in enumerate(least_ms):
        for k in range(reads):
            mapped(clock, 10_000.0 + 250 * number + 10 * k, lag_ms + (3.0 if k else 0.0))
    end_ms = 10_000.0 + 250 * len(least_ms)
    assert mapped(clock, end_ms, 60.0) == pytest.approx(0.0, abs=0.01)
    assert mapped(clock, end_ms + 1, 60.0) == pytest.approx(min(least_ms) if stepped else 0.0, abs=0.2)


def test_four_bins_with_nineteen_reads_wait_for_the_twentieth() -> None:
    clock, jumps = in_time(), list[int]()
    for number in range(8):
        for k in range(5 if number != 2 else 4):
            if mapped(clock, 10_000.0 + 250 * number + 10 * k, 40.0) > 30.0:
                jumps.append(number)
    assert jumps[0] == 7  # bins 3 to 6 are the first four with twenty reads


def test_a_bin_is_a_quarter_of_a_second_to_the_nanosecond() -> None:
    """The eighth bin ends with the last nanosecond before 2 s: no line is fitted before."""
    clock = ClockMap(50.0)
    for k in range(9):
        assert rate_after(clock) == 0.0 if k else clock.seed(2**40) is None
        for at_ns in (250 * MS * k, 250 * MS * (k + 1) - 1):
            if k < 8:
                late_ns = at_ns // 10_000  # 100 ppm
                clock.map(np.array([DEVICE0_NS + at_ns]), START_NS + at_ns + late_ns)
    clock.map(np.array([DEVICE0_NS + 2000 * MS]), START_NS + 2000 * MS + 2000 * MS // 10_000)
    assert rate_after(clock) == pytest.approx(1e-4, rel=1e-3)


def test_the_bins_of_a_record_are_a_twentieth_of_the_whole_record() -> None:
    """Reads at 0 s and from 10 to 30 s every 0.5 s, every third one in time: each bin of 1.5 s has one of these."""
    device_s = np.concatenate(([0.0], np.arange(10.5, 30.25, 0.5)))
    late_s = np.where(np.arange(len(device_s)) % 3 == 0, 0.0, 0.01)
    late_s[-1] = 0.0  # alone in its bin
    line = fit_line(device_s, device_s + late_s, 50.0)
    assert line.jitter_s == pytest.approx(0.0, abs=1e-9)


def test_the_first_reads_may_be_late() -> None:
    """The delay of the first reads is uncertain by 10 ms, which decreases with the square of their number."""
    assert in_time(1).std_ns == 10e6
    assert in_time(10).std_ns == pytest.approx(100e3, rel=1e-6)
    assert in_time(300).std_ns < 4e3


def test_a_seeded_clock_needs_no_reads_for_its_uncertainty() -> None:
    """The seed counts as one read; a step of the host's clock makes it invalid."""
    clock = ClockMap(50.0, seed=ClockSeed(DEVICE0_NS, START_NS, 0.0, 2**50))
    mapped(clock, 0.0)
    assert clock.std_ns == pytest.approx(3e3 + 8 * 20e3 / 2, abs=0.1)
    mapped(clock, 10.0, -4.0)
    assert clock.std_ns > 10e6


def test_reads_that_come_earlier_and_earlier_are_counted_once() -> None:
    clock = ClockMap(50.0)
    for k in range(30):
        mapped(clock, 1.0 * k, -1e-6 * k)
    assert clock.std_ns == pytest.approx(10e6 / 30**2, abs=50.0)


def test_the_rate_is_uncertain_since_the_least_late_read() -> None:
    clock = ClockMap(50.0)
    for k in range(180):
        mapped(clock, 10.0 * k, 0.0 if k == 30 else 0.01)
    mean = 8 * 20e3 / 180  # the lateness is below its least value
    assert clock.std_ns == pytest.approx(3e3 + mean + 50e-6 * 1490 * MS, abs=100.0)


def test_samples_before_the_first_are_in_no_bin() -> None:
    """Else there would be eight complete bins, of which a line is fitted, a quarter of a second earlier."""
    clock = ClockMap(50.0)
    mapped(clock, 0.0)
    mapped(clock, -1.0, -1e-4)
    for k in range(1, 8):
        mapped(clock, 250.0 * k, 250e-4 * k)
    assert rate_after(clock) == 0.0


def test_the_reads_of_thirty_seconds_count() -> None:
    """Quarters of a second with 25 reads each, also those with a number above 256."""
    assert in_time(7100).std_ns == pytest.approx(3e3 + 8 * 20e3 / (120 * 25), abs=0.1)


def test_after_a_step_the_mapped_time_is_that_of_the_least_lag_at_once() -> None:
    """The device clock drifts by 200 ppm and reads come every 40 ms: no part of the old rate is added twice."""

    def late_ms(k: int) -> float:
        return 2e-4 * 40.0 * k + (40.0 if k >= 500 else 0.0)

    clock = ClockMap(50.0)
    errors = [mapped(clock, 40.0 * k, late_ms(k)) for k in range(530)]
    jump = next(k for k in range(500, 530) if errors[k] > 30.0)
    assert min(abs(errors[jump] - late_ms(k)) for k in range(500, jump)) < 1e-3


def test_a_seed_without_delay_gives_its_time_to_the_nanosecond() -> None:
    clock = ClockMap(50.0, seed=ClockSeed(DEVICE0_NS, START_NS, 0.0, 2**50))
    assert int(clock.map(np.array([DEVICE0_NS]), START_NS)[0]) == START_NS


def test_a_read_with_newer_and_older_samples_is_learned() -> None:
    clock = in_time(100)
    clock.map(np.array([DEVICE0_NS + 985 * MS, DEVICE0_NS + 995 * MS]), START_NS + 995 * MS - 3 * MS)
    assert clock.std_ns > 1e6  # an early read: the correction is in progress


def test_a_map_states_the_step_that_its_newest_read_has_shown() -> None:
    clock = in_time(100)
    assert clock.step_ns == 0
    mapped(clock, 1000.0, -5.0)
    assert clock.step_ns == -5 * MS
    mapped(clock, 1010.0, -5.0)
    assert clock.step_ns == 0
