"""The map against single points: same numbers, honest bounds, every point served."""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.errors import NoBalancedState, OutsideDomain
from dynamics.stability.floquet import METHODS, floquet_multipliers
from dynamics.stability.floquet.quick_eigenvalues import eigenvalues
from dynamics.stability.stability_map import stability_map
from tests.dynamics.nominal import rig
from tests.effort import thorough

MASS = 7.27
K1 = MASS * (2 * math.pi * 3) ** 2
NOMINAL = RotorParameters(
    7.0, 0.12, 0.02117, Pendulum(0.075, 0.054, 0.001), Pendulum(0.075, 0.054, 0.001), K1, K1, 0.02, 0.02
)


def single(parameters: RotorParameters, speed_ratio: float, stiffness_ratio: float) -> float:
    """The multiplier of one point by an implicit method with many steps."""
    p = dataclasses.replace(parameters, k2_N_per_m=stiffness_ratio * parameters.k1_N_per_m)
    matrix = type_one(p, *balanced_angles(p)[0], p.speed_rad_s(speed_ratio))
    steps = math.ceil(40 + 20 * math.sqrt(max(1, stiffness_ratio)) / speed_ratio)
    return float(np.max(np.abs(np.linalg.eigvals(METHODS["implicit"].monodromy(matrix, steps))))) ** 2


def test_known_points() -> None:
    found = stability_map(NOMINAL, np.array([0.83, 1.6, 2.6, 3.3, 5.8]), np.array([14.9]), 1e-9)
    assert found.multiplier_max[0] == pytest.approx([1.361992, 0.937055, 0.974796, 1.373347, 0.978556], abs=6e-7)
    assert found.stable.tolist() == [[False, True, True, False, True]]


@pytest.mark.parametrize(
    ("zeta", "accuracy"),
    [
        pytest.param(zeta, accuracy, marks=() if i == j else thorough)
        for i, zeta in enumerate([0.0, 0.02, 0.1])
        for j, accuracy in enumerate([1e-8, 1e-11, 1e-3])
    ],
)
def test_bounds_hold_at_every_point(zeta: float, accuracy: float) -> None:
    p = dataclasses.replace(NOMINAL, zeta1=zeta, zeta2=zeta)
    speeds, stiffness = np.geomspace(0.1, 8, 23), np.linspace(1, 16, 11)
    found = stability_map(p, speeds, stiffness, accuracy)
    truth = np.array([[single(p, s, k) for s in speeds] for k in stiffness])
    assert found.multiplier_max.shape == found.error_estimate.shape == (11, 23)
    assert np.all(np.abs(found.multiplier_max - truth) <= found.error_estimate + 2e-12 * np.maximum(1, truth))
    assert np.all(found.error_estimate <= accuracy * np.maximum(1, truth) * 1.01)


def test_the_bound_is_not_idle() -> None:
    """A coarse map must differ from a fine one, else the test above proves nothing."""
    speeds, stiffness = np.linspace(0.4, 4, 30), np.array([14.9])
    coarse, fine = (stability_map(NOMINAL, speeds, stiffness, a) for a in (0.1, 1e-12))
    assert np.max(np.abs(coarse.multiplier_max - fine.multiplier_max)) > 1e-9


def test_points_that_explicit_steps_cannot_serve_are_served_one_by_one() -> None:
    stiff = dataclasses.replace(
        NOMINAL, a=Pendulum(0.075, 0.054, 50.0), b=Pendulum(0.075, 0.054, 50.0), zeta1=0.5, zeta2=0.5
    )
    found = stability_map(stiff, np.array([0.5, 2.0]), np.array([4.0, 9.0]))
    assert "point by point: 4" in found.method
    truth = [[single(stiff, s, k) for s in (0.5, 2.0)] for k in (4.0, 9.0)]
    assert found.multiplier_max == pytest.approx(np.array(truth), abs=1e-8)


def test_slow_points_are_served() -> None:
    found = stability_map(NOMINAL, np.array([0.002, 0.02]), np.array([14.9]))
    p = dataclasses.replace(NOMINAL, k2_N_per_m=14.9 * K1)
    for j, ratio in enumerate((0.002, 0.02)):
        one = floquet_multipliers(type_one(p, *balanced_angles(p)[0], p.speed_rad_s(ratio)), method="magnus")
        assert abs(found.multiplier_max[0, j] - one.largest) <= 2e-8


