"""Dry friction: closed forms, sticking that is exact, energy that only falls, modes that do not depend on tolerance."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from dynamics.equations.friction import BACKWARD, FORWARD, STUCK, modes_at, needed_torque, with_modes
from dynamics.equations.kernels import FA, FB, JA, rates
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import NotConverged
from dynamics.motions.integrate import locked_state, simulate

ARM = 0.054


def rig(friction_arm: float, damping: float = 1e-3, **change: float) -> RotorParameters:
    pendulum = Pendulum(0.075, ARM, damping, friction_arm)
    k1 = 7.27 * (2 * math.pi * 3) ** 2
    p = RotorParameters(7.0, 0.12, 0.02117, pendulum, pendulum, k1, 14.9 * k1, 0.02, 0.02)
    return dataclasses.replace(p, **change)


def opposed(friction_arm: float) -> RotorParameters:
    """No imbalance, no magnets: two opposed pendulums moving alike leave the disk at rest."""
    return rig(friction_arm, 0.0, imbalance_radius_m=0.0)


@pytest.mark.parametrize("method", ["explicit", "implicit"])
def test_a_slide_runs_down_and_sticks_as_in_closed_form(method: str) -> None:
    """J φ̈ = −F φ̇² gives φ̇ = u/(1 + (F/J) u t) until φ̇ = ω; then nothing moves the pendulum any more."""
    ratio, omega, u = 2e-3 / ARM, 20.0, 50.0  # F/J = friction arm over arm
    start = np.array([0.0, 0.0, 0.3, 0.3 + math.pi, 0.0, 0.0, u - omega, u - omega])
    scene, times = Scene(SpeedHistory.constant(omega), start=start), np.linspace(0, 2, 41)
    motion = simulate(opposed(2e-3), scene, times, 1e-9, method)
    stop = (1 / omega - 1 / u) / ratio
    assert {(e.kind, e.pendulum) for e in motion.events} == {("stick", 0), ("stick", 1)}
    assert np.allclose([e.time_s for e in motion.events], stop, rtol=0, atol=1e-8)
    run = np.minimum(times, stop)
    expected = 0.3 + np.log1p(ratio * u * run) / ratio - omega * run
    assert np.allclose(motion.angles_rad[:, 0], expected, rtol=0, atol=1e-9)
    assert np.all(motion.state[times > stop + 1e-6, 6] == 0.0)


def test_a_stick_ends_when_the_rotor_brakes_harder_than_friction_holds() -> None:
    """Braking at a: J a = F ω² ends the stick at ω = sqrt(a J/F); from there φ̇ = u/(1 + (F/J) u t) again."""
    ratio, brake = 2e-3 / ARM, 5.0
    start = np.array([0.0, 0.0, 0.3, 0.3 + math.pi, 0, 0, 0, 0])
    scene = Scene(SpeedHistory.ramp(20.0, 5.0, 3.0), start=start)
    slip_speed = math.sqrt(brake / ratio)
    slip = (20.0 - slip_speed) / brake
    motion = simulate(opposed(2e-3), scene, np.linspace(0, 3, 61), 1e-9)
    first = next(e for e in motion.events if e.pendulum == 0)
    assert first.kind == "slide forward"
    assert first.time_s == pytest.approx(slip, abs=1e-9)
    free = motion.time_s > slip
    assert np.all(motion.angles_rad[~free, 0] == 0.3)
    t = motion.time_s[free] - slip
    expected = 0.3 + np.log1p(ratio * slip_speed * t) / ratio - slip_speed * t + 0.5 * brake * t**2
    assert np.allclose(motion.angles_rad[free, 0], expected, rtol=0, atol=1e-8)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_friction_only_takes_energy(seed: int) -> None:
    """On a resting rotor the energy of disk, springs and pendulums cannot rise."""
    rng = np.random.default_rng(seed)
    p = rig(10 ** rng.uniform(-4, -1.5), 0.0, zeta1=0.0, zeta2=0.0, gravity_m_per_s2=float(rng.choice([0.0, 9.81])))
    start = rng.normal(size=8) * [1e-3, 1e-3, 2, 2, 0.02, 0.02, 8, 8]
    motion = simulate(p, Scene(SpeedHistory.constant(0.0), start=start), np.linspace(0, 0.6, 121), 1e-7)
    x, y, a, b, vx, vy, va, vb = motion.state.T
    energy = 0.5 * p.total_mass_kg * (vx**2 + vy**2) + 0.5 * (p.k1_N_per_m * x**2 + p.k2_N_per_m * y**2)
    energy += p.total_mass_kg * p.gravity_m_per_s2 * y
    s, j = p.a.first_moment_kg_m, p.a.inertia_kg_m2
    for angle, rate in ((a, va), (b, vb)):
        energy += 0.5 * j * rate**2 + s * rate * (vy * np.cos(angle) - vx * np.sin(angle))
        energy += p.gravity_m_per_s2 * s * np.sin(angle)
    assert np.max(np.diff(energy)) < 1e-6
    assert energy[-1] < energy[0]


def stick_slip_scene(p: RotorParameters) -> Scene:
    speed = p.speed_rad_s(1.6)
    return Scene(SpeedHistory.constant(speed), start=locked_state(p, speed, 0.0, 0.5, 2.5))


def test_modes_do_not_depend_on_tolerance_or_method() -> None:
    p = rig(1e-4)
    runs = [simulate(p, stick_slip_scene(p), 4.0, a, m) for a in (1e-5, 1e-9) for m in ("explicit", "implicit")]
    sequences = [[(e.kind, e.pendulum) for e in r.events] for r in runs]
    assert len(sequences[0]) > 40
    assert all(s == sequences[0] for s in sequences)
    instants = np.array([[e.time_s for e in r.events] for r in runs])
    assert np.max(np.abs(instants[2] - instants[3])) < 1e-6
    for run in runs:
        assert np.max(np.abs(run.state - runs[-1].state)[:, 2:4]) <= run.error_estimate + runs[-1].error_estimate


def test_sticking_is_exact_and_sliding_has_the_stated_direction() -> None:
    p = rig(1e-4)
    motion = simulate(p, stick_slip_scene(p), 4.0, 1e-7, dense=True)
    seen = set()
    for pendulum in range(2):
        own = [e for e in motion.events if e.pendulum == pendulum]
        for now, then in pairwise(own):
            if then.time_s - now.time_s < 1e-3:
                continue
            inside = motion.at(np.linspace(now.time_s, then.time_s, 22)[1:-1])
            seen.add(now.kind)
            if now.kind == "stick":
                assert np.all(inside[:, 6 + pendulum] == 0.0)
                assert np.ptp(inside[:, 2 + pendulum]) == 0.0
            else:
                sign = 1 if now.kind == "slide forward" else -1
                assert np.all(sign * inside[:, 6 + pendulum] > -1e-6)
    assert seen == {"stick", "slide forward", "slide backward"}


def test_a_steep_smooth_law_comes_close() -> None:
    """An independent method on the sign of θ̇ rounded off below 0.1 mrad/s."""
    p = rig(1e-4)
    scene, packed = stick_slip_scene(p), p.packed()
    times = np.linspace(0, 0.8, 17)

    def right(t: float, y: np.ndarray) -> np.ndarray:
        out, smooth = np.empty(8), packed.copy()
        smooth[[FA, FB]] *= np.tanh(y[6:] / 1e-4)
        rates(y, *scene.history.phase(t)[0], smooth, 1.0, 1.0, out)
        return out

    assert scene.start is not None
    reference = solve_ivp(right, (0, 0.8), scene.start, "LSODA", times, rtol=1e-8, atol=1e-10).y.T
    motion = simulate(p, scene, times, 1e-8)
    assert len(motion.events) >= 5
    assert np.max(np.abs(motion.state - reference)[:, 2:4]) < 2e-4
    without = simulate(rig(0.0), scene, times, 1e-8)
    assert np.max(np.abs(without.state - reference)[:, 2:4]) > 1e-2


def test_friction_that_always_holds_is_a_lock() -> None:
    p = rig(0.05)
    scene = stick_slip_scene(p)
    held = simulate(p, scene, 2.0, 1e-9)
    locked = simulate(p, dataclasses.replace(scene, released=(False, False)), 2.0, 1e-9)
    assert held.events == ()
    assert np.max(np.abs(held.state - locked.state)) < 1e-8


@given(st.integers(0, 2**32 - 1))
def test_modes_at_rest_agree_with_themselves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rig(10 ** rng.uniform(-6, -2), gravity_m_per_s2=9.81, pivot_shift_m=2e-3).packed()
    y = rng.normal(size=8) * [0.01, 0.01, 2, 2, 0.3, 0.3, 0, 0]
    phase, free = np.array([0.3, rng.uniform(0, 80), rng.normal() * 20]), (True, True)
    modes = modes_at(y, phase, p, free)
    packed, free_a, free_b = with_modes(p, modes, free)
    out = np.empty(8)
    for i in range(2):
        torque = needed_torque(i, y, *phase, packed, free_a, free_b, out)
        if modes[i] == STUCK:
            assert abs(torque) <= abs(p[FA + i]) * phase[1] ** 2
        else:
            assert out[6 + i] * modes[i] * p[JA + i] >= 0.0
    sliding = modes_at(y + np.array([0, 0, 0, 0, 0, 0, 1.0, -1.0]), phase, p, free)
    assert sliding == (FORWARD, BACKWARD)
    with pytest.raises(NotConverged, match="no mode fits"):
        modes_at(y * np.nan, phase, p, free)


def test_the_holding_torque_is_what_moves_a_released_pendulum() -> None:
    """Without friction, torque over inertia is the acceleration up to the disk's share in it."""
    p = rig(0.0).packed()
    y, phase, out = np.array([1e-3, 2e-3, 0.4, 2.0, 0.1, 0.2, 0.0, 0.0]), (0.3, 30.0, 5.0), np.empty(8)
    rates(y, *phase, p, 1.0, 0.0, out)
    acceleration = out[6]
    torque = needed_torque(0, y, *phase, p, 1.0, 0.0, out)
    assert torque / p[JA] == pytest.approx(acceleration, rel=1e-12)
