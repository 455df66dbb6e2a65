"""Measured steady states of signals made by formulas: every number with its uncertainty, and every limit."""

from __future__ import annotations

import cmath
import math
from dataclasses import FrozenInstanceError, asdict, dataclass, field, replace

import numpy as np
import pytest

from analysis import steady_state, to_come as extrapolated
from analysis.errors import NotEnoughData
from analysis.steady_state import (
    Interval,
    SteadyMeasurement,
    _angles,
    _between,
    _locked,
    _mean_off,
    _orders,
    _own,
    _quantisation,
    _settling,
    _span,
    _speed,
    _state,
    _stated,
    locked_radius_m,
    measure,
    plateau_end,
    plateau_start,
)
from analysis.to_come import UNEXPLAINED, ToCome, _bends, _radius_and_arc
from daq.signals.releases import Release
from daq.signals.run import Run
from daq.signals.settling import RotorSignals, Settling, SettlingLimits
from daq.signals.state_type import state_type
from rig_configs import Rig, load_rig

SPEED = 2 * math.pi * 8.0
STEP = 2 * math.pi / 4096
X, Y = 3e-4 * cmath.exp(0.4j), 2e-4 * cmath.exp(-1.1j)
TWICE = 5e-5  # order 2 of x
NOISE = 2e-6
THETA = (math.radians(250.3), math.radians(240.1))
RELEASE_S, END_S = 4.0, 24.0


def made(
    left_rad: float = 0.0,
    rate: float = 0.2,
    end_s: float = END_S,
    locked_deg: tuple[float, float] = (0.0, 180.0),
    orbit_left_m: float = 0.0,
    seed: int = 2,
) -> Run:
    """Locked until 4 s, then at THETA but for an approach of A; the orbit is steady; the stop begins at end_s."""
    rng = np.random.default_rng(seed)
    stop = end_s + 0.5
    t, laser = np.arange(0, stop, 1e-3), np.arange(0, stop, 1 / 2000)
    theta = np.where((t > RELEASE_S)[:, None], THETA, np.radians(locked_deg))
    theta[:, 0] += (t > RELEASE_S) * left_rad * np.exp(-rate * np.maximum(t - end_s, -20.0))
    codes = np.round(theta / STEP + 0.4 * rng.standard_normal(theta.shape))
    phase = 2 * math.pi * np.arange(int(8 * end_s) + 1)
    marks = phase / SPEED
    slow = marks[-1] + np.cumsum([0.127, 0.135, 0.15])
    size = 1 + (laser > RELEASE_S) * orbit_left_m / abs(X) * np.exp(-rate * np.maximum(laser - end_s, -20.0))
    wave = np.exp(1j * SPEED * laser)
    x = np.real(X * size * wave) + TWICE * np.cos(2 * SPEED * laser) + NOISE * rng.standard_normal(len(laser))
    y = np.real(Y * wave) + NOISE * rng.standard_normal(len(laser))
    return Run(
        test="point-D",
        source="d.mcap",
        start_s=1e9,
        x_time_s=laser,
        x_m=x + 1e-4,
        y_time_s=laser,
        y_m=y - 2e-4,
        angle_time_s=t,
        angle_rad=codes * STEP,
        mark_time_s=np.r_[marks, slow],
        mark_phase_rad=np.r_[phase, phase[-1] + 2 * math.pi * np.arange(1, 4)],
        releases=(Release(0, RELEASE_S), Release(1, RELEASE_S)),
        clock_rate_std={"x": 1e-7, "y": 1e-7, "angles": 1e-7, "phase": 1e-7},
    )


@pytest.fixture(scope="module")
def run() -> Run:
    return made()


@pytest.fixture(scope="module")
def found(run: Run, rig: Rig) -> SteadyMeasurement:
    return measure(run, rig)


def test_every_number_is_that_of_the_formula(found: SteadyMeasurement, rig: Rig) -> None:
    assert found.settling.settled, found.settling.why
    assert (found.state, found.locked, found.creeps) == ("III", True, False)
    assert found.locked_rad == pytest.approx([0.0, math.pi], abs=STEP)
    assert found.speed_rad_s.value == pytest.approx(SPEED, rel=1e-9)
    for theta, true in zip(found.theta_rad, THETA, strict=True):
        assert theta.value == pytest.approx(true, abs=0.3 * STEP)
        assert theta.std > math.radians(rig.roles.zero_std_deg)
    assert found.x_m == pytest.approx(X, abs=6 * found.noise_x_m)
    assert found.y_m == pytest.approx(Y, abs=6 * found.noise_y_m)
    assert found.amplitude_x_m.value == pytest.approx(abs(X), rel=1e-3)
    assert found.amplitude_y_m.value == pytest.approx(abs(Y), rel=1e-3)
    radius = math.sqrt(0.5 * (abs(X) ** 2 + abs(Y) ** 2 + TWICE**2))
    assert found.amplitude_m.value == pytest.approx(radius, rel=1e-3)
    gain_x, gain_y = rig.roles.gain_stds
    assert found.amplitude_x_m.std == pytest.approx(gain_x * abs(X), rel=0.02)
    assert found.amplitude_y_m.std == pytest.approx(gain_y * abs(Y), rel=0.02)
    common = math.hypot(gain_x * abs(X) ** 2, gain_y * abs(Y) ** 2) / (2 * radius)
    assert found.amplitude_m.std > common
    assert found.noise_floor_m == pytest.approx(math.sqrt(found.noise_x_m**2 + found.noise_y_m**2))
    covariance = found.to_come.covariance
    assert found.noise_x_m == pytest.approx(math.sqrt((covariance[2, 2] + covariance[3, 3]) / 2))
    assert found.noise_y_m == pytest.approx(math.sqrt((covariance[4, 4] + covariance[5, 5]) / 2))
    assert 0.3 < found.noise_y_m / (NOISE * math.sqrt(2 / 40_000)) < 3.0
    assert (found.release_s, found.to_s - found.from_s) == (RELEASE_S, 6.0)
    assert found.to_s == pytest.approx(END_S - 1 / 8, abs=0.13)
    assert found.remarks == ()


