"""Impossible values are reported and left out; other values of the same tests are kept; every file can be loaded."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from synthetic import Campaign

from daq.signals.run import Run
from identification import Estimate, identify
from identification.physical import keep_physical, physical_parameters, run_up_sides
from identification.run_up.fit import fit_run_up_run
from identification.run_up.result import RunUpFit, run_up_estimate
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, load_rig
from rig_configs.load import refusal

RIG = load_rig("virtual")


GAINS = (1e-3, 1e-3)


@pytest.fixture(scope="module")
def run_up() -> tuple[Campaign, Run, RunUpFit]:
    campaign = Campaign(5)
    run = campaign.run_up()
    return campaign, run, fit_run_up_run(run)


def sides(run: Run, fit: RunUpFit) -> tuple[Estimate, list[str]]:
    return run_up_sides(run, fit, run_up_estimate(run, fit, RIG.physics, GAINS), RIG, GAINS)


def turned(run: Run, a: float = 0.0, b: float = 0.0) -> Run:
    return dataclasses.replace(run, angle_rad=run.angle_rad + np.radians([a, b]))


@pytest.mark.parametrize(("shift", "name"), [((0, 180), "B"), ((180, 0), "A"), ((0, -180), "B"), ((0, 540), "B")])
def test_a_reading_half_a_turn_from_its_lock_costs_s_p_alone(
    run_up: tuple[Campaign, Run, RunUpFit], shift: tuple[float, float], name: str
) -> None:
    _, run, fit = run_up
    sound, nothing = sides(run, fit)
    assert nothing == []
    found, (message,) = sides(turned(run, *shift), fit)
    assert found.names == ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")
    assert np.array_equal(found.values, sound.values[:4])
    assert f"{name} reads" in message
    assert f"{sound.value('SP_kg_m'):.4g} kg m with half a turn more" in message


def test_all_else_goes_on_without_it(run_up: tuple[Campaign, Run, RunUpFit], tmp_path: Path) -> None:
    campaign, run, _ = run_up
    found = identify([turned(run, b=180), campaign.spin_down()], campaign.rig)
    assert set(found.parameters.values) == {*PARAMETER_UNITS} - {"SP_kg_m"}
    assert sum("in its lock" in warning for warning in found.warnings) == 1
    found.parameters.save(tmp_path / "parameters.toml")
    load_rig("virtual", tmp_path / "parameters.toml")


def test_a_laser_s_sign_and_an_index_mark_half_a_turn_off_are_reported(run_up: tuple[Campaign, Run, RunUpFit]) -> None:
    _, run, fit = run_up

    def phases(**shift: float) -> RunUpFit:
        return dataclasses.replace(fit, values={n: v + shift.get(n, 0.0) for n, v in fit.values.items()})

    mirrored, (message,) = sides(run, phases(phase_y_deg=180.0))
    assert "laser y shows the imbalance opposite" in message
    late, (message,) = sides(run, phases(phase_x_deg=-180.0, phase_y_deg=180.0))
    assert "the index mark is half a turn off" in message
    integrated = dataclasses.replace(run, phase_absolute=False)
    assert sides(integrated, phases(phase_x_deg=180.0, phase_y_deg=180.0))[1] == []
    for found in (mirrored, late):
        assert "SP_kg_m" in found.names


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("k1_N_per_m", -1.0),
        ("k2_N_per_m", 0.0),
        ("zeta1", -1e-6),
        ("zeta2", 2.5),
        ("c3_Nms_per_rad", -1e-9),
        ("c4_Nms_per_rad", 60.0),
        ("SP_kg_m", -0.0055),
        ("SP_kg_m", 5.0),
        ("k1_N_per_m", 1e12),
    ],
)
def test_every_value_that_the_loader_refuses_is_left_out(tmp_path: Path, name: str, value: float) -> None:
    sound = "zeta2" if name != "zeta2" else "zeta1"
    estimate = Estimate("t", ("a.mcap",), (name, sound), np.array([value, 0.02]), np.diag([1e-10, 1e-10]))
    kept, messages = keep_physical(estimate, RIG)
    assert kept is not None
    assert kept.names == (sound,)
    assert name in messages[0]
    assert "left out" in messages[0]
    joint = IdentifiedParameters({name: value, sound: 0.02}, np.diag([1e-10, 1e-10]))
    reduced, messages = physical_parameters(joint, RIG)
    assert list(reduced.values) == [sound]
    assert messages
    reduced.save(tmp_path / "p.toml")
    load_rig("virtual", tmp_path / "p.toml")
    alone, _ = keep_physical(Estimate("t", ("a.mcap",), (name,), np.array([value]), np.array([[1e-10]])), RIG)
    assert alone is None


def test_a_value_that_is_zero_within_its_uncertainty_is_reported_as_such() -> None:
    estimate = Estimate("t", ("a.mcap",), ("c3_Nms_per_rad",), np.array([-1e-6]), np.array([[1e-12]]))
    _, (message,) = keep_physical(estimate, RIG)
    assert "zero within its uncertainty" in message
    assert refusal(RIG, "c3_Nms_per_rad", 1e-6) is None
