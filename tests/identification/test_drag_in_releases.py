"""A torque that grows with the square of the speed: by a spin-down either drag or contact friction, by a release one.

The recordings are of benchmarks.worlds, whose equations are not the suite's.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.worlds.recording import record
from benchmarks.worlds.world import Spread, World, draw_world, with_effect
from daq.signals.run import Run
from identification import identify
from identification.identify import Identification
from identification.release_check import ReleaseRows, check_releases
from rig_configs import IdentifiedParameters
from rig_configs.drag import LABELS, Drag
from rig_configs.known import DRAG
from tests.effort import THOROUGH

SEED = 1003
SHARE = {
    "k1_N_per_m": 1e-4,
    "k2_N_per_m": 1e-4,
    "zeta1": 1e-3,
    "zeta2": 1e-3,
    "c3_Nms_per_rad": 1e-3,
    "c4_Nms_per_rad": 1e-3,
    "SP_kg_m": 1e-3,
}


def identified(world: World, drag: Drag | None) -> IdentifiedParameters:
    """What an identification would have found, with its errors drawn."""
    true = world.truth
    std = np.array([SHARE[name] * true[name] for name in true])
    drawn = std * np.random.default_rng(1).standard_normal(len(std))
    values = {name: true[name] + float(error) for name, error in zip(true, drawn, strict=True)}
    return IdentifiedParameters(values, np.diag(std**2), drag.table if drag else {})


def chi2_each(rows: ReleaseRows, found: IdentifiedParameters) -> float:
    """Of the rows, with everything that is uncertain, over their number."""
    total = rows.own + rows.by_parameter @ found.own_covariance @ rows.by_parameter.T
    total = total + sum(np.outer(shift, shift) for shift in rows.shared.values())
    return float(rows.values @ np.linalg.solve(total, rows.values)) / len(rows.values)


@pytest.fixture(scope="module")
def dragged() -> World:
    return draw_world(SEED, Spread(), with_effect("drag"))


@pytest.fixture(scope="module")
def before(dragged: World) -> list[Run]:
    """What is recorded before the releases."""
    return [record(dragged, SEED, test) for test in ("ring-down-x", "ring-down-y", "spin-down", "run-up")]


@pytest.fixture(scope="module")
def alone(dragged: World, before: list[Run]) -> Identification:
    """What is identified before the releases."""
    return identify(before, dragged.rig)


@pytest.fixture(scope="module")
def release_e(dragged: World) -> Run:
    return record(dragged, SEED, "point-E")


@pytest.fixture(scope="module")
def drag(dragged: World) -> Drag:
    true = np.array([dragged.mechanics.a.drag_Nms2_per_rad2, dragged.mechanics.b.drag_Nms2_per_rad2])
    return Drag(true * np.array([1.08, 0.95]), np.diag((0.08 * true) ** 2), undecided=True)


def test_a_release_with_drag_follows_it_and_decides_for_it(dragged: World, drag: Drag, release_e: Run) -> None:
    found = identified(dragged, drag)
    (rows,) = check_releases([release_e], dragged.rig, found)
    assert rows.followed
    assert rows.reading == "drag"
    assert chi2_each(rows, found) < 2
    assert all(np.linalg.norm(rows.shared[label]) > 1 for label in LABELS)
    without = identified(dragged, None)
    (bare,) = check_releases([release_e], dragged.rig, without)
    assert chi2_each(bare, without) > 10
    assert bare.reading == ""
    if bare.followed:
        assert set(DRAG) <= set(bare.by_number)


def test_a_release_with_contact_friction_decides_for_that() -> None:
    world = draw_world(SEED, Spread(), with_effect("contact=0.05"))
    true = np.array([world.mechanics.a.contact_kg_m2, world.mechanics.b.contact_kg_m2])
    found = identified(world, Drag(true * 1.05, np.diag((0.1 * true) ** 2), undecided=True))
    (rows,) = check_releases([record(world, SEED, "point-E")], world.rig, found)
    assert rows.followed
    assert rows.reading == "contact"


def test_a_spin_down_keeps_what_it_finds_as_one_thing(alone: Identification, drag: Drag) -> None:
    found = alone.parameters
    kept = Drag.of(found.provenance)
    assert kept is not None
    assert kept.undecided
    true = drag.values / np.array([1.08, 0.95])
    std = np.sqrt(np.diag(kept.covariance))
    assert np.all(np.abs(kept.values - true) < 3 * std)
    assert np.all(std < 0.3 * true)
    c3 = list(found.values).index("c3_Nms_per_rad")
    part = np.array([found.shared[label][c3] for label in LABELS])
    assert 0.3 < np.linalg.norm(part) / found.std["c3_Nms_per_rad"] < 1  # c3 depends on the drag, but not only on it
    assert np.linalg.eigvalsh(found.own_covariance)[0] >= 0


def test_an_error_of_masses_and_lengths_is_no_part_of_what_damping_and_drag_share() -> None:
    """Taken from all of c's error, the shared part was longer than c's own, and every release blamed c3."""
    world = draw_world(SEED, Spread.weighed(), with_effect("drag"))
    tests = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
    found = identify([record(world, SEED, test) for test in tests], world.rig).parameters
    own = found.covariance - sum(np.outer(shift, shift) for shift in found.shared.values())
    assert found.std["c3_Nms_per_rad"] > 1e-3 * found.values["c3_Nms_per_rad"]  # most of it by the lengths
    assert np.linalg.eigvalsh(own / np.outer(*2 * [[*found.std.values()]]))[0] > -1e-6
    kept = Drag.of(found.provenance)
    assert kept is not None
    share = kept.by_number["pendulums.a.length_m"] / kept.values * world.rig.physics.a.length_m
    assert share == pytest.approx([2.0, 0.0], abs=0.1)  # torques go with m R²


def test_releases_and_a_spin_down_find_the_damping_in_addition_to_the_drag(
    dragged: World, before: list[Run], alone: Identification, release_e: Run
) -> None:
    """The torque found by the spin-down then does not count as dry friction, and the releases are not left out."""
    releases = [record(dragged, SEED, "point-D"), release_e]
    found = identify([*before, *releases], dragged.rig, earlier=alone)
    assert {"point-D", "point-E", "spin-down"} <= {estimate.test for estimate in found.estimates}
    kept = Drag.of(found.parameters.provenance)
    assert kept is not None
    assert not kept.undecided
    assert max(found.parameters.provenance["friction"]["values"].values()) < 1e-9
    for name in ("c3_Nms_per_rad", "c4_Nms_per_rad"):
        off = found.parameters.values[name] - dragged.truth[name]
        assert abs(off) < 3 * found.parameters.std[name], name
        assert found.parameters.std[name] < 0.75 * alone.parameters.std[name], name


def test_friction_that_one_release_needs_is_in_all_of_them() -> None:
    """Without it A, B and C are followed, too, at masses, zeros and damping that are many standard deviations off."""
    world = draw_world(SEED, Spread(), with_effect("contact"))
    runs = [record(world, SEED, f"point-{name}") for name in ("BDE" if THOROUGH else "BE")]
    rows = check_releases(runs, world.rig, identified(world, None))
    true = np.array([world.mechanics.a.contact_kg_m2, world.mechanics.b.contact_kg_m2])
    for each, run in zip(rows, runs, strict=True):
        assert "only with dry friction" in each.remark, run.test
        speed2 = each.by_number["friction.a_kg_m2"][-2] / each.by_number["friction.a_Nm"][-2]
        torque = [each.values[-2 + i] / -each.by_number[f"friction.{name}_Nm"][-2 + i] for i, name in enumerate("ab")]
        assert torque == pytest.approx(true * speed2, rel=0.25), run.test
