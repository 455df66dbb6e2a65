"""The independent laboratory: its motion against closed forms, known steady states and the suite's own equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from benchmarks.worlds import Effects, Spread, World, campaign_tests, draw_world, record, with_effect
from benchmarks.worlds.motion import STEP_S, Mechanics, SwingingMass, Turning, moved
from benchmarks.worlds.recording import wander
from benchmarks.worlds.world import WRONG
from dynamics import Scene, SpeedHistory, simulate
from tests.dynamics.nominal import rig as nominal

FINE_S = 2.5e-5
BOTH = np.array([0.0, math.pi])


def mechanics(
    damping: float = 1e-3,
    zeta: float = 0.02,
    mass_b: float = 0.075,
    stiffness_ratio: float = 14.9,
    moment: float = 0.12 * 0.02117,
) -> Mechanics:
    """The nominal rig."""
    mass = 7.195 + mass_b
    k = np.array([1.0, stiffness_ratio]) * mass * (6 * math.pi) ** 2
    c = 2 * zeta * np.sqrt(k * mass)
    a, b = (SwingingMass(m, 0.054, damping) for m in (0.075, mass_b))
    return Mechanics(mass, (k[0], k[1]), (c[0], c[1]), moment, a, b)


def orbit(m: Mechanics, speed: float, phase: float = 0.0, locked: np.ndarray = BOTH) -> np.ndarray:
    """State on the locked orbit, shape (8,)."""
    x, y = (a * np.exp(1j * phase) for a in m.locked_orbit(speed, locked))
    return np.r_[x.real, y.real, locked, (1j * speed * x).real, (1j * speed * y).real, 0.0, 0.0]


def energy(m: Mechanics, state: np.ndarray) -> np.ndarray:
    """Of disk, springs that harden and pendulums, rotor at rest at ψ = 0."""
    x, y, vx, vy = state[:, 0], state[:, 1], state[:, 4], state[:, 5]
    whole = 0.5 * (m.mass_kg - m.a.mass_kg - m.b.mass_kg) * (vx**2 + vy**2)
    for i, own in enumerate((m.a, m.b)):
        phi, rate = state[:, 2 + i], state[:, 6 + i] * own.length_m
        whole = whole + 0.5 * own.mass_kg * ((vx - rate * np.sin(phi)) ** 2 + (vy + rate * np.cos(phi)) ** 2)
    for u, k, kappa in zip((x, y), m.stiffness_N_per_m, m.hardening_per_m2, strict=True):
        whole = whole + 0.5 * k * u**2 * (1 + 0.5 * kappa * u**2)
    return whole


def test_without_damping_the_energy_stays() -> None:
    """Springs that harden by 10 %, pendulums that are flicked: coupled as nothing in a campaign is."""
    m = replace(mechanics(damping=0.0, zeta=0.0), hardening_per_m2=(1.6e4, 1.6e4))
    start = np.array([2e-3, -1e-3, 0.3, 2.0, 0.01, 0.02, 30.0, -40.0])
    whole = energy(m, moved(m, Turning.steady(0.0, 0.0), np.linspace(0, 2, 401), start, True, FINE_S))
    assert np.ptp(whole) / whole[0] < 1e-9


@settings(max_examples=10, deadline=None)
@given(zeta=st.floats(1e-3, 0.2), ratio=st.floats(0.5, 15.0))
def test_locked_pendulums_ring_down_by_the_closed_form(zeta: float, ratio: float) -> None:
    m = mechanics(zeta=zeta, stiffness_ratio=ratio)
    time = np.linspace(0, 2, 501)
    found = moved(m, Turning.steady(0.3, 0.0), time, np.r_[2e-3, 1e-3, BOTH, np.zeros(4)], False, FINE_S)
    for axis, start in enumerate((2e-3, 1e-3)):
        natural = math.sqrt(m.stiffness_N_per_m[axis] / m.mass_kg)
        damped = natural * math.sqrt(1 - zeta**2)
        shape = np.cos(damped * time) + zeta * natural / damped * np.sin(damped * time)
        assert np.allclose(found[:, axis], start * np.exp(-zeta * natural * time) * shape, atol=1e-12)


def test_the_locked_orbit_stays_and_a_ramp_passes_the_resonance() -> None:
    """On its orbit, of a bent shaft too, the locked rig stays; on a ramp it is largest near a natural frequency."""
    m = replace(mechanics(), bow_m=1e-4, bow_rad=1.0)
    time = np.linspace(0, 2, 401)
    x, y = m.locked_orbit(40.0, BOTH)
    turn = np.exp(1j * (0.5 + 40.0 * time))
    found = moved(m, Turning.steady(0.5, 40.0), time, orbit(m, 40.0, 0.5), False, FINE_S)
    assert np.allclose(found[:, :2], np.column_stack([(x * turn).real, (y * turn).real]), atol=1e-11)
    turning = Turning.ramp(0.0, 0.5, 30.0, 60.0)
    grid = np.arange(0.0, 60.0, 1e-3)
    up = moved(mechanics(), turning, grid, np.r_[0.0, 0.0, BOTH, np.zeros(4)], False)
    assert turning.phase(grid)[1][np.argmax(np.abs(up[:, 0]))] == pytest.approx(6 * math.pi, rel=0.1)  # it lags


@pytest.mark.parametrize(
    ("ratio", "moment", "mass_b", "theta_deg", "radius_mm", "opposed"),
    [
        (0.8, 0.12 * 0.02117, 0.075, 303.708, 2.325497, 0.0),
        (2.5, 0.012, 0.075, 180.886, 0.638397, 0.0),
        (2.5, 0.001, 0.019, 174.456, 0.334778, math.pi),
    ],
)
def test_isotropic_states_of_types_II_and_III(
    ratio: float, moment: float, mass_b: float, theta_deg: float, radius_mm: float, opposed: float
) -> None:
    """Known values, and the closed form z = ω² H (S_P + S_T e^{iθ})."""
    m = mechanics(zeta=0.05, moment=moment, mass_b=mass_b, stiffness_ratio=1.0)
    speed = ratio * 6 * math.pi
    start = np.radians([theta_deg - 10, theta_deg - 5]) + np.array([0.0, opposed])
    last = moved(m, Turning.steady(0.0, speed), np.array([0.0, 100.0]), orbit(m, speed, 0.0, start), True)[-1]
    assert np.degrees(last[2]) % 360 == pytest.approx(theta_deg, abs=1e-3)
    assert np.degrees(last[3] - opposed) % 360 == pytest.approx(theta_deg, abs=1e-3)
    assert 1e3 * np.hypot(last[0], last[1]) == pytest.approx(radius_mm, abs=1e-5)
    s_t = m.a.mass_kg * 0.054 + math.cos(opposed) * m.b.mass_kg * 0.054
    h = 1 / (m.stiffness_N_per_m[0] - m.mass_kg * speed**2 + 1j * speed * m.damping_Ns_per_m[0])
    z = speed**2 * h * (moment + s_t * np.exp(1j * last[2]))
    assert (last[0] + 1j * last[1]) * np.exp(-100j * speed) == pytest.approx(z, abs=1e-9)


@pytest.mark.parametrize("name", "ABCDE")
def test_points_end_in_their_states(name: str) -> None:
    """I at B, C, E: S (e^{iθ3} + e^{iθ4}) = −S_P and no vibration; pendulums together at A, D."""
    world = draw_world(3, Spread.exact())
    run = record(world, 3, f"point-{name}")
    theta = run.angle_rad[run.angle_time_s > run.angle_time_s[-1] - 2].mean(axis=0)
    m = world.mechanics
    if name in "AD":
        assert abs(np.angle(np.exp(1j * (theta[0] - theta[1])))) < math.radians(0.3)
    else:
        arm = m.a.mass_kg * m.a.length_m
        away = math.acos(m.moment_kg_m / (2 * arm))
        assert sorted(theta % (2 * math.pi)) == pytest.approx([math.pi - away, math.pi + away], abs=2e-3)
        late = run.x_time_s > run.x_time_s[-1] - 2
        assert np.std(run.x_m[late]) == pytest.approx(world.effects.noise_m, rel=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_trajectories_agree_with_the_suites_dynamics(seed: int) -> None:
    """The one comparison with it: constant speed and ramp, free and locked, two seconds, 1e-8 of the largest value."""
    rng = np.random.default_rng(seed)
    physics, m = nominal(damping=2e-3), mechanics(damping=2e-3)
    assert m.stiffness_N_per_m[0] == pytest.approx(physics.k1_N_per_m, rel=1e-12)
    speed = float(rng.uniform(10, 110))
    start = np.r_[
        1e-3 * rng.standard_normal(2), rng.uniform(-3, 3, 2), 0.02 * rng.standard_normal(2), 5 * rng.standard_normal(2)
    ]
    time, free = np.linspace(0, 2, 201), seed < 4
    start[6:] *= free
    if seed % 2:
        history, turning = SpeedHistory.constant(speed, 0.4), Turning.steady(0.4, speed)
    else:
        history, turning = SpeedHistory.ramp(0.0, speed, 4.0), Turning.ramp(0.0, 0.0, speed, 4.0)
    theirs = simulate(physics, Scene(history, (free, free), start), time, 1e-10)
    ours = moved(m, turning, time, start, free, FINE_S)
    assert np.max(np.abs(ours[:, :2] - theirs.displacement_m)) < 1e-8 * np.max(np.abs(ours[:, :2]))
    assert np.max(np.abs(ours[:, 2:4] - theirs.angles_rad)) < 1e-8 * np.max(np.abs(ours[:, 2:4]))


@settings(max_examples=20, deadline=None)
@given(damping=st.floats(1e-4, 3e-3), dry=st.floats(1e-5, 3e-3), speed=st.floats(1.0, 15.0))
def test_dry_friction_stops_a_pendulum_by_the_closed_form(damping: float, dry: float, speed: float) -> None:
    """On a disk that hardly moves J θ̈ = −c θ̇ − T: it stops at (J/c) ln(1 + c θ̇0/T) and stays."""
    own = SwingingMass(0.075, 0.054, damping, dry_Nm=dry)
    m = Mechanics(1e9, (1e9, 1e9), (0.0, 0.0), 0.0, own, SwingingMass(0.075, 0.054, damping, dry_Nm=dry))
    inertia = 0.075 * 0.054**2
    stop = inertia / damping * math.log(1 + damping * speed / dry)
    time = np.linspace(0, 1.5 * stop, 300)
    found = moved(m, Turning.steady(0.0, 0.0), time, np.array([0.0, 0.0, 0.1, 0.2, 0.0, 0.0, speed, -speed]), True)
    since = np.minimum(time, stop)
    rate = (speed + dry / damping) * np.exp(-damping / inertia * since) - dry / damping
    assert np.allclose(found[:, 6], rate, atol=1e-5 * speed)
    assert np.allclose(found[:, 7], -rate, atol=1e-5 * speed)
    assert np.all(found[time > 1.001 * stop, 6:] == 0.0)


@pytest.mark.parametrize("name", ["drag_Nms2_per_rad2", "contact_kg_m2"])
def test_a_torque_with_the_square_of_the_speed_slows_by_the_closed_form(name: str) -> None:
    """On a rotor at rest J θ̈ = −c θ̇ − d θ̇²: θ̇ = c θ̇0 e / (c + d θ̇0 (1 − e)) with e = exp(−c t/J)."""
    c, d, speed = 1e-3, 2e-5, 12.0
    own = replace(SwingingMass(0.075, 0.054, c), **{name: d})
    m = Mechanics(1e9, (1e9, 1e9), (0.0, 0.0), 0.0, own, own)
    time = np.linspace(0, 0.5, 101)
    found = moved(m, Turning.steady(0.0, 0.0), time, np.array([0.0, 0.0, 0.1, 0.2, 0.0, 0.0, speed, -speed]), True)
    e = np.exp(-c * time / (0.075 * 0.054**2))
    rate = c * speed * e / (c + d * speed * (1 - e))
    assert np.allclose(found[:, 6], rate, atol=1e-7)
    assert np.allclose(found[:, 7], -rate, atol=1e-7)


def test_air_turns_with_the_disk_and_contact_goes_with_the_whole_speed() -> None:
    """On a turning rotor the same two differ: J θ̈ = −c θ̇ − d |θ̇| θ̇, or − F (ω + θ̇)² as on a pendulum that slides on."""
    c, d, speed, time = 1e-3, 2e-5, 5.0, np.linspace(0, 0.1, 101)
    start = np.array([0.0, 0.0, 0.1, 0.2, 0.0, 0.0, speed, speed])
    for name in ("drag_Nms2_per_rad2", "contact_kg_m2"):
        own = replace(SwingingMass(0.075, 0.054, c), **{name: d})
        m = Mechanics(1e9, (1e9, 1e9), (0.0, 0.0), 0.0, own, own)
        found = moved(m, Turning.steady(0.0, 20.0), time, start, True)[:, 6]
        seen = d * ((20.0 if name == "contact_kg_m2" else 0.0) + speed) ** 2
        slope = -(c * speed + seen) / (0.075 * 0.054**2)
        assert (found[1] - found[0]) / time[1] == pytest.approx(slope, rel=0.01)


def test_friction_holds_until_the_torque_is_above_it() -> None:
    """Enough friction of either kind holds both pendulums on the locked orbit; hardly any changes the motion little."""
    m = mechanics()
    stuck = replace(m, a=replace(m.a, dry_Nm=1.0), b=replace(m.b, contact_kg_m2=1e-3))
    loose = replace(m, a=replace(m.a, dry_Nm=1e-6), b=replace(m.b, contact_kg_m2=1e-10))
    time = np.linspace(0, 1, 101)
    start = orbit(m, 100.0, 0.0, BOTH + 0.1)
    assert np.all(moved(stuck, Turning.steady(0.0, 100.0), time, start, True)[:, 6:] == 0.0)
    freed = moved(loose, Turning.steady(0.0, 100.0), time, start, True)
    plain = moved(m, Turning.steady(0.0, 100.0), time, start, True)
    assert np.allclose(freed[:, 2:4], plain[:, 2:4], atol=5e-3)
    assert np.max(np.abs(freed[:, 2:4] - plain[:, 2:4])) > 1e-6


def laser(effect: str, test: str = "ring-down-x", seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Times, and what an effect adds to laser x."""
    world = draw_world(seed)
    with_it = record(replace(world, effects=with_effect(effect)), seed, test)
    return with_it.x_time_s, with_it.x_m - record(world, seed, test).x_m