def test_the_radius_and_its_gains_follow_from_the_orders() -> None:
    """Radius √(½ Σ|X_k|²): its slope along X is X/(2 r); a gain error of x changes it by g |X|²/(2 r)."""
    rig = load_rig("virtual", settings=["devices.laser_y.gain_std=0.01"])
    assert rig.roles.gain_stds[1] > 2 * rig.roles.gain_stds[0]
    x, y = np.array([3e-4 + 4e-4j, 1e-4, 2e-5j]), np.array([1.2e-3j, 0.0, 0.0])
    covariance = np.diag([1e-6, 4e-6, 1e-14, 4e-14, 9e-14, 16e-14])
    own, radius = _own(x, y, covariance)
    assert radius == pytest.approx(math.sqrt(0.5 * (25e-8 + 1e-8 + 4e-10 + 144e-8)))
    assert np.diag(own)[:4] == pytest.approx([1e-6, 4e-6, 0.36e-14 + 0.64 * 4e-14, 16e-14])
    along = np.array([3e-4, 4e-4, 0.0, 1.2e-3]) / (2 * radius)
    assert own[4, 4] == pytest.approx(float(along**2 @ [1e-14, 4e-14, 9e-14, 16e-14]))
    assert own[2, 4] == pytest.approx(0.6 * along[0] * 1e-14 + 0.8 * along[1] * 4e-14)
    same, stated = _stated(np.array([1.0, 2.0]), (x, y), covariance, rig)
    assert same == pytest.approx(own)
    gain_x, gain_y = rig.roles.gain_stds
    zero = math.radians(rig.roles.zero_std_deg)
    by_gain = math.sqrt((gain_x * 25e-8) ** 2 + (gain_y * 144e-8) ** 2) / (2 * radius)
    assert [one.value for one in stated] == pytest.approx([1.0, 2.0, 5e-4, 1.2e-3, radius])
    assert [one.std for one in stated] == pytest.approx(
        [
            math.sqrt(1e-6 + zero**2),
            math.sqrt(4e-6 + zero**2),
            math.sqrt(own[2, 2] + (gain_x * 5e-4) ** 2),
            math.sqrt(own[3, 3] + (gain_y * 1.2e-3) ** 2),
            math.sqrt(own[4, 4] + by_gain**2),
        ]
    )
    at_rest = np.zeros(3, complex), np.zeros(3, complex)
    still, none = _own(*at_rest, covariance)
    assert _stated(np.array([1.0, 2.0]), at_rest, covariance, rig)[1][4] == Interval(0.0, 0.0)
    assert none == 0.0
    assert np.diag(still)[2:] == pytest.approx([0.0] * 3)


def test_speed_has_the_scatter_of_the_marks_and_the_rate_of_the_clock(run: Run) -> None:
    late = np.random.default_rng(3).standard_normal(len(run.mark_time_s)) * 1e-4
    scattered = replace(run, mark_time_s=run.mark_time_s + late, clock_rate_std={"phase": 0.0})
    speed = _speed(scattered, 14.0, 20.0)
    count = 48
    expected = 1e-4 * SPEED / (6.0 / math.sqrt(12) * math.sqrt(count))
    assert speed.std == pytest.approx(expected, rel=0.3)
    assert speed.value == pytest.approx(SPEED, abs=4 * expected)
    clock = _speed(replace(run, clock_rate_std={"phase": 3e-5}), 14.0, 20.0)
    assert clock.std == pytest.approx(3e-5 * SPEED, rel=1e-6)
    assert _speed(replace(run, clock_rate_std={}), 14.0, 20.0).std < 1e-9  # a clock without a stated error
    assert _speed(run, 14.01, 14.51).value == pytest.approx(SPEED)  # four marks
    with pytest.raises(NotEnoughData, match=r"only 3 tachometer marks in the last 0\.4 s"):
        _speed(run, 14.01, 14.38)


def test_a_code_at_rest_leaves_a_step_over_the_root_of_twelve() -> None:
    step, rng = 0.1, np.random.default_rng(5)
    assert _quantisation(np.full(1000, 0.3), step) == pytest.approx(step / math.sqrt(12))
    fine = rng.uniform(0, step, 100_000)
    for noise, left in ((0.1, None), (0.25, None), (1.0, 0.0)):
        code = np.round((fine[0] + noise * step * rng.standard_normal(100_000)) / step) * step
        dither = max(0.0, float(np.var(code)) / step**2 - 1 / 12)
        expected = step / math.sqrt(12) * math.exp(-2 * math.pi**2 * dither) if left is None else left
        assert _quantisation(code, step) == pytest.approx(expected, abs=1e-4 * step)


def spun(*lengths: float) -> tuple[np.ndarray, np.ndarray]:
    times = np.cumsum([0.0, *lengths])
    return times, 2 * math.pi * np.arange(len(times))


