"""Scatter of start-ups: pairs that may change places, what is compared, and over assumed friction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.errors import NotEnoughData
from analysis.figures.start_ups import draw_start_ups
from analysis.friction_sweep import FrictionSweep, balance_of, scatter_over_friction
from analysis.settled_scatter import more_consistent, settled_scatter
from dynamics.motions.start_ups import random_starts
from rig_configs import load_rig
from tests.dynamics.nominal import rig

BALANCE = math.radians(30)


def _series(spread_deg: float, count: int = 8):
    rng = np.random.default_rng(5)
    theta = np.array([math.pi - BALANCE, math.pi + BALANCE]) + np.radians(spread_deg) * rng.standard_normal((count, 2))
    theta[::2] = theta[::2, ::-1]  # which of the two is which
    return settled_scatter(theta % (2 * math.pi), np.full(count, 1e-4), BALANCE)


def test_mirror_images_are_one_ending() -> None:
    found = _series(1.0)
    assert np.degrees(found.mean_rad) == pytest.approx([-30, 30], abs=1.5)
    assert math.degrees(found.scatter_rad) == pytest.approx(1.0, rel=0.5)
    assert found.off_rad == pytest.approx(found.scatter_rad, rel=0.5)
    assert found.scatter_std_rad < found.scatter_rad / 3


def test_consistency_is_a_question_of_both_variances() -> None:
    assert more_consistent(_series(0.1), _series(5.0)) < 1e-6
    assert more_consistent(_series(5.0), _series(0.1)) > 1 - 1e-6
    assert more_consistent(_series(1.0), _series(1.0)) == pytest.approx(0.5)
    still = settled_scatter(np.tile([2.0, 4.0], (3, 1)), np.zeros(3), None)
    assert more_consistent(_series(1.0), still) == 1.0
    assert np.isnan(still.off_rad)


def test_one_start_up_scatters_not() -> None:
    with pytest.raises(NotEnoughData, match=r"two or more with two angles each, got shape \(1, 2\)"):
        settled_scatter(np.zeros((1, 2)), np.zeros(1), None)


def test_scatter_grows_with_friction_and_pendulums_are_damped_out_of_it() -> None:
    speed, starts = 1500 * math.pi / 30, random_starts(6, 2)
    balls = scatter_over_friction(load_rig("ball_balancer").physics, (8e-6, 1.5e-4), speed, 12.5, starts)
    pendulums = scatter_over_friction(
        load_rig("isotropic", settings=["imbalance.radius_m=0.05"]).physics, (8e-6, 1.5e-4), speed, 12.5, starts
    )
    assert balls.scatter_rad[1] > 5 * balls.scatter_rad[0] > 0
    assert np.all(pendulums.scatter_rad < 0.2 * balls.scatter_rad)
    assert np.all(balls.held < 1.001)
    assert np.all(balls.still == 1.0)
    assert balls.half_width_rad[1] == pytest.approx(balls.half_width_rad[0] * 150 / 8, rel=1e-3)


def test_the_arm_of_a_scatter_lies_between_arms() -> None:
    parts = tuple(_series(spread) for spread in (0.1, 1.0, 10.0))
    unit = parts[1].scatter_rad
    sweep = FrictionSweep(np.array([1e-6, 1e-5, 1e-4]), parts, *(np.ones(3),) * 4)
    assert sweep.arm_at(unit) == pytest.approx(1e-5, rel=1e-6)
    assert sweep.arm_at(unit * math.sqrt(10)) == pytest.approx(math.sqrt(10) * 1e-5, rel=1e-6)
    assert math.isnan(sweep.arm_at(100 * unit))
    assert sweep.arm_at(1e-9) == 1e-6
    assert sweep.amplitude_m == pytest.approx([1e-4] * 3)


def test_balance() -> None:
    found = balance_of(load_rig("ball_balancer").physics)
    assert found == pytest.approx(BALANCE, abs=1e-3)
    assert balance_of(rig(1.0, sp=1.0)) is None


@pytest.mark.parametrize("zoom", [False, True])
def test_figure_has_every_start_up_and_level(zoom: bool) -> None:
    found = _series(1.0)
    figure = draw_start_ups(found, "title", {"without": 5e-4}, (), None, zoom)
    drawn = [line.get_xdata() for axes in figure.axes for line in axes.lines if line.get_marker() not in ("None", None)]
    assert len(drawn) == found.count * (2 if zoom else 1)
    assert len(figure.axes) == (2 if zoom else 1)
    assert figure.axes[0].get_ylim()[1] > 1.0, "the level of 1 mm peak to peak is in sight"
