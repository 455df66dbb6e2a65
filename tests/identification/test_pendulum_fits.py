"""Pendulum damping from coupled motion: run-down of both pendulums, release."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from synthetic import Campaign

from daq.signals.run import Run
from identification import FitFailed, NotIdentifiable, fit_release, fit_spin_down_run
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientFit


def known(campaign: Campaign) -> Knowledge:
    true = campaign.truth.identified()
    found = {n: true[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    return Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-3 * v for n, v in found.items()})


def without_friction(fit: TransientFit) -> tuple[np.ndarray, np.ndarray]:
    """c3, c4 and their standard deviations for a rig that is known to have none."""
    assert fit.open_friction is not None
    values, covariance = fit.open_friction.given(np.zeros(4))
    return values, np.sqrt(np.diag(covariance))


@pytest.mark.parametrize("rig_name", ["virtual", "isotropic"])
def test_coupled_run_down_covers(rig_name: str) -> None:
    z = []
    for seed in range(8):
        campaign = Campaign(seed, rig_name=rig_name, clock_rate_std=0.0)
        fit = fit_spin_down_run(campaign.spin_down(), known(campaign))
        true = campaign.truth.identified()
        assert all(abs(fit.values[n] - true[n]) < 3.5 * fit.std[n] for n in fit.values)
        c, std = without_friction(fit)
        z += [(x - true[n]) / s for x, s, n in zip(*without_friction(fit), fit.values, strict=True)]
        assert np.max(std / c) < 2e-3
    assert 0.45 < np.mean(np.abs(z) < 1) < 0.95
    assert np.max(np.abs(z)) < 4


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_few_samples_per_time_constant_are_enough(seed: int) -> None:
    settings = {f"virtual.truth.pendulums.{p}.damping_Nms_per_rad": 0.008 for p in "ab"}
    campaign = Campaign(seed, settings, clock_rate_std=0.0)
    whole = campaign.spin_down(apart_s=0.0)  # one hand, both at once: the first block holds an instant before it
    run = dataclasses.replace(whole, angle_time_s=whole.angle_time_s[::2], angle_rad=whole.angle_rad[::2])
    fit = fit_spin_down_run(run, known(campaign))
    for name in fit.values:
        assert abs(fit.values[name] - 0.008) < 4 * fit.std[name]


def test_answers_that_explain_a_run_down_alike_are_all_covered() -> None:
    truth = {
        "pendulums.a.damping_Nms_per_rad": 0.006,
        "pendulums.b.damping_Nms_per_rad": 0.0033,
        "suspension.zeta1": 0.11,
        "suspension.zeta2": 0.01,
    }
    settings = {f"virtual.truth.{name}": value for name, value in truth.items()}
    warned = 0
    for seed in range(5):
        campaign = Campaign(seed, settings, clock_rate_std=0.0)
        fit = fit_spin_down_run(campaign.spin_down(apart_s=0.0), known(campaign))
        warned += any("nearly as well" in warning for warning in fit.warnings)
        for true, value, std in zip((0.006, 0.0033), *without_friction(fit), strict=True):
            assert abs(value - true) < 3 * std < 0.03 * true
    assert warned >= 2


@pytest.mark.parametrize("point", ["D", "E"])
def test_release_finds_the_damping(point: str) -> None:
    campaign = Campaign(6, {"pendulums.b.mass_kg": 0.070}, clock_rate_std=0.0)
    fit = fit_release(campaign.point(point), known(campaign), np.radians(0.05))
    true = campaign.truth.identified()
    assert fit.horizon_s > 2
    for name, value in fit.values.items():
        assert abs(value - true[name]) < 4 * fit.std[name]
        assert fit.std[name] < 2e-3 * value


def turned(run: Run, angle_rad: float) -> Run:
    """A run as it is when the phase was integrated from a speed."""
    return dataclasses.replace(
        run,
        mark_phase_rad=run.mark_phase_rad + angle_rad,
        phase_rad=run.phase_rad + angle_rad,
        phase_absolute=False,
    )


@pytest.mark.parametrize(("seed", "angle_rad"), [(3, 0.0), (6, 1.1), (7, 2.0), (8, 4.0)])
def test_release_on_a_rotor_whose_angle_is_not_known(seed: int, angle_rad: float) -> None:
    campaign = Campaign(seed, clock_rate_std=0.0)
    run = campaign.point("E")
    fit, true = fit_release(turned(run, angle_rad), known(campaign), np.radians(0.05)), campaign.truth.identified()
    for name, value in fit.values.items():
        assert abs(value - true[name]) < 4 * fit.std[name]
        assert fit.std[name] < 5e-3 * value
    assert fit.chi2_per_dof < 1.3
    warning = next(w for w in fit.warnings if "no absolute reference" in w)
    lacks, std = (float(x) for x in re.findall(r"lacks (-?[\d.]+)° ± ([\d.]+)°", warning)[0])
    assert abs((lacks + np.degrees(angle_rad) + 90) % 180 - 90) < 4 * std < 12
    assert "half a revolution" in warning


def test_gravity_distinguishes_a_rotor_s_angle_from_its_opposite() -> None:
    campaign = Campaign(6, {"suspension.gravity_m_per_s2": 9.81}, clock_rate_std=0.0)
    fit, true = fit_release(turned(campaign.point("D"), 3.5), known(campaign), np.radians(0.05)), campaign.truth
    for name, value in fit.values.items():
        assert abs(value - true.identified()[name]) < 4 * fit.std[name]
    assert any(f"lacks {360 - np.degrees(3.5):.0f}" in w and "half" not in w for w in fit.warnings)


def test_where_nothing_depends_on_the_rotor_s_angle_it_costs_nothing() -> None:
    campaign = Campaign(3, rig_name="isotropic", clock_rate_std=0.0)
    run = campaign.point(next(iter(campaign.rig.points)))
    with_phase, without = (fit_release(r, known(campaign), np.radians(0.05)) for r in (run, turned(run, 0.7)))
    for name, value in with_phase.values.items():
        assert without.values[name] == pytest.approx(value, abs=with_phase.std[name])
        assert without.std[name] < 1.5 * with_phase.std[name]
    assert any("do not depend on it" in warning for warning in without.warnings)


def test_a_release_that_no_start_follows_is_left_out_in_words() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    wrong = dataclasses.replace(turned(campaign.point("E"), 1.5), phase_absolute=True)
    with pytest.raises(FitFailed, match=r"no start value led beyond the first [\d.]+ s") as refused:
        fit_release(wrong, known(campaign), np.radians(0.05))
    assert "inf" not in str(refused.value)


def test_release_of_another_rig_is_left_out() -> None:
    campaign = Campaign(6)
    run = campaign.point("E")
    moved = dataclasses.replace(run, angle_rad=run.angle_rad * 1.02)
    with pytest.raises(FitFailed):
        fit_release(moved, known(campaign), np.radians(0.05))


def test_a_start_ten_times_wrong_ends_at_the_same_damping() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run, start = campaign.point("E"), known(campaign)
    wrong = start.physics.with_values(c3_Nms_per_rad=1e-2, c4_Nms_per_rad=1e-4)
    near, far = (fit_release(run, k, np.radians(0.05)) for k in (start, dataclasses.replace(start, physics=wrong)))
    for name, value in near.values.items():
        assert far.values[name] == pytest.approx(value, abs=0.2 * near.std[name])
        assert near.intervals[name][0] < value < near.intervals[name][1]
    assert near.model == "coupled motion of disk and pendulums"


@pytest.mark.parametrize("setting", ["fast", "reference"])
def test_release_in_other_settings(setting) -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    fit = fit_release(campaign.point("E", 5.0), known(campaign), np.radians(0.05), setting=setting)
    for name, true in campaign.truth.identified().items():
        if name in fit.values:
            assert abs(fit.values[name] - true) < 4 * fit.std[name]


def test_strong_damping_at_speed_is_covered() -> None:
    settings = {f"virtual.truth.pendulums.{p}.damping_Nms_per_rad": 0.01 for p in "ab"}
    campaign = Campaign(4, settings, clock_rate_std=0.0)
    fit = fit_release(campaign.point("E"), known(campaign), np.radians(0.05))
    for name in fit.values:
        assert abs(fit.values[name] - 0.01) < 4 * fit.std[name]


def test_readings_that_are_missing_are_left_out() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run = campaign.point("E")
    holed = run.angle_rad.copy()
    holed[np.random.default_rng(0).random(len(holed)) < 0.05, 0] = np.nan
    fit = fit_release(dataclasses.replace(run, angle_rad=holed), known(campaign), np.radians(0.05))
    true = campaign.truth.identified()
    assert all(abs(fit.values[n] - true[n]) < 4 * fit.std[n] for n in fit.values)


def test_an_encoder_coarser_than_the_rig_file_states_is_seen() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run = campaign.point("E")
    step = 4 * run.angle_step_rad
    coarse = dataclasses.replace(run, angle_rad=np.round(run.angle_rad / step) * step)
    fit = fit_release(coarse, known(campaign), np.radians(0.05))
    true = campaign.truth.identified()
    assert all(abs(fit.values[n] - true[n]) < 4 * fit.std[n] for n in fit.values)


def test_a_run_without_a_release_is_refused() -> None:
    campaign = Campaign(6)
    run = campaign.point("E", 3.0)
    with pytest.raises(NotIdentifiable, match="expected a release of both pendulums"):
        fit_release(dataclasses.replace(run, releases=()), known(campaign), 1e-3)
    still = dataclasses.replace(campaign.spin_down(), angle_rad=np.zeros((len(run.angle_time_s), 2)))
    with pytest.raises(NotIdentifiable):
        fit_spin_down_run(still, known(campaign))