def test_the_plateau_ends_a_revolution_before_the_speed_changes() -> None:
    times, phase = spun(*[0.1] * 40, 0.101, 0.11, 0.15)
    assert plateau_end(times, phase, 0.0) == pytest.approx(3.8)
    assert plateau_end(times, phase, 1.0) == pytest.approx(3.8)
    for share, end in ((4e-4, 3.9), (6e-4, 3.8)):  # less than 5e-4 belongs to the plateau
        near = spun(*[0.1] * 40, 0.1 * (1 + share), 0.15)
        assert plateau_end(*near, 0.0) == pytest.approx(end, abs=1e-3)
    rough = 0.1 * (1 + 1e-3 * (np.arange(42) % 3 - 1))
    for share, late in ((7.6e-3, True), (8.4e-3, False)):  # eight times the median deviation, 1e-3
        end = plateau_end(*spun(*rough, 0.1 * (1 + share), 0.2), 0.0)
        assert end == pytest.approx(4.1 if late else 4.0, abs=1e-3)
    with pytest.raises(NotEnoughData, match=r"only 2 tachometer marks after the release at 4\.2 s"):
        plateau_end(*spun(*[0.1] * 43), 4.15)
    assert plateau_end(*spun(0.1, 0.1), 0.0) == pytest.approx(0.1)


def test_the_plateau_starts_with_the_first_mark_after_the_ramp() -> None:
    times, phase = spun(0.3, 0.2, 0.15, *[0.1] * 40)
    assert plateau_start(times, phase, 0.0, 4.65) == pytest.approx(0.75)
    assert plateau_start(times, phase, 0.7, 4.65) == pytest.approx(0.75)
    assert plateau_start(times, phase, 0.0, 2.0) == pytest.approx(0.75)
    assert plateau_start(*spun(*[0.1] * 40), 0.0, 4.0) == 0.0
    for share, start in ((9e-4, 0.0), (12e-4, 0.2)):  # twice the tolerance of the end
        assert plateau_start(*spun(0.1 * (1 + share), *[0.1] * 40), 0.0, 4.1) == pytest.approx(start, abs=1e-3)
    rough = 0.1 * (1 + 1e-3 * (np.arange(42) % 3 - 1))
    for share, start in ((7.6e-3, 0.0), (8.4e-3, 0.2)):  # eight times the median deviation, 1e-3
        assert plateau_start(*spun(0.1 * (1 + share), *rough), 0.0, 4.3) == pytest.approx(start, abs=2e-3)
    with pytest.raises(NotEnoughData, match=r"only 2 tachometer marks between 0\.0 and 0\.4 s"):
        plateau_start(times, phase, 0.0, 0.4)


def test_the_speed_of_a_plateau_is_that_of_its_last_quarter() -> None:
    """24 intervals, the last four at 1, 19 before at 1.02: eight times the median deviation from 1 is 0.16."""
    for first, late in ((1.1, False), (1.15, False), (1.17, True)):
        times, phase = spun(1 / first, *[1 / 1.02] * 19, *[1.0] * 4)
        assert plateau_start(times, phase, 0.0, 99.0) == times[2 if late else 0]
    times, phase = spun(*[1 / 1.02] * 25, *[1.0] * 3)  # the last seven of 28: their median is 1.02
    assert plateau_start(times, phase, 0.0, 99.0) == times[-1]
    times, phase = spun(1 / 1.12, *[1 / 1.02] * 23, *[1.0] * 4)  # the last seven: 1, and the last eight 1.01
    assert plateau_start(times, phase, 0.0, 99.0) == 0.0
    # the last one of seven: eight times the median deviation is 0.08, and of the last two 0.04
    assert plateau_start(*spun(1 / 0.94, *[1.0] * 5, 1 / 1.01), 0.0, 99.0) == 0.0
    assert plateau_start(*spun(0.1, 0.1), 0.0, 0.25) == 0.0
    assert plateau_start(*spun(0.1, 0.1, 0.2), 0.0, 0.45) == 0.0  # the last one of three


def before_release(a_deg: float, b_deg: float, at: tuple[float, float] = (0.0, 0.0), moved_deg: float = 0.0) -> Run:
    """Both pendulums at rest before a release at 4 s, but for A between two times."""
    t = np.arange(0.0, 5.0, 2e-3)
    angle = np.tile(np.radians([a_deg, b_deg]), (len(t), 1))
    angle[(t > at[0]) & (t < at[1]), 0] += math.radians(moved_deg)
    angle[t > RELEASE_S, 1] += 1.0
    none = np.empty(0)
    releases = (Release(0, RELEASE_S + 1), Release(1, RELEASE_S))
    return Run("point-D", "", 0.0, none, none, none, none, t, angle, none, none, releases, STEP)


@pytest.mark.parametrize("off_deg", [(1.9, 0.0), (0.0, -1.9), (2.1, 0.0), (0.0, -2.1), (0.0, 2.1), (-2.1, 0.0)])
def test_a_pendulum_within_two_degrees_of_its_lock_is_locked(off_deg: tuple[float, float]) -> None:
    for turns in (0.0, 360.0, -720.0):
        locked, angles = _locked(before_release(off_deg[0] + turns, 180.0 + off_deg[1] - turns))
        assert locked == (max(map(abs, off_deg)) < 2.0)
        assert np.degrees(angles) == pytest.approx([off_deg[0] + turns, 180.0 + off_deg[1] - turns])


@pytest.mark.parametrize(
    ("begin", "end", "moved_deg", "locked"),
    [
        (3.0, 3.1, 3.0, False),
        (1.1, 1.2, -3.0, False),
        (0.5, 0.99, 3.0, True),
        (3.985, 4.0, 3.0, True),  # the release itself
        (3.95, 3.97, 3.0, False),
        (3.0, 3.1, 2.5, True),  # two degrees and the six steps that a code may show
        (3.0, 3.1, 2.55, False),
    ],
)
def test_a_pendulum_that_moves_in_the_last_three_seconds_is_not_locked(
    begin: float, end: float, moved_deg: float, locked: bool
) -> None:
    assert _locked(before_release(0.0, 180.0, (begin, end), moved_deg))[0] == locked


