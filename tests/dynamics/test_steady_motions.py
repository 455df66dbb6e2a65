"""Steady motions against closed forms, long simulations, heyoka's multipliers, and each other in bigger models."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dynamics import Scene, SpeedHistory, multipliers, simulate, steady_states
from dynamics.bench import heyoka_peer
from dynamics.equations.kernels import rates
from dynamics.equations.model import AUTONOMOUS, HALF_REVOLUTION, WHOLE_REVOLUTION
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.errors import NoBalancedState, NotConverged, OutsideDomain
from dynamics.steady.steady_state import SteadyState
from tests.dynamics.nominal import from_domain, rig
from tests.effort import cases, thorough

needs_heyoka = pytest.mark.skipif(heyoka_peer.heyoka() is None, reason="heyoka has wheels for Linux only")


def apart(a: tuple[float, float], b: tuple[float, float]) -> float:
    return float(np.max(np.abs(np.exp(1j * np.array(a)) - np.exp(1j * np.array(b)))))


def left_over(p: RotorParameters, speed: float, s: SteadyState) -> float:
    """Angular and linear accelerations the equations leave against the orbit's own, relative, over the whole orbit."""
    n = len(s.states)
    order = np.fft.fftfreq(n, 1 / n)
    second = np.fft.ifft(-((speed * order[:, None]) ** 2) * np.fft.fft(s.states[:, :4], axis=0), axis=0).real
    packed, worst = p.packed(), 0.0
    size = speed**2 * (p.forcing_moment_kg_m + p.a.first_moment_kg_m + p.b.first_moment_kg_m) / p.total_mass_kg
    for j in range(n):
        out = np.empty(8)
        rates(s.states[j], 2 * np.pi * j / n, speed, 0.0, packed, 1.0, 1.0, out)
        miss = np.abs(out[4:] - second[j])
        worst = max(worst, float(np.max(miss[:2])) / size, float(np.max(miss[2:])) / speed**2)
    return worst


@pytest.mark.parametrize(("ratio", "kind"), [(0.83, "III"), (1.6, "I"), (2.6, "I"), (3.3, "III"), (5.8, "I")])
def test_the_stable_state_at_each_validation_point(ratio: float, kind: str) -> None:
    p = rig()
    found = steady_states(p, p.speed_rad_s(ratio))
    assert {s.type for s in found if s.stable} == {kind}
    assert {s.type for s in found} == {"I", "II", "III"}
    assert found.unresolved == ()
    for s in found:
        assert s.error_estimate <= 1e-8 * max(1, s.multiplier_max)
        assert left_over(p, p.speed_rad_s(ratio), s) < 1e-9


@pytest.mark.parametrize(
    ("point", "expected"), [(0.83, 1.361992), (1.6, 0.937055), (2.6, 0.974796), (3.3, 1.373347), (5.8, 0.978556)]
)
def test_multipliers_of_the_balanced_state(point: float, expected: float) -> None:
    """Six digits of an independent model in double precision."""
    p = rig()
    for accuracy in (1e-6, 1e-8, 1e-10):
        state = multipliers(p, p.speed_rad_s(point), accuracy)
        assert state.multiplier_max == pytest.approx(expected, abs=5.1e-7)
        assert state.error_estimate <= accuracy * max(1, expected)


@needs_heyoka
@pytest.mark.parametrize("ratio", [0.83, *(pytest.param(r, marks=thorough) for r in (1.6, 2.6, 3.3)), 5.8])
def test_multipliers_agree_with_heyoka_to_1e_10(ratio: float) -> None:
    """All eight multipliers of every steady state at the point, from its own start state."""
    p = rig()
    speed = p.speed_rad_s(ratio)
    compiled = heyoka_peer.half_turn_integrator(p, speed)
    for s in steady_states(p, speed, 1e-10):
        reference = heyoka_peer.multipliers(p, speed, s.start, compiled)
        worst = max(float(np.min(np.abs(reference - value))) for value in s.multipliers)
        assert worst < 1e-10 * max(1.0, s.multiplier_max)
        assert abs(abs(reference[0]) - s.multiplier_max) <= s.error_estimate + 1e-12 * s.multiplier_max


