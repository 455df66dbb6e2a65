"""Locks that open at another instant than their message states, in releases of a rig simulated for these tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pendulum_world import World

from identification import NotIdentifiable, fit_release
from identification.release_check import ReleaseRows, check_releases
from rig_configs import IdentifiedParameters, Rig, load_rig

AT_D = 3.3
ZERO_STD_RAD = float(np.radians(0.05))
LATE = [(5e-3, 5e-3), (-2e-3, 9e-3)]
SHARE = np.array([1e-4, 1e-4, 2e-3, 2e-3, 4e-3, 4e-3, 1e-3])
"""Relative standard uncertainties of k1, k2, ζ1, ζ2, c3, c4, S_P."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("virtual")


def identified(rig: Rig) -> IdentifiedParameters:
    true = rig.physics.identified()
    return IdentifiedParameters(true, np.diag(np.square(SHARE * np.array(list(true.values())))))


@pytest.mark.parametrize("late_s", LATE)
def test_the_instants_at_which_the_locks_open_are_estimated_with_the_damping(late_s: tuple[float, float]) -> None:
    world = World()
    fit, true = fit_release(world.release(AT_D, 1, late_s), world.knowledge, ZERO_STD_RAD), world.physics.identified()
    assert fit.chi2_per_dof < 1.3
    assert fit.friction is None
    for name, value in fit.values.items():
        assert abs(value - true[name]) < 4 * fit.std[name] < 0.01 * value

    for opening, true_s in zip(fit.openings, late_s, strict=True):
        assert abs(opening.late_s - true_s) < 4 * opening.std_s < 4e-3
        assert not opening.unusual
    assert not any("opened" in warning for warning in fit.warnings)


def test_a_lock_that_opens_later_than_the_rig_file_allows_is_named() -> None:
    world = World()
    fit = fit_release(world.release(AT_D, 3, (0.018, 0.0)), world.knowledge, ZERO_STD_RAD)
    assert [each.unusual for each in fit.openings] == [True, False]
    (warning,) = (text for text in fit.warnings if "opened" in text)
    assert "lock A opened 18" in warning
    assert "release_std_s" in warning


def checked(rig: Rig, late_s: tuple[float, float]) -> ReleaseRows:
    (rows,) = check_releases([World().release(AT_D, 4, late_s)], rig, identified(rig))
    return rows


@pytest.mark.parametrize("late_s", [(5e-3, 5e-3), (5e-3, 0.0), (0.018, 0.018)])
def test_a_validation_follows_locks_that_open_late(rig: Rig, late_s: tuple[float, float]) -> None:
    rows = checked(rig, late_s)
    assert rows.followed
    assert bool(rows.remark) == (max(late_s) > 0.015)
    by = rows.by_parameter
    total = rows.own + by @ identified(rig).own_covariance @ by.T
    total = total + sum(np.outer(shift, shift) for shift in rows.shared.values())
    chi2 = float(rows.values @ np.linalg.solve(total, rows.values))
    assert chi2 < len(rows.values) + 5 * np.sqrt(2 * len(rows.values))


def test_a_validation_names_a_lock_that_opens_late(rig: Rig) -> None:
    assert "lock B opened 18" in checked(rig, (0.0, 0.018)).remark


def test_the_rig_file_states_how_late_a_lock_may_open(rig: Rig) -> None:
    exact = rig.model_copy(update={"pendulums": rig.pendulums.model_copy(update={"release_std_s": 1e-3})})
    assert "lock A opened 5" in checked(exact, (5e-3, 0.0)).remark


def test_a_release_with_one_pendulum_that_stays_locked_is_refused_at_once() -> None:
    world = World()
    run = world.release(AT_D, 5, record_s=2.0)
    angle = run.angle_rad.copy()
    angle[:, 0] = angle[0, 0]
    with pytest.raises(NotIdentifiable, match=r"A moves by 0° and B by .*°; a lock did not open"):
        fit_release(replace(run, angle_rad=angle), world.knowledge, ZERO_STD_RAD)