def test_twenty_samples_before_a_release_are_enough() -> None:
    run = before_release(0.0, 180.0)
    for count in (19, 20):
        some = np.flatnonzero(run.angle_time_s < RELEASE_S - 0.021)[-count:]
        few = replace(run, angle_time_s=run.angle_time_s[some], angle_rad=run.angle_rad[some])
        if count == 20:
            assert _locked(few)[0]
        else:
            with pytest.raises(NotEnoughData, match="no pendulum angles before the release"):
                _locked(few)


def test_what_is_missing_is_named(rig: Rig, run: Run) -> None:
    with pytest.raises(NotEnoughData, match="the log holds no release of a pendulum"):
        measure(replace(run, releases=()), rig)
    with pytest.raises(NotEnoughData, match="only one of the two pendulums was released"):
        measure(replace(run, releases=(Release(1, 4.0), Release(1, 4.1))), rig)
    with pytest.raises(NotEnoughData, match=r"8\.\d s at speed after release, at least 9 s needed"):
        measure(replace(run, releases=(Release(0, 4.0), Release(1, END_S - 9.0))), rig)
    early = run.angle_time_s > 3.97
    with pytest.raises(NotEnoughData, match="no pendulum angles before the release"):
        measure(replace(run, angle_time_s=run.angle_time_s[early], angle_rad=run.angle_rad[early]), rig)
    late = run.angle_time_s < 20.0
    with pytest.raises(NotEnoughData, match="pendulum"):
        measure(replace(run, angle_time_s=run.angle_time_s[late], angle_rad=run.angle_rad[late]), rig)


def test_a_record_of_nine_windows_is_enough(rig: Rig, run: Run) -> None:
    both = replace(run, releases=(Release(0, 4.0), Release(1, END_S - 10.6)))
    assert measure(both, rig).release_s == END_S - 10.6


def test_the_locked_radius_is_that_of_two_seconds_before_the_release(run: Run) -> None:
    radius = math.sqrt(0.5 * (abs(X) ** 2 + abs(Y) ** 2))
    assert locked_radius_m(run) == pytest.approx(radius, rel=2e-3)
    other = (run.x_time_s < 1.95) | (run.x_time_s > 3.99)
    assert locked_radius_m(replace(run, x_m=np.where(other, 1.0, run.x_m))) == pytest.approx(radius, rel=2e-3)
    early = (run.x_time_s > 2.0) & (run.x_time_s < 2.5)
    assert locked_radius_m(replace(run, x_m=np.where(early, 2 * run.x_m, run.x_m))) > 1.05 * radius
    later = replace(run, releases=(Release(0, 9.0), Release(1, RELEASE_S)))
    assert locked_radius_m(later) == pytest.approx(radius, rel=2e-3)
    for lacking in (
        replace(run, releases=()),
        replace(run, mark_time_s=run.mark_time_s[:1], mark_phase_rad=run.mark_phase_rad[:1]),
        replace(run, y_m=np.full_like(run.y_m, np.nan)),
        replace(run, x_time_s=run.x_time_s[:0], x_m=run.x_m[:0]),
    ):
        assert math.isnan(locked_radius_m(lacking))


def test_an_approach_that_is_not_over_is_extrapolated(rig: Rig) -> None:
    """The noise may leave a second rate open, in about half of the draws: rate and amounts are those of most draws."""
    draws = [measure(made(math.radians(1.0), 0.3, seed=seed), rig) for seed in range(12)]
    for found in draws:
        assert found.state == "not settled"
        assert found.to_come.model != UNEXPLAINED
        assert found.theta_rad[1].value == pytest.approx(THETA[1], abs=STEP)
        assert found.to_come.shift[1] == pytest.approx(0.0, abs=STEP)
        assert 5 < found.to_come.windows <= 20
    scores = [(found.theta_rad[0].value - THETA[0]) / found.theta_rad[0].std for found in draws]
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 2.0  # the uncertainty is that of the errors
    at_end = [math.radians(1.0) * math.exp(0.3 * (END_S - found.to_s)) for found in draws]
    mean = (math.exp(0.3 * 6.0) - 1) / (0.3 * 6.0)
    assert np.median([found.to_come.rate_per_s for found in draws]) == pytest.approx(0.3, rel=0.25)
    shifts = [found.to_come.shift[0] / left for found, left in zip(draws, at_end, strict=True)]
    assert np.median(shifts) == pytest.approx(-mean, rel=0.1)
    left = [found.to_come.to_come[0] / left for found, left in zip(draws, at_end, strict=True)]
    assert np.median(left) == pytest.approx(-1.0, rel=0.2)


def test_clocks_that_agree_to_a_billionth_add_nothing(rig: Rig, run: Run) -> None:
    """In 20 s and 160 revolutions they turn the vector by 10⁻⁶ rad, 0.3 nm of 300 µm; its noise is ten times larger."""
    noise = [
        measure(replace(run, clock_rate_std=dict.fromkeys(run.clock_rate_std, std)), rig).noise_x_m
        for std in (1e-13, 1e-9)
    ]
    assert noise[1] == pytest.approx(noise[0], rel=0.05)


