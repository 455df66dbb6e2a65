"""Settled or not: decay, growth, creep and slip, with the rig's noise and quantisation."""

import dataclasses
import math

import numpy as np
import pytest

from daq.signals import settling
from daq.signals.settling import RotorSignals, Settling, SettlingLimits, locked_settled
from tests.daq.signals.known_motions import average
from tests.effort import cases

STEP = 2 * np.pi / 4096
SPEED = 49.0


def settled(
    data: RotorSignals,
    limits: SettlingLimits | None = None,
    *,
    angle_step_rad: float = STEP,
    release_time_s: float | None = None,
) -> Settling:
    return settling.settled(
        data, limits or SettlingLimits(), angle_step_rad=angle_step_rad, release_time_s=release_time_s
    )


def signals(
    offset,
    *,
    duration: float = 30.0,
    amplitude=lambda t: 1e-3 + 0 * t,
    wobble: float = 0.0,
    seed: int = 0,
    base=(0.0, math.pi),
    speed: float = SPEED,
    keep: float = 1.0,
):
    """Angles base + offset(t) (rad; A up, B down), order-1 motion of a given amplitude; all noisy and quantised."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, duration, 1e-3)
    t = t[rng.random(len(t)) < keep]
    angle = np.array(base) + np.stack([offset(t), -offset(t)], axis=1) + wobble * np.cos(2 * speed * t)[:, None]
    angle = np.round(angle / STEP + 0.3 * rng.standard_normal(angle.shape)) * STEP
    marks = np.arange(0, duration, 2 * np.pi / speed)
    lt = np.arange(0, duration, 1 / 4000)
    x = amplitude(lt) * np.cos(speed * lt) + 4e-6 * rng.standard_normal(len(lt))
    y = 0.7 * amplitude(lt) * np.sin(speed * lt) + 4e-6 * rng.standard_normal(len(lt))
    return t, angle, marks, speed * marks, lt, x, lt, y


def judge(*args, **kwargs) -> Settling:
    return settled(RotorSignals(*signals(*args, **kwargs)))


def test_standing_pendulums_are_settled() -> None:
    for seed in range(10):
        result = judge(lambda t: 1.0 + 0 * t, seed=seed)
        assert result.settled, result.why
        assert result.remaining_rad < math.radians(0.01)


@pytest.mark.parametrize("wobble_deg", [0.5, 5.0])
def test_wobble_of_a_periodic_orbit_does_not_matter(wobble_deg: float) -> None:
    result = judge(lambda t: 1.0 + 0 * t, wobble=math.radians(wobble_deg), keep=0.9)
    assert result.settled, result.why


@pytest.mark.parametrize("rate", [0.12, 0.2, 0.4, 1.0])
def test_remaining_bounds_an_exponential_approach(rate: float) -> None:
    """Never less than the remaining change; not much more if a slow approach cannot be hidden."""
    for left_deg in (3.0, 1.0, 0.3):
        left = math.radians(left_deg)
        result = judge(lambda t, left=left: 1.0 + np.minimum(left * np.exp(-rate * (t - 30.0)), 2.5))
        assert not result.settled
        assert result.remaining_rad > 0.93 * left
        if rate < 0.5:
            assert result.remaining_rad < 1.6 * left + math.radians(0.02)
            assert result.more_s == pytest.approx(math.log(left / math.radians(0.1)) / rate, abs=1.0 / rate)


@pytest.mark.parametrize("rate", [0.17, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("end_deg", [0.08, 0.3, 2.0])
def test_leaving_an_unstable_balance_is_never_settled(rate: float, end_deg: float) -> None:
    """At the end the pendulums are only end_deg from the saddle; the drift is below every tolerance, and grows."""
    for seed in range(cases(2, 8)):
        result = judge(lambda t: 0.18 + math.radians(end_deg) * np.exp(rate * (t - 30.0)), seed=seed)
        assert not result.settled, (seed, result)
        assert result.remaining_rad == math.inf


def test_standing_as_released_is_not_settled_for_a_while() -> None:
    """Nothing moves yet: only the time since release prevents acceptance."""
    data = signals(lambda t: np.where(t > 10.0, math.radians(1.0), 0.0), duration=30.0)
    assert not settled(RotorSignals(*data), release_time_s=10.0).settled
    assert "unstable balance" in settled(RotorSignals(*data), release_time_s=10.0).why
    assert settled(RotorSignals(*data), SettlingLimits(linger_s=15.0), release_time_s=10.0).settled


def test_creeping_pendulum_is_not_settled_though_the_amplitude_stands() -> None:
    for seed in range(5):
        result = judge(lambda t: math.radians(0.03) * t, seed=seed)
        assert not result.settled
        assert not result.slipping
        assert "pendulum angles drift" in result.why


def test_swinging_over_once_and_decaying_is_not_slipping() -> None:
    assert not judge(lambda t: 4.0 * (1 - np.exp(-0.6 * np.maximum(t - 22.0, 0)))).slipping


def test_short_or_sparse_signals_are_not_settled() -> None:
    assert "fewer than" in judge(lambda t: 0 * t, duration=5.0).why
    assert not settled(RotorSignals(*[np.empty((0, 2)) if j == 1 else np.empty(0) for j in range(8)])).settled
    data = signals(lambda t: 0 * t)
    for silent, what in ((1, "pendulum angles"), (5, "displacements"), (7, "displacements")):
        parts = RotorSignals(*[np.full_like(part, np.nan) if j == silent else part for j, part in enumerate(data)])
        for decide in (settled, locked_settled)[: 1 + (silent > 1)]:
            assert decide(parts).why == f"too many samples of the {what} are missing"
    few = settled(RotorSignals(data[0][:10], data[1][:10], *data[2:]))
    assert few.why == "too many samples of the pendulum angles are missing"


def test_locked_orbit_decays_before_it_is_steady() -> None:
    def decaying(t):  # a free vibration beats with the forced one
        return 1e-3 + 4e-4 * np.exp(-0.38 * t) * np.cos(3.2 * t)

    early = signals(lambda t: 0 * t, duration=9.0, amplitude=decaying)
    late = signals(lambda t: 0 * t, duration=26.0, amplitude=decaying)
    assert not locked_settled(RotorSignals(*early)).settled
    assert locked_settled(RotorSignals(*late)).settled, locked_settled(RotorSignals(*late)).why
    assert math.isnan(locked_settled(RotorSignals(*late)).remaining_rad)


def coded(
    offset, counts: int, noise: float, duration: float, *, ripple: float = 0.0, speed: float = SPEED, seed: int = 0
):
    """As `signals`, with encoders of any step and lasers at rest, for motions of both pendulums given in rad."""
    rng = np.random.default_rng(seed)
    t, _, marks, phase, tx, x, ty, y = signals(lambda t: 0 * t, duration=duration, speed=speed, seed=seed)
    step = 2 * np.pi / counts
    true = rng.uniform(0, 2 * np.pi, 2) + offset(t)[:, None] * [1.0, -0.7] + ripple * np.cos(2 * speed * t)[:, None]
    return t, np.round(true / step + noise * rng.standard_normal(true.shape)) * step, marks, phase, tx, x, ty, y


@pytest.mark.parametrize("counts", [4096, 65536])
@pytest.mark.parametrize("noise", [0.0, 0.3, 2.0])
def test_steady_pendulums_are_settled_with_any_encoder(counts: int, noise: float) -> None:
    """Constant counts above all: the means differ by floating point noise only."""
    for seed in range(cases(3, 6)):
        data = coded(lambda t: 0 * t, counts, noise, 14.0, ripple=(seed % 3) * 2e-3, seed=seed)
        result = settled(RotorSignals(*data))
        assert result.settled, (seed, result.why)
        assert settled(RotorSignals(*data), angle_step_rad=2 * np.pi / counts).settled


def test_a_coarse_encoder_that_stands_is_settled_once_it_has_stood_for_long() -> None:
    for seed in range(4):
        short, long = (coded(lambda t: 0 * t, 256, 0.0, duration, seed=seed) for duration in (11.0, 32.0))
        step = 2 * np.pi / 256
        early = settled(RotorSignals(*short), angle_step_rad=step)
        assert not early.settled
        assert 5 < early.more_s < 60
        late = settled(RotorSignals(*long), SettlingLimits(angle_tolerance_rad=math.radians(0.3)), angle_step_rad=step)
        assert late.settled, late.why


@pytest.mark.parametrize(("rate", "noise"), [(0.12, 0.3), (0.18, 0.0), (0.18, 0.3), (0.35, 0.0)])
def test_settled_means_that_no_more_than_the_tolerance_is_to_come(rate: float, noise: float) -> None:
    """Close to the end quantisation dominates; evaluated repeatedly, as in the guided test."""
    for seed in range(1):
        data = coded(lambda t: 2.0 * np.exp(-rate * t), 4096, noise, 75.0, seed=seed)
        for end in np.arange(6.0 / rate, 75.0, 1.0):
            inside = [data[j] <= end for j in (0, 2, 4, 6)]
            cut = [data[j][inside[j // 2]] for j in range(8)]
            result = settled(
                RotorSignals(*cut), SettlingLimits(angle_tolerance_rad=math.radians(0.05)), angle_step_rad=STEP
            )
            left = math.degrees(2.0 * math.exp(-rate * cut[2][-1]))
            if result.settled:
                break
            assert math.isfinite(result.remaining_rad), (end, result.why)
        assert result.settled, result.why
        assert left < 0.05
        again = settled(RotorSignals(*(data[j][data[j - j % 2] <= end + 2.5] for j in range(8))), angle_step_rad=STEP)
        assert again.settled, again.why  # a state that the test accepted is steady in the log after another 2.5 s


def test_two_rates_and_a_pause_are_not_mistaken_for_the_end() -> None:
    """A slow approach together with a fast one, one that starts late, and a pause."""
    for seed in range(4):

        def both(t):
            return 0.5 * np.exp(-1.2 * (t - 12.0)).clip(max=4) + 0.02 * np.exp(-0.1 * (t - 20.0))

        result = settled(RotorSignals(*coded(both, 4096, 0.3, 20.0, seed=seed)))
        assert not result.settled
        assert result.remaining_rad > 0.015
        late = coded(lambda t: 0.3 * np.exp(-0.2 * np.maximum(t - 14.0, 0.0)), 4096, 0.0, 20.0, seed=seed)
        assert not settled(RotorSignals(*late)).settled


def test_a_window_without_samples_does_not_hide_the_older_ones() -> None:
    data = list(coded(lambda t: 0 * t, 4096, 0.3, 30.0))
    keep = (data[0] < 8.0) | (data[0] > 9.5)
    data[0], data[1] = data[0][keep], data[1][keep]
    assert settled(RotorSignals(*data)).settled
    silent = data[0] < 28.0
    assert "angles are missing" in settled(RotorSignals(data[0][silent], data[1][silent], *data[2:])).why


def _wander(count: int, rate_Hz: float, seed: int) -> np.ndarray:
    """1/f noise with an rms of 10 µm."""
    rng = np.random.default_rng([seed, 5])
    frequency = np.fft.rfftfreq(count, 1 / rate_Hz)
    shape = np.where(frequency >= 0.02, np.maximum(frequency, 0.02) ** -0.5, 0.0)
    noise = np.fft.irfft(shape * (rng.standard_normal(len(shape)) + 1j * rng.standard_normal(len(shape))), count)
    return 1e-5 * noise / noise.std()


def test_lasers_that_wander_are_no_motion() -> None:
    """At 2.5 Hz an amplitude of a window scatters by 2 µm; pendulums at rest are settled nevertheless."""
    for duration in (18.0, 40.0):
        for seed in range(cases(2, 6)):
            data = list(signals(lambda t: 1.0 + 0 * t, speed=5 * np.pi, duration=duration, seed=seed))
            data[5], data[7] = (data[j] + _wander(len(data[j]), 4000.0, seed + 10 * j) for j in (5, 7))
            result = settled(RotorSignals(*data), angle_step_rad=STEP)
            assert result.settled, result.why


def test_lasers_that_wander_do_not_hide_an_orbit_or_pendulums_that_move() -> None:
    for seed in range(cases(2, 4)):
        orbit = list(
            signals(lambda t: 1.0 + 0 * t, amplitude=lambda t: 1e-3 + 1e-4 * np.exp(-0.1 * (t - 20.0)), seed=seed)
        )
        angle = list(signals(lambda t: 1.0 + math.radians(0.5) * np.exp(-0.2 * (t - 30.0)), seed=seed))
        for data, which in ((orbit, "amplitudes"), (angle, "pendulum angles")):
            data[5], data[7] = (data[j] + _wander(len(data[j]), 4000.0, seed + 10 * j) for j in (5, 7))
            result = settled(RotorSignals(*data), angle_step_rad=STEP)
            assert not result.settled
            assert which in result.why


TURNS = 8  # revolutions in a window of at least 1 s at 49 rad/s
WINDOW_S = TURNS * 2 * math.pi / SPEED
DEGREE = math.radians(1.0)


def clean(offset, *, amplitude=lambda t: 1e-3 + 0 * t, duration: float = 30.0, speed=lambda t: SPEED * t):
    """Signals without noise and rounding: A at offset(t), B opposite at rest; x and 0.7 times as much along y."""
    t = np.arange(0, duration, 2e-3)
    marks = np.arange(0, duration, 2 * math.pi / SPEED)
    laser = np.arange(0, duration, 1e-3)
    angles = np.stack([offset(t), math.pi + 0 * t], axis=1)
    x, y = amplitude(laser) * np.cos(speed(laser)), 0.7 * amplitude(laser) * np.sin(speed(laser))
    return t, angles, marks, speed(marks), laser, x, laser, y


def judged(data, *limits: SettlingLimits, **since: float) -> Settling:
    return settled(RotorSignals(*data), *limits, angle_step_rad=0.0, **since)


def released(change_a: float, change_b: float = 0.0, *, at: float = 15.0, earlier: float = 0.0):
    data = list(clean(lambda t: 0 * t))
    after = (data[0] > at)[:, None]
    before = (data[0] < at - 0.55)[:, None]
    data[1] = data[1] + after * [change_a, change_b] + before * [earlier, 0.0]
    return data


def test_span_and_drifts_are_those_of_the_windows() -> None:
    rate, end = 0.3, clean(lambda t: 0 * t)[2][-1]
    data = clean(lambda t: 0.5 * DEGREE * np.exp(-rate * (t - end)), amplitude=lambda t: 1e-3 + 2e-8 * t)
    found = judged(data)
    step = average(rate, -WINDOW_S, 0.0) - average(rate, -2 * WINDOW_S, -WINDOW_S)
    assert found.drift_rad == pytest.approx(0.5 * DEGREE * abs(step), rel=1e-3)
    assert found.drift_m == pytest.approx(2e-8 * WINDOW_S, rel=1e-3)
    assert found.span_s == pytest.approx(29 * WINDOW_S)
    assert judged(data, release_time_s=10.0).span_s == pytest.approx(19 * WINDOW_S)


def test_a_decision_needs_its_least_number_of_windows() -> None:
    data = clean(lambda t: 1.0 + 0 * t)
    limits, end = SettlingLimits(linger_s=0.0), data[2][-1]
    enough = judged(data, limits, release_time_s=end - 9.01 * WINDOW_S)
    short = judged(data, limits, release_time_s=end - 8.99 * WINDOW_S)
    assert enough.span_s == pytest.approx(9 * WINDOW_S)
    assert (short.settled, short.slipping, short.span_s) == (False, False, 0.0)
    assert (short.remaining_rad, short.remaining_m, short.more_s) == (math.inf,) * 3
    assert math.isnan(short.drift_rad) is math.isnan(short.drift_m) is True
    assert short.why == "fewer than 9 windows of 1 s since release"
    early, late = (
        locked_settled(RotorSignals(*[part[data[j - j % 2] <= count * WINDOW_S] for j, part in enumerate(data)]))
        for count in (8.9, 9.2)
    )
    assert early.why == "fewer than 9 windows of 1 s at speed"
    assert late.span_s == pytest.approx(9 * WINDOW_S)


@pytest.mark.parametrize(
    ("what", "tolerance", "unit"), [("pendulum angles", 0.1, "°"), ("amplitudes", 3.0, " µm"), ("locked", 5.0, " µm")]
)
def test_the_sentence_has_remaining_change_limit_and_time(what: str, tolerance: float, unit: str) -> None:
    if what == "pendulum angles":
        found = judged(clean(lambda t: DEGREE * np.exp(-0.2 * (t - 30.0))))
        left = math.degrees(found.remaining_rad)
    else:
        data = clean(lambda t: 1.0 + 0 * t, amplitude=lambda t: 1e-3 + 5e-5 * np.exp(-0.2 * (t - 30.0)))
        found = locked_settled(RotorSignals(*data)) if what == "locked" else judged(data)
        left = 1e6 * found.remaining_m
        assert left == pytest.approx(50.0, rel=0.4)
        assert math.isnan(found.drift_rad) is math.isnan(found.remaining_rad) is (what == "locked")
    of = "amplitudes" if what == "locked" else what
    more = f"the limit is {tolerance:g}{unit}; about {math.ceil(found.more_s)} s more"
    assert found.why == f"{of} may still change by {left:.2g}{unit}, {more}"
    assert found.more_s == pytest.approx(math.log(left / tolerance) / 0.2, rel=0.1)
    assert found.approaching is (what != "locked")


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


def test_mean_off_is_that_of_the_stated_period() -> None:
    data = clean(
        lambda t: DEGREE * np.exp(-0.2 * (t - 30.0)), amplitude=lambda t: 1e-3 + 5e-5 * np.exp(-0.2 * (t - 30.0))
    )
    for seconds in (2.0, 6.0):
        found = judged(data, SettlingLimits(average_s=seconds))
        more = average(0.2, -seconds, 0.0)
        assert found.mean_off_rad / found.remaining_rad == pytest.approx(more, rel=0.1)
        assert found.mean_off_m / found.remaining_m == pytest.approx(more, rel=0.1)
    assert judged(data) == judged(data, SettlingLimits(average_s=2.0))


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
    assert not judged(data, release_time_s=15.0).settled
    data[1][(data[0] > 14.7) & (data[0] < 14.9), 1] = np.nan
    assert not judged(data, release_time_s=15.0).settled
    data[1][data[0] <= 15.0] = np.nan
    assert judged(data, release_time_s=15.0).settled


def test_a_turning_pendulum_is_named_with_its_turns() -> None:
    for rate, sign in ((1.3, "+"), (-1.3, "−".replace("−", "-"))):
        data = list(clean(lambda t: 0 * t))
        data[1] = data[1] + np.stack([0 * data[0], rate * data[0]], axis=1)
        found = judged(data)
        turns = 1.3 * 8 * WINDOW_S / (2 * math.pi)
        assert found.why == f"pendulum B slips: {sign}{turns:.1f} turns relative to the rotor in the last windows"
        assert (found.slipping, found.settled, found.more_s, found.approaching) == (True, False, math.inf, False)


def test_a_locked_orbit_is_judged_without_angles() -> None:
    signals = RotorSignals(*clean(lambda t: 0 * t))
    silent = dataclasses.replace(signals, angle_time_s=np.empty(0), angle_rad=np.empty((0, 2)))
    assert locked_settled(silent) == locked_settled(signals)


@pytest.mark.parametrize(
    ("left_deg", "left_m", "rate", "is_level"),
    [(0.3, 0.0, 0.15, True), (0.3, 0.0, 0.3, False), (0.0, 3e-6, 0.15, True), (0.0, 8e-6, 0.3, False)],
)
def test_means_that_change_by_less_than_the_tolerances_in_the_last_window_rest(
    left_deg: float, left_m: float, rate: float, is_level: bool
) -> None:
    """More than a tolerance is still to come in all of them."""
    found = judged(
        clean(
            lambda t: 1.0 + DEGREE * left_deg * np.exp(-rate * (t - 30.0)),
            amplitude=lambda t: 1e-3 + left_m * np.exp(-rate * (t - 30.0)),
        )
    )
    assert found.approaching
    assert found.is_level is is_level
