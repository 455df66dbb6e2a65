"""Window means of signals that are known exactly: edges, means, noise, rounding, missing samples."""

import math
from dataclasses import replace

import numpy as np
import pytest

from daq.signals.window_means import (
    WindowMeans,
    _dither,
    _usual,
    amplitude_means,
    angle_means,
    orbit_means,
    whole_revolutions,
)

SPEED = 2 * math.pi * 6.25  # eight marks take 1.28 s; a window of 1 s has seven of them, 1.12 s
WINDOW_S = 7 / 6.25
STEP = 2 * math.pi / 4096


def marks(duration: float, speed: float = SPEED) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0.0, duration + 1e-9, 2 * math.pi / speed)
    return times, speed * times


def test_edges_are_whole_revolutions_back_from_the_last_mark() -> None:
    times, phase = marks(20.0)
    edges = whole_revolutions(times, phase, 1.0, 30)
    assert edges == pytest.approx(20.0 - WINDOW_S * np.arange(17, -1, -1))
    assert whole_revolutions(times, phase, 1.0, 5) == pytest.approx(20.0 - WINDOW_S * np.arange(5, -1, -1))
    assert whole_revolutions(times + 3.0, phase + 1.0, 1.0, 2) == pytest.approx(23.0 - WINDOW_S * np.array([2, 1, 0]))


def test_a_series_of_exactly_whole_windows_loses_none() -> None:
    times, phase = marks(9 * WINDOW_S)
    assert whole_revolutions(times, phase, 1.0, 30) == pytest.approx(WINDOW_S * np.arange(10), abs=1e-9)


def test_a_slow_rotor_has_windows_of_one_revolution() -> None:
    times = np.array([0.0, 1.5, 3.0, 4.5])
    edges = whole_revolutions(times, 2 * math.pi * np.arange(4), 1.0, 30)
    assert edges == pytest.approx(times)


def test_the_length_of_a_window_is_that_at_the_last_two_seconds_speed() -> None:
    """A rotor that was twice as fast: windows of the present speed, interpolated between the marks before."""
    slow = 2 * math.pi * np.arange(1, 26) / SPEED
    times = np.concatenate([-2 * math.pi * np.arange(50, 0, -1) / (2 * SPEED), [0.0], slow])
    edges = whole_revolutions(times, 2 * math.pi * np.arange(len(times)), 1.0, 30)
    assert np.diff(edges)[-3:] == pytest.approx([WINDOW_S] * 3)
    assert np.diff(edges)[:5] == pytest.approx([WINDOW_S / 2] * 5)
    assert len(edges) == 11


def test_too_few_marks_have_no_windows() -> None:
    assert not len(whole_revolutions(np.arange(2.0), np.arange(2.0), 1.0, 30))
    assert len(whole_revolutions(np.arange(3.0), 2 * math.pi * np.arange(3.0), 1.0, 30)) == 3
    gap = np.array([0.0, 0.5, 1.0, 3.1])  # one mark alone in the last two windows
    assert not len(whole_revolutions(gap, 2 * math.pi * np.arange(4), 1.0, 30))
    less = np.array([0.0, 0.5, 1.2, 3.1])
    assert len(whole_revolutions(less, 2 * math.pi * np.arange(4), 1.0, 30))
    for standing in (0.0, -0.1):  # a rotor that does not turn forwards has no revolution
        assert len(whole_revolutions(np.arange(9.0), standing * np.arange(9.0), 1.0, 30)) <= 1


