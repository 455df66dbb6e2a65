"""Points of a rig whose suspension depends on the motion, predicted with the terms that were found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.budget import PredictedBudgets, predicted_budgets
from analysis.budget_monte_carlo import NonlinearModel
from analysis.prediction import Prediction, predict_point
from analysis.term_errors import effects
from identification.joint.budget import parameter_budgets
from rig_configs import IdentifiedParameters, load_rig
from rig_configs.error_label import ErrorLabel
from rig_configs.suspension_terms import TERMS, SuspensionTerms

RIG = load_rig("virtual")
SPEED = RIG.physics.speed_rad_s(3.3)
STD = np.array([50.0, 100.0, 0.05, 0.02])


def identified(values: np.ndarray) -> IdentifiedParameters:
    found = RIG.physics.identified()
    n = len(found)
    k2 = list(found).index("k2_N_per_m")
    shift = np.zeros(n)
    shift[k2] = -1e-4 * found["k2_N_per_m"]
    label = ErrorLabel("suspension", TERMS[1])
    terms = SuspensionTerms(values, np.diag(STD**2), TERMS)
    return IdentifiedParameters(found, np.outer(shift, shift), shared={label: shift}, terms=terms)


def test_the_state_and_its_derivatives_are_those_of_the_rig_with_terms() -> None:
    values = np.array([1600.0, 1600.0, 1.0, 0.3])
    found = predict_point(RIG, identified(values), SPEED, (0.0, 0.0))
    plain = predict_point(RIG, replace(identified(values), terms=None), SPEED, (0.0, 0.0))
    assert np.max(np.abs(found.values - plain.values)[:2]) > 0.02  # rad
    for i, name in ((1, TERMS[1]), (3, TERMS[3])):
        ends = [
            predict_point(RIG, identified(values + sign * STD[i] * np.eye(4)[i]), SPEED, (0.0, 0.0), near_rad=None)
            for sign in (1, -1)
        ]
        slope = (ends[0].values - ends[1].values) / (2 * STD[i])
        assert np.allclose(found.by_term[name], slope, rtol=2e-2, atol=2e-2 * np.max(np.abs(slope[2:])))


def test_an_error_that_a_term_shares_with_k2_counts_once() -> None:
    values = np.array([1600.0, 1600.0, 1.0, 0.3])
    given = identified(values)
    found = predict_point(RIG, given, SPEED, (0.0, 0.0))
    label = ErrorLabel("suspension", TERMS[1])
    expected = found.by_parameter @ given.shared[label] + found.by_term[TERMS[1]] * STD[1]
    assert found.shared[label] == pytest.approx(expected, rel=1e-9)
    assert found.shared[ErrorLabel("suspension", TERMS[3])] == pytest.approx(found.by_term[TERMS[3]] * STD[3], rel=1e-9)
    assert set(found.shared) > {ErrorLabel("suspension", name) for name in TERMS}


def budgets(given: IdentifiedParameters, found: Prediction) -> PredictedBudgets:
    return predicted_budgets(
        {"D": found}, list(given.values), parameter_budgets(given, RIG).budgets, RIG, (0.0, 0.05), terms=given.terms
    )


def test_a_budget_has_the_terms_in_it() -> None:
    """u of each quantity is the prediction's own, gains that act through the terms included; linear draws agree."""
    given = identified(np.array([1600.0, 1600.0, 1.0, 0.3]))
    found = predict_point(RIG, given, SPEED, (0.0, 0.05))
    answer = budgets(given, found)
    u = np.sqrt(np.diag(answer.budgets.covariance))
    for row, quantity in enumerate(answer.quantities):
        assert u[row] == pytest.approx(quantity.scale * found.std[quantity.index], rel=1e-6), quantity.name
    assert {f"suspension {name}" for name in TERMS} < {source.name for source in answer.budgets.sources}
    model = NonlinearModel(answer, given.with_effects(RIG.physics))
    column = answer.first_columns[f"suspension {TERMS[3]}"]
    error = np.zeros((1, answer.budgets.sensitivities.shape[1]))
    none, moved = model(error)[0], model(error + 0.1 * np.eye(error.shape[1])[column])[0]
    assert moved - none == pytest.approx(0.1 * answer.budgets.sensitivities[:, column], rel=1e-2, abs=1e-9)


def test_effects_of_the_terms_are_stated_at_each_point() -> None:
    """¾ H a² of stiffness, 8/(3π) Q ω a of damping; what was not found is not named."""
    given = identified(np.array([1600.0, 1600.0, 1.0, 0.3]))
    state = predict_point(RIG, given, SPEED, (0.0, 0.0)).state
    y = abs(state.y_m)
    assert f"k2 is {100 * 0.75 * 1600 * y**2:.2g} % above its value at zero amplitude" in effects(given, state, SPEED)
    damping = 100 * 8 / (3 * np.pi) * 0.3 * SPEED * y
    assert f"ζ2 is {damping:.2g} % above" in effects(given, state, SPEED)
    assert given.terms is not None
    silent = replace(given, terms=replace(given.terms, found=()))
    assert effects(silent, state, SPEED) == ""
    assert effects(replace(given, terms=None), state, SPEED) == ""
