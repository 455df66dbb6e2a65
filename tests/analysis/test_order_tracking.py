"""Order tracking against signals whose orders are known."""

import numpy as np
import pytest

from analysis import order_track

SPEED = 31.0


def signal(n: int = 40000, noise: float = 0.0, seed: int = 0, ramp: float = 0.0):
    t = np.arange(n) / 4000
    psi = 0.7 + SPEED * t + 0.5 * ramp * t**2
    x = 2e-4 + (1e-3 * np.exp(1j * (psi + 0.4))).real + (2e-4 * np.exp(1j * (3 * psi - 1.0))).real
    return t, x + noise * np.random.default_rng(seed).standard_normal(n), psi


def test_orders_and_offset_are_found() -> None:
    track = order_track(*signal(), orders=(1, 2, 3))
    assert track.amplitude_m[:, 0] == pytest.approx(np.full(len(track.time_s), 1e-3 * np.exp(0.4j)), abs=2e-10)
    assert np.abs(track.amplitude_m[:, 1]).max() < 1e-12
    assert track.amplitude_m[:, 2] == pytest.approx(np.full(len(track.time_s), 2e-4 * np.exp(-1j)), abs=2e-10)
    assert track.offset_m == pytest.approx(np.full(len(track.time_s), 2e-4), abs=2e-10)


def test_speed_may_change() -> None:
    track = order_track(*signal(ramp=3.0))
    assert np.abs(track.amplitude_m[:, 0]) == pytest.approx(np.full(len(track.time_s), 1e-3), abs=2e-10)


def test_windows_are_whole_revolutions_up_to_the_end() -> None:
    t, x, psi = signal()
    track = order_track(t, x, psi, revolutions=3)
    assert len(track.time_s) == int((psi[-1] - psi[0]) / (6 * np.pi))
    assert np.diff(track.time_s) == pytest.approx(np.full(len(track.time_s) - 1, 6 * np.pi / SPEED), abs=3e-4)


def test_lost_samples_leak_nothing() -> None:
    t, x, psi = signal()
    x[np.cos(psi) > 0.6] = np.nan  # always the same part of the turn
    track = order_track(t, x, psi, orders=(1, 3))
    assert track.amplitude_m[:, 0] == pytest.approx(np.full(len(track.time_s), 1e-3 * np.exp(0.4j)), abs=1e-9)


def test_std_is_the_scatter() -> None:
    means, stds = [], []
    for seed in range(60):
        mean, std = order_track(*signal(8000, 4e-6, seed)).mean(1)
        means.append(mean)
        stds.append(std)
    scatter = np.std(np.real(means)), np.std(np.imag(means))
    assert np.mean(stds) == pytest.approx(np.mean(scatter), rel=0.25)
    track = order_track(*signal(8000, 4e-6, 0))
    assert track.residual_m == pytest.approx(np.full(len(track.time_s), 4e-6), rel=0.1)


def test_bad_input_is_refused() -> None:
    t, x, psi = signal(8000)
    with pytest.raises(ValueError, match="alike"):
        order_track(t, x[:-1], psi)
    with pytest.raises(ValueError, match="whole revolutions"):
        order_track(t[:100], x[:100], psi[:100])
    with pytest.raises(ValueError, match="whole revolutions"):
        order_track(t, np.full_like(x, np.nan), psi)
