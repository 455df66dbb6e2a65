"""Identification of campaigns and of subsets, and of a campaign with one deviating log."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic import Campaign

from identification import Estimate, NotIdentifiable, combine, identify
from rig_configs.error_label import ErrorLabel
from rig_configs.parameters_file import PARAMETER_UNITS
from rig_configs.schema import Rotor

TARGETS = {"k": 5e-4, "z": 1e-2, "c": 1e-2, "S": 5e-3}
TRUTHS = [
    {},
    {"virtual.truth.suspension.k2_N_per_m": "+7%", "virtual.truth.suspension.zeta1": "*2"},
    {
        "virtual.truth.pendulums.a.damping_Nms_per_rad": "*1.5",
        "virtual.truth.pendulums.b.damping_Nms_per_rad": "*0.7",
        "pendulums.b.mass_kg": 0.070,
    },
]


@pytest.mark.parametrize("changes", TRUTHS)
def test_a_campaign_meets_its_targets(changes: dict[str, object]) -> None:
    campaign = Campaign(11, dict(changes))
    messages: list[str] = []
    found = identify(campaign.commissioning(), campaign.rig, messages.append)
    assert len(found.warnings) == 1
    assert "does not exclude dry friction" in found.warnings[0]  # a lone spin-down cannot
    assert len(messages) == 4
    assert list(found.parameters.values) == list(PARAMETER_UNITS)
    for name, true in campaign.truth.identified().items():
        std = found.parameters.std[name]
        assert std < TARGETS[name[0]] * true
        assert abs(found.parameters.values[name] - true) < 4 * std
    assert abs(found.axis_angle_deg - 1) < 4 * found.axis_angle_std_deg
    assert {r.parameter for r in found.consistency} == {"k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2"}
    assert len(found.parameters.provenance["tests"]) == 4
    assert all(len(f.fit.curves) >= 2 for f in found.fits)


def test_a_result_survives_its_file(tmp_path) -> None:
    campaign = Campaign(1)
    parameters = identify([campaign.ring_down("x"), campaign.ring_down("y")], campaign.rig).parameters
    parameters.save(tmp_path / "parameters.toml")
    assert type(parameters).load(tmp_path / "parameters.toml").values == parameters.values


def test_ring_downs_alone_name_what_is_missing() -> None:
    campaign = Campaign(1)
    found = identify([campaign.ring_down("x"), campaign.ring_down("y")], campaign.rig)
    assert list(found.parameters.values) == ["k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2"]
    assert any("not identified: c3" in w and "record spin-down, run-up" in w for w in found.warnings)


@pytest.mark.parametrize(("reading", "dead", "works", "number"), [(np.nan, "y", "x", 1), (5e-3, "x", "y", 2)])
def test_a_dead_laser_leaves_the_other_s_direction(reading: float, dead: str, works: str, number: int) -> None:
    campaign = Campaign(3)
    whole = [campaign.ring_down("x"), campaign.ring_down("y")]
    runs = [dataclasses.replace(run, **{f"{dead}_m": np.full_like(run.y_m, reading)}) for run in whole]
    found = identify(runs, campaign.rig)
    assert set(found.parameters.values) == {f"k{number}_N_per_m", f"zeta{number}"}
    assert set(found.fits[0].fit.intervals) == set(found.fits[0].fit.values)
    for name, value in found.parameters.values.items():
        assert abs(value - campaign.truth.identified()[name]) < 4 * found.parameters.std[name]
    assert any(f"laser {dead}" in w and "check its cable" in w for w in found.warnings)
    assert any(f"pulled along {dead}, but only laser {works} works" in w for w in found.warnings)


def test_the_error_of_a_mass_without_uncertainty_is_within_the_interval() -> None:
    campaign = Campaign(1, {"virtual.truth.rotor.mass_kg": 7.007})
    rig = campaign.rig.model_copy(update={"rotor": Rotor(mass_kg=7.0)})  # states no uncertainty
    found = identify([campaign.ring_down("x"), campaign.ring_down("y")], rig)
    true = campaign.truth.identified()
    for name in ("k1_N_per_m", "k2_N_per_m"):
        off = found.parameters.values[name] - true[name]
        assert 0.5e-3 * true[name] < abs(off) < 2.5 * found.parameters.std[name]
    assert any("states no standard uncertainty of rotor.mass_kg:" in w for w in found.warnings)


def test_a_log_given_twice_counts_once() -> None:
    campaign = Campaign(1)
    run = campaign.ring_down("x")
    run = dataclasses.replace(run, metadata={**run.metadata, "digest": "d1"})
    copy = dataclasses.replace(run, source="copy.mcap")
    once, twice = identify([run], campaign.rig), identify([run, copy], campaign.rig)
    assert twice.parameters.values == once.parameters.values
    assert twice.parameters.std == once.parameters.std
    assert f"copy.mcap: the same recording as {run.source}; taken once" in twice.warnings


def test_spin_down_alone_works_from_the_file_s_suspension() -> None:
    campaign = Campaign(2)
    found = identify([campaign.spin_down()], campaign.rig)
    true = campaign.truth.identified()
    for name, value in found.parameters.values.items():
        assert abs(value - true[name]) < 4 * found.parameters.std[name]


def test_isotropic_campaign() -> None:
    campaign = Campaign(5, rig_name="isotropic")
    found = identify(campaign.commissioning(), campaign.rig)
    assert any("axes not resolved" in w for w in found.warnings)
    for name, true in campaign.truth.identified().items():
        assert abs(found.parameters.values[name] - true) < 4 * found.parameters.std[name]


def test_a_log_from_another_rig_is_named() -> None:
    campaign = Campaign(3)
    runs = campaign.commissioning()
    slow = dataclasses.replace(runs[0], x_time_s=runs[0].x_time_s * 1.001, y_time_s=runs[0].y_time_s * 1.001)
    found = identify([slow, *runs[1:]], campaign.rig)
    disagreement = [w for w in found.warnings if "disagree" in w]
    assert any("k1" in w and "ring-down-x" in w for w in disagreement)
    worst = max(found.consistency, key=lambda r: abs(r.z))
    assert worst.test == "ring-down-x"
    assert worst.p < 1e-4


def test_an_empty_log_becomes_a_warning() -> None:
    campaign = Campaign(3)
    run = campaign.spin_down()
    still = dataclasses.replace(run, angle_rad=np.zeros_like(run.angle_rad))
    found = identify([campaign.ring_down("x"), campaign.ring_down("y"), still], campaign.rig)
    assert any(w.startswith("spin-down left out") for w in found.warnings)
    with pytest.raises(NotIdentifiable, match="spin-down left out"):
        identify([still], campaign.rig)


def test_a_log_that_is_not_whole_is_warned_of_once() -> None:
    campaign = Campaign(3)
    runs = [campaign.ring_down("x"), campaign.ring_down("y")]
    holed = dataclasses.replace(runs[0], metadata={**runs[0].metadata, "missing": [f"place {k}" for k in range(7)]})
    runs = [holed, runs[1]]
    found = identify(runs, campaign.rig)
    again = identify(runs, campaign.rig, earlier=found)
    for warnings in (found.warnings, again.warnings):
        (message,) = [w for w in warnings if "the log is incomplete" in w]
        assert message.startswith(f"{holed.source}: ")
        assert message.endswith("place 4; and 2 more")


def test_shared_errors_do_not_average_out() -> None:
    name = ("SP_kg_m",)
    gain = {ErrorLabel("gain", "laser_x"): np.array([1e-6])}
    tests = [Estimate("run-up", (f"{i}",), name, np.array([2.5e-3]), np.array([[1e-16]]), gain) for i in range(9)]
    together, rows, warnings = combine(tests)
    assert together.std["SP_kg_m"] == pytest.approx(np.hypot(1e-6, 1e-8 / 3), rel=1e-6)
    assert warnings == []
    assert all(r.p > 0.99 for r in rows)