def test_disturbances_of_the_lasers_have_their_strength() -> None:
    time, hum = laser("hum=30e-6")
    for frequency, share in ((50, 1.0), (100, 0.4), (150, 0.2)):
        assert 2 * abs(np.mean(hum * np.exp(-2j * math.pi * frequency * time))) == pytest.approx(
            30e-6 * share, rel=0.02
        )
    assert np.std(laser("wander")[1]) == pytest.approx(1e-5, rel=1e-6)
    assert np.std(laser("noise=20e-6")[1]) == pytest.approx(16e-6, rel=0.02)
    time, runout = laser("runout", "run-up")
    assert np.max(runout[time > 30]) == pytest.approx(1e-4, rel=0.01)
    assert np.std(laser("runout")[1]) < 1e-12  # at rest it is an offset


def test_wander_has_as_much_power_in_every_octave() -> None:
    noise = wander(2**18, 1e-3, np.random.default_rng(1))
    power = np.abs(np.fft.rfft(noise)) ** 2
    frequency = np.fft.rfftfreq(2**18, 1e-3)
    octaves = [power[(frequency >= f) & (frequency < 2 * f)].sum() for f in (1, 4, 16, 64)]
    assert np.allclose(octaves, octaves[0], rtol=0.2)


def test_what_the_node_sends() -> None:
    world = draw_world(5)
    usual = record(world, 5, "point-C")
    fewer = record(replace(world, effects=with_effect("gaps=20")), 5, "point-C")
    assert len(fewer.angle_time_s) < 0.97 * len(usual.angle_time_s)
    stepped = record(replace(world, effects=with_effect("phase_step")), 5, "point-C")
    steps = stepped.phase_rad / math.radians(0.1)
    assert np.allclose(steps, np.round(steps), atol=1e-5)
    assert np.allclose(
        np.interp(stepped.mark_time_s, usual.mark_time_s, usual.mark_phase_rad)[1:-1],
        stepped.mark_phase_rad[1:-1],
        atol=math.radians(0.1),
    )
    noisy = record(replace(world, effects=with_effect("speed_noise")), 5, "point-C")
    assert not noisy.phase_absolute
    assert usual.phase_absolute
    speed = np.diff(noisy.phase_rad) / np.diff(noisy.phase_time_s) * 30 / math.pi
    assert np.std(speed) == pytest.approx(0.2 / math.sqrt(2), rel=0.05)  # the mean of two readings
    creeping = record(replace(world, effects=with_effect("creep")), 5, "spin-down")
    still = record(world, 5, "spin-down")
    assert len(creeping.mark_time_s) == len(still.mark_time_s) == 0
    assert not np.array_equal(creeping.angle_rad, still.angle_rad)


