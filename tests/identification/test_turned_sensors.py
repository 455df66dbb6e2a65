"""Two perpendicular lasers that are turned: their directions come from the rig file, other values from the records."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from synthetic import Campaign

from analysis.prediction import known_axis_angle
from daq.signals.run import Run
from identification import NotIdentifiable, identify
from identification.mounting import as_mounted, mounting_remarks
from identification.ring_down.fit import fit_ring_down_runs, ring_down_estimate
from rig_configs import IdentifiedParameters, load_rig
from rig_configs.error_label import ErrorLabel
from tests.effort import cases


def turned(run: Run, turn_deg: float) -> Run:
    return dataclasses.replace(run, turn_deg=turn_deg)


@pytest.mark.parametrize(
    ("turn", "angle", "seed"), [(45.0, 46.0, 1), (-45.0, -46.0, 3), (-45.0, -44.0, 2), (135.0, 136.0, 4)]
)
def test_k_zeta_and_the_imbalance_are_found_whichever_way_the_lasers_stand(
    turn: float, angle: float, seed: int
) -> None:
    campaign = Campaign(seed, axis_angle_deg=angle)
    runs = [turned(r, turn) for r in (campaign.ring_down("x"), campaign.ring_down("y"), campaign.run_up())]
    found = identify(runs, campaign.rig)
    truth, std = campaign.truth.identified(), found.parameters.std
    assert list(found.parameters.values) == ["k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m"]
    for name, value in found.parameters.values.items():
        assert abs(value - truth[name]) < 3.5 * std[name], name
    assert found.axis_angle_deg == pytest.approx(angle, abs=0.01)
    passage = found.fits[-1].fit.values
    assert (
        abs(passage["phase_x_deg"]) < 3
    )  # the index mark is at the angle of the rig file, without an error of a quarter turn
    assert not any("opposite" in warning or "direction_deg" in warning for warning in found.warnings)


def test_intervals_hold_the_truth_of_turned_lasers() -> None:
    """Ring-downs of some campaigns. Where one alone shows no weak direction, both together do."""
    z: list[float] = []
    together = 0
    for seed in range(cases(4, 12)):
        campaign = Campaign(seed, axis_angle_deg=45.0 + np.random.default_rng(seed).normal())
        found = identify([turned(campaign.ring_down(axis), 45.0) for axis in "xy"], campaign.rig)
        truth, std = campaign.truth.identified(), found.parameters.std
        z += [(value - truth[name]) / std[name] for name, value in found.parameters.values.items()]
        together += found.estimates[0].test == "ring-down"
        assert not any("left out" in warning for warning in found.warnings)
    assert len(z) == cases(16, 48)
    assert together > 0
    assert 0.6 < float(np.sqrt(np.mean(np.square(z)))) < 1.5
    assert np.mean(np.abs(z) < 1.96) > 0.8


def test_a_fit_of_lasers_along_the_axes_is_left_as_it_is() -> None:
    campaign = Campaign(1)
    fit = fit_ring_down_runs([campaign.ring_down("x")], campaign.truth.total_mass_kg)
    assert as_mounted(fit, 0.0) is fit
    assert as_mounted(fit, 3.0) is fit


def test_exchanged_directions_keep_their_numbers_together() -> None:
    campaign = Campaign(2, axis_angle_deg=50.0)
    fit = fit_ring_down_runs([campaign.ring_down("x")], campaign.truth.total_mass_kg)
    fit = dataclasses.replace(fit, warnings=["zeta1 depends on k2_N_per_m and f1_Hz; direction 2 of f12 and 31"])
    named = as_mounted(fit, 45.0)
    assert list(named.values) == list(fit.values)
    assert named.warnings == ["zeta2 depends on k1_N_per_m and f2_Hz; direction 1 of f12 and 31"]
    for one, other in (("zeta1", "zeta2"), ("k1_N_per_m", "k2_N_per_m"), ("f2_Hz", "f1_Hz")):
        assert named.values[one] == fit.values[other]
        assert named.std[one] == fit.std[other]
        assert named.intervals[one] == fit.intervals[other]
    names = list(fit.values)
    i, j, k = (names.index(n) for n in ("zeta1", "zeta2", "axis_angle_deg"))
    assert named.covariance[i, k] == fit.covariance[j, k] != fit.covariance[i, k]
    assert named.values["axis_angle_deg"] == pytest.approx(50.0, abs=0.3)
    assert [(one.direction, one.largest_m) for one in named.terms] == [
        (3 - one.direction, one.largest_m) for one in fit.terms
    ]
    low, high = named.intervals["axis_angle_deg"]
    assert low < named.values["axis_angle_deg"] < high


def test_a_direction_that_the_record_contradicts_is_reported() -> None:
    campaign = Campaign(1, axis_angle_deg=25.0)
    fit = fit_ring_down_runs([campaign.ring_down("x")], campaign.truth.total_mass_kg)
    found = as_mounted(fit, 45.0)
    (warning,) = mounting_remarks((found.values["axis_angle_deg"], found.std["axis_angle_deg"]), (45.0, 1.0))
    assert "turned: at 24.99 ± 0.04° to the stiffness axes by the record, at 45 ± 1° by the rig file" in warning
    assert "k1 and k2 are exchanged" in warning


@pytest.mark.parametrize(("mounted_std", "count"), [(1.0, 1), (1.3, 0), (0.0, 1)])
def test_sensors_turned_by_more_than_the_rig_file_allows_are_reported(mounted_std: float, count: int) -> None:
    campaign = Campaign(1, axis_angle_deg=3.0)
    settings = [f"devices.laser_{axis}.direction_std_deg={mounted_std}" for axis in "xy"]
    rig = load_rig("virtual", settings=settings)
    found = identify([campaign.ring_down("x")], rig)
    warnings = [warning for warning in found.warnings if "direction_std_deg" in warning]
    assert len(warnings) == count
    assert all(f"at 0 ± {mounted_std:g}° by the rig file" in warning for warning in warnings)
    assert mounting_remarks((math.nan, math.nan), (0.0, mounted_std)) == []


def test_one_turned_laser_alone_shows_no_direction() -> None:
    campaign, none = Campaign(1, axis_angle_deg=45.0), np.empty(0)
    run = dataclasses.replace(turned(campaign.ring_down("x"), 45.0), y_time_s=none, y_m=none)
    with pytest.raises(NotIdentifiable, match=r"only laser x works, and it stands turned by 45°"):
        identify([run], campaign.rig)


def test_both_clocks_are_in_what_both_sensors_show() -> None:
    campaign = Campaign(1, axis_angle_deg=46.0)
    run = turned(campaign.ring_down("x"), 45.0)
    fit = as_mounted(fit_ring_down_runs([run], campaign.truth.total_mass_kg), 45.0)
    k1 = fit.values["k1_N_per_m"]
    shared = ring_down_estimate(run, fit, 7.27).shared
    assert {label: shift[0] / k1 for label, shift in shared.items()} == {
        ErrorLabel("clock", "x"): pytest.approx(3e-6),
        ErrorLabel("clock", "y"): pytest.approx(3e-6),
    }


def test_an_angle_that_no_test_has_shown_is_that_of_the_mounting() -> None:
    nothing = IdentifiedParameters({"zeta1": 0.02}, np.array([[1e-8]]))
    assert known_axis_angle(nothing, load_rig("virtual")) == (0.0, 1.0)
    ends = ("x.direction_deg=-45", "y.direction_deg=45", "y.direction_std_deg=3")
    turned = [f"devices.laser_{end}" for end in ends]
    assert known_axis_angle(nothing, load_rig("virtual", settings=turned)) == (-45.0, 3.0)