@pytest.mark.parametrize(("ratio", "turns"), [(0.83, 260), (3.3, 400)])
def test_type_three_orbits_are_where_a_long_simulation_ends(ratio: float, turns: int) -> None:
    p = rig()
    speed = p.speed_rad_s(ratio)
    orbit = next(s for s in steady_states(p, speed, 1e-9) if s.stable)
    nearby = orbit.start + np.array([1e-4, -1e-4, 0.03, -0.02, 0, 0, 0, 0])
    end = 2 * np.pi * turns / speed
    times = np.concatenate([[0.0], end + 2 * np.pi * np.arange(65) / 64 / speed])
    motion = simulate(p, Scene(SpeedHistory.constant(speed), start=nearby), times, 1e-8)
    mean = motion.angles_rad[1:-1].mean(axis=0)
    assert apart(orbit.theta_rad, (mean[0], mean[1])) < 1e-6
    assert np.max(np.abs(motion.state[1, 2:4] - orbit.start[2:4])) < 1e-6
    assert np.max(np.abs(motion.state[1, :2] - orbit.start[:2])) < 1e-6 * orbit.amplitude_m


@pytest.mark.parametrize(
    ("p", "ratio", "kind", "angle_deg", "amplitude_mm"),
    [
        (rig(1.0, 0.05), 0.8, "III", 303.708, 2.325497),
        (rig(1.0, 0.05, 0.012), 2.5, "III", 180.886, 0.638397),
        (rig(1.0, 0.05, 0.001, 0.019), 2.5, "II", 174.456, 0.334778),
    ],
)
def test_published_isotropic_states(
    p: RotorParameters, ratio: float, kind: str, angle_deg: float, amplitude_mm: float
) -> None:
    (stable,) = [s for s in steady_states(p, p.speed_rad_s(ratio)) if s.stable]
    assert stable.type == kind
    assert math.degrees(stable.theta_rad[0]) == pytest.approx(angle_deg, abs=6e-4)
    assert 1e3 * stable.amplitude_m == pytest.approx(amplitude_mm, abs=6e-7)


@settings(max_examples=cases(12, 25))
@given(st.integers(0, 2**32 - 1))
def test_the_small_model_equals_the_bigger_ones(seed: int) -> None:
    """Isotropic: rest points of the rotating frame against orbits over half and over a whole revolution."""
    rng = np.random.default_rng(seed)
    p = rig(1.0, float(rng.uniform(0.01, 0.3)), float(rng.uniform(0.001, 0.009)), float(rng.uniform(0.02, 0.2)))
    speed = p.speed_rad_s(float(rng.choice([rng.uniform(0.3, 0.95), rng.uniform(1.1, 6.0)])))
    small = steady_states(p, speed)
    assert all(s.model.name == AUTONOMOUS for s in small)
    for name in (HALF_REVOLUTION, WHOLE_REVOLUTION):
        big = steady_states(p, speed, at_least=name)
        for s in small:
            twin = min(big, key=lambda b: apart(b.theta_rad, s.theta_rad))
            assert apart(twin.theta_rad, s.theta_rad) < 1e-9
            assert twin.type == s.type
            assert twin.amplitude_m == pytest.approx(s.amplitude_m, rel=1e-8, abs=1e-13)
            assert abs(twin.multiplier_max - s.multiplier_max) <= twin.error_estimate + s.error_estimate


def test_nearly_isotropic_is_nearly_isotropic() -> None:
    """The orbits go over into the rest points without a jump, linearly in the difference of the springs."""
    p = rig(1.0, 0.05)
    speed = p.speed_rad_s(0.8)
    rest = next(s for s in steady_states(p, speed) if s.stable)
    moves = []
    for share in (1e-5, 1e-4):
        near = replace(p, k2_N_per_m=p.k1_N_per_m * (1 + share))
        s = next(s for s in steady_states(near, speed) if s.stable)
        moves.append(apart(s.theta_rad, rest.theta_rad))
    assert moves[1] / moves[0] == pytest.approx(10, rel=0.02)