def test_a_seed_draws_one_world_and_effects_move_nothing_else() -> None:
    world, other = draw_world(7), draw_world(7, effects=Effects(hum_m=1e-5, cubic=0.01))
    assert world.truth == other.truth
    assert draw_world(8).truth != world.truth
    one, same = record(world, 1, "spin-down"), record(world, 1, "spin-down")
    assert np.array_equal(one.angle_rad, same.angle_rad)
    hummed = record(replace(world, effects=Effects(hum_m=1e-5)), 1, "spin-down")
    assert np.array_equal(one.angle_rad, hummed.angle_rad)
    assert not np.array_equal(one.angle_rad, record(world, 2, "spin-down").angle_rad)


def test_what_is_drawn_has_its_spread() -> None:
    worlds = [draw_world(seed, Spread.weighed()) for seed in range(300)]

    def spread(values: list[float]) -> float:
        return float(np.std(values))

    assert spread([w.mechanics.b.mass_kg for w in worlds]) == pytest.approx(0.075 * 5e-4, rel=0.15)
    assert spread([w.mechanics.a.length_m for w in worlds]) == pytest.approx(0.054 * 5e-4, rel=0.15)
    assert spread([w.clock["laser_x"] for w in worlds]) == pytest.approx(30e-6, rel=0.15)
    assert spread([w.zero_rad[1] for w in worlds]) == pytest.approx(math.radians(0.05), rel=0.15)
    assert spread([w.gain[0] for w in worlds]) == pytest.approx(1e-3, rel=0.15)
    exact = draw_world(1, Spread.exact())
    assert exact.mechanics.mass_kg == exact.rig.physics.total_mass_kg
    common = draw_world(1, replace(Spread.exact(), balance=1e-3))
    assert common.mechanics.a.mass_kg / 0.075 == pytest.approx(common.mechanics.mass_kg / exact.mechanics.mass_kg)


