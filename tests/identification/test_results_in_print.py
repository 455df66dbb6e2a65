"""Every result prints as a table of one screen and becomes a data frame."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import Campaign

from identification import (
    Identification,
    compare_parameters,
    fit_ring_down,
    identify,
    parse_requirement,
    plan_experiments,
    track,
)
from rig_basics.tabular import Tabular
from rig_configs.load import load_rig


@pytest.fixture(scope="module")
def found() -> Identification:
    campaign = Campaign(3, clock_rate_std=0.0)
    return identify([campaign.ring_down("x"), campaign.spin_down()], campaign.rig, setting="fast")


def is_a_screen(result: Tabular) -> bool:
    lines = str(result).splitlines()
    return len(lines) <= 24 and max(map(len, lines)) <= 100


def test_a_fit_shows_values_and_intervals() -> None:
    t = np.arange(0.0, 10.0, 1e-3)
    noise = 1e-6 * np.random.default_rng(1).standard_normal(len(t))
    fit = fit_ring_down(t, 1e-3 * np.exp(-0.2 * t) * np.cos(20.0 * t) + noise)
    shown = str(fit)
    assert is_a_screen(fit)
    assert "RingDownFit: " in shown.splitlines()[0]
    assert f"{fit.values['f1_Hz']:.8g}" in shown
    frame = fit.to_dataframe().set_index("name")
    assert frame.loc["f1_Hz", "std"] == fit.std["f1_Hz"]
    assert frame.loc["zeta1", "low_95"] == fit.intervals["zeta1"][0]


def test_an_identification_shows_parameters_and_what_to_record(found: Identification) -> None:
    assert is_a_screen(found)
    assert str(found).startswith("2 tests: identified parameters")
    assert found.to_record.split()[0] in str(found)
    frame = found.to_dataframe().set_index("name")
    assert frame.loc["k1_N_per_m", "value"] == found.parameters.values["k1_N_per_m"]
    assert frame.loc["k1_N_per_m", "unit"] == "N/m"


def test_a_comparison_and_a_plan_are_tables(found: Identification) -> None:
    compared = compare_parameters(found.parameters, found.parameters)
    assert is_a_screen(compared)
    assert compared.to_dataframe()["change"].tolist() == [0.0] * len(found.parameters.values)
    plan = plan_experiments(load_rig("virtual"), [parse_requirement("k1=0.1%")])
    assert is_a_screen(plan)
    assert plan.to_dataframe()["parameter"].tolist() == ["k1_N_per_m"]


def test_a_tracked_run_is_a_series() -> None:
    campaign = Campaign(3, clock_rate_std=0.0)
    tracked = track(campaign.point("D"), campaign.truth)
    assert is_a_screen(tracked)
    frame = tracked.to_dataframe()
    assert len(frame) == len(tracked.time_s)
    assert frame["theta3_rad"].tolist() == tracked.states[:, 2].tolist()