def test_an_orbit_that_is_not_over_is_extrapolated(rig: Rig) -> None:
    found = measure(made(orbit_left_m=1.5e-5, rate=0.3), rig)
    assert found.x_m == pytest.approx(X, abs=4e-6)
    at_end = 1.5e-5 * math.exp(0.3 * (END_S - found.to_s))
    mean = at_end * (math.exp(0.3 * 6.0) - 1) / (0.3 * 6.0)
    shift = complex(*found.to_come.shift[2:4])
    assert abs(shift) == pytest.approx(mean, rel=0.15)
    assert cmath.phase(shift) == pytest.approx(cmath.phase(-X), abs=0.1)
    assert found.to_come.shift[4:] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_creep_within_the_band_of_friction_is_compared(rig: Rig) -> None:
    run = made(math.radians(0.3), 0.2, end_s=16.0)
    plain = measure(run, rig)
    left = plain.settling.remaining_rad
    assert (plain.state, plain.creeps, plain.settling.settled) == ("not settled", False, False)
    assert not measure(run, rig, 0j, 0.99 * left).creeps
    found = measure(run, rig, 0j, 1.01 * left)
    assert (found.state, found.creeps) == ("III", True)
    more = np.diag(found.to_come.covariance - plain.to_come.covariance)
    assert more == pytest.approx([left**2] * 2 + [plain.settling.remaining_m**2] * 4)


def test_without_a_bound_the_last_change_counts() -> None:
    known = Settling(False, False, "", 1.0, 2.0, 3.0, 4.0, 5.0, mean_off_rad=6.0, mean_off_m=7.0)
    assert _mean_off(known) == (6.0, 7.0)
    assert _mean_off(replace(known, mean_off_rad=math.inf)) == (1.0, 7.0)
    assert _mean_off(replace(known, mean_off_m=math.inf)) == (6.0, 3.0)


@pytest.mark.parametrize(("mark_s", "stood"), [(1.45, True), (1.55, False), (3.9, False), (None, True)])
def test_a_rotor_without_a_mark_for_two_and_a_half_seconds_stood(mark_s: float | None, stood: bool) -> None:
    """The time then counts from the start of the plateau."""
    ramp = RELEASE_S + np.cumsum([0.6, 0.4, 0.3, 0.2])
    times = np.r_[[] if mark_s is None else [mark_s], ramp, ramp[-1] + 0.125 * np.arange(1, 100)]
    phase = 2 * math.pi * np.arange(len(times))
    run = replace(before_release(0.0, 180.0), mark_time_s=times, mark_phase_rad=phase)
    run = replace(run, releases=(Release(0, RELEASE_S), Release(1, RELEASE_S)))
    release, end, free = _span(run)
    assert free == stood
    assert release == pytest.approx(ramp[-1] + 0.125 if stood else RELEASE_S)
    assert end == pytest.approx(times[-3])


@dataclass
class Judge:
    """In place of the settling decision: settled at some ends of the marks, otherwise with a large bound."""

    ends: tuple[float, ...] = ()
    is_level: bool = True
    span_s: float = 12.0
    calls: list[dict[str, float | None]] = field(default_factory=list)

    def __call__(self, signals: RotorSignals, limits: SettlingLimits, **options: float | None) -> Settling:
        end = float(signals.mark_time_s[-1])
        first = {"first": signals.mark_time_s[0], "angle": signals.angle_time_s[0]}
        first |= {"x": signals.x_time_s[0], "y": signals.y_time_s[0]}
        self.calls.append(asdict(limits) | options | {"end": end} | {k: float(at) for k, at in first.items()})
        parts = list(vars(signals).values())
        assert [len(time) for time in parts[::2]] == [len(values) for values in parts[1::2]]
        why, ok = "too short" if self.span_s == 0 else "moves", end in self.ends
        return Settling(ok, False, why, 0.0, 1.0, 0.0, 1.0, self.span_s, more_s=9.0, is_level=self.is_level)


def long_run() -> Run:
    t = np.arange(0.0, 61.0, 0.25)
    return Run("point-D", "", 0.0, t, t, t, 2 * t, t, np.stack([t, t], axis=1), t, t, (), STEP)


