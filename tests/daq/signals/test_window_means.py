"""Window means of signals that are known exactly: edges, means, noise, rounding, missing samples."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from daq.signals.window_means import WindowMeans, amplitude_means, angle_means, orbit_means, whole_revolutions

SPEED = 2 * math.pi * 6.25  # eight marks take 1.28 s; a window of 1 s has seven of them, 1.12 s
WINDOW_S = 7 / 6.25
STEP = 2 * math.pi / 4096
TIME_S = np.arange(0.0, 20.0, 1e-3)
LASER_S = np.arange(0.0, 20.0, 1 / 2000)
MARKS_S = 2 * math.pi / SPEED * np.arange(126)  # 20 s
EDGES_S = whole_revolutions(MARKS_S, SPEED * MARKS_S, 1.0, 30)


def turned(times_s: list[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Marks one revolution apart at these times."""
    return np.array(times_s), 2 * math.pi * np.arange(len(times_s))


def test_edges_are_whole_revolutions_back_from_the_last_mark() -> None:
    assert pytest.approx(20.0 - WINDOW_S * np.arange(17, -1, -1)) == EDGES_S
    for most in (2, 5):
        shifted = whole_revolutions(MARKS_S + 3.0, SPEED * MARKS_S + 1.0, 1.0, most)
        assert shifted == pytest.approx(23.0 - WINDOW_S * np.arange(most, -1, -1))
    exactly = whole_revolutions(MARKS_S[:64], SPEED * MARKS_S[:64], 1.0, 30)
    assert exactly == pytest.approx(WINDOW_S * np.arange(10), abs=1e-9)
    slow = [0.0, 1.5, 3.0, 4.5]
    assert whole_revolutions(*turned(slow), 1.0, 30) == pytest.approx(slow)


def test_the_length_of_a_window_is_that_at_the_present_speed() -> None:
    """A rotor that was twice as fast: windows of the present speed, interpolated between the marks before."""
    slow = 2 * math.pi * np.arange(1, 26) / SPEED
    times = np.concatenate([-2 * math.pi * np.arange(50, 0, -1) / (2 * SPEED), [0.0], slow])
    edges = whole_revolutions(*turned(times), 1.0, 30)
    assert np.diff(edges)[-3:] == pytest.approx([WINDOW_S] * 3)
    assert np.diff(edges)[:5] == pytest.approx([WINDOW_S / 2] * 5)
    assert len(edges) == 11


@pytest.mark.parametrize(
    ("times_s", "edges"), [([0.0, 1.0], 0), ([0.0, 1.0, 2.0], 3), ([0.0, 0.5, 1.0, 3.1], 0), ([0.0, 0.5, 1.2, 3.1], 4)]
)
def test_too_few_marks_have_no_windows(times_s: list[float], edges: int) -> None:
    assert len(whole_revolutions(*turned(times_s), 1.0, 30)) == edges


@pytest.mark.parametrize("speed", [0.0, -0.1])
def test_a_rotor_that_does_not_turn_forwards_has_no_revolution(speed: float) -> None:
    assert len(whole_revolutions(np.arange(9.0), speed * np.arange(9.0), 1.0, 30)) <= 1


# --- angles ----------------------------------------------------------------------------------------------------------

STILL = np.tile([0.4, 2.0], (len(TIME_S), 1))


def rippling(noise: float = 0.0) -> np.ndarray:
    psi = SPEED * TIME_S
    ripple = [0.02 * np.cos(psi) - 0.01 * np.sin(psi) + 0.005 * np.cos(2 * psi), -0.03 * np.sin(2 * psi + 1.0)]
    return STILL + np.stack(ripple, axis=1) + noise * np.random.default_rng(1).standard_normal(STILL.shape)


def rounded(values: np.ndarray, step: float = STEP) -> np.ndarray:
    return np.round(values / step) * step


def found_angles(kept: np.ndarray, newest: int = 9) -> WindowMeans | None:
    return angle_means(TIME_S[kept], rippling()[kept], MARKS_S, SPEED * MARKS_S, EDGES_S, 0.0, newest)


