"""Budgets of identified parameters: variances sum to those of the file, and every source has its type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from identification.estimate import Estimate
from identification.joint.budget import exact_shifts, parameter_budgets
from identification.joint.combine import joint_estimate
from rig_configs import IdentifiedParameters, load_rig
from rig_configs.error_label import ErrorLabel
from uncertainty import ErrorSource, Group
from uncertainty.rows import budget_json, budget_rows

NAMES = ("k1_N_per_m", "k2_N_per_m", "zeta1")
VALUES = np.array([2600.0, 38000.0, 0.02])
STD = np.array([0.5, 8.0, 2e-5])
MASSES = ("rotor.mass_kg", "imbalance.mass_kg", "pendulums.a.mass_kg", "pendulums.b.mass_kg")
TOTAL_KG = load_rig("virtual").physics.total_mass_kg
BY_MASS = {name: np.array([VALUES[0], VALUES[1], 0.0]) / TOTAL_KG for name in MASSES}
SHARED = {
    ErrorLabel("clock", "laser_x"): [0.3, 0.0, 0.0],
    ErrorLabel("gain", "x"): [0.0, 2.0, 1e-5],
    ErrorLabel("friction", "1"): [0.0, 0.0, 5e-6],
}


def estimate(number: int, off: Sequence[float], correlation: float = 0.6, spread: float = 1.0) -> Estimate:
    """A test whose values are some standard deviations off."""
    own = spread**2 * np.outer(STD, STD) * (correlation + (1 - correlation) * np.eye(3))
    shared = {label: np.array(shift) for label, shift in SHARED.items()}
    return Estimate(
        f"test-{number}", (f"{number:02d}.mcap",), NAMES, VALUES + np.array(off) * STD, own, shared, "made up"
    )


def kept(estimates: Sequence[Estimate], model_share: float = 0.25) -> IdentifiedParameters:
    """A parameters file of tests, that keeps them."""
    joint = joint_estimate(estimates)
    tests = [
        {
            "test": e.test,
            "log": e.source,
            "values": dict(zip(e.names, e.values.tolist(), strict=True)),
            "covariance": e.covariance.tolist(),
            "model_share": model_share,
            "shared": {label.text: dict(zip(e.names, v.tolist(), strict=True)) for label, v in e.shared.items()},
        }
        for e in estimates
    ]
    return replace(joint.parameters, provenance={"tests": tests}, by_number=BY_MASS)


def scaled(matrix: np.ndarray, by: np.ndarray) -> np.ndarray:
    std = np.sqrt(np.diag(by))
    return matrix / np.outer(std, std)


OFF = st.lists(st.floats(-3, 3) | st.floats(-30, 30), min_size=3, max_size=3)


@settings(max_examples=40, deadline=None)
@example([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, 7.0]], 0.0, 0.99999, 0.0)  # widened in one parameter
@example([[0.0, 0.0, 0.0]], 0.5, 1.0, 5e-324)  # a share that leaves no variance
@given(st.lists(OFF, min_size=1, max_size=4), st.floats(-0.3, 0.9), st.floats(0.3, 3), st.floats(0, 1))
def test_variances_and_covariances_sum_to_those_of_the_file(
    offs: list[list[float]], correlation: float, spread: float, model_share: float
) -> None:
    estimates = [estimate(i, off, correlation, spread if i else 1.0) for i, off in enumerate(offs)]
    parameters = kept(estimates, model_share)
    found = parameter_budgets(parameters)
    assert found.budgets.names == NAMES
    summed = scaled(found.budgets.covariance, parameters.covariance)
    np.testing.assert_allclose(np.diag(summed), 1.0, atol=1e-8)
    np.testing.assert_allclose(summed, scaled(parameters.covariance, parameters.covariance), atol=1e-4)
    assert found.notes == ()


def test_a_disagreement_is_a_row_and_a_mild_one_stretches() -> None:
    apart = kept([estimate(0, [0, 0, 0]), estimate(1, [20, 0, 0])])
    rows = budget_rows(parameter_budgets(apart).budgets["k1_N_per_m"])
    assert rows[0].source == "disagreement"
    assert rows[0].share > 0.9
    mild = kept([estimate(0, [0, 0, 0], 0.0), estimate(1, [2.9, 0, 0], 0.0), estimate(2, [-2.9, 0, 0], 0.0)])
    found = parameter_budgets(mild)
    assert set(found.stretch) == {"k1_N_per_m"}
    assert found.stretch["k1_N_per_m"] > 1.5
    assert sum(row.contribution**2 for row in budget_rows(found.budgets["k1_N_per_m"])) == pytest.approx(
        mild.std["k1_N_per_m"] ** 2
    )


def test_own_noise_and_what_is_beyond_it_are_two_rows_of_each_test() -> None:
    found = parameter_budgets(kept([estimate(0, [0, 0, 0]), estimate(1, [0.5, 0, 0])])).budgets
    rows = {row.source: row for row in budget_rows(found["k1_N_per_m"])}
    own, beyond = rows["own: test-0 (00.mcap)"], rows["beyond noise: test-0 (00.mcap)"]
    assert own.contribution**2 / beyond.contribution**2 == pytest.approx(3.0)  # a quarter is beyond noise
    assert (own.kind, rows["clock laser_x"].kind) == ("A", "B")
    assert isinstance(found.sources[0], Group)
    assert set(rows) >= {
        "own: test-0 (00.mcap)",
        "own: test-1 (01.mcap)",
        "beyond noise: test-0 (00.mcap)",
        "beyond noise: test-1 (01.mcap)",
        "clock laser_x",
    }


def test_one_log_twice_gives_rows_of_their_own() -> None:
    found = parameter_budgets(kept([estimate(0, [0, 0, 0]), estimate(0, [0.5, 0, 0])], 0.0))
    assert {"own: test-0 (00.mcap)", "own: test-0 (00.mcap) 2"} <= {s.name for s in found.budgets.sources}


def test_the_rotor_mass_is_the_main_source_of_a_stiffness_with_its_sensitivity() -> None:
    parameters = kept([estimate(0, [0, 0, 0])])
    rig = load_rig("virtual", settings=["rotor.mass_std_kg=0.02"])
    found = parameter_budgets(parameters, rig)
    main = budget_rows(found.budgets["k1_N_per_m"])[0]
    assert main.source == "known rotor.mass_kg"
    assert (main.u, main.unit) == (0.02, "kg")
    assert main.sensitivity == pytest.approx(VALUES[0] / TOTAL_KG)
    assert found.budgets.correlation[0, 1] > 0.9
    assert "known rotor.mass_kg" not in {row.source for row in budget_rows(found.budgets["zeta1"])}
    (note,) = found.notes
    assert "u(k1_N_per_m) is 7.18" in note
    row = budget_json(found.budgets["k1_N_per_m"], 0.99)
    assert row["k"] == pytest.approx(2.5758, abs=1e-4)
    assert row["U95"] == pytest.approx(1.95996 * row["u"], rel=1e-5)


def test_an_instrument_brings_its_distribution_and_degrees_of_freedom() -> None:
    instrument = {
        "measures": ["rotor.mass_kg", "pendulums.a.mass_kg"],
        "relative_std": 0.002,
        "distribution": "rectangular",
        "degrees_of_freedom": 8.0,
    }
    rig = load_rig("virtual", settings={"instruments": {"balance": instrument}})
    found = parameter_budgets(kept([estimate(0, [0, 0, 0])]), rig).budgets
    row = budget_rows(found["k1_N_per_m"])[0]
    assert (row.source, row.distribution, row.degrees_of_freedom) == ("known balance", "rectangular", 8.0)
    both = rig.rotor.mass_kg + rig.pendulums.a.mass_kg
    assert row.contribution == pytest.approx(VALUES[0] * 0.002 * both / TOTAL_KG)
    assert found["k1_N_per_m"].degrees_of_freedom == pytest.approx(8.0, rel=0.05)


def test_gains_have_the_standard_uncertainty_of_the_rig_file() -> None:
    rig = load_rig("virtual")
    found = parameter_budgets(kept([estimate(0, [0, 0, 0])]), rig).budgets
    gain = next(s for s in found.sources if s.name == "gain x")
    assert isinstance(gain, ErrorSource)
    assert gain.std == rig.roles.gain_stds[0]
    row = next(r for r in budget_rows(found["k2_N_per_m"]) if r.source == "gain x")
    assert row.contribution == pytest.approx(2.0)


def test_a_file_without_its_tests_has_one_row_for_them() -> None:
    whole = kept([estimate(0, [0, 0, 0]), estimate(1, [0.3, 0, 0])])
    bare = replace(whole, provenance={}, by_number={})
    found = parameter_budgets(bare, load_rig("virtual", settings=["rotor.mass_std_kg=0.02"]))
    assert budget_rows(found.budgets["k1_N_per_m"])[0].source == "own: all tests together"
    np.testing.assert_allclose(
        scaled(found.budgets.covariance, bare.covariance), scaled(bare.covariance, bare.covariance), atol=1e-9
    )
    assert any("too little" in note for note in found.notes)
    assert any("no derivatives" in note for note in found.notes)


def test_what_a_tenth_of_a_percent_of_an_exact_number_does() -> None:
    parameters, rig = kept([estimate(0, [0, 0, 0])]), load_rig("virtual", settings=["imbalance.mass_std_kg=0.001"])
    shifts = exact_shifts(parameters, rig.known)
    assert set(shifts) == set(MASSES) - {"imbalance.mass_kg"}
    assert shifts["rotor.mass_kg"][0] / VALUES[0] == pytest.approx(1e-3 * 7.0 / TOTAL_KG)