def test_a_bound_of_a_moment_ago_holds_while_the_means_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a second to two and a half before, with any newest bound: the means show whether it holds."""
    for ago, is_level, expected in (
        (0.5, True, True),
        (1.5, True, True),
        (2.5, True, True),
        (2.5, False, False),
        (3.0, True, False),
        (0.75, True, False),
        (0.0, False, True),
    ):
        monkeypatch.setattr(steady_state, "settled", Judge((60.0 - ago,), is_level))
        found = _settling(long_run(), 10.0, 60.0, False)
        assert found.settled == expected, (ago, is_level)
        if expected and ago:
            assert (found.why, found.more_s) == ("steady a moment ago; moves", 0.0)
        else:
            assert (found.why, found.more_s) == ("moves", 9.0)


def test_the_decision_has_the_last_forty_seconds_and_the_release(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = Judge((60.0,))
    monkeypatch.setattr(steady_state, "settled", judge)
    for release, free, angle in ((10.0, False, 9.0), (35.0, True, 20.0)):
        _settling(long_run(), release, 60.0, free)
        call = judge.calls[-1]
        assert (call["first"], call["angle"], call["x"], call["y"]) == (release, angle, 20.0, 20.0)
        assert call["release_time_s"] == (None if free else release)
        assert (call["average_s"], call["angle_step_rad"]) == (6.0, STEP)
    monkeypatch.setattr(steady_state, "settled", Judge((), span_s=0.0))
    with pytest.raises(NotEnoughData, match="too short"):
        _settling(long_run(), 10.0, 60.0, False)


def test_samples_within_an_interval_and_finite() -> None:
    t = np.arange(5.0)
    one = _between(t, np.array([0.0, 1.0, np.nan, 3.0, 4.0]), 1.0, 3.0)
    assert [part.tolist() for part in one] == [[1.0, 3.0], [1.0, 3.0]]
    pair = np.array([[0.0, 0.0], [1.0, np.nan], [2.0, 2.0], [3.0, 3.0], [4.0, 4.0]])
    assert _between(t, pair, 1.0, 4.0)[1].tolist() == [[2.0, 2.0], [3.0, 3.0], [4.0, 4.0]]


def turning(count: int, seconds: float = 6.0, noise: float = 0.0) -> Run:
    """Angles with orders 1 and 2, not over whole revolutions; the rotor turns once a second."""
    t = np.linspace(0.0, seconds, count)
    psi = 2 * math.pi * t
    ripple = 0.1 * np.cos(psi + 0.3) + 0.05 * np.sin(2 * psi)
    angle = np.stack([1.0 + ripple, 2.0 - ripple], axis=1) + noise * np.random.default_rng(6).standard_normal(
        (count, 2)
    )
    none = np.empty(0)
    marks = np.arange(0.0, 7.0)
    return Run("", "", 0.0, none, none, none, none, t, angle, marks, 2 * math.pi * marks, (), 1e-4)


def test_mean_angles_are_free_of_orders_one_and_two() -> None:
    mean, std = _angles(turning(1001, 5.7), 0.0, 5.7)
    assert mean == pytest.approx([1.0, 2.0], abs=1e-9)
    assert std == pytest.approx([0.0, 0.0], abs=1e-9)
    mean, std = _angles(turning(4001, 5.7, 1e-2), 0.0, 5.7)
    assert std == pytest.approx([1e-2 / math.sqrt(4001 * 5 / 5.7)] * 2, rel=0.05)  # of the five whole revolutions
    assert mean == pytest.approx([1.0, 2.0], abs=4 * std[0])
    mean, std = _angles(turning(4001, 6.0, 1e-2), 0.0, 6.0)
    assert std == pytest.approx([1e-2 / math.sqrt(4001)] * 2, rel=0.03)  # of exactly six
    partial = turning(1001, 5.7)
    partial.angle_rad[partial.angle_time_s < 0.699] = 99.0  # before the five whole revolutions
    assert _angles(partial, 0.0, 5.7)[0] == pytest.approx([1.0, 2.0], abs=1e-9)
    still = replace(turning(1001), angle_rad=np.full((1001, 2), 1.0))
    assert _angles(still, 0.0, 6.0)[1] == pytest.approx([1e-4 / math.sqrt(12)] * 2, rel=1e-6)


def test_two_hundred_samples_over_two_revolutions_are_enough() -> None:
    assert _angles(turning(200), 0.0, 6.0)[0] == pytest.approx([1.0, 2.0])
    with pytest.raises(NotEnoughData, match=r"only 199 pendulum samples in the last 6\.0 s"):
        _angles(turning(199), 0.0, 6.0)
    assert _angles(turning(600), 0.0, 2.005)[0] == pytest.approx([1.0, 2.0], abs=1e-6)
    with pytest.raises(NotEnoughData, match=r"only 324 pendulum samples in the last 1\.9 s"):
        _angles(turning(1000), 0.0, 1.94)


def displaced(share: float, count: int = 6000) -> tuple[Run, np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 6.0, count)
    psi = 2 * math.pi * 8.0 * t
    wave = 1e-3 * np.cos(psi - 0.4) + 2e-4 * np.sin(2 * psi) + 1e-4 * np.cos(3 * psi)
    wave = wave + 1e-6 * np.random.default_rng(8).standard_normal(count)
    wave[np.random.default_rng(7).permutation(count)[round(share * count) :]] = np.nan
    marks = np.arange(0.0, 6.2, 0.125)
    return replace(turning(300), mark_time_s=marks, mark_phase_rad=16 * math.pi * marks), t, wave


def test_orders_one_to_three_of_a_laser() -> None:
    run, t, wave = displaced(1.0)
    orders, std = _orders(run, t, wave, 0.0, 6.0, "x")
    assert orders == pytest.approx([1e-3 * cmath.exp(-0.4j), -2e-4j, 1e-4], abs=1e-7)
    assert std == pytest.approx(1e-6 * math.sqrt(2 / 6000), rel=0.6)


def test_the_noise_of_a_laser_is_that_of_order_one() -> None:
    """Its amplitude changes from row to row by some micrometres; the other orders do not."""
    run, t, wave = displaced(1.0)
    row = np.floor(t)
    beat = 5e-6 * np.where(row % 2, 1.0, -1.0) * np.cos(2 * math.pi * 8.0 * t)
    std = _orders(run, t, wave + beat, 0.0, 6.0, "x")[1]
    assert std == pytest.approx(5e-6 * math.sqrt(0.5 * 6 / 5 / 6), rel=0.2)


def test_the_noise_over_few_revolutions_is_that_of_single_ones() -> None:
    """Its amplitude changes from revolution to revolution; over eight of them no two are taken together."""
    run, t, wave = displaced(1.0)
    beat = 5e-6 * np.where(np.floor(8.0 * t) % 2, 1.0, -1.0) * np.cos(2 * math.pi * 8.0 * t)
    std = _orders(run, t, wave + beat, 0.0, 1.0, "x")[1]
    assert std == pytest.approx(5e-6 * math.sqrt(0.5 * 8 / 7 / 8), rel=0.2)


@pytest.mark.parametrize(("share", "count", "enough"), [(0.31, 6000, True), (0.29, 6000, False), (1.0, 55, False)])
def test_three_tenths_of_the_samples_are_enough(share: float, count: int, enough: bool) -> None:
    run, t, wave = displaced(share, count)
    if enough:
        assert _orders(run, t, wave, 0.0, 6.0, "x")[0][0] == pytest.approx(1e-3 * cmath.exp(-0.4j), abs=1e-6)
        return
    with pytest.raises(NotEnoughData, match=r"laser x: too few valid samples in the last 6\.0 s"):
        _orders(run, t, wave, 0.0, 6.0, "x")


def test_sixty_valid_samples_are_the_fewest() -> None:
    marks = np.arange(0.0, 2.0, 0.5)
    run = replace(turning(300), mark_time_s=marks, mark_phase_rad=4 * math.pi * marks)
    for count, enough in ((60, True), (59, False)):
        t = np.linspace(0.0, 1.0, count)
        wave = 1e-3 * np.cos(4 * math.pi * t - 0.4)
        if enough:
            assert _orders(run, t, wave, 0.0, 1.0, "x")[0][0] == pytest.approx(1e-3 * cmath.exp(-0.4j), rel=1e-6)
        else:
            with pytest.raises(NotEnoughData, match="laser x: too few valid samples in the last"):
                _orders(run, t, wave, 0.0, 1.0, "x")


def test_a_state_has_a_type_if_it_is_settled_or_creeps(rig: Rig) -> None:
    known = Settling(True, False, "", 0.0, 0.0, 0.0, 0.0, 5.0)
    moves = replace(known, settled=False)
    assert _state(known, (0.1, 0.2), rig.physics, 0j, creeps=False) == "III"
    assert _state(moves, (0.1, 0.2), rig.physics, 0j, creeps=True) == "III"
    assert _state(moves, (0.1, 0.2), rig.physics, 0j, creeps=False) == "not settled"
    assert _state(replace(known, slipping=True), (0.1, 0.2), rig.physics, 0j, creeps=True) == "slipping"


# extrapolation


def extrapolation(shift: list[float], std: list[float], model: str = "one rate") -> ToCome:
    return ToCome(np.array(shift), np.diag(np.square(std)), np.zeros(6), model, 0.2, 12)


DEG, UM = math.radians(1.0), 1e-6


def test_the_sentence_has_what_clearly_exceeds_its_uncertainty() -> None:
    """Angles from two, orbits from three standard deviations, all to the uncertainty's first digit."""
    std = [0.1 * DEG] * 2 + [1 * UM] * 4
    assert extrapolation([0.19 * DEG, -0.19 * DEG, 1.7 * UM, 2.4 * UM, 0.0, 2.9 * UM], std).sentence == ""
    found = extrapolation([0.21 * DEG, -0.34 * DEG, 3 * UM, 4 * UM, 0.0, -3.2 * UM], std)
    assert found.sentence == (
        "extrapolated to where it ends: θ3 by 0.2 ± 0.1°, θ4 by −0.3 ± 0.1°, x by 5 ± 1 µm, y by 3 ± 1 µm"
    )
    fine = extrapolation([0.0123 * DEG, 0.0, 0.0, 0.0, 0.0, 0.0], [0.002 * DEG, DEG, UM, UM, UM, UM])
    assert fine.sentence == "extrapolated to where it ends: θ3 by 0.012 ± 0.002°"
    large = extrapolation([60.0 * DEG, 0.0, 0.0, 0.0, 0.0, 0.0], [20.0 * DEG, DEG, UM, UM, UM, UM])
    assert large.sentence == "extrapolated to where it ends: θ3 by 60 ± 20°"
    assert extrapolation([60.0 * DEG] * 6, std, UNEXPLAINED).sentence == ""
    metres = extrapolation([0.0, 0.0, 5.0, 0.0, 0.0, 0.0], [DEG, DEG, 1.0, 1.0, 1.0, 1.0])
    assert metres.sentence == "extrapolated to where it ends: x by 5000000 ± 1000000 µm"


