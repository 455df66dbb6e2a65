"""Pendulums that move, or do not, while their locks are reported closed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.acquisition.locked_watch import LockedWatch
from daq.channels import LOCK_A_CLOSED, LOCKS_CLOSED

RATE_HZ, BLOCK = 250, 5
ZERO_STD_DEG = 0.05


def found(
    degrees: np.ndarray, flags: np.ndarray | int = LOCKS_CLOSED, watch: LockedWatch | None = None
) -> list[tuple[int, float]]:
    """Return pendulum and time of each report; `degrees` are the angles of A at 250 Hz, B stands at 180°."""
    watch = watch or LockedWatch(ZERO_STD_DEG)
    marks = np.broadcast_to(np.asarray(flags, np.uint32), degrees.shape)
    out: list[tuple[int, float]] = []
    for start in range(0, len(degrees), BLOCK):
        rows = np.arange(start, start + BLOCK)
        angles = (np.radians(degrees[rows]), np.full(BLOCK, math.pi))
        out += [(pendulum, rows[-1] / RATE_HZ) for pendulum, _ in watch.feed(rows * 4_000_000, angles, marks[rows])]
    return out


def after(seconds: float, step_deg: float, ramp_s: float = 0.0) -> np.ndarray:
    time = np.arange(10 * RATE_HZ) / RATE_HZ
    return step_deg * np.clip((time - seconds) / max(ramp_s, 1e-3), 0.0, 1.0)


@pytest.mark.parametrize("ramp_s", [0.0, 0.05, 5.0], ids=["at once", "a slip", "creep"])
@pytest.mark.parametrize("step_deg", [8.0, -8.0, 2.0])
def test_a_pendulum_that_moves_in_its_closed_lock_is_reported_once(step_deg: float, ramp_s: float) -> None:
    reports = found(after(3.0, step_deg, ramp_s))
    assert [pendulum for pendulum, _ in reports] == [0]
    assert 3.0 < reports[0][1] < 3.0 + ramp_s + 0.2


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 360.0), st.integers(0, 2**31))
def test_play_and_noise_within_the_tolerance_are_not_reported(play_deg: float, at_deg: float, seed: int) -> None:
    moves = 0.5 * play_deg * np.random.default_rng(seed).uniform(-1.0, 1.0, 10 * RATE_HZ)
    assert found(at_deg + moves) == []


def test_a_lock_that_pulls_its_pendulum_in_is_not_reported() -> None:
    assert found(after(0.1, 20.0, 0.2)) == []


@pytest.mark.parametrize("late_blocks", [0, 1, 3])
def test_a_release_is_not_reported_although_its_flag_is_late(late_blocks: int) -> None:
    """A pendulum that is released at speed turns with 80 rad/s²."""
    time = np.arange(10 * RATE_HZ) / RATE_HZ
    moved = np.degrees(0.5 * 80.0 * np.maximum(time - 3.0, 0.0) ** 2)
    flags = np.where(np.arange(len(time)) < 3 * RATE_HZ + late_blocks * BLOCK, LOCKS_CLOSED, 0)
    assert found(moved, flags) == []


def test_an_open_lock_is_not_watched_and_a_closed_one_is_watched_again() -> None:
    degrees = np.r_[after(3.0, 8.0), 8.0 + after(3.0, 8.0)]
    flags = np.r_[np.full(10 * RATE_HZ, LOCKS_CLOSED - LOCK_A_CLOSED), np.full(10 * RATE_HZ, LOCKS_CLOSED)]
    assert [round(at) for _, at in found(degrees, flags)] == [13]


def test_counters_that_are_set_are_no_motion() -> None:
    watch = LockedWatch(ZERO_STD_DEG)
    assert found(np.zeros(2 * RATE_HZ), watch=watch) == []
    watch.restart()
    assert found(np.full(2 * RATE_HZ, 40.0), watch=watch) == []
