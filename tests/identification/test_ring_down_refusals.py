"""Rejected ring-downs: no decay, a decay that is too fast, too few samples, a dead sensor."""

from __future__ import annotations

import re

import numpy as np
import pytest

from identification import NotIdentifiable, fit_ring_down
from tests.effort import thorough

TIME = np.arange(12_000) / 1000
SIGMA = 4e-6


def decay(t: np.ndarray, f: float, zeta: float, amplitude: float = 1e-3) -> np.ndarray:
    w = 2 * np.pi * f
    return amplitude * np.exp(-zeta * w * t) * np.cos(w * np.sqrt(1 - zeta**2) * t + 0.3)


def noise(seed: int, t: np.ndarray = TIME) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).normal(size=len(t))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=thorough) for seed in (1, 2, 3))])
@pytest.mark.parametrize(
    "motion", [np.where(TIME < 4, 1e-3, 0.0), 1e-5 * TIME, 1e-3 * (TIME / 12) ** 2], ids=["step", "ramp", "bend"]
)
def test_a_motion_that_does_not_ring_gives_no_mode(motion: np.ndarray, seed: int) -> None:
    with pytest.raises(NotIdentifiable, match="nothing rings after the release"):
        fit_ring_down(TIME, motion + noise(seed))
    both = np.column_stack([motion + noise(seed), 0.7 * motion + noise(seed + 100)])
    with pytest.raises(NotIdentifiable, match="nothing r"):
        fit_ring_down(TIME, both)


def test_ten_times_the_noise_is_enough() -> None:
    """The price of the search costs no real decay, however short."""
    t = TIME[::5]
    for f, zeta in ((3.0, 0.002), (3.0, 0.3), (12.0, 0.3)):
        for seed in range(5):
            fit = fit_ring_down(t, decay(t, f, zeta, 10 * SIGMA) + noise(seed, t))
            assert abs(fit.values["f1_Hz"] - f) < 4.5 * fit.std["f1_Hz"]
            assert abs(fit.values["zeta1"] - zeta) < 4.5 * fit.std["zeta1"]


@pytest.mark.parametrize("f", [120.0, 200.0, 430.0])
def test_a_tone_above_the_band_is_named(f: float) -> None:
    with pytest.raises(NotIdentifiable, match=f"rings at about {f:.3g} Hz; frequencies up to 100 Hz"):
        fit_ring_down(TIME, decay(TIME, f, 0.01) + noise(0))


def test_a_tone_inside_the_band_and_hum_or_spikes_above_it_are_not() -> None:
    assert fit_ring_down(TIME, decay(TIME, 90.0, 0.005) + noise(0)).values["f1_Hz"] == pytest.approx(90, rel=1e-4)
    hum = 1e-4 * np.sin(2 * np.pi * 150 * TIME)
    assert fit_ring_down(TIME, decay(TIME, 3.0, 0.01) + hum + noise(0)).values["f1_Hz"] == pytest.approx(3, rel=1e-2)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        spikes = np.where(rng.random(len(TIME)) < 0.05, rng.uniform(-5e-3, 5e-3, len(TIME)), 0.0)
        spoilt = fit_ring_down(TIME, decay(TIME, 3.0, 0.2) + spikes + noise(seed))
        assert spoilt.values["f1_Hz"] == pytest.approx(3, rel=1e-2)


def test_few_samples_a_cycle_take_the_noise_from_the_residuals() -> None:
    t = np.arange(480) / 8
    z = []
    for seed in range(8):
        fit = fit_ring_down(t, decay(t, 3.0, 0.01) + noise(seed, t))
        assert 0.7 < fit.noise[0] / SIGMA < 1.4
        assert any("samples a cycle" in w for w in fit.warnings)
        z += [(fit.values["f1_Hz"] - 3) / fit.std["f1_Hz"], (fit.values["zeta1"] - 0.01) / fit.std["zeta1"]]
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.6
    fine = fit_ring_down(TIME, decay(TIME, 3.0, 0.01) + noise(0))
    assert not any("samples a cycle" in w for w in fine.warnings)


@pytest.mark.parametrize("degrees", [0.0, -1.0, np.nan])
def test_an_axis_prior_that_is_no_spread_is_refused(degrees: float) -> None:
    signal = decay(TIME, 3.0, 0.01) + noise(0)
    with pytest.raises(NotIdentifiable, match="axis_prior_deg > 0"):
        fit_ring_down(TIME, np.column_stack([signal, signal]), axis_prior_deg=degrees)


def test_growth_is_called_growth() -> None:
    with pytest.raises(NotIdentifiable, match=r"the motion grows: zeta1 = -0\.002 ± "):
        fit_ring_down(TIME, decay(TIME, 3.0, -0.002, 1e-4) + noise(0))


@pytest.mark.parametrize(("dead", "state"), [(np.nan, "every reading is NaN"), (2e-3, "constant at 0.002 m")])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_dead_sensor_is_named(axis: int, dead: float, state: str) -> None:
    signal = np.column_stack([decay(TIME, 3.0, 0.01) + noise(0)] * 2)
    signal[:, axis] = dead
    with pytest.raises(NotIdentifiable, match=f"sensor {'xy'[axis]}: .*{state}"):
        fit_ring_down(TIME, signal)


def test_too_few_cycles_are_not_rounded_up_to_enough() -> None:
    for count in (497, 499, 500):
        t = np.arange(count) / 1000
        with pytest.raises(NotIdentifiable, match="cycles") as caught:
            fit_ring_down(t, decay(t, 3.0, 0.01) + noise(0, t))
        shown = re.search(r"shows ([\d.]+) cycles", str(caught.value))
        assert shown is not None
        assert float(shown[1]) < 1.5