def test_the_extrapolation_in_json_has_degrees_and_micrometres() -> None:
    found = extrapolation(
        [2 * DEG, -1 * DEG, 3 * UM, 4 * UM, 5 * UM, -12 * UM], [DEG, 2 * DEG, UM, 7 * UM, 0.0, 2 * UM]
    )
    assert found.std == pytest.approx([DEG, 2 * DEG, UM, 7 * UM, 0.0, 2 * UM])
    assert found.to_json() == {
        "model": "one rate",
        "windows": 12,
        "rate_per_s": 0.2,
        "theta3_shift_deg": pytest.approx(2.0),
        "theta3_std_deg": pytest.approx(1.0),
        "theta4_shift_deg": pytest.approx(-1.0),
        "theta4_std_deg": pytest.approx(2.0),
        "x_shift_um": pytest.approx(5.0, rel=1e-9),
        "x_std_um": pytest.approx(5.0, rel=1e-9),
        "y_shift_um": pytest.approx(13.0, rel=1e-9),
        "y_std_um": pytest.approx(math.sqrt(2.0), rel=1e-9),
    }
    assert replace(found, rate_per_s=math.nan).to_json()["rate_per_s"] is None


def slow(revolutions: int) -> Run:
    """One revolution a second, as long as a window; orbit and angles are constant."""
    t, marks = np.arange(0.0, revolutions + 0.05, 2e-3), np.arange(revolutions + 1.0)
    wave = np.exp(2j * math.pi * t)
    angle = np.tile(THETA, (len(t), 1))
    rates = {"x": 3e-4, "y": 0.0, "phase": 4e-4}
    return Run(
        "", "", 0.0, t, np.real(X * wave), t, np.real(Y * wave), t, angle, marks, 2 * math.pi * marks, (), STEP, rates
    )


MEANS = np.array([*THETA, X.real, X.imag, Y.real, Y.imag])


