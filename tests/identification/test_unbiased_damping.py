"""Damping by spin-downs that were simulated for these tests: unbiased, with errors as large as stated."""

from __future__ import annotations

import numpy as np
from pendulum_world import World

from identification import fit_spin_down_run
from tests.effort import cases


def test_errors_of_spin_downs_without_friction_have_the_mean_zero() -> None:
    world, z = World(), list[float]()
    true = world.physics.identified()
    for seed in range(cases(16, 40)):
        fit = fit_spin_down_run(world.spin_down(seed), world.knowledge)
        assert fit.friction is None
        z += [float(np.log(fit.values[name] / true[name])) * fit.values[name] / fit.std[name] for name in fit.values]
    assert abs(np.mean(z)) < 2 / np.sqrt(len(z))
    assert 0.6 < np.std(z) < 1.4
