"""Numbers of the settling decision by formulas of their own: limits, signs, counts of windows, sentences."""

import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from daq.signals.approach import (
    SLOWEST_PER_S,
    Approach,
    _hidden_slow,
    _slowest,
    _terms,
    _two_terms,
    _unexplained,
    bound,
)
from daq.signals.settling import (
    RotorSignals,
    Settling,
    SettlingLimits,
    _judged,
    _more,
    _slipping,
    _visible,
    _worst,
    locked_settled,
    settled,
)
from daq.signals.window_means import WindowMeans

SPEED = 49.0
TURNS = 8  # revolutions in a window of at least 1 s at 49 rad/s
WINDOW_S = TURNS * 2 * math.pi / SPEED
DEGREE = math.radians(1.0)
BEGIN_S = 7.0  # of the first window


def windows(count: int, length: float = 1.0) -> np.ndarray:
    edges = BEGIN_S + length * np.arange(count + 1)
    return np.stack([edges[:-1], edges[1:]], axis=1)


def average(rate: float, begin: float, end: float) -> float:
    """Mean of e^{−rate t} from begin to end."""
    return (math.exp(-rate * begin) - math.exp(-rate * end)) / (rate * (end - begin))


def approach(rate: float, left: float, count: int, length: float = 1.0) -> np.ndarray:
    """Window means of an approach with `left` remaining at the end of the last window."""
    at = windows(count, length) - BEGIN_S - count * length
    return np.array([left * average(rate, begin, end) for begin, end in at])


def clean(offset, *, amplitude=lambda t: 1e-3 + 0 * t, duration: float = 30.0, speed=lambda t: SPEED * t):
    """Signals without noise and rounding: A at offset(t), B opposite at rest; x and 0.7 times as much along y."""
    t = np.arange(0, duration, 2e-3)
    marks = np.arange(0, duration, 2 * math.pi / SPEED)
    laser = np.arange(0, duration, 1e-3)
    angles = np.stack([offset(t), math.pi + 0 * t], axis=1)
    x, y = amplitude(laser) * np.cos(speed(laser)), 0.7 * amplitude(laser) * np.sin(speed(laser))
    return t, angles, marks, speed(marks), laser, x, laser, y


# the bound


