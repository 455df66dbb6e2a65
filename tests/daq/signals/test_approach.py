"""The bound on the remaining change: never too small for approaches, decaying oscillations, creep and growth."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.signals.approach import bound
from daq.signals.rounding import code_noise, half_width
from tests.daq.signals.known_motions import WINDOW_S, average, means, windows
from tests.effort import cases


def errors(seed: int, count: int, width: float) -> np.ndarray:
    return width * np.random.default_rng(seed).uniform(-0.9, 0.9, count)


sizes = st.floats(-2.5, 0.0).map(lambda p: 10.0**p)
widths = st.floats(-4.5, -2.0).map(lambda p: 10.0**p)
counts = st.integers(9, 30)
seeds = st.integers(0, 1000)


@settings(deadline=None, max_examples=cases(20, 40))
@given(sizes, st.floats(0.09, 1.5), widths, counts, seeds)
def test_one_rate_is_bounded(left: float, rate: float, width: float, count: int, seed: int) -> None:
    left = min(left, 2.9 * math.exp(-rate * 9 * WINDOW_S))  # nine windows earlier it was still moving
    edges = windows(count)
    values = means(lambda t: np.minimum(left * np.exp(-rate * t), 3.0), edges) + errors(seed, count, width)
    found = bound(edges, values, width, 2.0)
    assert found.remaining >= 0.9 * left - width
    assert found.mean_off >= 0.97 * found.remaining


@pytest.mark.parametrize(("fast", "share"), [(0.27, 1.0), (0.4, 0.3), (0.5, 0.1), (0.65, 0.02), (1.0, 1e-3)])
@pytest.mark.parametrize("slow", [0.09, 0.13, 0.18])
@pytest.mark.parametrize("count", [10, 14, 20])
def test_two_rates_near_each_other_are_bounded(slow: float, fast: float, share: float, count: int) -> None:
    """Together they look like one rate between them, which would be over much sooner than the slow part is."""
    edges, width = windows(count), 1e-3
    values = means(lambda t: np.exp(-slow * t) + share * np.exp(-fast * t), edges) + errors(1, count, width)
    found = bound(edges, values, width, 2.0)
    assert 0.8 * (1 + share) < found.remaining < 4 * (1 + share)
    assert found.mean_off > found.remaining


@settings(deadline=None, max_examples=cases(20, 60))
@given(sizes, st.floats(0.1, 0.6), st.floats(0.6, 2.5), st.floats(0, 6.3), widths, counts, seeds)
def test_a_decaying_swing_is_bounded(
    left: float, rate: float, turn: float, phase: float, width: float, count: int, seed: int
) -> None:
    edges = windows(count)
    values = means(lambda t: left * np.exp(-rate * t) * np.cos(turn * t + phase), edges) + errors(seed, count, width)
    after = np.linspace(0, 60, 3001)
    to_come = np.abs(left * np.exp(-rate * after) * np.cos(turn * after + phase)).max()
    # a third less if the motion is at its maximum at the end of the last window
    assert bound(edges, values, width, 2.0).remaining >= 0.6 * to_come - 2 * width


@settings(deadline=None, max_examples=cases(20, 40))
@given(st.floats(0.15, 1.0), st.floats(20, 1000), counts, seeds, st.sampled_from([1.0, -1.0]))
def test_growth_that_shows_has_no_bound(rate: float, size: float, count: int, seed: int, sign: float) -> None:
    edges, width = windows(count), 1e-3
    values = means(lambda t: sign * size * width * np.exp(rate * t), edges) + errors(seed, count, width)
    assert bound(edges, values, width, 2.0).remaining > 0.5 * size * width


@pytest.mark.parametrize("count", [9, 15, 30])
def test_creep_that_shows_may_go_far_and_creep_that_does_not_is_bounded(count: int) -> None:
    edges, width = windows(count), 1e-3
    for seed in range(10):
        slow = means(lambda t: 0.1 * width / count * t, edges) + errors(seed, count, 0.9 * width)
        fast = means(lambda t: 8 * width / count * t, edges) + errors(seed, count, width)
        assert bound(edges, slow, width, 2.0).remaining < 4.5 * width
        assert bound(edges, fast, width, 2.0).remaining > 20 * width


def test_the_longer_means_stand_the_less_can_be_to_come() -> None:
    edges = windows(30)
    left = [bound(edges[-n:], np.zeros(n), 1.0, 2.0).remaining for n in (9, 15, 22, 30)]
    assert all(later < 0.75 * earlier for earlier, later in pairwise(left))
    assert left[0] == pytest.approx(2 / math.expm1(0.08 * 8 * WINDOW_S), rel=0.2)


@pytest.mark.parametrize("length_s", [10.0, 60.0])
def test_long_windows_of_a_slow_rotor_have_a_bound(length_s: float) -> None:
    """Fast trial rates overflow there: they are no fit, and what remains is not taken for 0."""
    edges = np.arange(31.0) * length_s
    edges = np.stack([edges[:-1], edges[1:]], axis=1)
    slow = 1.0 / edges[-1, 1]
    values = means(lambda t: np.exp(-slow * t) + 0.1 * np.exp(-3 * slow * t), edges)
    assert bound(edges, values, 1e-5, 2.0).remaining > 0.5


def test_identical_means_leave_no_drift() -> None:
    """Constant counts: their floating point noise is not treated as a drift."""
    edges = windows(12)
    values = 1.234 + 1e-15 * np.arange(12)
    assert bound(edges, values, 7.7e-4, 2.0).remaining < 1.5e-3


@settings(deadline=None, max_examples=cases(40, 100))
@given(st.floats(0, 0.6), st.floats(-0.5, 0.5), st.integers(0, 100))
def test_half_width_holds_the_mean_of_a_noisy_code(noise: float, offset: float, seed: int) -> None:
    """Compared with the rounding itself, for any position within a count: codes alternate on an edge without noise."""
    codes = np.round(offset + noise * np.random.default_rng(seed).standard_normal(20_000))
    shares = [np.array([np.mean(side)]) for side in (codes < np.median(codes), codes > np.median(codes))]
    seen = float(code_noise(*shares, np.array([len(codes)]))[0])
    allowed = half_width(1.0, 0.0 if math.isnan(seen) else seen)
    assert abs(float(codes.mean()) - offset) <= 1.1 * allowed + 4 * float(codes.std()) / math.sqrt(len(codes))
    if not math.isnan(seen):
        assert seen == pytest.approx(noise, rel=0.25)


@settings(deadline=None, max_examples=cases(20, 60))
@given(st.floats(0, 3), st.floats(-0.5, 0.5))
def test_half_width_holds_the_mean_of_a_wobbling_code(ripple: float, offset: float) -> None:
    codes = np.round(offset + ripple * np.cos(2 * np.pi * np.arange(20_000) / 20_000))
    assert abs(float(codes.mean()) - offset) <= half_width(1.0, 0.0, ripple) + 1e-3


@pytest.mark.parametrize("rate", [0.2, 0.37])
def test_a_little_more_noise_makes_no_jump(rate: float) -> None:
    """The end of an overshoot, whose range is about four widths: near there the bound changes gradually."""
    edges = windows(13)
    ending = means(lambda t: np.exp(-rate * t), edges)
    shape = ending / float(np.ptp(ending))
    found = [bound(edges, shape * widths_, 1.0, 6.0).remaining for widths_ in np.linspace(3.9, 4.2, 31)]
    assert max(later / earlier for earlier, later in pairwise(found)) < 1.15


def test_windows_before_those_that_one_rate_fits_limit_what_two_rates_could_still_do() -> None:
    """Means of a pendulum with a 12 bit code, degrees. One rate fits the newest 14 nearly within their width; two rates
    that fit these alone could leave 0.6°, two that fit all 21 could not."""
    values = [9.7182, 7.1123, 5.1763, 3.7499, 2.7106, 1.9538, 1.4079, 1.01, 0.7241, 0.518, 0.3678, 0.2608, 0.1836]
    values += [0.1248, 0.0899, 0.0517, 0.0327, 0.0229, 0.0148, 0.0051, 0.0]
    edges = windows(21) * 1.03663 / WINDOW_S
    for width in (0.0045, 0.006, 0.0065, 0.009):
        assert 0.012 < bound(edges, np.array(values), width, 6.0).remaining < 0.1
    assert bound(edges[7:], np.array(values[7:]), 0.006, 6.0).remaining > 0.5


def approach(rate: float, count: int) -> np.ndarray:
    """Window means of an approach with 1 left at the end of the last window."""
    return means(lambda t: np.exp(-rate * t), windows(count))


TWO_RATES = approach(0.1, 15) + 1e-3 * approach(1.0, 15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rate", [0.1, 0.2, 0.4])
def test_a_clear_approach_is_bounded_closely(rate: float, sign: float) -> None:
    found = bound(windows(12), sign * approach(rate, 12), 1e-6, 3.0)
    assert 1.0 <= found.remaining < (1.35 if rate > 0.15 else 1.6)
    assert found.rate_per_s == pytest.approx(rate, rel=0.15)
    assert found.mean_off / found.remaining == pytest.approx(average(found.rate_per_s, -3.0, 0.0), rel=0.03)
    assert found.seen_s == pytest.approx(12 * WINDOW_S)


def test_a_straight_line_and_growth_have_no_bound() -> None:
    for values in (np.arange(12.0), -np.arange(12.0), np.exp(0.3 * np.arange(12.0))):
        found = bound(windows(12), values, 1e-3, 2.0)
        assert (found.remaining, found.mean_off, found.rate_per_s) == (math.inf, math.inf, 0.0)
        assert 9.0 < found.seen_s < 12.5


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exact_growth_at_any_rate_has_no_bound(sign: float) -> None:
    for rate in np.geomspace(0.03, 0.6, 25):
        values = [sign * average(-rate, a, b) for a, b in windows(20) - 20 * WINDOW_S]
        assert bound(windows(20), np.array(values), 1e-9, 2.0).remaining == math.inf


def test_a_long_straight_line_is_seen_as_a_whole() -> None:
    assert bound(windows(30), np.arange(30.0), 1e-9, 2.0).seen_s == pytest.approx(30 * WINDOW_S)


def test_a_swing_that_does_not_decay_moves_to_both_sides() -> None:
    edges = windows(18)
    values = np.array([(math.sin(1.3 * b) - math.sin(1.3 * a)) / 1.3 for a, b in edges])
    found = bound(edges, values, 1e-3, 2.0)
    assert 1.7 < found.remaining < 3.0


def test_a_bound_does_not_depend_on_a_constant_part() -> None:
    for values in (1e-2 * approach(2.0, 12), TWO_RATES[-12:], approach(0.2, 12), np.zeros(12)):
        plain = bound(windows(12), values, 1e-6, 2.0)
        for share in (-3.0, 4.0):
            moved = values + share * max(1.0, float(np.ptp(values)))
            assert bound(windows(12), moved, 1e-6, 2.0).remaining == pytest.approx(plain.remaining, rel=1e-4)


@pytest.mark.parametrize("scale", [1e-4, 1e3])
def test_a_bound_scales_with_means_and_width(scale: float) -> None:
    moving = np.zeros(12)
    moving[0] = 2.0001
    rough = np.array([1.0, -1, -1, 1, 1, 1, -1, 1, -1])
    for values, width in (
        (moving, 1.0),
        (np.zeros(12), 1.0),
        (rough, 1e-4),
        (TWO_RATES, 1e-4),
        (1e-2 * approach(2.0, 12), 1e-9),
        (approach(0.2, 12), 1e-3),
        (np.exp(0.3 * np.arange(12.0)), 1e-3),
        (means(lambda t: np.exp(-0.1 * t) * np.cos(1.3 * t), windows(12)), 1e-3),
    ):
        plain = bound(windows(len(values)), values, width, 2.0)
        scaled = bound(windows(len(values)), scale * values, scale * width, 2.0)
        assert scaled.remaining == pytest.approx(scale * plain.remaining, rel=1e-6)
        assert scaled.mean_off == pytest.approx(scale * plain.mean_off, rel=1e-6)
        assert (scaled.rate_per_s, scaled.seen_s) == pytest.approx((plain.rate_per_s, plain.seen_s))
