"""The terms that ring-downs find, chosen and shared with the values of the same test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds.recording import record
from benchmarks.worlds.world import draw_world, with_effect
from identification import identify
from identification.estimate import Estimate
from identification.ring_down.direction_terms import DirectionTerms
from identification.suspension_terms import ChosenTerms, sharing_terms
from rig_configs.error_label import ErrorLabel
from rig_configs.suspension_terms import TERMS, SuspensionTerms

RNG = np.random.default_rng(3)
ROOT = RNG.standard_normal((4, 4)) * np.array([[1e-5], [1e-6], [3.0], [1e-2]])
OWN = DirectionTerms(2, np.array([1600.0, 0.3]), ROOT @ ROOT.T, (True, True), 2.5e-3)
K = 37000.0


def estimate() -> Estimate:
    scale = np.array([2 * K, 1.0])
    covariance = np.zeros((4, 4))
    covariance[np.ix_([1, 3], [1, 3])] = np.outer(scale, scale) * OWN.covariance[:2, :2]
    covariance[[0, 2], [0, 2]] = 0.01, 1e-12
    names = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")
    return Estimate(
        "ring-down-y",
        ("y.mcap",),
        names,
        np.array([2500.0, K, 0.02, 0.02]),
        covariance,
        {ErrorLabel("clock"): np.ones(4) * 1e-9},
        "two coupled decays, separable least squares",
        {},
        {
            TERMS[1 + 2 * i]: np.array([0.0, 2 * K * OWN.covariance[0, 2 + i], 0.0, OWN.covariance[1, 2 + i]])
            for i in range(2)
        },
    )


def chosen(own: DirectionTerms = OWN) -> ChosenTerms:
    covariance = np.zeros((4, 4))
    covariance[np.ix_([1, 3], [1, 3])] = own.covariance[2:, 2:]
    terms = SuspensionTerms(np.array([0.0, own.values[0], 0.0, own.values[1]]), covariance, (TERMS[1], TERMS[3]))
    return ChosenTerms(terms, {2: (("y.mcap",), own)})


def test_what_a_test_shares_with_its_terms_takes_nothing_from_its_uncertainty() -> None:
    """Own and shared errors together are as before, and their covariance with the terms is that of the fit."""
    before, picked = estimate(), chosen()
    (after,) = sharing_terms([before], picked)
    assert np.allclose(after.total_covariance, before.total_covariance, rtol=1e-12)
    assert np.linalg.eigvalsh(after.covariance / np.sqrt(np.outer(*[np.diag(before.covariance)] * 2)))[0] > -1e-12
    shifts = picked.terms.shifts
    together = sum(np.outer(after.shared[label], shift) for label, shift in shifts.items())
    assert np.allclose(together[1, [1, 3]], 2 * K * OWN.covariance[0, 2:], rtol=1e-9)
    assert np.allclose(together[3, [1, 3]], OWN.covariance[1, 2:], rtol=1e-9)
    assert not np.any(together[[0, 2]])


def test_terms_of_another_ring_down_take_the_place_of_those_before() -> None:
    (first,) = sharing_terms([estimate()], chosen())
    other = ChosenTerms(chosen().terms, {2: (("better.mcap",), replace(OWN, largest_m=3e-3))})
    (after,) = sharing_terms([first], other)
    assert list(after.shared) == [ErrorLabel("clock")]
    assert np.allclose(after.covariance, estimate().covariance, rtol=1e-12)


@pytest.mark.parametrize("effect", ["quadratic", "cubic=0.03"])
def test_ring_downs_of_an_independent_rig(effect: str) -> None:
    """Both directions' terms come with the parameters, within their uncertainty and the lasers' gains."""
    world = draw_world(7, None, with_effect(effect))
    runs = [record(world, 7, test) for test in ("ring-down-x", "ring-down-y")]
    found = identify(runs, world.rig).parameters
    terms = found.terms
    assert terms is not None
    at = [2, 3] if effect == "quadratic" else [0, 1]
    assert terms.found == tuple(TERMS[i] for i in at)
    true = np.r_[world.mechanics.hardening_per_m2, world.mechanics.quadratic_s_per_m]
    std = np.sqrt(sum(shift**2 for shift in terms.errors(world.rig.roles.gain_stds).values()))
    assert np.all(np.abs(terms.values - true)[at] < 4 * std[at])
    assert np.all(std[at] < 0.05 * true[at])
    assert {label for label in found.shared if label.kind == "suspension"} == {
        ErrorLabel("suspension", TERMS[i]) for i in at
    }
    left = [i for i in range(4) if i not in at]
    assert not np.any(terms.covariance[left])


def test_a_rig_without_terms_has_no_table() -> None:
    world = draw_world(7)
    found = identify([record(world, 7, test) for test in ("ring-down-x", "ring-down-y")], world.rig).parameters
    assert found.terms is None
    assert not [label for label in found.shared if label.kind == "suspension"]