def angles(values: np.ndarray, step: float = STEP) -> WindowMeans:
    found = angle_means(TIME_S, values, MARKS_S, SPEED * MARKS_S, EDGES_S, step, 9)
    assert found is not None
    return found


def test_means_do_not_depend_on_the_ripple_and_have_their_noise() -> None:
    """The width of a mean is a multiple of the deviation of a mean of 1120 samples."""
    exact, noisy = angles(rippling(), 0.0), angles(rippling(1e-2), 0.0)
    assert exact.means == pytest.approx(np.tile([0.4, 2.0], (17, 1)), abs=1e-9)
    assert exact.edges_s == pytest.approx(np.stack([EDGES_S[:-1], EDGES_S[1:]], axis=1))
    assert (exact.step, exact.coloured) == (0.0, False)
    assert exact.width == pytest.approx([0.0, 0.0], abs=1e-9)
    assert noisy.noise == pytest.approx([1e-2 / math.sqrt(1120)] * 2, rel=0.03)
    assert np.all(np.abs(noisy.means - exact.means) < 1.2 * noisy.width)
    assert np.std(noisy.means, axis=0) == pytest.approx(noisy.noise, rel=0.5)


def test_a_constant_code_leaves_half_a_step() -> None:
    found = angles(rounded(STILL))
    assert found.width == pytest.approx([0.5 * STEP] * 2, rel=1e-6)
    assert found.rounding[0, :2] == pytest.approx([STEP / math.pi, STEP / (2 * math.pi)])


@pytest.mark.parametrize("ripple", [0.0, 3.0])
@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("creep", [0.0, 0.1, 0.5])
def test_noise_and_a_ripple_of_some_steps_average_the_rounding_out(ripple: float, noise: float, creep: float) -> None:
    """A creep shows both neighbouring codes without any noise: it does not count as noise. All in steps."""
    more = ripple * np.cos(SPEED * TIME_S) + creep * TIME_S / WINDOW_S
    drawn = noise * np.random.default_rng(3).standard_normal(STILL.shape)
    found = angles(rounded(STILL + STEP * (more[:, None] + drawn)))
    middle = STILL[:17] + STEP * creep * found.edges_s.mean(axis=1)[:, None] / WINDOW_S
    assert np.all(np.abs(found.means - middle) <= 1.2 * found.width)
    assert np.all(found.width < (0.4 if ripple or (noise and creep < 0.5) else 1.0) * STEP)
    if not ripple and not noise:
        assert np.all(found.width >= 0.5 * STEP * (1 - 1e-9))


def test_missing_samples() -> None:
    some = found_angles((TIME_S < 2.0) | (TIME_S > 4.5))
    assert len(some.means) == len(some.edges_s) == 15
    middle = (TIME_S < 14.0) | (TIME_S > 18.5)
    assert found_angles(TIME_S < 19.0) is found_angles(middle) is None
    assert found_angles(middle, newest=1) is not None


# --- lasers ----------------------------------------------------------------------------------------------------------

X, Y = 1e-3 * np.exp(0.7j), 4e-4 * np.exp(-2.0j)


def displacement(vector: complex, noise: float = 0.0, seed: int = 1, t: np.ndarray = LASER_S) -> np.ndarray:
    drawn = noise * np.random.default_rng(seed).standard_normal(len(t))
    return 2e-4 + np.real(vector * np.exp(1j * SPEED * t)) + 1e-4 * np.cos(2 * SPEED * t) + drawn


def of_lasers(
    means: Callable[..., WindowMeans | None], x: np.ndarray, y: np.ndarray, tx: np.ndarray = LASER_S
) -> WindowMeans | None:
    return means(tx, x, LASER_S, y, MARKS_S, SPEED * MARKS_S, EDGES_S, 9)


