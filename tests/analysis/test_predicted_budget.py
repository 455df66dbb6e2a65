"""Budgets of predicted quantities: the same covariance as the prediction's, and Monte Carlo against the linear law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.budget import PredictedBudgets, predicted_budgets, quantity_names
from analysis.budget_monte_carlo import NonlinearModel
from analysis.errors import NoStableState
from analysis.prediction import known_axis_angle, predict_point
from identification.joint.budget import parameter_budgets
from rig_configs import IdentifiedParameters, Rig, load_rig
from rig_configs.error_label import ErrorLabel
from uncertainty import check_linear, monte_carlo
from uncertainty.rows import budget_rows

INSTRUMENT = {
    "measures": ["rotor.mass_kg", "pendulums.a.mass_kg"],
    "relative_std": 0.003,
    "distribution": "rectangular",
}
MASSES = ("rotor.mass_kg", "imbalance.mass_kg", "pendulums.a.mass_kg", "pendulums.b.mass_kg")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("virtual", settings={"instruments": {"balance": INSTRUMENT}, "pendulums.a.length_std_m": 1e-5})


@pytest.fixture(scope="module")
def identified(rig: Rig) -> IdentifiedParameters:
    """Parameters with own errors of 10⁻⁴ and those of the balance, as an identification with this rig finds them."""
    values = rig.physics.identified()
    total = rig.physics.total_mass_kg
    slope = np.array([0.0 if name.startswith("zeta") else v / total for name, v in values.items()])
    by_number = dict.fromkeys(MASSES, slope)
    shared = {
        source.label: np.sum([by_number[n] * step for n, step in source.effects.items() if n in by_number], axis=0)
        for source in rig.known.sources
        if set(source.effects) & set(by_number)
    }
    gain = np.array([1e-3 * v if name == "SP_kg_m" else 0.0 for name, v in values.items()])
    shared[ErrorLabel("gain", "x")] = gain
    own = np.diag([(1e-4 * v) ** 2 for v in values.values()])
    covariance = own + np.sum([np.outer(v, v) for v in shared.values()], axis=0)
    return IdentifiedParameters(values, covariance, {}, (1.0, 0.05), shared, by_number)


@pytest.fixture(scope="module")
def found(rig: Rig, identified: IdentifiedParameters) -> PredictedBudgets:
    predictions = {
        name: predict_point(rig, identified, rig.physics.speed_rad_s(rig.points[name].speed_ratio))
        for name in ("B", "D")
    }
    parameters = parameter_budgets(identified, rig).budgets
    return predicted_budgets(predictions, list(identified.values), parameters, rig, known_axis_angle(identified, rig))


def test_the_budgets_hold_the_covariance_of_the_prediction(found: PredictedBudgets) -> None:
    """The prediction adds its shared errors label by label; the budgets by sources. Both are one covariance."""
    scale = np.array([q.scale for q in found.quantities if q.point == "D"])
    at = [i for i, q in enumerate(found.quantities) if q.point == "D"]
    expected = found.predictions["D"].covariance * np.outer(scale, scale)
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found.budgets.covariance[np.ix_(at, at)] / np.outer(std, std), expected / np.outer(std, std), atol=1e-6
    )
    assert [found.budgets.names[i] for i in at] == quantity_names("D")
    assert found.budgets["D.theta3_deg"].value == pytest.approx(np.degrees(found.predictions["D"].values[0]))


def test_uncertainties_that_a_rig_file_got_after_the_identification_act_through_the_parameters_too(
    rig: Rig, identified: IdentifiedParameters, found: PredictedBudgets
) -> None:
    gains = {label: shift for label, shift in identified.shared.items() if label.kind != "known"}
    own = identified.own_covariance + np.sum([np.outer(v, v) for v in gains.values()], axis=0)
    before = replace(identified, covariance=own, shared=gains)
    expected = found.predictions["D"]
    prediction = predict_point(rig, before, expected.speed_rad_s)
    np.testing.assert_allclose(prediction.covariance, expected.covariance, rtol=1e-6, atol=1e-20)
    stale = replace(
        identified, shared={**identified.shared, ErrorLabel("known", "scales"): np.ones(len(identified.values))}
    )
    assert ErrorLabel("known", "scales") not in stale.shared_with(rig.known)
    plain = replace(identified, by_number={})
    assert set(plain.shared_with(rig.known)) == set(identified.shared)


def test_a_mass_acts_through_the_parameters_and_directly_in_one_row(found: PredictedBudgets) -> None:
    row = next(r for r in budget_rows(found.budgets["D.theta3_deg"]) if r.source == "known balance")
    prediction = found.predictions["D"]
    known = next(s for s in found.known.sources if s.name == "balance")
    slope = np.array([prediction.by_number[n][0] * step for n, step in known.effects.items()])
    through = prediction.shared[ErrorLabel("known", "balance")][0] - np.sum(slope)
    assert abs(np.sum(slope)) > 1e-6
    assert abs(through) > 1e-6
    assert row.contribution == pytest.approx(np.degrees(through + np.sum(slope)), rel=1e-6)
    assert row.distribution == "rectangular"


def test_a_balanced_amplitude_and_a_source_without_effect_have_no_row(found: PredictedBudgets) -> None:
    assert [q.name for q in found.quantities if q.point == "B"] == ["B.theta3_deg", "B.theta4_deg"]
    length = next(r for r in budget_rows(found.budgets["B.theta3_deg"]) if "length" in r.source)
    assert length.source == "known pendulums.a.length_m"  # directly: no parameter of this file depends on it


def test_monte_carlo_agrees_where_all_is_nearly_linear(rig: Rig, found: PredictedBudgets) -> None:
    """The model's values for a draw are those of the linear law but for the curvature, draw by draw."""
    sources = found.budgets.sources
    drawn = np.concatenate(
        [s.draw(np.random.default_rng(i), 40).reshape(40, s.width) for i, s in enumerate(sources)], 1
    )
    values = NonlinearModel(found, rig.physics)(drawn)
    linear = found.budgets.values + drawn @ found.budgets.sensitivities.T
    u = np.array([b.std for b in found.budgets.budgets])
    assert np.max(np.abs(linear - found.budgets.values) / u) > 1.5
    assert np.max(np.abs(values - linear) / u) < 0.02