@pytest.mark.parametrize("count", [9, 20])
def test_constant_means_leave_what_the_slowest_rate_hides(count: int) -> None:
    """A change of 2 w between the first and the last mean, at the slowest rate."""
    found = bound(windows(count), np.zeros(count), 1e-3, 2.0)
    most, least = (
        2e-3 / (average(rate, -count, 1.0 - count) - average(rate, -1.0, 0.0))
        for rate in (SLOWEST_PER_S, 1.07 * SLOWEST_PER_S)
    )
    assert least <= found.remaining <= most * (1 + 1e-9)
    assert SLOWEST_PER_S <= found.rate_per_s <= 1.07 * SLOWEST_PER_S
    assert found.seen_s == pytest.approx(count)
    assert found.mean_off / found.remaining == pytest.approx(average(found.rate_per_s, -2.0, 0.0), rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rate", [0.1, 0.2, 0.4])
def test_a_clear_approach_is_bounded_closely(rate: float, sign: float) -> None:
    found = bound(windows(12), sign * approach(rate, 1.0, 12), 1e-6, 3.0)
    assert 1.0 <= found.remaining < (1.35 if rate > 0.15 else 1.6)
    assert found.rate_per_s == pytest.approx(rate, rel=0.15)
    assert found.mean_off / found.remaining == pytest.approx(average(found.rate_per_s, -3.0, 0.0), rel=0.03)
    assert found.seen_s == pytest.approx(12.0)


def test_a_straight_line_and_growth_have_no_bound() -> None:
    for means in (np.arange(12.0), -np.arange(12.0), np.exp(0.3 * np.arange(12.0))):
        found = bound(windows(12), means, 1e-3, 2.0)
        assert (found.remaining, found.mean_off, found.rate_per_s) == (math.inf, math.inf, 0.0)
        assert 9.0 <= found.seen_s <= 12.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exact_growth_at_any_rate_has_no_bound(sign: float) -> None:
    for rate in np.geomspace(0.03, 0.6, 25):
        means = [sign * average(-rate, a, b) for a, b in windows(20) - BEGIN_S - 20.0]
        assert bound(windows(20), np.array(means), 1e-9, 2.0).remaining == math.inf


def test_a_long_straight_line_is_seen_as_a_whole() -> None:
    assert bound(windows(30), np.arange(30.0), 1e-9, 2.0).seen_s == pytest.approx(30.0)


def test_an_early_disturbance_leaves_the_newer_windows() -> None:
    """Of 20 windows the 14 newest fit, then 9: the series is shortened by 0.7 at a time."""
    means = approach(0.2, 1.0, 20)
    means[:5] += [40.0, -30.0, 50.0, -20.0, 35.0]
    found = bound(windows(20), means, 1e-6, 2.0)
    assert found.seen_s == pytest.approx(14.0)
    assert 1.0 <= found.remaining < 1.35


TWO_RATES = approach(0.1, 1.0, 15) + approach(1.0, 1e-3, 15)


def test_two_rates_are_bounded_by_the_sum_of_what_both_leave() -> None:
    found = bound(windows(15), TWO_RATES, 1e-4, 2.0)
    assert 1.0 < found.remaining < 2.0
    assert 1.05 * found.remaining < found.mean_off < 1.2 * found.remaining
    assert 0.05 < found.rate_per_s < 0.2
    assert 9.0 < found.seen_s < 15.0  # the fast rate is between the trial rates: fifteen windows do not fit


@pytest.mark.parametrize("fast", [0.25, 4.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_terms_that_cancel_now_are_added_with_their_absolute_values(fast: float, sign: float) -> None:
    """The means contain nothing else than two of the trial rates."""
    length = 1.0 if fast < 1.0 else 0.3
    slow, fast = min(_terms()[0], key=lambda pair: math.dist(pair, (SLOWEST_PER_S, fast)))
    means = sign * (5.0 + approach(slow, 1.0, 9, length) - approach(fast, 0.8, 9, length))
    found = _two_terms(windows(9, length), means, 1e-12, 1.5, 1.0, 2.0)
    assert found is not None
    assert found.remaining == pytest.approx(1.8, rel=0.02)
    assert found.mean_off == pytest.approx(average(slow, -2.0, 0.0) + 0.8 * average(fast, -2.0, 0.0), rel=0.02)
    assert found.rate_per_s == pytest.approx(slow)
    assert found.seen_s == pytest.approx(9 * length)


def swinging(decay: float, turn: float, phase: float) -> np.ndarray:
    """Twelve window means of e^{−decay t} cos(turn t + phase), with t = 0 at the end of the last window."""
    at = windows(12) - BEGIN_S - 12.0
    rate = complex(-decay, turn)
    return np.array([(np.exp(1j * phase) * (np.exp(rate * b) - np.exp(rate * a)) / rate).real for a, b in at])


@pytest.mark.parametrize("phase", [0.0, 0.8, 2.0])
@pytest.mark.parametrize(
    ("decay", "turn", "sides"),
    [
        (SLOWEST_PER_S, 0.25, 1.0),
        (SLOWEST_PER_S, 2.8, 1.0),
        (0.03, 0.25, 1.0),
        (1e-4, 2.8, 2.0),
        (-0.1, 0.25, 2.0),
        (-0.1, 2.8, 2.0),
    ],
)
def test_an_oscillation_is_bounded_by_its_amplitude(decay: float, turn: float, sides: float, phase: float) -> None:
    """One that does not decay moves to both sides."""
    found = _two_terms(windows(12), 3.0 + swinging(decay, turn, phase), 1e-12, 1.5, 1.0, 2.0)
    assert found is not None
    assert found.remaining == pytest.approx(sides, rel=0.03)
    assert found.rate_per_s == pytest.approx(max(decay, 0.0))
    assert found.mean_off >= found.remaining
    if sides == 1.0:
        parts = abs(math.cos(phase)) + abs(math.sin(phase))
        assert found.mean_off == pytest.approx(max(1.0, parts * average(decay, -2.0, 0.0)), rel=0.03)


def test_trial_rates_of_two_terms_are_dense_enough() -> None:
    """Pairs of rates between the trial rates leave less than a hundredth of their range."""
    for slow, fast in ((0.1, 0.5), (0.13, 1.0), (0.3, 1.5), (0.6, 2.5)):
        means = approach(slow, 1.0, 9, 0.5) + approach(fast, 1.0, 9, 0.5)
        range_ = float(np.ptp(means))
        assert _two_terms(windows(9, 0.5), means, 1e-12, 1.5, 0.01 * range_, 2.0) is not None


def test_oscillations_at_the_trial_rates_are_fitted_exactly() -> None:
    """Nine decays from 0.08 to 2 1/s and 14 angular frequencies from 0.25 to 2.8 rad/s, each with a constant ratio."""
    for decay in 0.08 * 25.0 ** (np.arange(4) / 8):
        for turn in 0.25 * 11.2 ** (np.arange(14) / 13):
            means = swinging(decay, turn, 0.8)
            found = _two_terms(windows(12), means, 1e-12, 1.5, 1e-6 * float(np.ptp(means)), 2.0)
            assert found is not None
            assert found.rate_per_s == pytest.approx(decay)


def test_a_bound_of_two_terms_grows_with_the_width_and_needs_a_fit() -> None:
    means = approach(SLOWEST_PER_S, 1.0, 9, 0.3) - approach(4.0, 0.8, 9, 0.3)
    sizes = [_two_terms(windows(9, 0.3), means, width, 1.5, 1e3, 2.0) for width in (1e-12, 1e-4, 1e-3, 1e-2)]
    bounds = [each.remaining for each in sizes if each is not None]
    assert len(bounds) == 4
    assert bounds[1] > bounds[0] + 1e-4
    assert bounds[2] > bounds[1] + 1e-3
    assert bounds[3] > bounds[2] + 1e-2
    rough = 0.1 * np.array([1, -1, -1, 1, 1, 1, -1, 1, -1])
    assert _two_terms(windows(9), rough, 1e-12, 1.5, 0.05, 2.0) is None
    assert _two_terms(windows(9), rough, 1e-12, 1.5, 0.2, 2.0) is not None
    assert _two_terms(windows(9), rough, 0.21, 1.5, 0.2, 2.0) is None


def test_a_crude_bound_is_enough_for_what_moves_far() -> None:
    """Two rates are not tried: the whole range of the newest nine means, at the slowest rate."""
    change = float(np.ptp(TWO_RATES[-3:]))
    fine, crude = (bound(windows(15), TWO_RATES, 1e-4, 2.0, far=share * change) for share in (1.01, 0.99))
    late = float(TWO_RATES[6] - TWO_RATES[14])
    assert fine == bound(windows(15), TWO_RATES, 1e-4, 2.0)
    assert crude.remaining == pytest.approx(1.02 * late / math.expm1(SLOWEST_PER_S * 8.0))
    assert crude.mean_off / crude.remaining == pytest.approx(average(SLOWEST_PER_S, -2.0, 0.0))
    assert (crude.rate_per_s, crude.seen_s) == (SLOWEST_PER_S, pytest.approx(9.0))


@pytest.mark.parametrize(("rate", "standing"), [(2.0, 7), (1.2, 5)])
def test_a_fast_approach_hides_a_slow_one_until_the_means_stand(rate: float, standing: int) -> None:
    """Standing: windows whose means differ by less than 2 w, with w a hundredth of the newest nine's range."""
    means = approach(rate, 1e-2, 12)
    width = 0.01 * float(means[3] - means[11])
    assert means[12 - standing] - means[11] < 2 * width < means[11 - standing] - means[11]
    found = bound(windows(12), means, 1e-9, 2.0)
    assert found.remaining == pytest.approx(2 * width / math.expm1(SLOWEST_PER_S * (standing - 1)))
    assert found.mean_off / found.remaining == pytest.approx(average(SLOWEST_PER_S, -2.0, 0.0))
    assert found.rate_per_s == SLOWEST_PER_S


def test_a_hidden_slow_approach_is_limited_by_the_time_that_the_means_stood() -> None:
    means = np.array([9.0, 7.0, 5.0, 3.0, 5.0, 3.0, 5.0, 3.0, 5.0])
    crude = _unexplained(windows(9), means, 0.5, 2.0).remaining
    assert crude == pytest.approx(7.0 / math.expm1(SLOWEST_PER_S * 8.0))
    assert _hidden_slow(windows(9), means, 0.5) == crude  # the newest two differ by four widths
    for standing in (2, 3, 5):
        stood = np.r_[means[: 9 - standing], np.zeros(standing)]
        expected = 0.1 / math.expm1(SLOWEST_PER_S * (standing - 1))
        assert expected < _unexplained(windows(9), stood, 0.05, 2.0).remaining
        assert _hidden_slow(windows(9), stood, 0.05) == pytest.approx(expected)
    assert _hidden_slow(windows(9), np.zeros(9), 0.5) == pytest.approx(1.0 / math.expm1(SLOWEST_PER_S * 8.0))


def test_a_swing_that_does_not_decay_moves_to_both_sides() -> None:
    edges = windows(18)
    means = np.array([(math.sin(1.3 * b) - math.sin(1.3 * a)) / 1.3 for a, b in edges])
    found = bound(edges, means, 1e-3, 2.0)
    assert 1.7 < found.remaining < 3.0


@pytest.mark.parametrize(
    ("means", "width", "bounded"),
    [
        ([-1.0, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 5.0, 3.0], 0.1, True),  # back to where the second half began
        ([0.0, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 7.0, 6.3], 0.1, False),  # 3.3 of 4
        ([0.0, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 7.0, 6.1], 0.1, True),  # 3.1 of 4
        ([0.0, -1.0, -2.0, -1.0, -3.0, -5.0, -7.0, -7.0, -6.3], 0.1, False),
        ([0.0, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 7.0, 6.3], 0.82, False),  # 4.02 widths
        ([0.0, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 7.0, 6.3], 0.83, True),  # 3.98 widths
        ([-1.1, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 7.0, 7.0], 0.1, True),  # 4.1 in the first half, 4 in the second
        ([-0.9, 1.0, 2.0, 1.0, 3.0, 5.0, 7.0, 7.0, 7.0], 0.1, False),
    ],
)
def test_a_motion_in_one_direction_that_does_not_slow_down_has_no_bound(
    means: list[float], width: float, bounded: bool
) -> None:
    found = _unexplained(windows(9), np.array(means), width, 2.0)
    left = (max(means) - min(means) + 2 * width) / math.expm1(SLOWEST_PER_S * 8.0)
    assert found.remaining == pytest.approx(left if bounded else math.inf)
    assert found.mean_off == pytest.approx(left * average(SLOWEST_PER_S, -2.0, 0.0) if bounded else math.inf)
    assert (found.rate_per_s, found.seen_s) == (SLOWEST_PER_S if bounded else 0.0, 9.0)


def test_missing_signals_are_named() -> None:
    data = clean(lambda t: 0 * t)
    empty = np.full_like(data[1], np.nan)
    assert settled(RotorSignals(data[0], empty, *data[2:])).why == "too many samples of the pendulum angles are missing"
    silent = np.full_like(data[7], np.nan)
    assert settled(RotorSignals(*data[:7], silent)).why == "too many samples of the displacements are missing"
    assert locked_settled(RotorSignals(*data[:7], silent)).why == "too many samples of the displacements are missing"


def test_a_motion_of_fewer_windows_is_compared_by_its_halves() -> None:
    means = np.array([0.0, 1.0, 2.0, 5.0, 6.0, 7.0, 8.5])  # 5 up to the middle window, 3.5 from it on
    assert _unexplained(windows(7), means, 0.1, 2.0).remaining == pytest.approx(8.7 / math.expm1(SLOWEST_PER_S * 6.0))
    assert _unexplained(windows(7), means - [0, 0, 0, 1.6, 0, 0, 0], 0.1, 2.0).remaining == math.inf


def test_a_bound_does_not_depend_on_a_constant_part() -> None:
    for means in (approach(2.0, 1e-2, 12), TWO_RATES[-12:], approach(0.2, 1.0, 12), np.zeros(12)):
        plain = bound(windows(12), means, 1e-6, 2.0)
        for share in (-3.0, 4.0):
            moved = means + share * max(1.0, float(np.ptp(means)))
            assert bound(windows(12), moved, 1e-6, 2.0).remaining == pytest.approx(plain.remaining, rel=1e-4)


@pytest.mark.parametrize("scale", [1e-4, 1e3])
def test_a_bound_scales_with_means_and_width(scale: float) -> None:
    moving = np.zeros(12)
    moving[0] = 2.0001
    rough = np.array([1.0, -1, -1, 1, 1, 1, -1, 1, -1])
    for means, width in (
        (moving, 1.0),
        (np.zeros(12), 1.0),
        (rough, 1e-4),
        (TWO_RATES, 1e-4),
        (approach(2.0, 1e-2, 12), 1e-9),
        (approach(0.2, 1.0, 12), 1e-3),
        (np.exp(0.3 * np.arange(12.0)), 1e-3),
        (swinging(0.1, 1.3, 0.0), 1e-3),
    ):
        plain = bound(windows(len(means)), means, width, 2.0)
        scaled = bound(windows(len(means)), scale * means, scale * width, 2.0)
        assert scaled.remaining == pytest.approx(scale * plain.remaining, rel=1e-6)
        assert scaled.mean_off == pytest.approx(scale * plain.mean_off, rel=1e-6)
        assert (scaled.rate_per_s, scaled.seen_s) == pytest.approx((plain.rate_per_s, plain.seen_s))


def test_what_no_model_explains_to_a_tenth_of_its_range_has_the_crude_bound() -> None:
    rough = np.array([1.0, -1, -1, 1, 1, 1, -1, 1, -1])
    assert bound(windows(9), rough, 1e-4, 2.0).remaining == math.inf
    ended = np.array([1.0, -1, -1, 1, 1, 1, -1, 1, 0.9])
    expected = 2.0 * 1.02 / math.expm1(SLOWEST_PER_S * 8.0)
    assert bound(windows(9), ended, 1e-4, 2.0).remaining == pytest.approx(expected)


def test_means_that_agree_to_twice_the_width_are_constant() -> None:
    """They exclude approaches, and include none that are slower than the slowest rate."""
    still = bound(windows(12), np.zeros(12), 1.0, 2.0)
    noise = np.array([1, -1, -1, 1, -1, 1, 1, 1, -1, -1, 1, -1])
    assert bound(windows(12), 0.95 * noise, 1.0, 2.0).remaining <= still.remaining
    edge = np.zeros(12)
    edge[0] = 2.0 * (1 + 1e-12)
    assert bound(windows(12), edge, 1.0, 2.0).remaining <= 1.2 * still.remaining
    edge[0] = 2.0001
    assert bound(windows(12), edge, 1.0, 2.0).remaining > 1.5 * still.remaining


def test_slower_approaches_are_included_the_more_the_means_move() -> None:
    """From 0.08 1/s for means that move by up to 4 widths to 0.01 1/s for 8, with the third power."""
    assert [_slowest(widths) for widths in (0.0, 4.0)] == [SLOWEST_PER_S] * 2
    assert _slowest(6.0) == pytest.approx(0.08 * (2 / 3) ** 3)
    assert [_slowest(widths) for widths in (8.0, 100.0)] == pytest.approx([0.01] * 2)


def test_the_width_is_at_least_a_hundredth_of_what_moves() -> None:
    means = approach(0.2, 1.0, 12) + 0.003 * np.array([1, -1, 1, 1, -1, -1, 1, -1, 1, -1, -1, 1])
    one_rate_alone = bound(windows(12), means, 0.0, 2.0, far=0.0)
    wide = bound(windows(12), means, 0.01 * float(np.ptp(means[-9:])), 2.0)
    assert one_rate_alone == wide
    assert bound(windows(12), means, 0.0, 2.0).remaining > wide.remaining  # two rates may explain what is not noise


# the decision


def test_span_and_drifts_are_those_of_the_windows() -> None:
    data = clean(lambda t: 0.5 * DEGREE * np.exp(-0.3 * (t - 29.877)), amplitude=lambda t: 1e-3 + 2e-8 * t)
    found = settled(RotorSignals(*data), angle_step_rad=0.0)
    last = data[2][-1]
    step = (
        0.5
        * DEGREE
        * abs(
            average(0.3, last - WINDOW_S - 29.877, last - 29.877)
            - average(0.3, last - 2 * WINDOW_S - 29.877, last - WINDOW_S - 29.877)
        )
    )
    assert found.drift_rad == pytest.approx(step, rel=1e-3)
    assert found.drift_m == pytest.approx(2e-8 * WINDOW_S, rel=1e-3)
    assert found.span_s == pytest.approx(29 * WINDOW_S)
    since = settled(RotorSignals(*data), angle_step_rad=0.0, release_time_s=10.0)
    assert since.span_s == pytest.approx(19 * WINDOW_S)


def test_nine_windows_are_enough_and_eight_are_not() -> None:
    data = clean(lambda t: 1.0 + 0 * t)
    end = data[2][-1]
    assert settled(
        RotorSignals(*data), SettlingLimits(linger_s=0.0), release_time_s=end - 9.01 * WINDOW_S
    ).span_s == pytest.approx(9 * WINDOW_S)
    short = settled(RotorSignals(*data), release_time_s=end - 8.99 * WINDOW_S)
    assert (short.settled, short.slipping, short.span_s, short.remaining_rad) == (False, False, 0.0, math.inf)
    assert (short.remaining_m, short.more_s) == (math.inf, math.inf)
    assert math.isnan(short.drift_rad)
    assert math.isnan(short.drift_m)
    assert short.why == "fewer than 9 windows of 1 s since release"
    signals = [part[data[j - j % 2] <= 8.9 * WINDOW_S] for j, part in enumerate(data)]
    assert locked_settled(RotorSignals(*signals)).why == "fewer than 9 windows of 1 s at speed"
    enough = [part[data[j - j % 2] <= 9.2 * WINDOW_S] for j, part in enumerate(data)]
    assert locked_settled(RotorSignals(*enough)).span_s == pytest.approx(9 * WINDOW_S)


def test_pendulums_that_move_far_are_judged_by_the_newest_windows() -> None:
    """Far: more than 20 tolerances, 2°, over three windows."""
    for per_window, count in ((1.05, 9), (0.95, 29)):
        data = clean(lambda t, rate=per_window * DEGREE / WINDOW_S: rate * t)
        assert settled(RotorSignals(*data), angle_step_rad=0.0).span_s == pytest.approx(count * WINDOW_S)


def test_the_sentence_has_remaining_change_limit_and_time() -> None:
    data = clean(lambda t: DEGREE * np.exp(-0.2 * (t - 30.0)))
    found = settled(RotorSignals(*data), angle_step_rad=0.0)
    left, rate = math.degrees(found.remaining_rad), 0.2
    assert found.more_s == pytest.approx(math.log(left / 0.1) / rate, rel=0.1)
    assert found.why == (
        f"pendulum angles may still change by {left:.2g}°, the limit is 0.1°; about {math.ceil(found.more_s)} s more"
    )
    assert found.approaching
    orbit = clean(lambda t: 1.0 + 0 * t, amplitude=lambda t: 1e-3 + 5e-5 * np.exp(-0.2 * (t - 30.0)))
    found = settled(RotorSignals(*orbit), angle_step_rad=0.0)
    left = 1e6 * found.remaining_m
    assert left == pytest.approx(50.0, rel=0.4)
    assert found.more_s == pytest.approx(math.log(left / 3.0) / rate, rel=0.1)
    assert found.why == (
        f"amplitudes may still change by {left:.2g} µm, the limit is 3 µm; about {math.ceil(found.more_s)} s more"
    )
    locked = locked_settled(RotorSignals(*orbit))
    left = 1e6 * locked.remaining_m
    assert locked.more_s == pytest.approx(math.log(left / 5.0) / rate, rel=0.1)
    assert locked.why == (
        f"amplitudes may still change by {left:.2g} µm, the limit is 5 µm; about {math.ceil(locked.more_s)} s more"
    )
    assert math.isnan(locked.drift_rad)
    assert math.isnan(locked.remaining_rad)


def test_the_longer_of_both_times_counts() -> None:
    slow, fast = (lambda t: 1e-3 + 5e-5 * np.exp(-0.1 * (t - 30.0))), (lambda t: DEGREE * np.exp(-0.4 * (t - 30.0)))
    both = settled(RotorSignals(*clean(fast, amplitude=slow)), angle_step_rad=0.0)
    orbit = settled(RotorSignals(*clean(lambda t: 0 * t, amplitude=slow)), angle_step_rad=0.0)
    angle = settled(RotorSignals(*clean(fast)), angle_step_rad=0.0)
    assert both.more_s == pytest.approx(orbit.more_s)
    assert both.more_s > 2 * angle.more_s > 0
    assert both.why == angle.why.partition(";")[0] + both.why[both.why.index(";") :]


def test_a_drift_is_named_per_window() -> None:
    found = settled(RotorSignals(*clean(lambda t: 0.2 * DEGREE * t)), angle_step_rad=0.0)
    assert found.why == f"pendulum angles drift by {0.2 * WINDOW_S:.2g}° per window and the drift does not shrink"
    assert (found.more_s, found.approaching) == (math.inf, False)
    moving = settled(RotorSignals(*clean(lambda t: 0 * t, amplitude=lambda t: 1e-3 + 2e-6 * t)), angle_step_rad=0.0)
    assert moving.why == f"amplitudes drift by {2.0 * WINDOW_S:.2g} µm per window and the drift does not shrink"


def test_slack_multiplies_both_limits() -> None:
    angle = clean(lambda t: DEGREE * np.exp(-0.2 * (t - 30.0)))
    orbit = clean(lambda t: 1.0 + 0 * t, amplitude=lambda t: 1e-3 + 5e-5 * np.exp(-0.2 * (t - 30.0)))
    assert "the limit is 0.3°" in settled(RotorSignals(*angle), SettlingLimits(slack=3.0), angle_step_rad=0.0).why
    assert "the limit is 9 µm" in settled(RotorSignals(*orbit), SettlingLimits(slack=3.0), angle_step_rad=0.0).why
    assert (
        settled(RotorSignals(*angle), SettlingLimits(slack=20.0), angle_step_rad=0.0).why
        == "angles and amplitudes are steady"
    )


def test_mean_off_is_that_of_the_stated_period() -> None:
    data = clean(
        lambda t: DEGREE * np.exp(-0.2 * (t - 30.0)), amplitude=lambda t: 1e-3 + 5e-5 * np.exp(-0.2 * (t - 30.0))
    )
    for seconds in (2.0, 6.0):
        found = settled(RotorSignals(*data), SettlingLimits(average_s=seconds), angle_step_rad=0.0)
        more = average(0.2, -seconds, 0.0)
        assert found.mean_off_rad / found.remaining_rad == pytest.approx(more, rel=0.1)
        assert found.mean_off_m / found.remaining_m == pytest.approx(more, rel=0.1)
    assert settled(RotorSignals(*data), angle_step_rad=0.0) == settled(
        RotorSignals(*data), SettlingLimits(average_s=2.0), angle_step_rad=0.0
    )


@pytest.mark.parametrize("gain", [2.2e-4, -2.2e-4])
def test_the_change_of_speed_is_signed_and_limited_to_a_thousandth(gain: float) -> None:
    """Mean speed of the last two of nine windows less that of the first two: seven windows apart."""

    def phase(per_s: float):
        return lambda t: SPEED * (t + 0.5 * per_s * (t - 25.0) ** 2)

    found = settled(RotorSignals(*clean(lambda t: 0 * t, speed=phase(gain))), angle_step_rad=0.0)
    percent = float(found.why.partition("by ")[2].partition(" %")[0])
    assert percent == pytest.approx(100 * gain * 7 * WINDOW_S, abs=0.01)
    assert found.why.startswith("the speed still changes, by ")
    assert (found.settled, found.approaching) == (False, False)
    less = settled(RotorSignals(*clean(lambda t: 0 * t, speed=phase(0.55 * gain))), angle_step_rad=0.0)
    assert less.settled, less.why


def released(change_a: float, change_b: float = 0.0, *, at: float = 15.0, earlier: float = 0.0):
    data = list(clean(lambda t: 0 * t))
    after = (data[0] > at)[:, None]
    before = (data[0] < at - 0.55)[:, None]
    data[1] = data[1] + after * [change_a, change_b] + before * [earlier, 0.0]
    return data


@pytest.mark.parametrize(
    ("change_a", "change_b", "held"),
    [
        (4.5, 0.0, True),
        (-4.5, 0.0, True),
        (5.5, 0.0, False),
        (-5.5, 0.0, False),
        (0.0, 4.5, True),
        (0.0, 5.5, False),
        (40.0, 40.0, True),
        (40.0, 34.0, False),
        (361.0, 0.0, True),
        (-361.0, 0.0, True),
        (180.0, 0.0, False),
    ],
)
def test_a_pair_with_its_gap_at_release_is_not_accepted(change_a: float, change_b: float, held: bool) -> None:
    found = settled(
        RotorSignals(*released(DEGREE * change_a, DEGREE * change_b)), angle_step_rad=0.0, release_time_s=15.0
    )
    assert found.settled != held, found.why
    assert ("unstable balance" in found.why) == held
    assert not found.approaching


def test_the_gap_at_release_is_that_of_the_last_half_second() -> None:
    data = released(0.0, earlier=DEGREE * 90)
    assert not settled(RotorSignals(*data), angle_step_rad=0.0, release_time_s=15.0).settled
    data[1][(data[0] > 14.7) & (data[0] < 14.9), 1] = np.nan
    assert not settled(RotorSignals(*data), angle_step_rad=0.0, release_time_s=15.0).settled
    data[1][data[0] <= 15.0] = np.nan
    assert settled(RotorSignals(*data), angle_step_rad=0.0, release_time_s=15.0).settled


def test_a_pair_that_stays_for_half_a_minute_is_accepted() -> None:
    data = clean(lambda t: 0 * t, duration=41.0)
    end = data[2][-1]
    assert settled(RotorSignals(*data), angle_step_rad=0.0, release_time_s=end - 30.5).settled
    assert not settled(RotorSignals(*data), angle_step_rad=0.0, release_time_s=end - 29.5).settled


def test_a_turning_pendulum_is_named_with_its_turns() -> None:
    for rate, sign in ((1.3, "+"), (-1.3, "−".replace("−", "-"))):
        data = list(clean(lambda t: 0 * t))
        data[1] = data[1] + np.stack([0 * data[0], rate * data[0]], axis=1)
        found = settled(RotorSignals(*data), angle_step_rad=0.0)
        turns = 1.3 * 8 * WINDOW_S / (2 * math.pi)
        assert found.why == f"pendulum B slips: {sign}{turns:.1f} turns relative to the rotor in the last windows"
        assert (found.slipping, found.settled, found.more_s, found.approaching) == (True, False, math.inf, False)


def test_slipping_is_a_steady_turn_by_more_than_half() -> None:
    """Nine means: the last four of eight steps are at least half as large as the first four."""

    def column(*steps: float) -> np.ndarray:
        return np.stack([np.zeros(9), np.cumsum([0.0, *steps])], axis=1)

    assert not _slipping(column(*[0.39] * 8))  # 3.12 rad
    assert not _slipping(np.stack([np.zeros(9), np.linspace(0.0, np.pi, 9)], axis=1))  # half a turn
    assert _slipping(column(*[0.40] * 8))
    assert _slipping(column(*[-0.40] * 8))
    assert _slipping(column(*[1.0] * 4, *[0.55] * 4))
    assert not _slipping(column(*[1.0] * 4, *[0.45] * 4))
    assert not _slipping(column(*[1.0] * 7, -0.1))
    assert not _slipping(column(*[-1.0] * 7, 0.1))
    assert not _slipping(column(1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0))


def test_time_until_the_limit() -> None:
    assert _more(Approach(8.0, 8.0, 0.5, 10.0), 1.0) == pytest.approx(math.log(8.0) / 0.5)
    for left in (1.0, 0.5, 0.0):
        assert _more(Approach(left, left, 0.5, 10.0), 1.0) == 0.0
    assert _more(Approach(8.0, 8.0, 0.0, 10.0), 1.0) == math.inf
    assert _more(Approach(math.inf, math.inf, 0.0, 10.0), 1.0) == math.inf


def seen(means: np.ndarray, width: tuple[float, float], coloured: bool = False) -> WindowMeans:
    return WindowMeans(
        windows(len(means)), means, np.array(width), np.array(width) / 3.5, np.empty((2, 0)), coloured=coloured
    )


def test_lasers_that_wander_raise_the_limit_to_the_width_of_a_mean() -> None:
    orbit = seen(np.zeros((9, 2)), (2e-6, 7e-6))
    assert _visible(orbit, 3e-6) == 3e-6
    assert _visible(replace(orbit, coloured=True), 3e-6) == 7e-6
    assert _visible(replace(orbit, coloured=True), 9e-6) == 9e-6


def test_the_worse_quantity_counts_with_the_least_width() -> None:
    means = np.stack([np.zeros(12), approach(0.2, 1.0, 12)], axis=1)
    for order in (slice(None), slice(None, None, -1)):
        found = _worst(seen(means[:, order], (1e-3, 1e-3)), 0.01, 0.1, 2.0)
        assert found == bound(windows(12), means[:, 1], 1e-3, 2.0)
    still = _worst(seen(np.zeros((12, 2)), (0.0, 0.0)), 0.5, 0.1, 2.0)
    assert still == bound(windows(12), np.zeros(12), 0.05, 2.0)
    wide = _worst(seen(np.zeros((12, 2)), (0.2, 0.0)), 0.5, 0.1, 2.0)
    assert wide == bound(windows(12), np.zeros(12), 0.2, 2.0)


def test_the_least_width_is_a_fiftieth_of_the_angles_tolerance_and_a_tenth_of_the_amplitudes() -> None:
    limits = SettlingLimits(angle_tolerance_rad=0.5, amplitude_tolerance_m=3e-6, average_s=2.0)
    still = seen(np.zeros((12, 2)), (0.0, 0.0))
    found = _judged(still, still, limits, "", held=False)
    assert found.remaining_rad == pytest.approx(bound(windows(12), np.zeros(12), 0.01, 2.0).remaining)
    assert found.remaining_m == pytest.approx(bound(windows(12), np.zeros(12), 3e-7, 2.0).remaining)


@pytest.mark.parametrize("kind", [Settling, SettlingLimits, RotorSignals, Approach, WindowMeans])
def test_a_result_cannot_be_changed(kind: type) -> None:
    with pytest.raises(FrozenInstanceError):
        object.__new__(kind).name = 1


def test_options_are_given_by_name() -> None:
    signals = RotorSignals(*clean(lambda t: 0 * t))
    with pytest.raises(TypeError):
        SettlingLimits(0.1)
    with pytest.raises(TypeError):
        settled(signals, SettlingLimits(), 0.1)
    with pytest.raises(TypeError):
        locked_settled(signals, 5e-6)


def test_a_locked_orbit_is_judged_without_angles() -> None:
    signals = RotorSignals(*clean(lambda t: 0 * t))
    silent = replace(signals, angle_time_s=np.empty(0), angle_rad=np.empty((0, 2)))
    assert locked_settled(silent) == locked_settled(signals)
