"""Probabilities of the ends of a release, and Wilson's interval."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.errors import AnalysisError
from analysis.release_probabilities import ReleaseDraws, drawn_rigs, end_probabilities, wilson_interval
from dynamics.errors import OutsideDomain
from rig_configs import IdentifiedParameters, load_rig
from tests.effort import cases


@pytest.mark.parametrize(
    ("count", "draws", "low", "high"),
    # R. G. Newcombe, Statistics in Medicine 17 (1998) 857-872, table I, method 3
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilsons_interval_is_the_published_one(count, draws, low, high):
    assert wilson_interval(count, draws) == pytest.approx((low, high), abs=6e-5)


def test_wilsons_interval_of_all_and_of_nonsense():
    low, high = wilson_interval(20, 20)
    assert (low, high) == pytest.approx((1 - 0.1611, 1.0), abs=6e-5)
    with pytest.raises(OutsideDomain):
        wilson_interval(3, 2)
    with pytest.raises(OutsideDomain):
        wilson_interval(1, 2, 1.0)


def test_rigs_are_drawn_by_the_covariance():
    physics = load_rig("virtual").physics
    covariance = np.array([[4e-6, 1.5e-6], [1.5e-6, 1e-6]])
    known = IdentifiedParameters({"zeta1": 0.02, "zeta2": 0.03}, covariance)
    rigs = drawn_rigs(physics, known, 4000, np.random.default_rng(1))
    drawn = np.array([(p.zeta1, p.zeta2) for p in rigs])
    assert drawn.mean(axis=0) == pytest.approx([0.02, 0.03], abs=2e-4)
    assert np.cov(drawn.T) == pytest.approx(covariance, rel=0.15)
    assert drawn_rigs(physics, IdentifiedParameters({}, np.zeros((0, 0))), 2, np.random.default_rng(1)) == [physics] * 2


def test_a_covariance_without_rigs_is_refused():
    physics = load_rig("virtual").physics
    known = IdentifiedParameters({"zeta1": -0.02}, np.array([[1e-8]]))
    with pytest.raises(AnalysisError, match="possible rigs"):
        drawn_rigs(physics, known, 2, np.random.default_rng(1))


def test_the_ends_of_a_release_are_weighed():
    physics = load_rig("virtual").physics
    known = IdentifiedParameters({"zeta1": 0.02}, np.array([[1e-8]]))
    draws = cases(4, 12)
    found = end_probabilities(physics, physics.speed_rad_s(5.8), known, ReleaseDraws(draws, play_rad=2.0, seed=2))
    assert {end.name for end in found.ends} == {"I"}
    assert len(found.ends) == 2  # so much play decides between the mirror images
    assert sum(end.count for end in found.ends) == found.draws == draws
    for end in found.ends:
        assert end.interval[0] < end.probability < end.interval[1]
    with pytest.raises(OutsideDomain):
        ReleaseDraws(0)
