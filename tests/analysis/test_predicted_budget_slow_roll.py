"""Budgets of predicted quantities of a rig with run-out, a bow and dry friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.budget import PredictedBudgets, predicted_budgets
from analysis.budget_monte_carlo import NonlinearModel
from analysis.dry_friction import DryFriction, Sensors, left_open, seen_slopes
from analysis.prediction import known_axis_angle, predict_point
from identification.joint.budget import parameter_budgets
from rig_configs import IdentifiedParameters, Rig, load_rig
from rig_configs.error_label import ErrorLabel
from rig_configs.known import KEPT_FRICTION
from rig_configs.slow_roll import SlowRoll
from uncertainty.rows import budget_rows

RUN_OUT, BOW = 30e-6 * np.exp(0.8j), 10e-6 * np.exp(2.0j)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("virtual", settings={"devices.encoder.index_angle_std_deg": 0.1, "rotor.mass_std_kg": 0.002})


@pytest.fixture(scope="module")
def roll() -> SlowRoll:
    root = 1e-7 * np.random.default_rng(3).standard_normal((6, 6))  # everything is correlated
    return SlowRoll(complex(RUN_OUT), complex(RUN_OUT), complex(BOW), root @ root.T, (0.3, 0.7))


@pytest.fixture(scope="module")
def identified(rig: Rig, roll: SlowRoll) -> IdentifiedParameters:
    values = rig.physics.identified()
    gain = np.array([1e-3 * v if name == "SP_kg_m" else 0.0 for name, v in values.items()])
    covariance = np.diag([(1e-4 * v) ** 2 for v in values.values()]) + np.outer(gain, gain)
    friction = {
        "values": dict(zip(KEPT_FRICTION, (2e-4, 1e-4, 0.0, 0.0), strict=True)),
        "covariance": np.diag([1e-10, 1e-10, 0.0, 0.0]).tolist(),
    }
    return IdentifiedParameters(
        values, covariance, {"friction": friction}, (1.0, 0.05), {ErrorLabel("gain", "x"): gain}, slow_roll=roll
    )


@pytest.fixture(scope="module")
def found(rig: Rig, identified: IdentifiedParameters) -> PredictedBudgets:
    predictions = {
        name: predict_point(rig, identified, rig.physics.speed_rad_s(rig.points[name].speed_ratio))
        for name in ("A", "B", "E")
    }
    return predicted_budgets(
        predictions,
        list(identified.values),
        parameter_budgets(identified, rig).budgets,
        rig,
        known_axis_angle(identified, rig),
        slow_roll=identified.slow_roll,
    )


def test_every_budget_comes_to_the_predictions_uncertainty(found: PredictedBudgets) -> None:
    """Held by friction at B, moved by it at A and E; a balanced state of a bent shaft has amplitudes too."""
    assert [len(found.predictions[name].friction.covariance) for name in "ABE"] == [1, 2, 1]
    assert len(found.quantities) == 15
    for quantity, one in zip(found.quantities, found.budgets.budgets, strict=True):
        expected = quantity.scale * found.predictions[quantity.point].std[quantity.index]
        assert one.std == pytest.approx(expected, rel=1e-6), quantity.name


def test_points_are_correlated_by_the_slow_roll_and_not_by_friction(found: PredictedBudgets) -> None:
    names = [source.name for source in found.budgets.sources]
    assert {"dry friction at A", "dry friction at B", "dry friction at E", "gain y"} <= set(names)
    assert sum(name.startswith("slow roll") for name in names) == 6
    column = found.first_columns["dry friction at B"]
    others = [i for i, q in enumerate(found.quantities) if q.point != "B"]
    assert not np.any(found.budgets.sensitivities[others, column : column + 2])


def test_rows_have_the_sensitivities_of_the_prediction(
    rig: Rig, identified: IdentifiedParameters, found: PredictedBudgets
) -> None:
    """A bow that is one standard deviation longer, by a new prediction."""
    std = np.r_[np.zeros(4), 2e-7, 1e-7]
    roll = SlowRoll(0j, 0j, complex(BOW), np.diag(std**2), (0.5, 0.5))
    alone = replace(identified, slow_roll=roll)
    speed = found.predictions["B"].speed_rad_s
    before = predict_point(rig, alone, speed)
    budgets = predicted_budgets(
        {"B": before},
        list(alone.values),
        parameter_budgets(alone, rig).budgets,
        rig,
        known_axis_angle(alone, rig),
        slow_roll=roll,
    )
    row = next(r for r in budget_rows(budgets.budgets["B.theta3_deg"]) if r.source.endswith("bow along 0°"))
    near = before.values[:2].tolist()
    longer = replace(alone, slow_roll=replace(roll, bow_m=roll.bow_m + 2e-7))
    moved = np.degrees(predict_point(rig, longer, speed, near_rad=near).values[0] - before.values[0])
    assert (row.unit, row.kind, row.u) == ("m", "A", pytest.approx(2e-7))
    assert abs(row.sensitivity * row.u) == pytest.approx(abs(moved), rel=1e-2)


def test_monte_carlo_follows_run_out_bow_and_friction(rig: Rig, found: PredictedBudgets) -> None:
    sources = found.budgets.sources
    drawn = np.concatenate([s.draw(np.random.default_rng(i), 8).reshape(8, s.width) for i, s in enumerate(sources)], 1)
    names = [source.name for source in sources]
    wanted = [i for i, name in enumerate(names) if name.startswith(("slow", "dry", "gain", "known phase"))]
    kept = np.zeros(drawn.shape[1], bool)
    for i in wanted:
        at = found.first_columns[names[i]]
        kept[at : at + sources[i].width] = True
    drawn *= kept
    values = NonlinearModel(found, rig.physics)(drawn)
    linear = found.budgets.values + drawn @ found.budgets.sensitivities.T
    u = np.array([b.std for b in found.budgets.budgets])
    assert np.max(np.abs(linear - found.budgets.values) / u) > 0.5
    assert np.max(np.abs(values - linear) / u) < 0.05


def test_friction_moves_what_sensors_with_run_out_show(rig: Rig, identified: IdentifiedParameters) -> None:
    """|X + r| goes with the angles otherwise than |X|: against the orbits of pendulums held a little off."""
    physics = identified.applied_to(rig.physics)
    at_b = predict_point(rig, identified, rig.physics.speed_rad_s(1.6))
    sensors: Sensors = (0.02, (RUN_OUT, -1j * RUN_OUT))
    state, friction = at_b.state, DryFriction.of(identified)
    opened = left_open(friction, physics, at_b.speed_rad_s, state, lambda s, t: np.empty((len(t), len(s))), sensors)
    assert opened.held is not None
    turn = np.array([[np.cos(0.02), np.sin(0.02)], [-np.sin(0.02), np.cos(0.02)]])
    orbit = np.array([state.x_m, -1j * state.y_m])
    for j in range(2):
        ends = [np.abs(turn @ (orbit + sign * 1e-5 * opened.held.orbit_slopes[:, j]) + sensors[1]) for sign in (1, -1)]
        assert opened.slopes[2:4, j] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4)
    straight = seen_slopes(opened.held, orbit, (0.02, (0j, 0j)))
    assert np.abs(straight[2:] - opened.slopes[2:]).max() > 0.1 * np.abs(opened.slopes[2:]).max()
