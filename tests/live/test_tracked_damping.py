"""Damping panel: no value for a pendulum that stands still in its lock, with reports of the locks or without."""

from __future__ import annotations

import math

import numpy as np
import pytest

from daq.channels import LOCK_A_CLOSED, LOCKS_CLOSED
from live.followers import Damping
from live.model import LiveModel
from live.signals import Signals
from rig_configs import load_rig

RIG = load_rig("virtual")
SECONDS = 2.0
NOISE_RAD = 5e-4


def followed(flags: int, swinging: tuple[bool, bool]) -> Damping:
    """A rotor at rest whose pendulums run down from a flick, or stand still."""
    signals, rng = Signals(RIG, 0), np.random.default_rng(1)
    time = np.arange(0, SECONDS, 1e-3)
    run_down = 2.0 * (1 - np.exp(-4.6 * time))
    a, b = (run_down * moves + NOISE_RAD * rng.standard_normal(len(time)) for moves in swinging)
    found = Damping(signals, LiveModel(RIG))
    columns = {"theta3_rad": a, "theta4_rad": math.pi + b, "flags": np.full(len(time), flags, np.uint32)}
    signals.feed("pendulums", np.round(time * 1e9).astype(np.int64), columns)
    found.follow(SECONDS)
    return found


@pytest.mark.parametrize("flags", [LOCKS_CLOSED, 0])
def test_locked_pendulums_have_no_damping(flags: int) -> None:
    damping = followed(flags, (False, False))
    assert len(damping.between(0.0, SECONDS)) == 0
    assert damping.locked == ("A", "B")


@pytest.mark.parametrize("flags", [LOCK_A_CLOSED, 0])
def test_a_free_pendulum_with_a_locked_one_keeps_its_damping(flags: int) -> None:
    damping = followed(flags, (False, True))
    rows = damping.between(0.0, SECONDS)
    assert len(rows) > 0
    assert np.isnan(rows[:, 1:3]).all()
    assert np.isfinite(rows[:, 3:5]).all()
    assert damping.locked == ("A",)
