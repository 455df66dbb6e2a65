"""Where a release ends: the states the rig is expected to reach, mirror images, and pendulums that never lock."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dynamics import RotorParameters, release_outcome, steady_states
from tests.dynamics.nominal import rig


@pytest.mark.parametrize(("ratio", "kind"), [(0.83, "III"), (1.6, "I"), (2.6, "I"), (3.3, "III"), (5.8, "I")])
def test_a_release_reaches_the_stable_state(ratio: float, kind: str) -> None:
    p = rig()
    found = release_outcome(p, p.speed_rad_s(ratio))
    assert found.state == kind
    assert found.reached is not None
    assert found.reached.stable
    assert 0 < found.after_s < 60


def test_pendulums_that_slip_by_turns_are_recognised() -> None:
    """High damping between the resonances: no steady motion is stable and the pendulums never lock."""
    p = rig(zeta=0.05)
    speed = p.speed_rad_s(3.3)
    assert not any(s.stable for s in steady_states(p, speed))
    found = release_outcome(p, speed)
    assert found.state == "slipping"
    assert found.reached is None
    assert max(map(abs, found.slip_turns)) > 8


def test_identical_pendulums_changed_over_reach_the_mirror_image() -> None:
    p = rig()
    speed = p.speed_rad_s(5.8)
    first = release_outcome(p, speed, (0.01, math.pi - 0.01))
    second = release_outcome(p, speed, (math.pi - 0.01, 0.01))
    assert first.state == second.state == "I"
    assert np.allclose(first.theta_rad, second.theta_rad[::-1], atol=1e-12)
    assert abs(first.theta_rad[0] - second.theta_rad[0]) > 1


def test_undamped_pendulums_do_not_settle_in_the_time_given() -> None:
    p: RotorParameters = rig(zeta=0.0, damping=0.0)
    found = release_outcome(p, p.speed_rad_s(2.6), most_revolutions=80)
    assert found.state in ("not settled", "slipping")
    assert found.reached is None


def test_friction_ends_the_motion_beside_the_balanced_angles() -> None:
    p = rig()
    rubbing = replace(p, a=replace(p.a, friction_arm_m=1e-5), b=replace(p.b, friction_arm_m=1e-5))
    found = release_outcome(rubbing, p.speed_rad_s(2.0))
    assert found.state == "I"
    assert found.reached is not None
    away = np.abs(np.angle(np.exp(1j * (np.array(found.theta_rad) - np.array(found.reached.theta_rad)))))
    assert 1e-3 < away.max() <= max(found.reached.stick_half_width_rad)


def test_so_much_friction_that_nothing_moves() -> None:
    p = rig()
    held = replace(p, a=replace(p.a, friction_arm_m=1e-2), b=replace(p.b, friction_arm_m=1e-2))
    start = (0.3, 2.0)
    found = release_outcome(held, p.speed_rad_s(2.0), start)
    assert np.allclose(found.theta_rad, start, atol=1e-12)


def test_the_slowest_rotor_is_given_up_at_once_because_its_states_draw_too_slowly() -> None:
    p = rig()
    found = release_outcome(p, p.speed_rad_s(1e-3))
    assert (found.state, found.reached) == ("not settled", None)
    assert found.revolutions <= 40
    assert "revolutions for each e-fold" in found.seen


def test_friction_that_holds_the_pendulums_away_from_any_state_names_none() -> None:
    p = rig()
    held = replace(p, a=replace(p.a, friction_arm_m=1e-3), b=replace(p.b, friction_arm_m=1e-3))
    found = release_outcome(held, p.speed_rad_s(3.3))
    assert found.state == "held by friction"
    assert found.reached is None