def test_monte_carlo_differs_where_a_rectangular_source_dominates(rig: Rig, found: PredictedBudgets) -> None:
    wide = {**INSTRUMENT, "relative_std": 0.03, "measures": ["pendulums.a.mass_kg"]}
    other = load_rig("virtual", settings={"instruments": {"balance": wide}})
    parameters = replace(found.budgets)  # sources of the parameters are those of a file without this instrument
    exact = IdentifiedParameters(
        rig.physics.identified(), np.diag([(1e-7 * v) ** 2 for v in rig.physics.identified().values()])
    )
    parameters = parameter_budgets(exact, other).budgets
    predictions = {"B": found.predictions["B"]}
    budgets = predicted_budgets(predictions, list(exact.values), parameters, other, (0.0, 0.0))
    result = monte_carlo(
        NonlinearModel(budgets, other.physics),
        budgets.budgets.sources,
        seed=2,
        trials=1500,
        names=budgets.budgets.names,
    )
    check = check_linear(budgets.budgets["B.theta3_deg"], result, 1)
    row = budget_rows(budgets.budgets["B.theta3_deg"])[0]
    assert (row.source, row.distribution) == ("known balance", "rectangular")
    assert row.share > 0.99
    assert check.verdict == "differ"
    low, high = check.sampled
    assert (high - low) / (2 * result["B.theta3_deg"].std) == pytest.approx(0.95 * np.sqrt(3), rel=0.05)


def test_a_draw_that_leaves_the_domain_is_refused_with_words(rig: Rig, found: PredictedBudgets) -> None:
    model = NonlinearModel(found, rig.physics)
    error = np.zeros((1, found.budgets.sensitivities.shape[1]))
    error[0, found.first_columns["known balance"]] = -2.0  # of its scale: masses below 0
    with pytest.raises(NoStableState, match="a draw has impossible parameters"):
        model(error)


def test_exact_numbers_move_the_quantities_through_both_ways(
    rig: Rig, identified: IdentifiedParameters, found: PredictedBudgets
) -> None:
    shifts = found.exact_shifts(identified.by_number)
    assert set(shifts) == {"imbalance.mass_kg", "pendulums.b.mass_kg"}  # of the others this file has no derivative
    number, step = "pendulums.b.mass_kg", 1e-3 * rig.pendulums.b.mass_kg
    change = dict(zip(identified.values, (step * identified.by_number[number]).tolist(), strict=True))
    moved = replace(identified, values={name: v + change[name] for name, v in identified.values.items()})
    speed = found.predictions["D"].speed_rad_s
    again = predict_point(rig.with_number(number, rig.pendulums.b.mass_kg + step), moved, speed)
    at = [q.name for q in found.quantities].index("D.theta3_deg")
    seen = np.degrees(again.values[0] - found.predictions["D"].values[0])
    assert shifts[number][at] == pytest.approx(seen, rel=0.01)
