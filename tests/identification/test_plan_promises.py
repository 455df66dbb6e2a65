"""Promises of a plan against the uncertainties of fits, for tests that were simulated independently of both."""

from __future__ import annotations

import numpy as np
import pytest
from pendulum_world import World

from identification import fit_release, fit_spin_down_run
from identification.plan import SensorProperties
from identification.plan.experiment import RESERVE
from identification.plan.pendulums import release, spin_down
from rig_configs import load_rig

RIG = load_rig("virtual")
SENSORS = SensorProperties.of(RIG)
HAND_S = 0.05
"""Time after a flick that a plan leaves to the hand; the simulated flicks have none."""


def test_a_spin_down_reaches_what_its_plan_promises() -> None:
    world, flick = World(), 10.0
    after_hand = flick * np.exp(-HAND_S * world.physics.a.damping_Nms_per_rad / world.physics.a.inertia_kg_m2)
    planned = spin_down(world.physics, SENSORS, flick, 6.0)
    for seed in range(3):
        run = world.spin_down(seed, (after_hand, -after_hand))
        fit = fit_spin_down_run(run, world.knowledge)
        for name, value in fit.values.items():
            assert 0.6 < fit.std[name] / value / planned.relative_std(name) < RESERVE


@pytest.mark.parametrize("ratio", [3.3, 5.8])
def test_a_release_reaches_what_its_plan_promises(ratio: float) -> None:
    world = World()
    planned = release(world.physics, SENSORS, "point-D", world.physics.speed_rad_s(ratio), 6.0)
    fit = fit_release(world.release(ratio, 2), world.knowledge, float(np.radians(0.05)))
    for name, value in fit.values.items():
        assert 0.6 < fit.std[name] / value / planned.relative_std(name) < RESERVE
