"""Uncertainties of first mass moments and of the margins, against draws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.moment_margins import moment_margins, probability_of_region
from rig_configs import IdentifiedParameters, load_rig

_NOTHING = IdentifiedParameters({}, np.zeros((0, 0)))
_SETTINGS = ["pendulums.b.mass_kg=0.060", "pendulums.a.mass_std_kg=0.0004", "pendulums.b.length_std_m=0.0003"]


def test_without_uncertainties_there_are_none() -> None:
    found = moment_margins(load_rig("isotropic"), _NOTHING)
    assert found.std_kg_m == (0, 0, 0)
    assert found.grow_std_kg_m == found.shrink_std_kg_m == 0


def test_margins_spread_as_draws_do() -> None:
    rig = load_rig("isotropic", settings=[*_SETTINGS, "imbalance.radius_std_m=0.0002"])
    found = moment_margins(rig, _NOTHING)
    rng, n = np.random.default_rng(3), 200_000
    a = (0.075 + 0.0004 * rng.standard_normal(n)) * 0.054
    b = 0.060 * (0.054 + 0.0003 * rng.standard_normal(n))
    s = 0.120 * (0.02117 + 0.0002 * rng.standard_normal(n))
    assert found.std_kg_m == pytest.approx((a.std(), b.std(), s.std()), rel=0.01)
    assert found.grow_std_kg_m == pytest.approx((a + b - s).std(), rel=0.01)
    assert found.shrink_std_kg_m == pytest.approx((s - (a - b)).std(), rel=0.01)


def test_what_one_balance_weighed_is_off_together(tmp_path) -> None:
    text = (
        load_path("isotropic") + '\n[instruments.balance]\nmeasures = ["pendulums.a.mass_kg", "pendulums.b.mass_kg"]\n'
    )
    path = tmp_path / "own.toml"
    path.write_text(text + "relative_std = 0.01\n", encoding="utf-8")
    found = moment_margins(load_rig(str(path)), _NOTHING)
    each = 0.01 * 0.075 * 0.054
    assert found.std_kg_m[:2] == pytest.approx((each, each))
    assert found.grow_std_kg_m == pytest.approx(2 * each), "both too heavy: errors add"
    assert found.shrink_std_kg_m == pytest.approx(0, abs=1e-12), "and leave S_A − S_B alone"


def test_an_identified_imbalance_has_its_own_uncertainty() -> None:
    known = IdentifiedParameters({"SP_kg_m": 0.0026}, np.array([[1e-10]]))
    found = moment_margins(load_rig("isotropic", known, ["imbalance.mass_std_kg=0.05"]), known)
    assert found.moments_kg_m[2] == pytest.approx(0.0026)
    assert found.std_kg_m[2] == pytest.approx(1e-5)


def test_probability() -> None:
    assert probability_of_region(None, 1.0) == 1
    assert probability_of_region(0.0, 1.0) == pytest.approx(0.5)
    assert probability_of_region(1.0, 1.0) == pytest.approx(0.5 * (1 + math.erf(1 / math.sqrt(2))))


def load_path(name: str) -> str:
    from importlib import resources

    return resources.files("rig_configs").joinpath(f"{name}.toml").read_text(encoding="utf-8")
