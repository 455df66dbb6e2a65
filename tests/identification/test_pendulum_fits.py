"""Pendulum damping: plain run-down, coupled run-down, release."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic import STEP, Campaign

from identification import FitFailed, NotIdentifiable, fit_release, fit_spin_down, fit_spin_down_run
from identification.pendulums.suspension_knowledge import Knowledge


def run_down(seed: int, friction: float = 0.0, rate: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """One second at rest, a flick to 10 rad/s, encoder readings; friction is a deceleration, rad/s²."""
    time = np.arange(0, 5, 1e-3)
    t = np.maximum(time - 1.0, 0)
    level = friction / rate
    stop = np.log1p(10 / level) / rate if friction else np.inf
    s = np.minimum(t, stop)
    angle = (10 + level) / rate * (1 - np.exp(-rate * s)) - level * s
    rng = np.random.default_rng(seed)
    return time, np.round(angle / STEP + 0.3 * rng.normal(size=len(t))) * STEP


def known(campaign: Campaign) -> Knowledge:
    true = campaign.truth.identified()
    found = {n: true[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    return Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-3 * v for n, v in found.items()})


def test_plain_run_down_covers_and_raises_no_false_alarm() -> None:
    z, alarms = [], 0
    for seed in range(40):
        fit = fit_spin_down(*run_down(seed), inertia_kg_m2=2e-4)
        z.append((fit.values["rate_per_s"] - 2) / fit.std["rate_per_s"])
        alarms += fit.friction_p < 1e-3
        assert fit.values["c_Nms_per_rad"] == pytest.approx(2e-4 * fit.values["rate_per_s"])
    assert 0.5 < np.mean(np.abs(z) < 1) < 0.9
    assert np.max(np.abs(z)) < 4.5
    assert alarms == 0


def test_dry_friction_is_noticed() -> None:
    fit = fit_spin_down(*run_down(1, friction=0.05))
    assert any("not purely viscous" in w for w in fit.warnings)


def test_pendulum_at_rest_is_refused() -> None:
    time = np.arange(0, 5, 1e-3)
    with pytest.raises(NotIdentifiable, match="flick"):
        fit_spin_down(time, np.round(0.3 * np.random.default_rng(0).normal(size=5000)) * STEP)


@pytest.mark.parametrize("rig_name", ["virtual", "isotropic"])
def test_coupled_run_down_covers(rig_name: str) -> None:
    z = []
    for seed in range(8):
        campaign = Campaign(seed, rig_name=rig_name, clock_rate_std=0.0)
        fit = fit_spin_down_run(campaign.spin_down(), known(campaign))
        true = campaign.truth.identified()
        z += [(fit.values[n] - true[n]) / fit.std[n] for n in fit.values]
        assert all(fit.std[n] < 2e-3 * fit.values[n] for n in fit.values)
    assert 0.45 < np.mean(np.abs(z) < 1) < 0.95
    assert np.max(np.abs(z)) < 4


@pytest.mark.parametrize("point", ["D", "E"])
def test_release_finds_the_damping(point: str) -> None:
    campaign = Campaign(6, {"pendulums.b.mass_kg": 0.070}, clock_rate_std=0.0)
    fit = fit_release(campaign.point(point), known(campaign), np.radians(0.05))
    true = campaign.truth.identified()
    assert fit.horizon_s > 2
    for name, value in fit.values.items():
        assert abs(value - true[name]) < 4 * fit.std[name]
        assert fit.std[name] < 2e-3 * value


def test_release_of_another_rig_is_left_out() -> None:
    campaign = Campaign(6)
    run = campaign.point("E")
    moved = dataclasses.replace(run, angle_rad=run.angle_rad * 1.02)
    with pytest.raises(FitFailed):
        fit_release(moved, known(campaign), np.radians(0.05))
