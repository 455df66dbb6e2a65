"""Encoders that are mounted off the axis of their pendulums, in spin-downs that were simulated for these tests."""

from __future__ import annotations

import numpy as np
import pytest
from pendulum_world import Encoders, World

from identification import fit_spin_down_run

HALF_A_DEGREE = float(np.radians(0.5))


def off_axis(a_rad: float, b_rad: float, turn_rad: float) -> World:
    return World(encoders=Encoders(off_axis_rad=(a_rad, b_rad), off_axis_at_rad=(turn_rad, 2 * turn_rad)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_encoder_off_its_axis_is_no_drag(seed: int) -> None:
    world = off_axis(HALF_A_DEGREE, HALF_A_DEGREE, 1.3 * seed)
    fit, true = fit_spin_down_run(world.spin_down(seed), world.knowledge), world.physics.identified()
    assert fit.friction is None
    assert not any("drag" in warning for warning in fit.warnings if "exclude" not in warning)
    assert sum("off its axis" in warning for warning in fit.warnings) == 2
    for name, value in fit.values.items():
        assert abs(value - true[name]) < 3 * fit.std[name] < 0.05 * value


def test_the_encoder_that_is_off_its_axis_is_named_with_its_error() -> None:
    world = off_axis(0.0, HALF_A_DEGREE, 0.9)
    fit = fit_spin_down_run(world.spin_down(4), world.knowledge)
    (warning,) = (text for text in fit.warnings if "off its axis" in text)
    assert "encoder B reads 0." in warning
    size = float(warning.split("reads ")[1].split(" ±")[0])
    assert 0.3 < size < 0.7


def test_encoders_on_their_axes_are_not_blamed() -> None:
    world = World()
    for seed in range(4):
        fit = fit_spin_down_run(world.spin_down(20 + seed), world.knowledge)
        assert fit.friction is None
        assert not any("off its axis" in warning for warning in fit.warnings)
