"""Run-ups with a small effect once per turn outside the model: S_P is within its interval, no bow is invented."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from run_up_worlds import World
from synthetic import Campaign

from identification import RunUpFit, fit_run_up_run, identify
from identification.physical import run_up_sides
from identification.run_up.result import run_up_estimate
from rig_configs.load import load_rig

BENT = 100e-6 * np.exp(1.0j)
EFFECTS = {
    "pendulums 0.3 mm apart in height": World(pendulum_height_m=3e-4),
    "pendulums 3 mm apart in height": World(pendulum_height_m=3e-3),
    "a stand that moves with the force in the bearing": World(floor_m_per_N=1e-6, stand_Hz=20.0),
    "a slip of the phase of 0.1°": World(slip_deg=0.1),
    "a slip of the phase of 0.1° in a resonance": World(slip_deg=0.1, slip_at=0.385, noise_m=2e-6, seed=1),
    "lasers that lag by 1 ms": World(lag_s=1e-3),
    "lasers nonlinear by 0.1 % of their range": World(curvature=1e-3, range_m=0.01),
    "2 % of the imbalance lost before the resonances": World(lost=0.02, lost_at=0.25),
    "2 % of the imbalance lost between the resonances": World(lost=0.02, lost_at=0.5),
    "2 % of the imbalance lost after the resonances": World(lost=0.02, lost_at=0.8),
}


@functools.cache
def fit_in(effect: str) -> RunUpFit:
    return EFFECTS[effect].fit()


def assert_within(world: World, fit: RunUpFit, most_std: float = 3.5) -> None:
    """Both eccentricities agree with the imbalance before or after a loss, or any between them."""
    for name in ("amplitude_x_m", "amplitude_y_m"):
        low, high = world.eccentricity_m * (1 - world.lost), world.eccentricity_m
        off = max(low - fit.values[name], fit.values[name] - high, 0.0)
        assert off < most_std * fit.std[name], (name, off / world.eccentricity_m, off / fit.std[name], fit.model)


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_outside_the_model_does_not_move_the_imbalance(effect: str) -> None:
    world, fit = EFFECTS[effect], fit_in(effect)
    assert_within(world, fit)
    assert "bow_x_m" not in fit.values or fit.values["bow_x_m"] < 0.02 * world.eccentricity_m
    # without a bound an interval of any width would pass
    assert max(fit.std[f"amplitude_{axis}_m"] for axis in "xy") < 0.2 * world.eccentricity_m


def test_a_tilting_disk_is_named_and_costs_little() -> None:
    fit = fit_in("pendulums 0.3 mm apart in height")
    assert any(w.startswith("a motion that grows with the square of the speed") for w in fit.warnings)
    assert 1e-6 < fit.values["growing_x_m"] < 4e-6
    assert fit.std["amplitude_x_m"] < 1e-3 * World().eccentricity_m


def test_a_lag_is_no_slow_roll_and_costs_little() -> None:
    fit = fit_in("lasers that lag by 1 ms")
    assert fit.values["delay_x_s"] == pytest.approx(1e-3, abs=4 * fit.std["delay_x_s"])
    assert not [name for name in fit.values if name.startswith(("run_out", "bow", "growing"))]
    assert fit.std["amplitude_x_m"] < 1e-3 * World().eccentricity_m


def test_what_the_model_lacks_is_named_with_its_size() -> None:
    lost = fit_in("2 % of the imbalance lost between the resonances")
    assert any(
        "the model does not contain all" in w and "an imbalance that changed on the way" in w for w in lost.warnings
    )
    assert any("because an opposite run-out cancels it" in row.why for row in lost.model_table)
    assert not any("does not contain" in w for w in World().fit().warnings)


@pytest.mark.parametrize("seed", range(4))
def test_a_rotor_of_the_model_keeps_its_interval(seed: int) -> None:
    world = World(seed=seed)
    fit = world.fit()
    assert fit.warnings == []
    assert_within(world, fit)
    assert fit.std["amplitude_x_m"] < 1e-4 * world.eccentricity_m


@pytest.mark.parametrize("height_m", [0.0, 3e-4])
def test_a_true_bow_keeps_its_accuracy(height_m: float) -> None:
    world = World(bow_m=BENT, pendulum_height_m=height_m)
    fit = world.fit()
    assert_within(world, fit)
    assert fit.std["amplitude_x_m"] < 1e-3 * world.eccentricity_m
    for axis in "xy":
        found = fit.values[f"bow_{axis}_m"] * np.exp(1j * np.radians(fit.values[f"bow_{axis}_deg"]))
        assert abs(found - BENT) < 0.5e-6
    assert "run_out_x_m" not in fit.values


def test_a_true_run_out_is_no_bow() -> None:
    world = World(run_out_m=(80e-6 + 0j, 50e-6j))
    fit = world.fit()
    assert_within(world, fit)
    assert "bow_x_m" not in fit.values
    assert fit.values["run_out_x_m"] == pytest.approx(80e-6, abs=0.5e-6)


def test_a_true_bow_next_to_a_run_out_is_found() -> None:
    world = World(run_out_m=(40e-6j, 40e-6j), bow_m=70e-6)
    fit = world.fit()
    assert_within(world, fit)
    assert fit.values["bow_x_m"] == pytest.approx(70e-6, abs=4 * fit.std["bow_x_m"])


def test_what_is_lost_between_the_resonances_is_within_the_imbalance_of_the_rig() -> None:
    rig = load_rig("virtual")
    world = World(lost=0.02, mass_kg=rig.physics.total_mass_kg)
    run = world.run()
    estimate = run_up_estimate(run, fit_run_up_run(run), rig.physics, (0.0, 0.0))
    value, std = estimate.value("SP_kg_m"), estimate.std["SP_kg_m"]
    for true in (world.moment_kg_m, 0.98 * world.moment_kg_m):
        assert abs(value - true) < 3 * std
    assert std < 0.03 * world.moment_kg_m


def test_lasers_that_contradict_each_other_widen_the_imbalance() -> None:
    """A stand that moves with the force of the springs is a gain of its own for each laser."""
    rig, gains = load_rig("virtual"), (1e-3, 1e-3)
    world = World(stand_m_per_N=1e-6, stand_Hz=14.0, mass_kg=rig.physics.total_mass_kg)
    run = world.run()
    fit = fit_run_up_run(run)
    estimate = run_up_estimate(run, fit, rig.physics, gains)
    assert abs(estimate.value("SP_kg_m") - world.moment_kg_m) < 3 * estimate.std["SP_kg_m"]
    assert estimate.std["SP_kg_m"] < 0.01 * world.moment_kg_m
    messages = run_up_sides(run, fit, estimate, rig, gains)[1]
    assert any("more apart than their gains permit" in message for message in messages)


def test_lasers_that_agree_keep_the_imbalance_sharp() -> None:
    rig = load_rig("virtual")
    world = World(mass_kg=rig.physics.total_mass_kg)
    run, exact = world.run(), (0.0, 0.0)
    fit = fit_run_up_run(run)
    estimate = run_up_estimate(run, fit, rig.physics, exact)
    assert estimate.std["SP_kg_m"] < 1e-4 * world.moment_kg_m
    assert run_up_sides(run, fit, estimate, rig, exact)[1] == []


DAMPING = ("c3_Nms_per_rad", "c4_Nms_per_rad")


def test_a_run_up_whose_imbalance_is_refused_gives_no_bow_to_the_spin_down() -> None:
    """Its encoder reads pendulum B next to A, so that S_P would be negative; the spin-down is perfect."""
    campaign = Campaign(3)
    run = World(bow_m=3e-3, mass_kg=campaign.rig.physics.total_mass_kg).run(locked_rad=(0.0, 0.3))
    found = identify([run, campaign.spin_down()], campaign.rig)
    assert "SP_kg_m" not in found.parameters.values
    assert found.parameters.slow_roll is None
    for name in DAMPING:
        assert abs(found.parameters.values[name] - campaign.truth.identified()[name]) < 4 * found.parameters.std[name]


def test_a_bow_is_handed_on_with_its_uncertainty() -> None:
    campaign = Campaign(3)
    run = World(bow_m=3e-4, mass_kg=campaign.rig.physics.total_mass_kg).run()
    found = identify([run, campaign.spin_down()], campaign.rig)
    assert found.parameters.slow_roll is not None
    (spin_down,) = [estimate for estimate in found.estimates if estimate.names == DAMPING]
    assert any(label.kind == "slow roll" for label in spin_down.shared)
    for name in DAMPING:
        assert abs(found.parameters.values[name] - campaign.truth.identified()[name]) < 4 * found.parameters.std[name]
