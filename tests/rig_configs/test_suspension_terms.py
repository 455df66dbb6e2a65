"""The suspension's terms in parameters.toml, and what is done with them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from rig_configs import IdentifiedParameters, load_rig
from rig_configs.error_label import ErrorLabel
from rig_configs.errors import ParametersFileError
from rig_configs.suspension_terms import TERMS, SuspensionTerms, moved_term

COVARIANCE = np.zeros((4, 4))
COVARIANCE[np.ix_([0, 2], [0, 2])] = [[9.0, -0.012], [-0.012, 1e-4]]
FOUND = SuspensionTerms(np.array([1600.0, 0.0, 1.06, 0.0]), COVARIANCE, (TERMS[0], TERMS[2]), ("a.mcap",), ("12ab",))


def parameters(terms: SuspensionTerms | None) -> IdentifiedParameters:
    return IdentifiedParameters({"k1_N_per_m": 2500.0}, np.array([[0.01]]), terms=terms)


def test_a_file_holds_them_and_an_older_one_holds_none(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    parameters(FOUND).save(path)
    found = IdentifiedParameters.load(path).terms
    assert found is not None
    assert np.array_equal(found.values, FOUND.values)
    assert np.array_equal(found.covariance, FOUND.covariance)
    assert (found.found, found.logs, found.digests) == (FOUND.found, FOUND.logs, FOUND.digests)
    parameters(None).save(path)
    assert "suspension" not in path.read_text(encoding="utf-8")
    assert IdentifiedParameters.load(path).terms is None


def test_a_file_with_terms_that_make_no_sense_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    parameters(FOUND).save(path)
    for old, new in (("value = 1600.0", "value = nan"), ("[9.0,", "[-9.0,")):
        text = path.read_text(encoding="utf-8")
        assert old in text
        (tmp_path / "bad.toml").write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(ParametersFileError, match=re.escape("bad.toml")):
            IdentifiedParameters.load(tmp_path / "bad.toml")


def test_a_rig_gets_them() -> None:
    physics = load_rig("virtual").physics
    found = parameters(FOUND).applied_to(physics)
    assert found.hardening_per_m2 == (1600.0, 0.0)
    assert found.damping_growth_s_per_m == (1.06, 0.0)
    assert parameters(None).applied_to(physics).suspension_is_linear
    assert moved_term(found, TERMS[3], 0.5).damping_growth_s_per_m == (1.06, 0.5)


def test_independent_errors_make_up_the_covariance_and_a_gain_enters_by_its_power() -> None:
    shifts = FOUND.shifts
    assert list(shifts) == [ErrorLabel("suspension", TERMS[0]), ErrorLabel("suspension", TERMS[2])]
    assert np.allclose(sum(np.outer(s, s) for s in shifts.values()), COVARIANCE, rtol=1e-12, atol=1e-15)
    errors = FOUND.errors((1e-3, 2e-3))
    assert np.allclose(errors[ErrorLabel("gain", "x")], [-3.2, 0.0, -1.06e-3, 0.0])
    assert not np.any(errors[ErrorLabel("gain", "y")])
