"""Results of the analysis print as a table and become a data frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from analysis_runs import Drawn, point_run

from analysis import (
    OrbitEllipse,
    PointResult,
    ReleaseDraws,
    Validation,
    amplitude_spectrum,
    end_probabilities,
    moment_margins,
    order_map,
    order_track,
    slip_track,
    validate_point,
)
from analysis.budget import predicted_budgets
from analysis.simulated_run import SimulatedRun
from identification.joint.budget import parameter_budgets
from rig_configs import IdentifiedParameters, Rig

TIME = np.arange(0.0, 4.0, 1e-3)
PHASE = 2 * np.pi * 10 * TIME
SIGNAL = 1e-3 * np.cos(PHASE + 0.3) + 1e-4 * np.cos(2 * PHASE)


@pytest.fixture(scope="module")
def point(rig: Rig, drawn: Drawn) -> PointResult:
    return validate_point(point_run(rig, "D", drawn=drawn, after_s=30.0), rig, drawn.identified, drawn.axis_angle_deg)


def test_a_point_has_a_row_for_each_quantity(point: PointResult) -> None:
    frame = point.to_dataframe().set_index("quantity")
    values = point.to_json()
    assert frame["measured"]["theta3_deg"] == values["measured"]["theta3_deg"]
    assert frame["predicted"]["amplitude_mm"] == values["predicted"]["amplitude_mm"]
    assert frame["difference"]["theta4_deg"] == values["scores"]["theta4"]["error_deg"]
    assert frame["uncertainty"]["theta4_deg"] == values["scores"]["theta4"]["u_validation_deg"]
    assert frame["z"]["theta4_deg"] == point.z_scores["theta4"]
    assert str(point).startswith("PointResult D: pass; state ")


def test_a_validation_has_the_rows_of_its_points(point: PointResult) -> None:
    lost = PointResult("B", "I", "not settled", None, None, {}, "not enough data", "no release", "b.mcap", "a bow")
    found = Validation({"D": point, "B": lost})
    frame = found.to_dataframe()
    assert frame["point"].tolist() == ["D"] * 5 + ["B"] * 5
    assert frame["verdict"].tolist() == ["pass"] * 5 + ["not enough data"] * 5
    assert frame["measured"].isna().tolist() == [False] * 5 + [True] * 5
    assert frame["z"].tolist()[:5] == list(point.columns()["z"])
    assert str(found).startswith("Validation: not passed, 1 of 2 points pass\n")
    assert "- B: a bow" in str(found).splitlines()


def test_measurement_and_prediction_have_the_same_quantities(point: PointResult) -> None:
    assert point.measurement is not None
    assert point.prediction is not None
    measured = dataclasses.replace(point.measurement, remarks=("laser x: spikes",))
    seen, expected = measured.to_dataframe(), point.prediction.to_dataframe()
    assert seen["quantity"].tolist()[:5] == expected["quantity"].tolist()
    assert seen["value"].tolist()[-1] == measured.speed_rad_s.value
    assert expected["std"].tolist() == point.prediction.std.tolist()
    assert str(measured).endswith("- laser x: spikes")
    assert str(point.prediction).startswith(f"Prediction: state {point.state} at ")


def test_predicted_budgets_and_margins_show_their_quantities(rig: Rig, drawn: Drawn, point: PointResult) -> None:
    assert point.prediction is not None
    known: IdentifiedParameters = drawn.identified
    budgets = parameter_budgets(known, rig).budgets
    found = predicted_budgets({"D": point.prediction}, list(known.values), budgets, rig, drawn.axis_angle_deg)
    assert found.to_dataframe()["name"].tolist() == list(found.budgets.names)
    margins = moment_margins(rig, known)
    assert margins.to_dataframe()["value_kg_m"].tolist()[:3] == list(margins.moments_kg_m)
    assert margins.to_dataframe()["std_kg_m"].tolist()[3:] == [margins.grow_std_kg_m, margins.shrink_std_kg_m]


def test_tracks_and_spectra_have_a_row_each() -> None:
    track = order_track(TIME, SIGNAL, PHASE, (1, 2), revolutions=10).to_dataframe()
    assert track["amplitude1_m"].tolist() == pytest.approx([1e-3] * len(track))
    assert track["phase1_rad"].tolist() == pytest.approx([0.3] * len(track))
    assert track["amplitude2_m"].tolist() == pytest.approx([1e-4] * len(track))
    orders = order_map(TIME, SIGNAL, PHASE)
    frame = orders.to_dataframe()
    assert frame.groupby("order")["amplitude_m"].mean()[1.0] == pytest.approx(1e-3, rel=1e-3)
    assert frame["time_s"].nunique() == len(orders.time_s)
    spectrum = amplitude_spectrum(TIME, SIGNAL)
    assert spectrum.to_dataframe()["values"].tolist() == spectrum.values.tolist()
    slip = slip_track(TIME, np.stack([0.1 * PHASE, -0.2 * PHASE], 1), PHASE).to_dataframe()
    assert slip["slip3_order"].tolist() == pytest.approx([0.1] * len(slip))
    assert slip["slip4_order"].tolist() == pytest.approx([-0.2] * len(slip))


def test_an_ellipse_and_a_simulated_run_show_their_numbers() -> None:
    ellipse = OrbitEllipse(3e-3 + 0j, 1e-3 + 0j).to_dataframe()
    assert ellipse[["major_m", "minor_m", "precession"]].to_numpy().tolist() == [[4e-3, 2e-3, "forward"]]
    pairs = np.stack([TIME, -TIME], 1)
    run = SimulatedRun(TIME, PHASE, np.full(len(TIME), 62.8), SIGNAL, SIGNAL, pairs).to_dataframe()
    assert run["theta4_rad"].tolist() == (-TIME).tolist()


def test_probabilities_have_a_row_for_each_end(rig: Rig) -> None:
    speed = rig.physics.speed_rad_s(2.0)
    found = end_probabilities(rig.physics, speed, IdentifiedParameters({}, np.zeros((0, 0))), ReleaseDraws(4))
    frame = found.to_dataframe()
    assert frame["probability"].sum() == 1.0
    assert frame["high"].tolist() == [end.interval[1] for end in found.ends]
