"""Masses that are uncertain: they are no dry friction, and damping is known as well as they leave it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st
from synthetic import Campaign

from identification import fit_release
from identification.joint.shared_friction import friction_messages
from identification.pendulums.friction import Friction
from identification.pendulums.open_friction import OpenFriction, pooled, together
from identification.pendulums.suspension_knowledge import Knowledge
from rig_configs.known import KnownSource

MASS = "pendulums.a.mass_kg"
UNIT = np.array([1e-3, 1e-3, 1e-6, 1e-6, 1e-9, 1e-9])
SOURCE = KnownSource(MASS, 1e-5, "kg", {MASS: 1e-5})


def answers_of(shift: float, seed: int, count: int = 3) -> list[OpenFriction]:
    """Some tests' answers, truth 0, taken with a mass that is `shift` standard uncertainties too small."""
    rng, found = np.random.default_rng(seed), list[OpenFriction]()
    for _ in range(count):
        root = 1e-2 * rng.standard_normal((6, 6))
        slope = 30.0 * np.linalg.norm(root) * rng.standard_normal(6) / 1e-5
        values = (root @ rng.standard_normal(6) - slope * shift * 1e-5) * UNIT
        covariance = root @ root.T + 1e-8 * np.eye(6)
        found.append(OpenFriction(values, covariance * np.outer(UNIT, UNIT), {MASS: slope * UNIT}))
    return found


@given(st.integers(0, 1000), st.floats(-2, 2))
def test_a_mass_that_is_off_is_no_friction(seed: int, shift: float) -> None:
    tests = answers_of(shift, seed)
    whole = pooled(tests, [SOURCE]).covering([SOURCE])
    white = np.linalg.solve(np.linalg.cholesky(whole.covariance / np.outer(UNIT, UNIT)), whole.values / UNIT)
    assert white @ white < 45.0  # χ² of six that chance exceeds once in 2e7
    shared = together(tests, None, [SOURCE])
    assert np.all(np.abs(shared.friction) < 6 * np.sqrt(np.diag(shared.covariance)))
    if abs(shift) > 1:
        naive = together(tests)
        assert np.max(np.abs(naive.friction / np.sqrt(np.diag(naive.covariance)))) > np.max(
            np.abs(shared.friction / np.sqrt(np.diag(shared.covariance)))
        )


@given(st.integers(0, 1000))
def test_pooling_with_sources_is_least_squares_with_the_mass_as_an_unknown(seed: int) -> None:
    tests = answers_of(1.0, seed)
    rows, aims = [np.r_[np.zeros(6), 1.0][None]], [np.zeros(1)]
    for test in tests:
        root = np.linalg.inv(np.linalg.cholesky(test.covariance / np.outer(UNIT, UNIT)))
        rows.append(root @ np.column_stack([np.eye(6), -test.slope(MASS) / UNIT * 1e-5]))
        aims.append(root @ (test.values / UNIT))
    design, aim = np.vstack(rows), np.concatenate(aims)
    exact = np.linalg.lstsq(design, aim)[0][:6]
    covariance = np.linalg.inv(design.T @ design)[:6, :6]
    whole = pooled(tests, [SOURCE])
    std = np.sqrt(np.diag(covariance))
    assert np.abs(whole.values / UNIT - exact) == pytest.approx(np.zeros(6), abs=1e-3 * float(std.max()))
    found = whole.covering([SOURCE]).covariance / np.outer(UNIT, UNIT)
    assert np.sqrt(np.diag(found)) == pytest.approx(std, rel=1e-2)


def test_friction_that_a_mass_explains_is_not_reported() -> None:
    friction = np.r_[0.0, 0.0, 8.0, 0.0, 0.0, 0.0] * UNIT
    sharp = 0.25 * np.diag(UNIT**2)
    slope = {MASS: np.r_[0.0, 0.0, 8.0, 0.0, 0.0, 0.0] * UNIT / 1e-5}
    pair = [OpenFriction(friction, sharp, slope) for _ in range(2)]
    assert friction_messages(together(pair)) != []
    assert friction_messages(together(pair, None, [SOURCE])) == []
    assert Friction.sure(pooled(pair)) is not None
    assert Friction.sure(pooled(pair, [SOURCE]).covering([SOURCE])) is None


def known(campaign: Campaign) -> Knowledge:
    """What the other tests find where the rig file's mass of A is not the true one: frequencies and the moment."""
    true, file = campaign.truth, campaign.rig.physics
    grown = file.total_mass_kg / true.total_mass_kg
    found = {n: true.identified()[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    found = {n: v * (grown if n.startswith("k") else 1.0) for n, v in found.items()}
    moments = [p.a.first_moment_kg_m - p.b.first_moment_kg_m for p in (true, file)]
    found["SP_kg_m"] = (found["SP_kg_m"] + moments[0]) * grown - moments[1]
    return Knowledge.nominal(file).with_found(found, {n: 1e-3 * v for n, v in found.items()})


@pytest.mark.parametrize("point", ["E"])
def test_a_release_finds_a_mass_that_is_off_within_its_uncertainty(point: str) -> None:
    mass = 0.075 * (1 - 1.5e-3)
    campaign = Campaign(7, {"virtual.truth.pendulums.a.mass_kg": mass}, clock_rate_std=0.0)
    run, knowledge = campaign.point(point), known(campaign)
    stated = dataclasses.replace(knowledge, number_std={MASS: 0.075e-3, "pendulums.b.mass_kg": 0.075e-3})
    fit = fit_release(run, stated, np.radians(0.05))
    assert fit.friction is None
    assert set(fit.number_std) == set(stated.number_std)
    true = campaign.truth.identified()
    for name, value in fit.values.items():
        assert abs(value - true[name]) < 3 * fit.std[name] < 0.03 * value
