"""Run-up: both resonances and the imbalance without start values and without sweep bias."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import Campaign

from dynamics.equations.speed_history import SpeedHistory
from identification import IdentificationError, NotIdentifiable, fit_run_up, fit_run_up_run
from identification.run_up.fit import run_up_estimate

GAINS = (1e-3, 1e-3)


def test_run_up_covers_the_truth() -> None:
    z = []
    for seed in range(6):
        campaign = Campaign(seed)
        run = campaign.run_up(ramp_s=25.0)
        fit = fit_run_up_run(run)
        assert fit.warnings == []
        estimate = run_up_estimate(run, fit, campaign.rig.physics, GAINS)
        true = campaign.truth.identified()
        z += [(estimate.value(n) - true[n]) / estimate.std[n] for n in estimate.names]
        z.append((fit.values["axis_angle_deg"] - 1.0) / fit.std["axis_angle_deg"])
    assert 0.5 < np.mean(np.abs(z) < 1) < 0.9
    assert np.max(np.abs(z)) < 4
    # values from a peak and its width, and from a steady-state curve through the Vold–Kalman amplitude
    for naive in (fit.half_power, fit.vold_kalman):
        assert naive["x"][0] > 1.03 * fit.values["f1_Hz"]
        assert naive["x"][1] > 1.5 * fit.values["zeta1"]


def test_unequal_pendulums_are_subtracted() -> None:
    campaign = Campaign(1, {"pendulums.b.mass_kg": 0.070}, calibrated=True)
    run = campaign.run_up(ramp_s=20.0)
    estimate = run_up_estimate(run, fit_run_up_run(run), campaign.rig.physics, GAINS)
    assert estimate.value("SP_kg_m") == pytest.approx(campaign.truth.imbalance_moment_kg_m, rel=5e-4)


def test_arrays_on_one_time_base() -> None:
    campaign = Campaign(4, calibrated=True, delay_std_s=0.0, clock_rate_std=0.0)
    run = campaign.run_up(ramp_s=20.0)
    time = np.arange(run.mark_time_s[0], run.mark_time_s[-1], 1e-3)
    psi = SpeedHistory.from_phases(run.mark_time_s, run.mark_phase_rad).phase(time)[:, 0]
    signals = []
    for t, m in ((run.x_time_s, run.x_m), (run.y_time_s, run.y_m)):
        good = np.isfinite(m)
        signals.append(np.interp(time, t[good], m[good]))
    fit = fit_run_up(time, np.column_stack(signals), psi)
    f1, f2 = np.array(campaign.truth.natural_frequencies_rad_s) / (2 * np.pi)
    assert fit.values["f1_Hz"] == pytest.approx(f1, rel=1e-4)
    assert fit.values["f2_Hz"] == pytest.approx(f2, rel=1e-4)
    assert fit.values["zeta2"] == pytest.approx(campaign.truth.zeta2, rel=2e-3)


def test_too_slow_a_run_up_gives_the_first_direction_alone() -> None:
    campaign = Campaign(0)
    run = campaign.run_up(to_rpm=400.0, ramp_s=15.0)
    fit = fit_run_up_run(run)
    assert "f2_Hz" not in fit.values
    assert any("resonance 2 (sensor y) is not identifiable" in w for w in fit.warnings)
    estimate = run_up_estimate(run, fit, campaign.rig.physics, GAINS)
    assert estimate.names == ("k1_N_per_m", "zeta1", "SP_kg_m")
    true = campaign.truth.identified()
    for name in estimate.names:
        assert abs(estimate.value(name) - true[name]) < 4 * estimate.std[name]


def test_a_run_up_below_both_resonances_is_refused() -> None:
    run = Campaign(0).run_up(to_rpm=120.0, ramp_s=15.0)
    with pytest.raises(IdentificationError, match="resonance"):
        fit_run_up_run(run)


def test_too_few_marks_are_refused() -> None:
    run = Campaign(0).run_up(to_rpm=60.0, ramp_s=12.0)
    with pytest.raises(NotIdentifiable, match="needs ten"):
        fit_run_up_run(run)
