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


@pytest.mark.parametrize(("c3", "c4"), [(2e-3, 6e-4), (7e-4, 1.8e-3)])
def test_the_pendulum_that_rests_first_reaches_what_its_plan_promises(c3: float, c4: float) -> None:
    """Its readings at rest are rounded to one value, which is no noise: neither fit nor plan use them."""
    world, flick = World(RIG.physics.with_values(c3_Nms_per_rad=c3, c4_Nms_per_rad=c4)), 10.0
    both = (world.physics.a, world.physics.b)
    after_hand = [flick * np.exp(-HAND_S * p.damping_Nms_per_rad / p.inertia_kg_m2) for p in both]
    planned = spin_down(world.physics, SENSORS, flick, 6.0)
    fit = fit_spin_down_run(world.spin_down(1, (after_hand[0], -after_hand[1])), world.knowledge)
    for name, value in fit.values.items():
        assert 0.6 < fit.std[name] / value / planned.relative_std(name) < RESERVE


@pytest.mark.parametrize("record_s", [4.0, 10.0])
def test_a_release_of_any_length_reaches_what_its_plan_promises(record_s: float) -> None:
    """At the end of a short record the pendulums still move, and the fit uses less of it."""
    world = World(RIG.physics.with_values(c3_Nms_per_rad=2e-3, c4_Nms_per_rad=1.6e-3))
    speed = world.physics.speed_rad_s(3.3)
    planned = release(world.physics, SENSORS, "point-D", speed, record_s)
    fit = fit_release(world.release(3.3, 2, record_s=record_s), world.knowledge, float(np.radians(0.05)))
    for name, value in fit.values.items():
        assert 0.5 < fit.std[name] / value / planned.relative_std(name) < 1.3 * RESERVE


@pytest.mark.parametrize("ratio", [3.3, 5.8])
def test_a_release_reaches_what_its_plan_promises(ratio: float) -> None:
    world = World()
    planned = release(world.physics, SENSORS, "point-D", world.physics.speed_rad_s(ratio), 6.0)
    fit = fit_release(world.release(ratio, 2), world.knowledge, float(np.radians(0.05)))
    for name, value in fit.values.items():
        assert 0.6 < fit.std[name] / value / planned.relative_std(name) < RESERVE