def angles(t: np.ndarray, noise: float = 0.0, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    psi = SPEED * t
    a = 0.4 + 0.02 * np.cos(psi) - 0.01 * np.sin(psi) + 0.005 * np.cos(2 * psi)
    b = 2.0 - 0.03 * np.sin(2 * psi + 1.0)
    return np.stack([a, b], axis=1) + noise * rng.standard_normal((len(t), 2))


def found_angles(t: np.ndarray, values: np.ndarray, step: float | None, newest: int = 9) -> WindowMeans | None:
    times, phase = marks(20.0)
    return angle_means(t, values, times, phase, whole_revolutions(times, phase, 1.0, 30), step, newest)


def test_means_do_not_depend_on_the_ripple_and_have_their_noise() -> None:
    """3.5 standard deviations of a mean of 1120 samples."""
    t = np.arange(0.0, 20.0, 1e-3)
    exact = found_angles(t, angles(t), 0.0)
    assert exact is not None
    assert exact.means == pytest.approx(np.tile([0.4, 2.0], (17, 1)), abs=1e-9)
    assert exact.edges_s[0] == pytest.approx([20.0 - 17 * WINDOW_S, 20.0 - 16 * WINDOW_S])
    assert (exact.step, exact.coloured) == (0.0, False)
    assert exact.width == pytest.approx([0.0, 0.0], abs=1e-9)
    noisy = found_angles(t, angles(t, 1e-2), 0.0)
    assert noisy is not None
    assert noisy.noise == pytest.approx([1e-2 / math.sqrt(1120)] * 2, rel=0.03)
    assert noisy.width == pytest.approx(3.5 * noisy.noise)
    assert np.std(noisy.means, axis=0) == pytest.approx(noisy.noise, rel=0.5)


def rounded(values: np.ndarray, step: float = STEP) -> np.ndarray:
    return np.round(values / step) * step


def test_a_constant_code_leaves_half_a_step() -> None:
    t = np.arange(0.0, 20.0, 1e-3)
    still = np.tile([0.4, 2.0], (len(t), 1))
    found = found_angles(t, rounded(still), STEP)
    assert found is not None
    assert found.width == pytest.approx([0.5 * STEP] * 2, rel=1e-6)
    assert found.rounding[0, :2] == pytest.approx([STEP / math.pi, STEP / (2 * math.pi)])
    unknown = found_angles(t, rounded(still), None)  # a code that never changes has the default step
    assert unknown is not None
    assert unknown.step == pytest.approx(STEP)


def test_noise_and_a_ripple_of_some_steps_average_the_rounding_out() -> None:
    t = np.arange(0.0, 20.0, 1e-3)
    still = np.tile([0.4, 2.0], (len(t), 1))
    noise = STEP * np.random.default_rng(3).standard_normal(still.shape)
    dithered = found_angles(t, rounded(still + noise), STEP)
    assert dithered is not None
    assert dithered.width == pytest.approx(3.5 * dithered.noise, rel=1e-3)
    assert np.all(dithered.rounding[:, 0] < 1e-6 * STEP)
    ripple = 3.0 * STEP * np.cos(SPEED * t)[:, None]
    rippling = found_angles(t, rounded(still + ripple), STEP)
    assert rippling is not None
    assert np.all(rippling.width < 0.3 * STEP)
    assert np.all(np.abs(rippling.means - still[:17]) < rippling.width)


def test_noise_is_not_read_from_the_codes_of_a_moving_pendulum() -> None:
    """A creep of half a step per window shows both neighbouring codes without any noise."""
    t = np.arange(0.0, 20.0, 1e-3)
    creep = np.tile([0.4, 2.0], (len(t), 1)) + 0.5 * STEP / WINDOW_S * t[:, None]
    moving = found_angles(t, rounded(creep), STEP)
    assert moving is not None
    assert np.all(moving.width >= 0.5 * STEP)
    slower = np.tile([0.4, 2.0], (len(t), 1)) + 0.1 * STEP / WINDOW_S * t[:, None]
    noise = 0.8 * STEP * np.random.default_rng(4).standard_normal(slower.shape)
    shown = found_angles(t, rounded(slower + noise), STEP)
    assert shown is not None
    assert np.all(shown.width < 0.3 * STEP)


def test_the_step_is_the_smallest_change_of_a_code() -> None:
    t = np.arange(0.0, 20.0, 1e-3)
    code = rounded(angles(t), 2 * STEP)
    code[::7] += 1e-12  # floating point noise is not a step
    code[100] = np.nan
    found = found_angles(t, code, None)
    assert found is not None
    assert found.step == pytest.approx(2 * STEP)


def test_missing_samples() -> None:
    t = np.arange(0.0, 20.0, 1e-3)
    early = (t < 2.0) | (t > 4.5)
    some = found_angles(t[early], angles(t[early]), 0.0)
    assert some is not None
    assert len(some.means) == len(some.edges_s) == 15
    late = t < 19.0
    assert found_angles(t[late], angles(t[late]), 0.0) is None
    middle = (t < 14.0) | (t > 18.5)
    assert found_angles(t[middle], angles(t[middle]), 0.0) is None
    assert found_angles(t[middle], angles(t[middle]), 0.0, newest=1) is not None


def lasers(t: np.ndarray, noise: float, seed: int) -> np.ndarray:
    return noise * np.random.default_rng(seed).standard_normal(len(t))


X, Y = 1e-3 * np.exp(0.7j), 4e-4 * np.exp(-2.0j)


def displacement(t: np.ndarray, vector: complex, noise: float = 0.0, seed: int = 1) -> np.ndarray:
    return 2e-4 + np.real(vector * np.exp(1j * SPEED * t)) + 1e-4 * np.cos(2 * SPEED * t) + lasers(t, noise, seed)


def test_order_one_of_lasers_with_its_noise() -> None:
    """Deviation of an amplitude, or of a part of the vector, from n samples: σ √(2/n)."""
    tx, ty = np.arange(0.0, 20.0, 1 / 4000), np.arange(1e-4, 20.0, 1 / 2000)
    x, y = displacement(tx, X, 4e-6, 5), displacement(ty, Y, 1e-5, 6)
    times, phase = marks(20.0)
    edges = whole_revolutions(times, phase, 1.0, 30)
    std = np.array([4e-6 * math.sqrt(2 / 4480), 1e-5 * math.sqrt(2 / 2240)])
    size = amplitude_means(tx, x, ty, y, times, phase, edges, 9)
    assert size is not None
    assert size.means == pytest.approx(np.tile([1e-3, 4e-4], (17, 1)), abs=5 * std.max())
    assert size.noise == pytest.approx(std, rel=0.05)
    assert size.width == pytest.approx(3.5 * size.noise)
    assert (size.step, size.coloured, size.rounding.shape) == (0.0, False, (2, 0))
    orbit = orbit_means(tx, x, ty, y, times, phase, edges, 9)
    assert orbit is not None
    assert orbit.means.mean(axis=0) == pytest.approx([X.real, X.imag, Y.real, Y.imag], abs=2 * std.max())
    assert orbit.noise == pytest.approx(np.repeat(std, 2), rel=0.05)
    assert orbit.width == pytest.approx(3.5 * orbit.noise)
    assert orbit.neighbours == pytest.approx([0.0] * 4)
    assert orbit.edges_s[-1] == pytest.approx([20.0 - WINDOW_S, 20.0])


def test_noise_near_order_one_is_in_the_noise_of_its_vector() -> None:
    """A drift of x with a spectrum that falls with the square of the frequency; without it, white noise alone."""
    t = np.arange(0.0, 20.0, 1 / 2000)
    steps = 1e-6 * np.random.default_rng(11).standard_normal(len(t))
    drift = np.convolve(steps, np.exp(-np.arange(2000) / 400))[: len(t)]
    x = displacement(t, X, 1e-7, 5) + drift
    times, phase = marks(20.0)
    edges = whole_revolutions(times, phase, 1.0, 30)
    found = orbit_means(t, x, t, displacement(t, Y, 1e-7, 6), times, phase, edges, 9)
    assert found is not None
    assert found.coloured
    assert found.noise[:2] == pytest.approx(found.means[:, :2].std(axis=0), rel=0.6)
    assert found.noise[2:] == pytest.approx([1e-7 * math.sqrt(2 / 2240)] * 2, rel=0.1)


def test_noise_near_order_one_of_one_laser_is_not_in_the_amplitudes_of_the_other() -> None:
    t = np.arange(0.0, 20.0, 1 / 2000)
    drift = np.convolve(1e-6 * np.random.default_rng(11).standard_normal(len(t)), np.exp(-np.arange(2000) / 400))
    disturbed, calm = displacement(t, X, 1e-7, 5) + drift[: len(t)], displacement(t, Y, 1e-7, 6)
    times, phase = marks(20.0)
    edges = whole_revolutions(times, phase, 1.0, 30)
    for pair, of in (((disturbed, calm), 1), ((calm, disturbed), 0)):
        found = amplitude_means(t, pair[0], t, pair[1], times, phase, edges, 9)
        assert found is not None
        assert found.noise[of] == pytest.approx(1e-7 * math.sqrt(2 / 2240), rel=0.3)
        assert found.noise[1 - of] > 3 * found.noise[of]


def test_both_lasers_must_have_samples() -> None:
    t = np.arange(0.0, 20.0, 1e-3)
    times, phase = marks(20.0)
    edges = whole_revolutions(times, phase, 1.0, 30)
    x, y = displacement(t, X), displacement(t, Y)
    silent = np.full_like(x, np.nan)
    for means in (amplitude_means, orbit_means):
        assert means(t, silent, t, y, times, phase, edges, 9) is None
        assert means(t, x, t, silent, times, phase, edges, 9) is None
        hole = np.where((t > 2.0) & (t < 4.5), np.nan, x)
        for pair in ((hole, y), (x, hole)):
            found = means(t, pair[0], t, pair[1], times, phase, edges, 9)
            assert found is not None
            assert len(found.means) == len(found.edges_s) == 15


def test_covariance_of_windows_that_meet_and_that_do_not() -> None:
    edges = np.array([[0.0, 1.0], [1.0, 2.0], [3.0, 4.0], [4.0, 5.0]])
    seen = WindowMeans(edges, np.zeros((4, 2)), np.zeros(2), np.array([2.0, 0.1]), np.empty((2, 0)))
    plain = seen.noise_covariance(0.5)
    assert plain[0] == pytest.approx(4.0 * np.eye(4))
    assert plain[1] == pytest.approx(0.25 * np.eye(4))  # not below the least deviation
    correlated = replace(seen, neighbours=np.array([0.3, 0.4])).noise_covariance(0.5)
    pairs = np.kron(np.eye(2), np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert correlated[0] == pytest.approx(4.0 * np.eye(4) + 1.2 * pairs)
    assert correlated[1] == pytest.approx(0.25 * np.eye(4) + 0.1 * pairs)
    later = edges + np.array([[0, 0], [1e-5, 0], [0, 0], [-1e-5, 0]])
    apart = replace(seen, edges_s=later, neighbours=np.array([0.3, 0.4]))
    assert apart.noise_covariance(0.5)[0] == pytest.approx(4.0 * np.eye(4))
    long = replace(apart, edges_s=100.0 * edges + [[0, 0], [5e-5, 0], [0, 0], [0, 0]])  # half of 1e-6 of their length
    assert long.noise_covariance(0.5)[0] == pytest.approx(4.0 * np.eye(4) + 1.2 * pairs)


def test_noise_of_a_code_is_the_median_of_three_or_more_windows() -> None:
    assert _usual(np.array([np.nan, 0.2, 0.9, 0.3])) == 0.3
    assert _usual(np.array([np.nan, 0.2, 0.9])) == 0.0


def test_noise_of_a_code_with_a_ripple_is_the_scatter_without_the_rounding() -> None:
    """A scatter of √(2² + 1/12) steps: 2 steps before rounding. A ripple of less than half a step shows no noise."""
    step = 0.1
    scatter = step * math.sqrt(4.0 + 1 / 12)
    assert _dither(0.7, scatter, 0.5 * step, step) == pytest.approx(2.0)
    assert _dither(0.7, scatter, 0.49 * step, step) == 0.7
    assert _dither(0.7, 0.1 * step, step, step) == 0.0
    assert _dither(0.7, scatter, 1.0, 0.0) == 0.7
