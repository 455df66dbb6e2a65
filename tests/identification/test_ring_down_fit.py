"""Ring-down: exact recovery, honest intervals, masks, rigs that look alike in both directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from synthetic import Campaign

from identification import NotIdentifiable, fit_ring_down, fit_ring_down_runs


def decay(time: np.ndarray, f: float, zeta: float, amplitude: float, phase: float) -> np.ndarray:
    omega = 2 * np.pi * f
    return amplitude * np.exp(-zeta * omega * time) * np.cos(omega * np.sqrt(1 - zeta**2) * time + phase)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    f=st.floats(2.5, 12.0),
    log_zeta=st.floats(np.log(1e-3), np.log(0.15)),
    phase=st.floats(0, 2 * np.pi),
    seed=st.integers(0, 2**31),
)
def test_one_mode_is_found_without_a_start_value(f: float, log_zeta: float, phase: float, seed: int) -> None:
    zeta = float(np.exp(log_zeta))
    time = np.arange(0, 12, 1e-3)
    rng = np.random.default_rng(seed)
    fit = fit_ring_down(time, decay(time, f, zeta, 1e-3, phase) + 1e-5 * rng.normal(size=len(time)), mass_kg=2.0)
    assert abs(fit.values["f1_Hz"] - f) < 5.5 * fit.std["f1_Hz"]
    assert abs(fit.values["zeta1"] - zeta) < 5.5 * fit.std["zeta1"]
    assert fit.values["k1_N_per_m"] == pytest.approx(2 * (2 * np.pi * fit.values["f1_Hz"]) ** 2)


def test_one_mode_reaches_the_bound() -> None:
    """Spread and stated std against the closed form V = 2 σ² / (fs a² T³ g(u)) at a long record."""
    f, zeta, sigma, rate = 3.0, 0.02, 1e-5, 1000
    time = np.arange(0, 14, 1 / rate)
    d = zeta * 2 * np.pi * f
    bound = 4 * (sigma / 1e-3) * np.sqrt(d / rate)  # relative sd of ζ, long record
    found, stated = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        y = decay(time, f, zeta, 1e-3, rng.uniform(0, 6)) + sigma * rng.normal(size=len(time))
        fit = fit_ring_down(time, y)
        found.append(fit.values["zeta1"] / zeta - 1)
        stated.append(fit.std["zeta1"] / zeta)
    assert np.mean(stated) == pytest.approx(bound, rel=0.05)
    assert np.std(found) == pytest.approx(bound, rel=0.3)


def test_two_records_cover_the_truth() -> None:
    z = []
    for seed in range(6):
        campaign = Campaign(seed, clock_rate_std=0.0)
        runs = [campaign.ring_down(axis, record_s=8.0) for axis in "xy"]
        fit = fit_ring_down_runs(runs, campaign.truth.total_mass_kg)
        true = {**campaign.truth.identified(), "axis_angle_deg": campaign.axis_angle_deg}
        assert fit.warnings == []
        assert 0.9 < fit.chi2_per_dof < 1.1
        z += [(fit.values[n] - true[n]) / fit.std[n] for n in fit.values if n in true]
    assert 0.5 < np.mean(np.abs(z) < 1) < 0.86
    assert np.max(np.abs(z)) < 4.5


def test_axis_angle_column_takes_no_information_from_noise() -> None:
    """Twenty times the noise must stretch the angle's interval twenty times."""
    std = []
    for noise in (4e-6, 8e-5):
        campaign = Campaign(3, laser_noise_m=noise)
        runs = [campaign.ring_down(axis, record_s=6.0) for axis in "xy"]
        std.append(fit_ring_down_runs(runs).std["axis_angle_deg"])
    assert std[1] / std[0] == pytest.approx(20, rel=0.15)


def test_rail_and_invalid_samples_are_left_out() -> None:
    time = np.arange(0, 12, 1 / 2000)
    rng = np.random.default_rng(5)
    y = decay(time, 3.0, 0.02, 3e-3, 0.3) + 4e-6 * rng.normal(size=len(time))
    y = np.round(y / 4e-7) * 4e-7
    clean = fit_ring_down(time, y)
    y[rng.random(len(y)) < 0.05] = np.nan
    y = np.where(np.isnan(y), np.nan, np.clip(y, -2e-3, 2e-3))
    railed = fit_ring_down(time, y)
    assert any("rail" in w for w in railed.warnings)
    assert abs(railed.values["zeta1"] - 0.02) < 4.5 * railed.std["zeta1"]
    assert railed.std["zeta1"] < 4 * clean.std["zeta1"]


def test_alike_directions_are_reported_not_resolved() -> None:
    campaign = Campaign(2, rig_name="isotropic")
    fit = fit_ring_down_runs([campaign.ring_down("x"), campaign.ring_down("y")], campaign.truth.total_mass_kg)
    assert any("axes not resolved" in w for w in fit.warnings)
    true = campaign.truth.identified()
    for name in ("zeta1", "zeta2"):
        assert abs(fit.values[name] - true[name]) < 4 * fit.std[name]
    assert fit.values["k1_N_per_m"] == pytest.approx(true["k1_N_per_m"], rel=5e-5)
    lone = fit_ring_down_runs([campaign.ring_down("x")])
    assert set(lone.values) == {"f1_Hz", "zeta1"}
    assert lone.warnings


def test_quiet_record_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(NotIdentifiable, match="nothing rings down"):
        fit_ring_down(np.arange(4000) / 1000, 4e-6 * rng.normal(size=4000))
