"""Maps over any two numbers of a rig, and maps large enough to be interpolated, against single points."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import NoBalancedState
from dynamics.stability.floquet import floquet_multipliers
from dynamics.stability.map_plane import SAME, RigPlane, SpeedStiffnessPlane
from dynamics.stability.map_rigs import MapRigs
from dynamics.stability.stability_map import multipliers_on_grid, stability_map, stability_map_over
from tests.dynamics.nominal import rig

NOMINAL = rig()


def silent(share: float) -> None:
    assert 0.0 <= share <= 1.0


def single(parameters: RotorParameters, speed_rad_s: float) -> float:
    matrix = type_one(parameters, *balanced_angles(parameters)[0], speed_rad_s)
    return floquet_multipliers(matrix, 1e-11, "implicit").largest


def damped_and_unbalanced(radius_m: float, damping: float) -> tuple[RotorParameters, float]:
    """x: where the imbalance sits; y: the pendulums' damping. No balanced state above 67.5 mm."""
    a, b = (dataclasses.replace(p, damping_Nms_per_rad=damping) for p in (NOMINAL.a, NOMINAL.b))
    return dataclasses.replace(NOMINAL, imbalance_radius_m=radius_m, a=a, b=b), NOMINAL.speed_rad_s(1.6)


@pytest.mark.parametrize("zeta", [0.0, 0.02])
def test_an_interpolated_map_holds_its_bounds(zeta: float) -> None:
    p = dataclasses.replace(NOMINAL, zeta1=zeta, zeta2=zeta)
    speeds, stiffness = np.linspace(0.3, 7, 110), np.linspace(1, 16, 90)
    found = stability_map(p, speeds, stiffness, 1e-8)
    counts = [int(part.split()[-1]) for part in found.method.split(";")]
    assert sum(counts) == found.multiplier_max.size
    assert counts[0] > 0.6 * found.multiplier_max.size
    assert np.all(found.error_estimate <= 1e-8 * np.maximum(1, found.multiplier_max) * 1.01)
    random = np.random.default_rng(16)
    for i, j in zip(random.integers(90, size=60), random.integers(110, size=60), strict=True):
        q = dataclasses.replace(p, k2_N_per_m=float(stiffness[i]) * p.k1_N_per_m)
        truth = single(q, q.speed_rad_s(float(speeds[j])))
        assert abs(found.multiplier_max[i, j] - truth) <= found.error_estimate[i, j] + 2e-11 * max(1, truth)


def test_the_order_of_speeds_and_ratios_does_not_matter() -> None:
    random = np.random.default_rng(4)
    speeds, stiffness = random.permutation(np.linspace(0.8, 6, 80)), random.permutation(np.linspace(1, 9, 70))
    found = stability_map(NOMINAL, speeds, stiffness)
    ordered = stability_map(NOMINAL, np.sort(speeds), np.sort(stiffness))
    again = ordered.multiplier_max[np.ix_(np.argsort(np.argsort(stiffness)), np.argsort(np.argsort(speeds)))]
    assert np.array_equal(found.multiplier_max, again)


def test_any_two_numbers_against_single_points() -> None:
    plane = RigPlane(damped_and_unbalanced)
    radii, dampings = np.linspace(0.0, 0.075, 121), np.linspace(2e-4, 4e-3, 80)
    found, errors, counts = multipliers_on_grid(plane, radii, dampings, 1e-8, silent)
    assert counts[0] > 0
    there = np.array([bool(balanced_angles(damped_and_unbalanced(radius, 1e-3)[0])) for radius in radii])
    assert 0 < there.sum() < len(radii)
    assert np.array_equal(np.isnan(found), np.broadcast_to(~there, found.shape))
    random = np.random.default_rng(6)
    for i, j in zip(random.integers(80, size=40), random.choice(np.flatnonzero(there)[1:-1], 40), strict=True):
        truth = single(*damped_and_unbalanced(float(radii[j]), float(dampings[i])))
        assert abs(found[i, j] - truth) <= errors[i, j] + 2e-11 * max(1, truth)


def test_both_planes_agree_on_speed_and_stiffness() -> None:
    def at(speed_ratio: float, stiffness_ratio: float) -> tuple[RotorParameters, float]:
        p = dataclasses.replace(NOMINAL, k2_N_per_m=stiffness_ratio * NOMINAL.k1_N_per_m)
        return p, p.natural_frequencies_rad_s[0] * speed_ratio

    speeds, stiffness = np.linspace(1.2, 5, 12), np.linspace(1, 9, 9)
    general, _, _ = multipliers_on_grid(RigPlane(at, SAME, SAME), speeds, stiffness, 1e-9, silent)
    special = SpeedStiffnessPlane(NOMINAL, balanced_angles(NOMINAL)[0])
    known, _, _ = multipliers_on_grid(special, speeds, stiffness, 1e-9, silent)
    assert general == pytest.approx(known, abs=1e-13)


def test_a_function_from_two_numbers_to_a_rig_makes_a_map() -> None:
    found = stability_map_over(damped_and_unbalanced, [0.01, 0.02], 1e-3)
    assert found.columns()["x"].tolist() == [0.01, 0.02]
    for radius, multiplier in zip(found.x.tolist(), found.multiplier_max[0].tolist(), strict=True):
        assert multiplier == pytest.approx(single(*damped_and_unbalanced(radius, 1e-3)), rel=1e-8)


def test_the_numbers_of_a_point_are_those_of_the_exact_equations() -> None:
    """At the phase 0 the inverse mass matrix and the pendulums' push are those of `type_one`."""
    p = dataclasses.replace(NOMINAL, a=dataclasses.replace(NOMINAL.a, mass_kg=0.06))
    angles, speed = balanced_angles(p)[0], p.speed_rad_s(1.7)
    numbers = MapRigs.of([p], [angles], [speed]).numbers[0]
    exact = type_one(p, *angles, speed).at(0.0)
    w_xx, w_xy, w_yy = numbers[6] + numbers[7], numbers[8], numbers[6] - numbers[7]
    assert exact[4:6, :2] == pytest.approx(
        -np.array([[w_xx * p.k1_N_per_m, w_xy * p.k2_N_per_m], [w_xy * p.k1_N_per_m, w_yy * p.k2_N_per_m]])
    )
    assert exact[4:6, 2] == pytest.approx(-(speed**2) * numbers[13:15])
    assert exact[4:6, 6] == pytest.approx(speed * (numbers[9:11] - numbers[4] * numbers[13:15]))


def test_a_point_without_a_balanced_state_is_refused() -> None:
    with pytest.raises(NoBalancedState, match=r"x = 0\.2"):
        RigPlane(damped_and_unbalanced).one(0.2, 0.001)