def test_one_pendulum_alone() -> None:
    """S_A = S_P and no B: balanced at 180°, a multiplier of its own kind but a map all the same."""
    p = dataclasses.replace(NOMINAL, a=Pendulum(0.12, 0.02117, 0.001), b=Pendulum.absent())
    found = stability_map(p, np.array([1.6]), np.array([1.0, 4.0]))
    assert np.all(np.isfinite(found.multiplier_max))
    assert found.multiplier_max[1, 0] == pytest.approx(single(p, 1.6, 4.0), abs=1e-8)


def test_exact_border_of_balance() -> None:
    p = dataclasses.replace(NOMINAL, imbalance_radius_m=2 * 0.075 * 0.054 / 0.12)
    for damping in (0.001, 0.0):
        q = dataclasses.replace(p, a=Pendulum(0.075, 0.054, damping), b=Pendulum(0.075, 0.054, damping))
        found = stability_map(q, np.array([1.6, 6.0]), np.array([4.0]), 1e-6)
        assert np.all(found.multiplier_max >= 1 - 1e-6)


def test_progress_rises_to_one_and_many_threads_may_ask() -> None:
    heard: list[float] = []
    speeds, stiffness = np.linspace(0.3, 6, 40), np.linspace(1, 16, 40)
    alone = stability_map(NOMINAL, speeds, stiffness, 1e-6, heard.append)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda _: stability_map(NOMINAL, speeds, stiffness, 1e-6), range(4)))
    for one in together:
        assert np.array_equal(one.multiplier_max, alone.multiplier_max)


@pytest.mark.parametrize(
    ("speeds", "stiffness", "accuracy"),
    [
        ([0.0, 1.0], [1.0], 1e-6),
        ([1.0], [-1.0], 1e-6),
        ([math.nan], [1.0], 1e-6),
        ([1.0], [1.0], 1e-15),
        ([1.0, 1e200], [1.0], 1e-6),
        ([1.0], [1e-300, 1.0], 1e-6),
    ],
)
def test_ratios_outside_the_domain_are_refused(speeds: list[float], stiffness: list[float], accuracy: float) -> None:
    with pytest.raises(OutsideDomain, match=r"above 0|accuracy"):
        stability_map(NOMINAL, np.array(speeds), np.array(stiffness), accuracy)


def test_without_a_balanced_state_or_with_gravity_there_is_no_map() -> None:
    with pytest.raises(NoBalancedState, match="balanced state"):
        stability_map(dataclasses.replace(NOMINAL, imbalance_radius_m=0.2), np.array([1.0]), np.array([2.0]))
    with pytest.raises(OutsideDomain, match="gravity"):
        stability_map(dataclasses.replace(NOMINAL, gravity_m_per_s2=9.81), np.array([1.0]), np.array([2.0]))


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_quick_eigenvalues_are_lapacks(seed: int, n: int) -> None:
    random = np.random.default_rng(seed)
    matrix = random.standard_normal((n, n)) * 10 ** random.uniform(-2, 2, (n, 1))
    if seed % 3 == 0:
        matrix[:, 0] = 0.0
    values = np.empty(n, complex)
    assert eigenvalues(matrix.copy(), values)
    truth = np.linalg.eigvals(matrix)
    near = np.abs(values[:, None] - truth[None, :]).min(axis=1)
    assert np.all(near <= 1e-7 * np.linalg.norm(matrix))
    assert np.sum(values) == pytest.approx(np.trace(matrix), abs=1e-12 * np.linalg.norm(matrix))
    assert np.max(np.abs(values)) == pytest.approx(np.max(np.abs(truth)), rel=1e-7)


def test_eigenvalues_of_what_is_not_a_number_are_refused() -> None:
    values = np.empty(3, complex)
    assert not eigenvalues(np.full((3, 3), np.nan), values)
    assert not eigenvalues(np.full((3, 3), np.inf), values)


def test_a_point_that_no_method_computes_to_the_accuracy_is_counted_as_missed() -> None:
    """A slow, undamped rotor on a stiff spring: the map goes on, with the bound it could reach."""
    found = stability_map(rig(zeta=0.0, damping=0.0), np.array([0.0016, 1.6]), np.array([1000.0]), 1e-12)
    assert found.multiplier_max.shape == (1, 2)
    assert np.all(np.isfinite(found.multiplier_max))
    assert np.all(np.isfinite(found.error_estimate))
    assert found.missed >= 1
    assert found.missed == np.count_nonzero(found.error_estimate > 1e-12 * np.maximum(1, found.multiplier_max))
