"""A run-up recorded after the identification: compared with it, and part of the validation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.validation import validate
from benchmarks.worlds.recording import record
from benchmarks.worlds.world import Spread, World, draw_world
from daq.signals.run import Run
from identification import Identification, identify
from identification.release_check import ReleaseRows, check_run_ups
from rig_configs.error_label import ErrorLabel

SEED = 800_000


@pytest.fixture(scope="module")
def world() -> World:
    return draw_world(SEED, Spread.weighed())


@pytest.fixture(scope="module")
def before(world: World) -> list[Run]:
    return [record(world, SEED, test) for test in ("ring-down-x", "ring-down-y", "run-up")]


@pytest.fixture(scope="module")
def found(world: World, before: list[Run]) -> Identification:
    return identify(before, world.rig)


def later(world: World, seed: int) -> Run:
    return replace(record(world, seed, "run-up"), source="later/run-up-2.mcap")


def compared(world: World, run: Run, found: Identification) -> ReleaseRows:
    (rows,) = check_run_ups([run], world.rig, found.parameters)
    return rows


def test_a_run_up_that_has_identified_is_not_compared(world: World, before: list[Run], found: Identification) -> None:
    assert check_run_ups(before, world.rig, found.parameters) == []
    rows = compared(world, later(world, SEED + 1), found)
    assert rows.point == "run-up"
    assert rows.rows == ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")


def test_differences_are_as_large_as_their_covariance_has_them(world: World, found: Identification) -> None:
    """What both share counts once: a mass that is off moves k of both run-ups alike, clocks are each log's own."""
    rows = compared(world, later(world, SEED + 1), found)
    assert np.all(np.abs(rows.shared[ErrorLabel("known", "rotor.mass_kg")][:2]) < 1e-6 * np.array([2500.0, 38000.0]))
    shared = np.array(list(rows.shared.values()))
    total = rows.own + rows.by_parameter @ found.parameters.own_covariance @ rows.by_parameter.T + shared.T @ shared
    chi2 = float(rows.values @ np.linalg.solve(total, rows.values))
    assert 0.4 < chi2 < 15.1  # of 5 degrees of freedom all but 1 % at either end


@pytest.mark.parametrize(("by", "passes"), [(0.0, True), (12.0, False)])
def test_damping_that_has_changed_since_fails_the_validation(
    world: World, found: Identification, by: float, passes: bool
) -> None:
    changed = world.changed("zeta1", by * found.parameters.std["zeta1"])
    rows = compared(world, later(changed, SEED + 2), found)
    judged = validate([], world.rig, found.parameters, releases=[rows])
    assert judged.agreement is not None
    assert judged.agreement.passed is passes
    assert ("zeta1" in judged.agreement.significant_causes[:1]) is not passes
    assert "run-up" in judged.agreement.points