@pytest.mark.parametrize("name", WRONG)
def test_one_number_is_wrong_and_no_other(name: str) -> None:
    world = draw_world(2)
    wrong = world.changed(name, 1e-5)

    def numbers(of: World) -> dict[str, float]:
        return of.truth | {
            "mass_b": of.mechanics.b.mass_kg,
            "length_b": of.mechanics.b.length_m,
            "zero_a": of.zero_rad[0],
            "zero_b": of.zero_rad[1],
            "gain_x": of.gain[0],
        }

    before, after = numbers(world), numbers(wrong)
    moved_by = {n: after[n] - before[n] for n in before if after[n] != before[n]}
    assert moved_by == pytest.approx({WRONG[name] or name: 1e-5}, rel=1e-3)
    assert wrong.mechanics.mass_kg - world.mechanics.mass_kg == pytest.approx(
        1e-5 if name == "mass_b" else 0.0, abs=1e-14
    )
    c = wrong.mechanics.damping_Ns_per_m[0]
    assert c == pytest.approx(
        2 * wrong.zeta[0] * math.sqrt(wrong.mechanics.stiffness_N_per_m[0] * wrong.mechanics.mass_kg)
    )


def test_what_does_not_exist_is_refused() -> None:
    world = draw_world(0)
    with pytest.raises(ValueError, match="point-A"):
        record(world, 0, "point-Z")
    with pytest.raises(ValueError, match="mass_b"):
        world.changed("colour", 1.0)
    with pytest.raises(ValueError, match="hum_m"):
        with_effect("colour=3")
    assert campaign_tests(world)[-5:] == [f"point-{name}" for name in "ABCDE"]


@pytest.mark.parametrize("name", "ADE")
def test_the_campaigns_step_is_short_enough(name: str) -> None:
    """A fifth of it moves a release by less than 1 nm and 2e-7 rad: far below what the sensors resolve."""
    world = draw_world(1, effects=Effects(cubic=0.03, quadratic=0.05, drag=0.02))
    speed = world.rig.points[name].speed_ratio * 6 * math.pi
    time, start = np.linspace(0, 10, 1001), orbit(world.mechanics, speed, 0.0, BOTH + 0.003)
    coarse, fine = (
        moved(world.mechanics, Turning.steady(0.0, speed), time, start, True, step) for step in (STEP_S, 5e-5)
    )
    assert np.max(np.abs(coarse - fine)[:, :2]) < 1e-9
    assert np.max(np.abs(coarse - fine)[:, 2:4]) < 2e-7
