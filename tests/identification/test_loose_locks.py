"""A pendulum that moves in its closed lock is named, and what depends on its angle is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pendulum_world import World, with_loose_lock

from daq.signals.run import Run
from identification import NotIdentifiable, fit_release, identify
from identification.locked_pendulums import loose_locks
from rig_configs import load_rig


@pytest.fixture(scope="module")
def release() -> Run:
    return World().release(3.3, 1, record_s=1.0)


def as_test(run: Run, test: str) -> Run:
    """The locked stretch of a run, as the recording of another test."""
    locked = run.angle_time_s < 2.9
    return replace(run, test=test, releases=(), angle_time_s=run.angle_time_s[locked], angle_rad=run.angle_rad[locked])


@pytest.mark.parametrize(("pendulum", "name"), [(0, "A"), (1, "B")])
def test_the_pendulum_its_angle_and_the_instant_are_named(release: Run, pendulum: int, name: str) -> None:
    (found,) = loose_locks(with_loose_lock(as_test(release, "run-up"), pendulum, 8.0, 1.5))
    assert found.pendulum == name
    assert found.moved_deg == pytest.approx(8.0, abs=0.2)
    assert found.at_s == pytest.approx(1.5, abs=0.2)


def test_locked_pendulums_and_single_wrong_readings_are_not_named(release: Run) -> None:
    run = as_test(release, "run-up")
    assert loose_locks(run) == []
    angle = run.angle_rad.copy()
    angle[::500, 0] += 1.0
    assert loose_locks(replace(run, angle_rad=angle)) == []


def test_a_run_up_with_a_loose_lock_is_left_out(release: Run) -> None:
    with pytest.raises(NotIdentifiable, match=r"run-up left out: .*pendulum A moves by 8\.\d° from 1\.5 s on"):
        identify([with_loose_lock(as_test(release, "run-up"), 0, 8.0, 1.5)], load_rig("virtual"))


def test_a_release_with_a_loose_lock_is_refused(release: Run) -> None:
    with pytest.raises(NotIdentifiable, match=r"pendulum B moves by 8\.\d° from 1\.5 s on"):
        fit_release(with_loose_lock(release, 1, 8.0, 1.5), World().knowledge, float(np.radians(0.05)))