def test_the_clocks_turn_a_vector_in_proportion_to_the_revolutions(monkeypatch: pytest.MonkeyPatch) -> None:
    """The covariance of the arcs, third column of the orbit's radii and arcs, is that of one common rate."""
    seen = list[np.ndarray]()

    def limit(edges_s: np.ndarray, means: np.ndarray, noise: np.ndarray, bends: object) -> None:
        seen.append(noise)

    monkeypatch.setattr(extrapolated, "limit", limit)
    extrapolated.to_come(slow(10), 0.0, 10.0, MEANS, np.ones(6))
    for at, size, rate in ((3, abs(X), 5e-4), (5, abs(Y), 4e-4)):
        assert np.sqrt(np.diag(seen[0][at])) == pytest.approx(
            size * rate * 2 * math.pi * np.arange(9.0, -1.0, -1.0), rel=1e-3, abs=1e-10
        )


@pytest.mark.parametrize(("revolutions", "windows"), [(8, 0), (9, 9), (10, 10), (12, 12)])
def test_nine_windows_of_all_signals_are_extrapolated(revolutions: int, windows: int) -> None:
    found = extrapolated.to_come(slow(revolutions), 0.0, 20.0, MEANS, np.ones(6))
    assert found.windows == windows
    assert (found.model == UNEXPLAINED) is (windows == 0)


@pytest.mark.parametrize("lacking", ["windows", "angles", "orbit"])
def test_without_windows_of_all_signals_the_mean_keeps_its_uncertainty(lacking: str) -> None:
    run, stds = slow(8 if lacking == "windows" else 10), np.arange(1.0, 7.0)
    if lacking == "angles":
        run = replace(run, angle_time_s=run.angle_time_s[:0], angle_rad=run.angle_rad[:0])
    elif lacking == "orbit":
        run = replace(run, y_time_s=run.y_time_s[:0], y_m=run.y_m[:0])
    found = extrapolated.to_come(run, 0.0, 10.0, MEANS, stds)
    assert (found.model, found.windows, found.sentence) == (UNEXPLAINED, 0, "")
    assert math.isnan(found.rate_per_s)
    assert found.std.tolist() == stds.tolist()
    assert found.covariance.tolist() == np.diag(stds**2).tolist()
    assert found.shift.tolist() == found.to_come.tolist() == [0.0] * 6


def test_vectors_as_radius_and_arc() -> None:
    """Mean (3, 4): the radius is along it, the arc across it, counted from it in metres."""
    mean, n = np.array([3.0, 4.0]), 10
    along, across = mean / 5.0, np.array([-4.0, 3.0]) / 5.0
    turn = np.linspace(-0.04, 0.02, n)
    radius = 5.0 + np.linspace(0.3, 0.0, n)
    vectors = radius[:, None] * (np.cos(turn)[:, None] * along + np.sin(turn)[:, None] * across)
    noise = np.stack([0.01 * np.eye(n), 0.04 * np.eye(n)])
    turned = np.linspace(0.01, 0.0, n)
    found = _radius_and_arc(vectors, noise, mean, turned)
    assert found is not None
    both, own, back = found
    assert both == pytest.approx(np.column_stack([radius, 5.0 * turn]))
    assert back == pytest.approx(np.column_stack([along, across]))
    assert own[0] == pytest.approx((0.36 * 0.01 + 0.64 * 0.04) * np.eye(n))
    assert own[1] == pytest.approx((0.64 * 0.01 + 0.36 * 0.04) * np.eye(n) + 25.0 * np.outer(turned, turned))
    for change, fits in ((0.49, True), (0.51, False)):  # a tenth of the radius, over the newest nine windows
        moved = np.tile(mean, (n, 1))
        moved[1] += change * along
        moved[0] += 3.0 * across
        assert (_radius_and_arc(moved, noise, mean, turned) is not None) == fits


def test_the_second_order_is_twice_the_change_times_the_remaining_angle() -> None:
    seen = np.zeros((9, 6))
    seen[0] = [0.1, -0.3, 1e-5, 4e-5, 2e-5, 9e-5]
    held = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    assert _bends(seen, held) == pytest.approx([2 * 0.3 * 0.3] * 2 + [2 * 0.3 * 4e-5] * 4)
    assert _bends(seen, np.ones(6)) == pytest.approx([2 * 0.3 * 0.3] * 2 + [2 * 0.3 * 9e-5] * 4)


# the type of a state


class _Moment:
    def __init__(self, value: float) -> None:
        self.first_moment_kg_m = value


class _Moments:
    imbalance_moment_kg_m = 1.0
    a, b = _Moment(2.0), _Moment(2.0)


@pytest.mark.parametrize("bow", [0j, 0.5 + 0.3j])
@pytest.mark.parametrize(("share", "kind"), [(0.14, "I"), (0.16, "II"), (-0.14, "I"), (-0.16, "II")])
def test_pendulums_that_leave_less_than_fifteen_per_cent_balance(share: float, kind: str, bow: complex) -> None:
    """Two moments of 2 at ±φ about the opposite of the imbalance add to 4 cos φ."""
    whole = 1.0 + bow
    half = math.acos(abs(whole) * (1 + share) / 4.0)
    middle = cmath.phase(whole) + math.pi
    assert state_type((middle + half, middle - half), _Moments(), bow) == kind
    assert state_type((middle - half + 2 * math.pi, middle + half), _Moments(), bow) == kind


def test_pendulums_within_a_right_angle_are_together() -> None:
    for apart, kind in ((89.0, "III"), (91.0, "II"), (-89.0, "III"), (-91.0, "II"), (271.0, "III"), (360.0, "III")):
        assert state_type((0.3, 0.3 + math.radians(apart)), _Moments()) == kind


@pytest.mark.parametrize("kind", [Interval, SteadyMeasurement, ToCome])
def test_a_result_cannot_be_changed(kind: type) -> None:
    with pytest.raises(FrozenInstanceError):
        object.__new__(kind).name = 1
