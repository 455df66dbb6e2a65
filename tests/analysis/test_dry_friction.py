"""Dry friction at the points: a rig that stands inside its band passes, and only one whose friction is known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from analysis import predict_point
from analysis.causes import Cause
from analysis.differences import Differences
from analysis.dry_friction import DryFriction
from analysis.explanations import explanations
from analysis.validation import PointResult, validate_point
from benchmarks.worlds import Spread, World, draw_world, record, with_effect
from daq.signals.run import Run
from rig_configs import PARAMETER_UNITS, IdentifiedParameters
from rig_configs.known import KEPT_FRICTION

SHARE = 0.005


@pytest.fixture(scope="module")
def world() -> World:
    return draw_world(3, Spread(), with_effect(f"dry={SHARE}"))


@pytest.fixture(scope="module")
def run(world: World) -> Run:
    return record(world, 3, "point-E")


def identified(world: World, known: bool) -> IdentifiedParameters:
    """The truth within a thousandth, with the friction or without."""
    values = {name: world.truth[name] for name in PARAMETER_UNITS}
    std = np.array([1e-4 * abs(v) for v in values.values()])
    a, b = world.mechanics.a.dry_Nm, world.mechanics.b.dry_Nm
    friction = {
        "values": dict(zip(KEPT_FRICTION, (a, b, 0.0, 0.0), strict=True)),
        "covariance": np.diag([(0.01 * a) ** 2, (0.01 * b) ** 2, 0.0, 0.0]).tolist(),
    }
    axis = (math.degrees(world.axis_rad), 0.01)
    return IdentifiedParameters(values, np.diag(std**2), {"friction": friction} if known else {}, axis)


def judged(world: World, run: Run, known: bool) -> PointResult:
    return validate_point(run, world.rig, identified(world, known))


def test_pendulums_that_friction_holds_pass_where_the_friction_is_known(world: World, run: Run) -> None:
    dry, smooth = judged(world, run, True), judged(world, run, False)
    assert (dry.verdict, smooth.verdict) == ("pass", "fail")
    assert max(abs(z) for z in dry.z_scores.values()) < 3
    assert max(abs(z) for z in smooth.z_scores.values()) > 10


def test_the_band_is_in_the_predictions_uncertainty(world: World) -> None:
    speed = world.rig.physics.speed_rad_s(5.8)
    dry, smooth = (predict_point(world.rig, identified(world, known), speed) for known in (True, False))
    assert dry.held is not None
    assert smooth.held is None
    assert dry.covariance[:2, :2] - smooth.covariance[:2, :2] == pytest.approx(dry.held.covariance, rel=1e-3)
    assert dry.values[:2] == pytest.approx(smooth.values[:2])
    assert np.all(dry.std[:2] > 0.4 * dry.held.half_width_rad)


def test_a_wobbling_state_is_predicted_where_friction_moves_it(world: World) -> None:
    speed = world.rig.physics.speed_rad_s(0.83)
    dry, smooth = (predict_point(world.rig, identified(world, known), speed) for known in (True, False))
    shift = np.degrees(dry.values[:2] - smooth.values[:2])
    assert np.all((shift > -0.2) & (shift < -0.08))  # the independent motion at 0.5 %: −0.125°
    assert np.all(dry.std[:2] > smooth.std[:2])


def test_what_friction_does_to_a_point_that_is_not_settled(world: World) -> None:
    """It holds nothing at A, where the pulsation exceeds it: the last approach is not a creep."""
    late = judged(world, record(world, 3, "point-A", 20.0), True)
    assert late.verdict == "not settled"
    assert "leave their unstable balance late" in late.why
    assert "creep" not in late.why


def test_friction_of_one_test_and_of_all_tests(world: World) -> None:
    of_test = {"tests": [{"friction": {"contact_a_kg_m2": 2e-9}, "friction_std": {"contact_a_kg_m2": 1e-10}}]}
    found = DryFriction.of(dataclasses.replace(identified(world, False), provenance=of_test))
    assert found is not None
    torque, std = found.torque_at(100.0)
    assert torque == pytest.approx([2e-5, 0.0])
    assert std == pytest.approx([1e-6, 0.0])
    assert DryFriction.of(identified(world, False)) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_as_a_cause_is_not_below_zero(sign: float) -> None:
    none = np.zeros((4, 0))
    rows = tuple(("E", f"release {i + 1}") for i in range(4))
    direction = np.array([1.0, 2.0, 0.0, -1.0])
    differences = Differences(rows, sign * 6 * direction, np.eye(4), none, (), np.zeros((0, 0)), none, {}, {})
    friction = Cause(
        "friction.a_Nm",
        "dry friction of pendulum A",
        0.0,
        1.0,
        direction,
        "% of c3 · 12 rad/s",
        0.1,
        "another spin-down",
        one_sided=True,
    )
    found = explanations(differences, [friction])
    if sign < 0:
        assert found.best is None
        return
    assert found.best is not None
    assert found.best.sizes == pytest.approx((6.0,))
    assert "dry friction of pendulum A of 0.600 ± 0.041 % of c3 · 12 rad/s" in found.sentences[0]
