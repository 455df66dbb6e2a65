"""Releases of a bent rig: their derivatives keep the model's exact symmetry, and they agree with what is true."""

from __future__ import annotations

import numpy as np
import pytest

from analysis import validate
from benchmarks.worlds import Effects, World, draw_world, record
from identification.release_check.check import ReleaseRows, check_releases
from rig_configs import IdentifiedParameters
from rig_configs.slow_roll import SlowRoll

SEED, POINTS = 1019, "ACDE"  # a bow of 100 µm, 20° from the imbalance


@pytest.fixture(scope="module")
def world() -> World:
    return draw_world(SEED, effects=Effects(bow_m=1e-4))


@pytest.fixture(scope="module")
def identified(world: World) -> IdentifiedParameters:
    bow = world.mechanics.bow_m * np.exp(1j * world.mechanics.bow_rad)
    roll = SlowRoll(0j, 0j, complex(bow), np.diag([0.0] * 4 + [1e-14] * 2), (0.5, 0.5))
    covariance = np.diag([(1e-4 * value) ** 2 for value in world.truth.values()])
    angle = (float(np.degrees(world.axis_rad)), 0.01)
    return IdentifiedParameters(world.truth, covariance, axis_angle_deg=angle, slow_roll=roll)


@pytest.fixture(scope="module")
def releases(world: World, identified: IdentifiedParameters) -> list[ReleaseRows]:
    return check_releases([record(world, SEED, f"point-{name}") for name in POINTS], world.rig, identified)


def test_lengths_moments_bow_and_dampings_together_move_no_angle(
    world: World, identified: IdentifiedParameters, releases: list[ReleaseRows]
) -> None:
    """R → λR, S_P → λS_P, b → λb, c → λ²c scales the orbit alone. One part of it by 1 % is hundreds of deviations."""
    physics, roll = world.rig.physics, identified.slow_roll
    assert roll is not None
    for release in releases:
        by = dict(zip(release.parameters, release.by_parameter.T, strict=True))
        lengths = sum(
            release.by_number[f"pendulums.{n}.length_m"] * p.length_m for n, p in (("a", physics.a), ("b", physics.b))
        )
        bow = (
            -release.by_slow_roll["bow along"] * roll.bow_m.real - release.by_slow_roll["bow across"] * roll.bow_m.imag
        )
        damping = 2 * sum(by[name] * world.truth[name] for name in ("c3_Nms_per_rad", "c4_Nms_per_rad"))
        parts = np.array([lengths, by["SP_kg_m"] * world.truth["SP_kg_m"], bow, damping]) * 0.01
        assert np.linalg.norm(parts, axis=1).min() > 20
        assert np.linalg.norm(parts.sum(axis=0)) < 1, release.point


def test_releases_agree_with_the_truth(
    world: World, identified: IdentifiedParameters, releases: list[ReleaseRows]
) -> None:
    runs = [record(world, SEED, f"point-{name}") for name in POINTS]
    found = validate(runs, world.rig, identified, releases=releases)
    assert found.agreement is not None
    assert found.agreement.passed, found.agreement.together
