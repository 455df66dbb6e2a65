"""The integrator against other integrators, closed forms, energies, and its own error bound."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.integrate import solve_ivp

from dynamics.equations.kernels import PACKED, rates
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.equations.phase_segments import PhaseSegments
from dynamics.equations.scene import Scene, time_at_speed
from dynamics.equations.sine_cosine import real_sine_cosine
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import DynamicsError, NotConverged, OutsideDomain
from dynamics.motions.batch import simulate_batch
from dynamics.motions.integrate import fastest_rate, integrate, locked_orbit, locked_state, simulate
from dynamics.motions.motion import Motion
from dynamics.motions.motion_problem import motion_problem
from dynamics.motions.trajectory import run

ARM = 0.054


def rig(
    damping: float = 1e-3, stiffness_ratio: float = 14.9, zeta: float = 0.02, mass: float = 0.075
) -> RotorParameters:
    total = 7.12 + 2 * mass
    k1 = total * (2 * math.pi * 3) ** 2
    pendulum = Pendulum(mass, ARM, damping)
    return RotorParameters(7.0, 0.12, 0.02117, pendulum, pendulum, k1, stiffness_ratio * k1, zeta, zeta)


def release(p: RotorParameters, speed_ratio: float = 1.6) -> Scene:
    speed = p.speed_rad_s(speed_ratio)
    return Scene(SpeedHistory.constant(speed), start=locked_state(p, speed, 0.0, 2e-3, math.pi - 1e-3))


def error_of(motion: Motion, reference: np.ndarray) -> float:
    """Largest error as Motion.error_estimate counts it."""
    return float(np.max(np.abs(motion.state - reference)[:, :4] / [ARM, ARM, 1.0, 1.0]))


def by_scipy(p: RotorParameters, scene: Scene, times: np.ndarray) -> np.ndarray:
    packed, history = p.packed(), scene.history
    free = [float(f) for f in scene.released]

    def right(t: float, y: np.ndarray) -> np.ndarray:
        out = np.empty(8)
        psi, speed, acceleration = history.phase(t)[0]
        rates(y, psi, speed, acceleration, packed, free[0], free[1], out)
        return out

    assert scene.start is not None
    return solve_ivp(right, times[[0, -1]], scene.start, "DOP853", times, rtol=1e-13, atol=1e-15).y.T


def by_heyoka(p: RotorParameters, scene: Scene, times: np.ndarray) -> np.ndarray:
    """Taylor series of order 20 on equations written down here, constant speed, no shift."""
    hy = pytest.importorskip("heyoka")
    names = ("x", "y", "a", "b", "vx", "vy", "va", "vb")
    x, y, a, b, vx, vy, va, vb = hy.make_vars(*names)
    psi0, speed, _ = scene.history.phase(times[0])[0]
    psi = psi0 + speed * (hy.time - float(times[0]))
    mass, (c1, c2) = p.total_mass_kg, p.damping_Ns_per_m
    forces = [-p.k1_N_per_m * x - c1 * vx, -p.k2_N_per_m * y - c2 * vy]
    forces = [
        forces[0] + p.imbalance_moment_kg_m * speed**2 * hy.cos(psi),
        forces[1] + p.imbalance_moment_kg_m * speed**2 * hy.sin(psi),
    ]
    matrix = [[mass + 0.0 * x, 0.0 * x], [0.0 * x, mass + 0.0 * x]]
    drawn = []
    for pendulum, angle, rate in ((p.a, a, va), (p.b, b, vb)):
        s, j, c = pendulum.first_moment_kg_m, pendulum.inertia_kg_m2, pendulum.damping_Nms_per_rad
        sine, cosine = hy.sin(psi + angle), hy.cos(psi + angle)
        phi_rate = speed + rate
        # J φ̈ = S n·q̈ − c θ̇;  push S (φ̇² e + φ̈ n), n = (sin, −cos)
        forces[0] += s * phi_rate**2 * cosine - s * c / j * rate * sine
        forces[1] += s * phi_rate**2 * sine + s * c / j * rate * cosine
        matrix[0][0] -= s**2 / j * sine**2
        matrix[1][1] -= s**2 / j * cosine**2
        matrix[0][1] += s**2 / j * sine * cosine
        drawn.append((s / j, c / j, sine, cosine, rate))
    matrix[1][0] = matrix[0][1]
    det = matrix[0][0] * matrix[1][1] - matrix[0][1] ** 2
    ax = (matrix[1][1] * forces[0] - matrix[0][1] * forces[1]) / det
    ay = (matrix[0][0] * forces[1] - matrix[0][1] * forces[0]) / det
    turning = [sj * (sine * ax - cosine * ay) - cj * rate for sj, cj, sine, cosine, rate in drawn]
    system = list(zip((x, y, a, b, vx, vy, va, vb), (vx, vy, va, vb, ax, ay, *turning), strict=True))
    assert scene.start is not None
    taylor = hy.taylor_adaptive(system, scene.start.tolist(), time=float(times[0]), tol=1e-16, compact_mode=True)
    return taylor.propagate_grid(times)[5]


@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_rates_of_a_complex_state_have_the_real_parts_of_a_real_one(seed: int, free_a: bool, free_b: bool) -> None:
    rng = np.random.default_rng(seed)
    y = rng.normal(size=8) * [0.01, 0.01, 30, 3, 0.5, 0.5, 20, 20]
    psi, speed, acceleration = rng.normal(size=3) * [1e3, 60, 20]
    packed = rig().packed() * rng.uniform(0.5, 2, PACKED)
    packed[12:20] = rng.uniform(0, [3e-3, 1e-3, 1e-3, 1e-6, 1e-6, 9.81, 1e-3, 1e-3])
    packed[20:] = rng.uniform(0, [1e4, 1e4, 1.0, 1.0, 1e-4, 1e-4])
    arguments = psi, speed, acceleration, packed, float(free_a), float(free_b)
    expected, found = np.empty(8), np.empty(8, complex)
    rates(y, *arguments, expected)
    rates(y + 1e-30j * rng.normal(size=8), *arguments, found)
    assert np.allclose(found.real, expected, rtol=1e-12, atol=1e-12 * np.max(np.abs(expected)))


@given(st.floats(-1e6, 1e6))
def test_sine_and_cosine_are_those_of_the_library(angle: float) -> None:
    found = real_sine_cosine(angle)
    assert np.allclose(found, [math.sin(angle), math.cos(angle)], rtol=0, atol=4e-16 + 1e-20 * abs(angle))


@pytest.mark.parametrize("method", ["explicit", "implicit"])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-7, 1e-10])
def test_twenty_seconds_after_a_release(method: str, accuracy: float) -> None:
    """Against an independent integrator on independently written equations."""
    p = rig()
    scene, times = release(p), np.linspace(0, 20, 301)
    reference = by_heyoka(p, scene, times)
    motion = simulate(p, scene, times, accuracy, method)
    error = error_of(motion, reference)
    assert error <= motion.error_estimate <= accuracy
    assert motion.error_estimate < 1e5 * error + 1e-12
    assert motion.method == method


def test_an_independent_method_agrees_through_a_ramp_with_locked_and_free_pendulums() -> None:
    p = dataclasses.replace(rig(), pivot_shift_m=2e-3, pivot_shift_compensated=False, gravity_m_per_s2=9.81)
    history = SpeedHistory.ramp(20.0, 80.0, 3.0)
    scene = Scene(history, (True, False), locked_state(p, 20.0, 0.0, 0.4, 2.0))
    times = np.linspace(0, 3.0, 101)
    motion = simulate(p, scene, times, 1e-9)
    assert error_of(motion, by_scipy(p, scene, times)) < 1e-9


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32 - 1))
def test_the_bound_holds_on_random_motions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, scene, times = random_motion(rng)
    accuracy = 10 ** rng.uniform(-9, -3)
    try:
        motion = simulate(p, scene, times, accuracy)
    except NotConverged:
        return
    assert motion.error_estimate <= accuracy
    problem = motion_problem(p, scene, times)
    loose, tight = (run(problem.problem, t, True, 10**6).states[problem.wanted] for t in (1e-12, 1e-13))
    reference_error = error_of(dataclasses.replace(motion, state=loose), tight)
    if reference_error < 0.2 * motion.error_estimate:
        assert error_of(motion, tight) <= motion.error_estimate


def random_motion(rng: np.random.Generator) -> tuple[RotorParameters, Scene, np.ndarray]:
    p = rig(10 ** rng.uniform(-4, 1.7), 10 ** rng.uniform(0, 1.3), 10 ** rng.uniform(-2.5, -0.5))
    speed = p.speed_rad_s(rng.uniform(0.3, 6.0))
    constant = SpeedHistory.constant(speed)
    history = constant if rng.random() < 0.5 else SpeedHistory.ramp(speed, speed * rng.uniform(0.3, 1.5), 1.5)
    start = locked_state(p, speed, 0.0, 0.5 * rng.normal(), math.pi + 0.5 * rng.normal())
    go = None if rng.random() < 0.7 else (rng.uniform(0, 3), rng.uniform(0, 3))
    return p, Scene(history, (True, True), start, go), np.linspace(0, 3.0, rng.integers(2, 200))


@pytest.mark.parametrize("kind", ["constant", "sagging", "shifted", "absent"])
def test_a_locked_motion_is_its_closed_form(kind: str) -> None:
    p = {
        "constant": rig(),
        "sagging": dataclasses.replace(rig(), gravity_m_per_s2=9.81),
        "shifted": dataclasses.replace(rig(), pivot_shift_m=3e-3, pivot_shift_compensated=False),
        "absent": dataclasses.replace(rig(), a=Pendulum.absent(), b=Pendulum.absent()),
    }[kind]
    speed, times = 45.0, np.linspace(1.0, 3.0, 50)
    history = SpeedHistory.constant(speed, 0.3, 1.0)
    released = (kind == "absent",) * 2
    motion = simulate(p, Scene(history, released, locked_state(p, speed, 0.3, 0.7, 2.5)), times, 1e-11)
    closed = np.array([locked_state(p, speed, psi, 0.7, 2.5) for psi in 0.3 + speed * (times - 1.0)])
    assert np.allclose(motion.state[:, :4], closed[:, :4], rtol=0, atol=1e-11)
    assert np.allclose(motion.state[:, 4:], closed[:, 4:], rtol=0, atol=1e-9)


def test_an_uncompensated_shift_is_imbalance_of_the_locked_rig() -> None:
    p = dataclasses.replace(rig(), pivot_shift_m=3e-3, pivot_shift_compensated=False)
    more = p.with_values(SP_kg_m=p.imbalance_moment_kg_m + 0.15 * 3e-3)
    plain = dataclasses.replace(more, pivot_shift_m=0.0)
    assert np.allclose(locked_orbit(p, 40.0, 0.3, 2.0), locked_orbit(plain, 40.0, 0.3, 2.0), rtol=1e-13)


def test_balls_move_like_pendulums_of_their_inertia_at_constant_speed() -> None:
    """At constant speed only J θ̈, S and c enter: a ball is a pendulum of mass M/(1 + κ), arm R (1 + κ), S kept."""
    p = rig()
    ball = Pendulum(0.075, ARM, 1e-3, ball_radius_m=0.01)
    stand_in = Pendulum(0.075 / 1.4, ARM * 1.4, 1e-3)
    rotor = p.rotor_mass_kg + 2 * 0.075 * (1 - 1 / 1.4)  # the same total mass
    balls = dataclasses.replace(p, a=ball, b=ball)
    pendulums = dataclasses.replace(p, rotor_mass_kg=rotor, a=stand_in, b=stand_in)
    assert balls.total_mass_kg == pytest.approx(pendulums.total_mass_kg, rel=1e-15)
    scene = release(p)
    one, other = (simulate(q, scene, np.linspace(0, 5, 100), 1e-9).state for q in (balls, pendulums))
    assert np.allclose(one, other, rtol=0, atol=1e-6)
    assert np.max(np.abs(one - simulate(p, scene, np.linspace(0, 5, 100), 1e-9).state)) > 1e-3


def test_energy_stays_without_damping_on_a_resting_rotor() -> None:
    """Rotor at rest under gravity, no damping: kinetic, spring and height energies of all masses add to a constant."""
    p = dataclasses.replace(rig(0.0, 14.9, 0.0), gravity_m_per_s2=9.81)
    start = np.array([2e-3, -1e-3, 1.2, -0.4, 0.0, 0.05, 3.0, -1.0])
    motion = simulate(p, Scene(SpeedHistory.constant(0.0), start=start), np.linspace(0, 3, 400), 1e-9)
    x, y, a, b, vx, vy, va, vb = motion.state.T
    energy = 0.5 * (p.total_mass_kg) * (vx**2 + vy**2) + 0.5 * (p.k1_N_per_m * x**2 + p.k2_N_per_m * y**2)
    energy += p.total_mass_kg * 9.81 * y
    for pendulum, angle, rate in ((p.a, a, va), (p.b, b, vb)):
        s, j = pendulum.first_moment_kg_m, pendulum.inertia_kg_m2
        energy += 0.5 * j * rate**2 + s * rate * (vy * np.cos(angle) - vx * np.sin(angle)) + 9.81 * s * np.sin(angle)
    assert np.ptp(energy) < 1e-8
    assert np.ptp(a) > 1.0


def test_polynomials_between_the_instants_are_as_accurate() -> None:
    p = rig()
    scene = release(p)
    motion = simulate(p, scene, np.linspace(0, 5, 11), 1e-8, dense=True)
    fine = np.linspace(0, 5, 2000)
    assert np.max(np.abs(motion.at(fine) - simulate(p, scene, fine, 1e-11).state)[:, :4] / [ARM, ARM, 1, 1]) < 1e-8
    assert np.array_equal(motion.at(motion.time_s), motion.state)
    with pytest.raises(OutsideDomain, match="covers"):
        motion.at(5.1)
    with pytest.raises(OutsideDomain, match="dense=True"):
        simulate(p, scene, 1.0).at(0.5)


def test_crossings_are_located() -> None:
    p = rig()
    motion = simulate(p, release(p), np.linspace(0, 5, 11), 1e-10, dense=True)
    found = motion.crossings(0, 1e-4)
    up, down = motion.crossings(0, 1e-4, 1), motion.crossings(0, 1e-4, -1)
    assert np.allclose(motion.at(found)[:, 0], 1e-4, rtol=0, atol=1e-14)
    assert np.array_equal(np.sort(np.r_[up, down]), found)
    assert np.all(motion.at(up)[:, 4] > 0)
    samples = motion.at(np.linspace(0, 5, 20001))[:, 0] > 1e-4
    assert len(found) == np.count_nonzero(np.diff(samples)) > 10


def test_release_in_the_middle_of_a_run() -> None:
    """Locked up to the release, then the same as a run that starts there."""
    p = rig()
    history = SpeedHistory.ramp(25.0, 35.0, 4.0)
    at = time_at_speed(history, 30.0, 0.0, 4.0)
    assert at == pytest.approx(2.0)
    start = locked_state(p, 25.0, 0.0, 0.4, 2.0)
    times = np.linspace(0, 4, 201)
    motion = simulate(p, Scene(history, (True, True), start, (at, 3.0)), times, 1e-9)
    assert [(e.time_s, e.kind, e.pendulum) for e in motion.events] == [(at, "release", 0), (3.0, "release", 1)]
    assert np.all(motion.angles_rad[times <= at, 0] == 0.4)
    assert np.all(motion.angles_rad[times <= 3.0, 1] == 2.0)
    assert abs(motion.angles_rad[-1, 0] - 0.4) > 0.1
    middle = np.searchsorted(times, at)
    rest = simulate(p, Scene(history, (True, True), motion.state[middle], (at, 3.0)), times[middle:], 1e-9)
    assert error_of(rest, motion.state[middle:]) < 1e-7
    with pytest.raises(OutsideDomain, match="does not pass"):
        time_at_speed(history, 50.0, 0.0, 4.0)


def test_the_rotors_stop_is_an_event() -> None:
    history = SpeedHistory.ramp(20.0, -5.0, 5.0)
    motion = simulate(rig(), Scene(history, (False, False)), np.linspace(0, 5, 3), 1e-6)
    assert [(e.kind, e.time_s) for e in motion.events] == [("stop", pytest.approx(4.0, rel=1e-12))]


def test_knots_that_matter_are_landed_on_and_others_are_not() -> None:
    """A spline through exact phases of a constant speed has a thousand knots that do not matter."""
    p = rig()
    scene = release(p)
    marks = np.linspace(-1, 6, 1000)
    speed = p.speed_rad_s(1.6)
    measured = dataclasses.replace(scene, history=SpeedHistory.from_phases(marks, speed * marks))
    times = np.linspace(0, 5, 50)
    plain, splined = simulate(p, scene, times, 1e-6), simulate(p, measured, times, 1e-6)
    assert splined.steps < 2 * plain.steps
    assert error_of(plain, splined.state) < 2e-6
    ramp = dataclasses.replace(scene, history=SpeedHistory.ramp(speed, 1.1 * speed, 1.234))
    starts = simulate(p, ramp, np.linspace(0, 2, 50), 1e-6, dense=True).polynomials
    assert starts is not None
    assert 1.234 in starts.spans[:, 0]
    rng = np.random.default_rng(1)
    rough = SpeedHistory.from_phases(marks[::10], speed * marks[::10] + 1e-3 * rng.normal(size=100))
    scene = dataclasses.replace(scene, history=rough)
    motion = simulate(p, scene, times, 1e-7)
    tight = simulate(p, scene, times, 1e-10)
    assert error_of(motion, tight.state) <= motion.error_estimate <= 1e-7


@pytest.mark.parametrize(("rate_rpm_s", "seconds"), [(1000.0, 1.05), (10.0, 105.0), (0.1, 300.0)])
def test_ramps_through_resonance(rate_rpm_s: float, seconds: float) -> None:
    """Locked pendulums: a linear oscillator under a sweep, against the fixed-step method at a hundredth of its step."""
    p, rpm = rig(), math.pi / 30
    history = SpeedHistory.ramp(150 * rpm, (150 + rate_rpm_s * seconds) * rpm, seconds)
    start = locked_state(p, 150 * rpm, 0.0, 0.0, 2.0)
    motion = simulate(p, Scene(history, (False, False), start), np.linspace(0, seconds, 9), 1e-7)
    step = 0.02 / fastest_rate(p, 1200 * rpm, (False, False))
    fixed = integrate(start, motion.time_s, step, history.knots_s, history.coefficients, p.packed(), 0.0, 0.0)
    assert error_of(motion, fixed) < 2e-6


def test_strong_magnets_are_integrated_implicitly() -> None:
    p = rig(50.0)
    motion = simulate(p, release(p), 2.0, 1e-8)
    assert motion.method == "implicit"
    assert "fastest decay 2.29e+05 /s" in motion.why
    explicit = simulate(p, release(p), 2.0, 1e-8, "explicit")
    assert explicit.steps > 50 * motion.steps
    assert error_of(motion, explicit.state) < 2e-8
    assert simulate(rig(), release(rig()), 2.0, 1e-8).method == "explicit"


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(
    masses=st.tuples(*2 * [st.one_of(st.just(0.0), st.floats(-9, 0.85).map(lambda e: 10**e))]),
    damping=st.floats(-6, 1.7).map(lambda e: 10**e),
    stiffness_ratio=st.floats(0, 4).map(lambda e: 10**e),
    zeta=st.floats(0, 2),
    moment=st.one_of(st.just(0.0), st.floats(-9, -1).map(lambda e: 10**e)),
    speed=st.floats(0, 150),
    friction=st.one_of(st.just(0.0), st.floats(-7, -2).map(lambda e: 10**e)),
    gravity=st.sampled_from([0.0, 9.81]),
)
def test_the_whole_domain_is_answered_or_refused(
    masses: tuple[float, float],
    damping: float,
    stiffness_ratio: float,
    zeta: float,
    moment: float,
    speed: float,
    friction: float,
    gravity: float,
) -> None:
    a, b = (Pendulum(m, ARM, damping, friction) for m in masses)
    k1 = 7.12 * 18.85**2
    p = RotorParameters(7.0, 0.12, moment / 0.12, a, b, k1, stiffness_ratio * k1, zeta, zeta, 1e-3, False, gravity)
    scene = Scene(SpeedHistory.constant(speed), start=locked_state(p, speed, 0.0, 0.3, 2.5))
    try:
        motion = simulate(p, scene, np.linspace(0, 0.5, 11), 1e-6, work_limit=300_000)
    except DynamicsError:
        return
    assert np.all(np.isfinite(motion.state))
    assert motion.error_estimate <= 1e-6


def test_work_beyond_the_limit_is_refused_with_its_size() -> None:
    p = rig()
    with pytest.raises(NotConverged, match=r"need about .* steps, the limit is .*work_limit"):
        simulate(p, release(p), np.array([0.0, 1e9]), 1e-3)
    with pytest.raises(NotConverged, match=r"steps brought the motion .*work_limit"):
        simulate(p, release(p), 20.0, 1e-9, work_limit=2500)


def test_a_motion_that_cannot_be_foretold_is_refused() -> None:
    """Pendulums that slip through a slow ramp: neighbours separate by more than double precision holds."""
    p, rpm = rig(), math.pi / 30
    scene = Scene(SpeedHistory.ramp(150 * rpm, 1200 * rpm, 1050.0))
    with pytest.raises(NotConverged, match=r"error bound .* diverge"):
        simulate(p, scene, np.array([0.0, 1050.0]), 1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"accuracy": 0.0}, "accuracy"),
        ({"accuracy": math.nan}, "accuracy"),
        ({"time_s": -1.0}, "duration"),
        ({"time_s": np.array([1.0, 0.0])}, "runs backwards"),
        ({"method": "euler"}, "method"),
    ],
)
def test_what_means_nothing_is_refused(change: dict[str, object], message: str) -> None:
    arguments = {"time_s": 1.0, "accuracy": 1e-6} | change
    with pytest.raises(OutsideDomain, match=message):
        simulate(rig(), release(rig()), **arguments)
    with pytest.raises(OutsideDomain, match="eight finite"):
        simulate(rig(), Scene(SpeedHistory.constant(1.0), start=np.zeros(7)), 1.0)


def test_a_duration_gives_two_hundred_samples_a_second() -> None:
    class Rig:
        physics = rig()

    motion = simulate(Rig(), release(rig()), 0.5, 1e-3)
    assert np.allclose(motion.time_s, np.arange(101) / 200)
    assert motion.state.shape == (101, 8)


def test_rates_of_absent_and_locked_pendulums_do_not_count() -> None:
    p = rig(50.0)
    assert fastest_rate(p, 0.0) == pytest.approx(50.0 / (0.075 * ARM**2))
    own = max(p.natural_frequencies_rad_s)
    assert fastest_rate(p, 0.0, (False, False)) == own
    assert fastest_rate(dataclasses.replace(p, a=Pendulum.absent(), b=Pendulum.absent()), 0.0) < 2 * own


def test_phases_of_segments_are_those_of_the_history() -> None:
    rng = np.random.default_rng(0)
    history = SpeedHistory.from_phases(np.cumsum(rng.uniform(0.1, 1, 9)), np.cumsum(rng.uniform(1, 5, 9)))
    segments = PhaseSegments.of(history)
    times = np.linspace(history.knots_s[0] - 1, history.knots_s[-1] + 1, 101)
    assert np.allclose([segments.phase(t) for t in times], history.phase(times), rtol=1e-12, atol=1e-12)


def test_a_batch_is_its_single_runs_and_failures_are_flagged() -> None:
    scene, rng = release(rig()), np.random.default_rng(3)
    parameters = [rig(1e-3 * rng.uniform(0.9, 1.1), 14.9 * rng.uniform(0.9, 1.1)) for _ in range(6)]
    times, seen = np.linspace(0, 4, 21), []
    broken = dataclasses.replace(scene, start=np.full(8, np.nan))
    scenes = [scene] * 5 + [broken]
    batch = simulate_batch(parameters, scenes, times, 1e-7, lambda done, of: seen.append((done, of)))
    assert batch.ok.tolist() == [True] * 5 + [False]
    assert seen[-1] == (6, 6)
    assert "eight finite" in str(batch.failures[5])
    assert np.all(np.isnan(batch.states[5]))
    assert np.isinf(batch.error_estimates[5])
    for i in range(5):
        single = simulate(parameters[i], scene, times, 1e-7)
        assert np.array_equal(batch.states[i], single.state)
        assert batch.error_estimates[i] == single.error_estimate
    last = simulate_batch(parameters[:2], scene, times, 1e-7, last_only=True)
    assert np.array_equal(last.states[:, 0], batch.states[:2, -1])
    with pytest.raises(OutsideDomain, match="as many"):
        simulate_batch(parameters, scenes[:2], times)


def test_a_long_run_that_separates_is_refused_from_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 1e6 rad/s neighbouring motions of free pendulums diverge in hundredths of a second: a second is refused."""
    followed: list[float] = []

    def counted(problem, *args):
        followed.append(float(problem.times[-1] - problem.times[0]))
        return run(problem, *args)

    monkeypatch.setattr("dynamics.motions.integrate.run", counted)
    fast = dataclasses.replace(release(rig()), history=SpeedHistory.constant(1e6), start=None)
    with pytest.raises(NotConverged, match=r"within the first .* too fast"):
        simulate(rig(), fast, 1.0)
    assert max(followed) < 0.05
    followed.clear()
    simulate(rig(), release(rig()), 1.0)  # a short run is followed whole, at once
    assert min(followed) == 1.0
