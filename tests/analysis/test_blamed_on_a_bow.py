"""A bow that leaves a point without a steady state, or makes its approach slow, is named as the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis import validate
from analysis.bent_shaft import blamed_on_bow
from analysis.validation import Validation
from benchmarks.worlds import Effects, Spread, World, draw_world, record
from dynamics import steady_states
from rig_cli.validation_page import whole_lines
from rig_configs import IdentifiedParameters
from rig_configs.slow_roll import SlowRoll

SEED = 1008  # the bow lies opposite to the imbalance


@pytest.fixture(scope="module")
def world() -> World:
    return draw_world(SEED, Spread(gain=0.0), Effects(bow_m=1e-4))


@pytest.fixture(scope="module")
def identified(world: World) -> IdentifiedParameters:
    """As a perfect campaign finds it."""
    bow = world.mechanics.bow_m * np.exp(1j * world.mechanics.bow_rad)
    covariance = np.diag([(1e-4 * value) ** 2 for value in world.truth.values()])
    roll = SlowRoll(0j, 0j, complex(bow), np.diag([0.0] * 4 + [1e-14] * 2), (0.5, 0.5))
    return IdentifiedParameters(
        world.truth, covariance, axis_angle_deg=(float(np.degrees(world.axis_rad)), 0.01), slow_roll=roll
    )


@pytest.fixture(scope="module")
def found(world: World, identified: IdentifiedParameters) -> Validation:
    return validate([record(world, SEED, f"point-{name}") for name in "ABD"], world.rig, identified)


def test_pendulums_that_slip_because_of_the_bow(found: Validation) -> None:
    point = found.points["D"]
    assert (point.state, point.verdict) == ("slipping", "fail")
    assert "the bow of 100 µm at -179° is the reason: with a straight shaft state III is stable here" in point.why


def test_an_approach_that_the_bow_makes_slow(found: Validation) -> None:
    point = found.points["A"]
    assert point.verdict == "not settled"
    assert "the bow of 100 µm at -179° makes the approach slow: 0.12 /s by the model" in point.why


def test_the_other_points_are_judged_and_nothing_else_is_blamed(found: Validation) -> None:
    """What is missing at D has no differences, so no cause is fitted to the noise of the others."""
    assert found.points["B"].verdict == "pass"
    assert "bow" not in found.points["B"].why
    assert found.agreement is not None
    assert found.agreement.passed
    assert found.explanations is None
    assert not found.passed


def test_the_answer_begins_with_the_bow(found: Validation) -> None:
    first, second, *_ = whole_lines(found.to_json())
    assert first.startswith("A: the bow of 100 µm at -179° makes the approach slow")
    assert second == "D: the bow of 100 µm at -179° is the reason: with a straight shaft state III is stable here"


def test_a_slipping_rotor_s_own_motion_is_no_line_of_the_lasers(found: Validation) -> None:
    assert not [text for text in found.warnings if "line" in text]


def test_a_bow_that_changes_nothing_is_not_blamed(world: World) -> None:
    physics, speed = world.rig.physics, world.rig.physics.speed_rad_s(3.3)
    crooked = replace(physics, bow_x_m=1e-6)
    stable = next(s for s in steady_states(crooked, speed, 1e-6) if s.stable)
    assert blamed_on_bow(crooked, speed, stable) == ""
    assert blamed_on_bow(physics, speed, None) == ""
    slack = replace(physics.with_values(zeta1=0.1, zeta2=0.1), bow_x_m=1e-6)  # slips with a straight shaft too
    assert blamed_on_bow(slack, speed, None) == ""
