"""Points of a rig whose suspension depends on the motion, predicted with the terms that were found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.prediction import predict_point
from rig_configs import IdentifiedParameters, load_rig
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
    label = f"suspension {TERMS[1]}"
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
    label = f"suspension {TERMS[1]}"
    expected = found.by_parameter @ given.shared[label] + found.by_term[TERMS[1]] * STD[1]
    assert found.shared[label] == pytest.approx(expected, rel=1e-9)
    assert found.shared[f"suspension {TERMS[3]}"] == pytest.approx(found.by_term[TERMS[3]] * STD[3], rel=1e-9)
    assert set(found.shared) > {f"suspension {name}" for name in TERMS}
