"""Where a release ends: the states the rig is expected to reach, mirror images, and pendulums that never lock."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.release_outcomes import judge, referee
from dynamics import Pendulum, RotorParameters, Scene, SpeedHistory, release_outcome, simulate, steady_states
from dynamics.bench.heyoka_runs import available
from dynamics.stability.turn_map import turn_derivatives
from dynamics.steady.outcome import PLAY_RAD, _Release, releases_within_play
from dynamics.steady.slipping import slipping_motion
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


def campaign_rig(mass_b: float = 0.07195988750713632) -> RotorParameters:
    """Weakly damped pendulums between the resonances: transients of hundreds of revolutions and many turns."""
    a, b = Pendulum(0.075, 0.054, 9.547e-5), Pendulum(mass_b, 0.054, 9.1257e-5)
    return RotorParameters(7.0, 0.12, 0.02117, a, b, 2582.0, 42031.2, 0.0212688, 0.0126597)


def test_a_transient_of_many_turns_that_locks_is_no_slipping() -> None:
    p = campaign_rig()
    found = release_outcome(p, p.speed_rad_s(3.07))
    assert found.state == "III"
    assert math.degrees(found.theta_rad[0]) == pytest.approx(267.0, abs=0.5)
    assert found.revolutions > 400
    assert max(map(abs, found.slip_turns)) > 8


@pytest.mark.parametrize("ratio", [3.0, 3.066, 3.075, 3.08])
def test_no_slipping_is_claimed_where_an_independent_integration_locks(ratio: float) -> None:
    """The referee goes on for as long as the claim is about: a slipping release may not lock, a locked one must."""
    if not available():
        pytest.skip("needs heyoka")
    p = campaign_rig()
    speed = p.speed_rad_s(ratio)
    found = release_outcome(p, speed)
    assert judge(found.state, found.reached, referee(p, speed, 6000)) in ("right", "no claim")
    assert found.state != "not settled" or "not settled within" in found.seen


def test_one_strobe_near_a_state_is_not_rest_there() -> None:
    """A motion that passes a state's angles at speed has not arrived: the rates count, and the motion must approach."""
    p = rig()
    speed = p.speed_rad_s(1.6)
    states = [s for s in steady_states(p, speed, 1e-6) if s.stable]
    passing = _Release(p, speed, (0.0, math.pi), 1e-6)
    past = np.tile(states[0].start, (3, 1))
    past[:, 6] = 0.5 * speed
    assert np.min(passing._distance(past, states[0])) > 0.1
    assert np.max(passing._distance(states[0].start[None, :], states[0])) == 0


def test_chaotic_slipping_is_not_claimed_to_last() -> None:
    p = rig(zeta=0.1, damping=0.00022)
    found = release_outcome(p, p.speed_rad_s(3.261), most_revolutions=1300)
    assert (found.state, found.slipping) == ("not settled", None)
    assert "turns against the rotor" in found.seen
    assert "within 1320 revolutions" in found.seen


def test_a_slipping_motion_is_stable_by_its_own_linear_equations() -> None:
    p = rig(zeta=0.05)
    found = release_outcome(p, p.speed_rad_s(3.3))
    assert found.slipping is not None
    assert found.slipping.shrinkage < 0.1
    assert found.slipping.misfit_rad < 2e-3
    assert found.slipping.turns_per_revolution[0] == pytest.approx(found.slipping.turns_per_revolution[1], abs=1e-6)


def test_a_stretch_towards_a_lock_is_no_slipping_motion() -> None:
    """Six turns and more, then rest: the curve of the turning part does not foretell what follows."""
    p = campaign_rig()
    release = _Release(p, p.speed_rad_s(3.07), (PLAY_RAD, math.pi - 0.5 * PLAY_RAD), 1e-6)
    for _ in range(8):
        release._advance()
    strobe = np.concatenate(release.blocks)
    assert np.max(np.abs(np.ptp(strobe[:, 2:4], axis=0))) > 12 * math.pi
    assert slipping_motion(p, release.speed, strobe) is None


def test_derivatives_over_a_revolution_are_those_of_the_motion() -> None:
    p = rig()
    speed = p.speed_rad_s(3.3)
    start = np.array([1e-4, -2e-4, 0.7, 2.5, 0.01, -0.02, -3.0, 2.0])
    (found,) = turn_derivatives(p, speed, start[None, :])
    times = np.array([0.0, 2 * math.pi / speed])
    for i, step in ((2, 1e-4), (7, 1e-3)):
        moved = [
            simulate(p, Scene(SpeedHistory.constant(speed), start=start + sign * step * np.eye(8)[i]), times, 1e-10)
            for sign in (1, -1)
        ]
        difference = (moved[0].state[-1] - moved[1].state[-1]) / (2 * step)
        assert np.allclose(found[:, i], difference, rtol=1e-3, atol=1e-5 * np.max(np.abs(difference)))


def test_pendulums_without_an_imbalance_rest_opposed_at_any_angle() -> None:
    p = rig(sp=0.0)
    speed = p.speed_rad_s(1.6)
    states = steady_states(p, speed)
    assert [(s.type, s.any_angle) for s in states] == [("I", True)]
    found = release_outcome(p, speed)
    assert found.state == "I"
    assert found.reached is not None
    assert found.reached.any_angle
    assert abs(math.degrees(found.theta_rad[0] - found.theta_rad[1])) == pytest.approx(180, abs=1e-3)


def test_releases_within_the_play_are_followed_each_to_its_own_image() -> None:
    p = rig()
    found = releases_within_play(p, p.speed_rad_s(5.8))
    assert len(found) == 5
    assert all(o.state == "I" and o.reached is not None for o in found)
    assert len({o.from_rad for o in found}) == 5


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


def test_friction_ends_the_motion_next_to_the_balanced_angles() -> None:
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