def test_gravity_goes_to_nothing_smoothly_and_needs_the_whole_revolution() -> None:
    p = rig()
    speed = p.speed_rad_s(5.8)
    without = next(s for s in steady_states(p, speed) if s.stable)
    shifts = []
    for g in (1e-3, 1e-2):
        s = next(s for s in steady_states(rig(gravity_m_per_s2=g), speed) if s.stable)
        assert s.model.name == WHOLE_REVOLUTION
        shifts.append(np.max(np.abs(s.states[:, 2:4] - s.states[:, 2:4].mean(axis=0))))
    assert shifts[1] / shifts[0] == pytest.approx(10, rel=1e-2)
    full = next(s for s in steady_states(rig(gravity_m_per_s2=9.81), speed) if s.stable)
    assert full.type == without.type == "I"
    assert left_over(rig(gravity_m_per_s2=9.81), speed, full) < 1e-9
    sag = -p.total_mass_kg * 9.81 / p.k2_N_per_m
    assert np.mean(full.states[:, 1]) == pytest.approx(sag, rel=0.02)


def test_a_ball_rests_where_a_pendulum_does_but_swings_slower() -> None:
    """At constant speed rolling only adds inertia: on an isotropic suspension the same angles, other multipliers."""
    p = rig(1.0, 0.05)
    ball = Pendulum(0.075, 0.054, 0.001, ball_radius_m=0.012)
    rolling = replace(p, a=ball, b=ball)
    speed = p.speed_rad_s(2.0)
    plain, rolled = steady_states(p, speed), steady_states(rolling, speed)
    for s, t in zip(sorted(plain, key=lambda s: s.theta_rad), sorted(rolled, key=lambda s: s.theta_rad), strict=True):
        assert s.theta_rad == pytest.approx(t.theta_rad, abs=1e-12)
        assert abs(s.multiplier_max - t.multiplier_max) > 1e-4


def test_dry_friction_gives_a_band_of_resting_poses() -> None:
    """Twice the friction, twice the band; the band's edge is where the torque is just held."""
    widths = []
    for arm in (1e-6, 2e-6):
        p = rig()
        held = replace(p, a=replace(p.a, friction_arm_m=arm), b=replace(p.b, friction_arm_m=arm))
        s = next(s for s in steady_states(held, p.speed_rad_s(1.6)) if s.stable)
        widths.append(s.stick_half_width_rad[0])
    assert 0 < widths[0] < 0.1
    assert widths[1] == pytest.approx(2 * widths[0], rel=1e-6)


def test_one_locked_pendulum_and_no_pendulum() -> None:
    p = rig()
    one = steady_states(p, p.speed_rad_s(1.6), released=(True, False))
    assert {s.type for s in one} == {"one"}
    assert all(len(s.multipliers) == 6 for s in one)
    none = steady_states(replace(p, a=Pendulum.absent(), b=Pendulum.absent()), p.speed_rad_s(1.6))
    assert [(s.type, len(s.multipliers)) for s in none] == [("none", 4)]
    bare = replace(p, a=Pendulum.absent(), b=Pendulum.absent())
    decay = math.exp(-2 * math.pi / bare.speed_rad_s(1.6) * 0.02 * bare.natural_frequencies_rad_s[0])
    (state,) = steady_states(bare, bare.speed_rad_s(1.6))
    assert state.multiplier_max == pytest.approx(decay, rel=1e-12)


@settings(max_examples=cases(12, 60), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_over_the_whole_domain_an_answer_holds_or_is_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, ratio = from_domain(rng)
    speed = p.speed_rad_s(ratio)
    try:
        found = steady_states(p, speed, 1e-6)
    except NotConverged:
        return
    for s in found:
        assert np.all(np.isfinite(s.states))
        assert np.all(np.isfinite(s.multipliers))
        assert s.error_estimate <= 1e-6 * max(1, s.multiplier_max)


def test_refusals_state_why() -> None:
    p = rig(sp=0.02)
    with pytest.raises(NoBalancedState, match="undersized"):
        multipliers(p, 30.0)
    with pytest.raises(NoBalancedState, match="pivot shift"):
        multipliers(rig(pivot_shift_m=1e-3), 30.0)
    for speed, accuracy, word in ((0.0, 1e-8, "speed"), (math.nan, 1e-8, "speed"), (30.0, 1e-14, "accuracy")):
        with pytest.raises(OutsideDomain, match=word):
            steady_states(rig(), speed, accuracy)
    with pytest.raises(OutsideDomain, match="expected RotorParameters"):
        steady_states("virtual", 30.0)