def test_order_one_of_lasers_with_its_noise() -> None:
    """Deviation of an amplitude, or of a part of the vector, from n samples: σ √(2/n)."""
    tx = np.arange(1e-4, 20.0, 1 / 4000)
    signals = displacement(X, 4e-6, 5, tx), displacement(Y, 1e-5, 6), tx
    std = np.array([4e-6 * math.sqrt(2 / 4480), 1e-5 * math.sqrt(2 / 2240)])
    size, orbit = of_lasers(amplitude_means, *signals), of_lasers(orbit_means, *signals)
    assert size.means == pytest.approx(np.tile([1e-3, 4e-4], (17, 1)), abs=5 * std.max())
    assert (size.step, size.coloured, size.rounding.shape) == (0.0, False, (2, 0))
    assert orbit.means.mean(axis=0) == pytest.approx([X.real, X.imag, Y.real, Y.imag], abs=2 * std.max())
    assert orbit.neighbours == pytest.approx([0.0] * 4)
    assert orbit.edges_s[-1] == pytest.approx([20.0 - WINDOW_S, 20.0])
    for found, noise in ((size, std), (orbit, np.repeat(std, 2))):
        assert found.noise == pytest.approx(noise, rel=0.05)
        assert np.all((2 * noise < found.width) & (found.width < 5 * noise))


@pytest.mark.parametrize("disturbed", [0, 1])
def test_noise_near_order_one_is_in_the_noise_of_its_own_vector(disturbed: int) -> None:
    """A drift of one laser with a spectrum that falls with the square of the frequency."""
    steps = 1e-6 * np.random.default_rng(11).standard_normal(len(LASER_S))
    pair = [displacement(X, 1e-7, 5), displacement(Y, 1e-7, 6)]
    pair[disturbed] = pair[disturbed] + np.convolve(steps, np.exp(-np.arange(2000) / 400))[: len(LASER_S)]
    size, orbit = of_lasers(amplitude_means, *pair), of_lasers(orbit_means, *pair)
    white, own = 1e-7 * math.sqrt(2 / 2240), orbit.noise.reshape(2, 2)
    assert orbit.coloured
    assert own[disturbed] == pytest.approx(orbit.means.std(axis=0).reshape(2, 2)[disturbed], rel=0.6)
    assert own[1 - disturbed] == pytest.approx([white] * 2, rel=0.1)
    assert size.noise[1 - disturbed] == pytest.approx(white, rel=0.3)
    assert size.noise[disturbed] > 3 * size.noise[1 - disturbed]


@pytest.mark.parametrize("means", [amplitude_means, orbit_means])
def test_both_lasers_must_have_samples(means: Callable[..., WindowMeans | None]) -> None:
    whole, silent = displacement(X), np.full(len(LASER_S), np.nan)
    hole = np.where((LASER_S > 2.0) & (LASER_S < 4.5), np.nan, whole)
    for other in (silent, hole):
        for pair in ((other, whole), (whole, other)):
            found = of_lasers(means, *pair)
            assert (found and (len(found.means), len(found.edges_s))) == (None if other is silent else (15, 15))


def test_covariance_of_windows_that_meet_and_that_do_not() -> None:
    edges = np.array([[0.0, 1.0], [1.0, 2.0], [3.0, 4.0], [4.0, 5.0]])
    plain = WindowMeans(edges, np.zeros((4, 2)), np.zeros(2), np.array([2.0, 0.1]), np.empty((2, 0)))
    correlated = replace(plain, neighbours=np.array([0.3, 0.4]))
    apart = replace(correlated, edges_s=edges + np.array([[0, 0], [1e-5, 0], [0, 0], [-1e-5, 0]]))
    pairs = np.kron(np.eye(2), np.array([[0.0, 1.0], [1.0, 0.0]]))
    for windows, shares in ((plain, (0.0, 0.0)), (correlated, (1.2, 0.1)), (apart, (0.0, 0.0))):
        for variance, share, found in zip((4.0, 0.25), shares, windows.noise_covariance(0.5), strict=True):
            assert found == pytest.approx(variance * np.eye(4) + share * pairs)  # not below the least deviation
