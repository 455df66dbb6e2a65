"""Noise of order-1 vectors from the coefficients next to the order: white, 1/f, hum, and changing orbits."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.signals.order_noise import OrderNoise
from daq.signals.window_means import WindowMeans, amplitude_means, orbit_means, whole_revolutions
from tests.effort import cases

RATE, WHITE_M = 2000.0, 4e-6
WINDOWS = 20


def one_over_f(count: int, rng: np.random.Generator, power: float = 1.0) -> np.ndarray:
    """Noise with a spectrum like 1/f^power and an rms of 1."""
    frequency = np.fft.rfftfreq(2 * count, 1 / RATE)
    frequency[0] = np.inf
    drawn = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    noise = np.fft.irfft(frequency ** (-power / 2) * drawn)[:count]
    return noise / noise.std()


def means(turn_Hz: float, more=lambda t, rng: 0.0, orbit=lambda t: 1e-3, seed: int = 0) -> WindowMeans:
    """Windows of an orbit measured by two lasers with additional disturbances."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, WINDOWS + 1.5, 1 / RATE)
    marks = np.arange(0.013, t[-1], 1 / turn_Hz)
    psi = 2 * np.pi * turn_Hz * (t - marks[0])
    phases = 2 * np.pi * np.arange(len(marks))
    shown = [orbit(t) * np.cos(psi - at) + WHITE_M * rng.standard_normal(len(t)) + more(t, rng) for at in (0.3, 1.9)]
    edges = whole_revolutions(marks, phases, 1.0, WINDOWS)
    found = orbit_means(t, shown[0], t, shown[1], marks, phases, edges, 9)
    assert found is not None
    return found


@pytest.mark.parametrize("turn_Hz", [2.5, 7.8, 17.4])
def test_white_noise_is_left_as_it_is(turn_Hz: float) -> None:
    found = [means(turn_Hz, seed=seed) for seed in range(25)]
    assert sum(each.coloured for each in found) <= 1
    expected = WHITE_M * np.sqrt(2 / (RATE * np.ceil(turn_Hz) / turn_Hz))
    assert np.median([each.noise for each in found]) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("turn_Hz", "power"), [(2.5, 1.0), (7.8, 1.0), (17.4, 1.0), (4.8, 1.8)])
def test_wander_widens_the_means_by_as_much_as_they_scatter(turn_Hz: float, power: float) -> None:
    """The estimated noise compared with the vectors' own scatter, which needs no spectrum."""
    found = [means(turn_Hz, lambda t, rng: 2e-5 * one_over_f(len(t), rng, power), seed=seed) for seed in range(12)]
    assert all(each.coloured for each in found)
    scatter = np.mean([each.means.var(axis=0, ddof=1) for each in found], axis=0)
    stated = np.mean([each.noise**2 for each in found], axis=0)
    assert stated / scatter == pytest.approx(np.ones(4), rel=0.35)
    assert np.mean(stated) / np.mean(scatter) == pytest.approx(1.0, rel=0.2)


def test_hum_counts_by_what_leaks_into_the_order() -> None:
    found = [
        means(7.8, lambda t, rng: 5e-5 * np.sin(2 * np.pi * 50.2 * t + 6 * rng.random()), seed=s) for s in range(6)
    ]
    scatter = np.mean([each.means.var(axis=0, ddof=1) for each in found])
    stated = np.mean([each.noise**2 for each in found])
    assert 0.5 < stated / scatter < 2.5


@pytest.mark.parametrize("rate", [0.1, 0.2, 0.5])
def test_an_orbit_that_still_changes_is_no_noise(rate: float) -> None:
    """A change of tens of micrometres per second leaks into all coefficients next to the order."""
    found = means(7.8, orbit=lambda t: 1e-3 + 2e-4 * np.exp(-rate * t))
    white = means(7.8)
    assert found.noise == pytest.approx(white.noise, rel=0.3)


def test_amplitudes_have_the_larger_part_of_the_noise() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0, WINDOWS + 1.5, 1 / RATE)
    marks = np.arange(0.0, t[-1], 1 / 2.5)
    phases = 2 * np.pi * np.arange(len(marks))
    x = 1e-3 * np.cos(5 * np.pi * t) + 2e-5 * one_over_f(len(t), rng) + WHITE_M * rng.standard_normal(len(t))
    edges = whole_revolutions(marks, phases, 1.0, WINDOWS)
    vectors = orbit_means(t, x, t, x, marks, phases, edges, 9)
    sizes = amplitude_means(t, x, t, x, marks, phases, edges, 9)
    assert sizes.noise[0] == pytest.approx(vectors.noise[:2].max(), rel=0.1)
    assert sizes.width == pytest.approx(3.5 * sizes.noise)


@settings(max_examples=cases(20, 50), deadline=None)
@given(st.lists(st.booleans(), min_size=8, max_size=20), st.floats(-0.45, 0.45))
def test_covariance_of_windows_with_gaps_is_positive(kept: list[bool], neighbours: float) -> None:
    starts = np.flatnonzero([*kept, True, True]).astype(float)
    edges = np.stack([starts, starts + 1], axis=1)
    found = WindowMeans(
        edges,
        np.zeros((len(starts), 1)),
        np.ones(1),
        np.array([2e-6]),
        np.empty((1, 0)),
        neighbours=np.array([neighbours]),
    )
    covariance = found.noise_covariance(1e-12)[0]
    assert np.linalg.eigvalsh(covariance).min() > 0.05 * 4e-12
    meet = np.diff(starts) == 1
    assert np.diag(covariance, 1) == pytest.approx(4e-12 * neighbours * meet, rel=1e-12, abs=1e-24)


def test_nothing_found_is_white() -> None:
    assert OrderNoise() == OrderNoise(1.0, 1.0, 0.0)
