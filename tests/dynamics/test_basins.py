"""Basins: regions that catch, slipping orbits by Newton's method, releases of a grid and of a list."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dynamics import Pendulum, Scene, SpeedHistory, simulate, steady_states
from dynamics.errors import OutsideDomain
from dynamics.motions.locked_motion import locked_state
from dynamics.steady.basins import coexisting
from dynamics.steady.basins.basin_map import basins
from dynamics.steady.basins.coexisting import stable_motions
from dynamics.steady.basins.ends import NEAR_RAD, packed, steady_ends
from dynamics.steady.basins.fibres import series
from dynamics.steady.basins.following import follow
from dynamics.steady.basins.pursuit import deviation
from dynamics.steady.basins.regions import quadratic_form, spectral_radius
from dynamics.steady.basins.single import kind_of, release_ends
from dynamics.steady.basins.slipping_orbits import SlippingOrbit, mean_rates, slipping_orbit
from dynamics.steady.basins.turning import RevolutionMap
from tests.dynamics.nominal import rig

B, D, E = 1.6, 3.3, 5.8


def _speed(p, ratio):
    return p.speed_rad_s(ratio)


def _gap(angles, others):
    return float(np.max(np.abs(np.exp(1j * np.asarray(angles)) - np.exp(1j * np.asarray(others)))))


def _later(p, speed, state, seconds):
    """The state after whole revolutions, by the integrator that bounds its error."""
    turns = math.ceil(seconds * speed / (2 * math.pi))
    for _ in range(turns // 10 + 1):
        scene = Scene(SpeedHistory.constant(speed), (True, True), state.copy())
        state = simulate(p, scene, np.array([0.0, 10 * 2 * math.pi / speed]), 1e-6).state[-1]
    return state


@pytest.fixture(scope="module")
def slipping() -> tuple[RevolutionMap, SlippingOrbit, np.ndarray]:
    """The slipping orbit at D with strong damping, and the strobed motion it was found from."""
    p = rig(zeta=0.05)
    turning = RevolutionMap.of(p, _speed(p, D))
    strobe = turning.strobed(locked_state(p, turning.speed_rad_s, 0.0, 0.3, 2.9), 1400)[-900:]
    found = slipping_orbit(turning, strobe, NEAR_RAD)
    assert found is not None
    return turning, found, strobe


def test_a_revolution_is_the_integrators():
    p = rig(zeta=0.03, pivot_shift_m=1e-3)
    turning = RevolutionMap.of(p, _speed(p, D))
    rng = np.random.default_rng(3)
    for state in rng.normal(size=(3, 8)) * 0.5 * turning.units:
        scene = Scene(SpeedHistory.constant(turning.speed_rad_s), (True, True), state.copy())
        wanted = simulate(p, scene, np.array([0.0, turning.period_s]), 1e-10).state[-1]
        assert np.max(np.abs((turning.after(state[None, :])[0] - wanted) / turning.units)) < 1e-8


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 0.995))
def test_the_form_shrinks_with_every_step_of_the_linear_map(seed, radius):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(6, 6))
    matrix *= radius / spectral_radius(matrix)
    form = quadratic_form(matrix)
    away = rng.normal(size=(50, 6))
    before = np.einsum("ni,ij,nj->n", away, form, away)
    after = np.einsum("ni,ij,nj->n", away @ matrix.T, form, away @ matrix.T)
    assert np.all(after <= max(radius, 0.25) * before * (1 + 1e-9))


def test_what_a_region_holds_ends_at_its_state():
    p = rig()
    turning = RevolutionMap.of(p, _speed(p, E))
    ends = steady_ends(turning)
    assert [(end.name, end.mirror) for end in ends] == [("I", 0), ("I", 1)]
    table, away = packed(ends, turning), np.empty(8)
    rng = np.random.default_rng(5)
    for number, end in enumerate(ends):
        assert end.region is not None
        outward = np.linalg.inv(np.linalg.cholesky(end.region.form)).T
        way = rng.normal(size=8)
        state = end.start + 0.45 * outward @ (way / np.linalg.norm(way))
        assert deviation(state, number, table, away) == pytest.approx(0.45**2)
        assert _gap(_later(p, turning.speed_rad_s, state, 20.0)[2:4], end.start[2:4]) < 1e-3


def test_mirror_images_have_mirrored_regions():
    p = rig()
    first, second = steady_ends(RevolutionMap.of(p, _speed(p, B)))
    assert first.region is not None
    assert second.region is not None
    over = [0, 1, 3, 2, 4, 5, 7, 6]
    assert np.allclose(second.region.form, first.region.form[np.ix_(over, over)])
    assert _gap(first.start[2:4], second.start[[3, 2]]) < 1e-9


def test_a_slipping_orbit_solves_its_equation_and_has_the_rate_of_the_motion(slipping):
    turning, orbit, strobe = slipping
    assert orbit.period_revolutions == 0
    assert orbit.winding == (1, 1)
    assert orbit.residual < 1e-5
    assert np.allclose(mean_rates(strobe[:, 2:4]), orbit.turns_per_revolution, atol=1e-7)
    # A state of the curve comes to that of the curve ρ further on
    here = series(orbit.values, np.array([0.3]))[0]
    there = series(orbit.values, np.array([0.3 + orbit.rotation]))[0]
    here[2:4] += 2 * math.pi * 0.3
    there[2:4] += 2 * math.pi * (0.3 + orbit.rotation)
    gap = (turning.after(here[None, :])[0] - there) / turning.units
    assert np.max(np.abs(gap)) < 1e-5


def test_deviations_from_a_slipping_orbit_shrink_by_its_multipliers(slipping):
    turning, orbit, _ = slipping
    assert orbit.multipliers[0] == pytest.approx(1.0)
    assert orbit.multiplier_across == pytest.approx(0.909, abs=2e-3)
    number = 50
    table = (orbit.points, orbit.forms, np.array([0, len(orbit.points)]), np.array([orbit.lead]), np.array([1]))
    state = orbit.points[100].copy()
    state[5] += 0.03 * turning.units[5]
    away, values = np.empty(8), []
    for each in turning.strobed(state, number):
        values.append(deviation(each, 0, table, away))
    slope = np.polyfit(np.arange(10, 48), np.log(values[10:48]), 1)[0]  # the slowest pair turns while it shrinks
    assert math.exp(0.5 * slope) == pytest.approx(orbit.multiplier_across, abs=0.015)


def test_a_transient_that_turns_is_no_slipping_orbit():
    p = rig()
    turning = RevolutionMap.of(p, _speed(p, E))
    start = locked_state(p, turning.speed_rad_s, 0.0, 0.0, 0.0)
    start[6:8] = -0.4 * turning.speed_rad_s  # thrown back: they turn until their damping has caught them
    strobe = turning.strobed(start, 60)
    assert np.max(np.abs(strobe[-1, 2:4] - strobe[0, 2:4])) > 2 * math.pi
    assert slipping_orbit(turning, strobe, NEAR_RAD) is None


def test_pendulums_that_hang_are_a_locked_slipping_orbit():
    p = replace(rig(), gravity_m_per_s2=9.81)
    turning = RevolutionMap.of(p, _speed(p, 0.4))
    strobe = turning.strobed(locked_state(p, turning.speed_rad_s, 0.0, 0.0, 3.1), 300)
    orbit = slipping_orbit(turning, strobe, NEAR_RAD)
    assert orbit is not None
    assert (orbit.period_revolutions, orbit.winding) == (1, (-1, -1))
    assert orbit.turns_per_revolution == (-1.0, -1.0)
    assert orbit.multipliers[0] < 1.0


def test_releases_end_where_the_integrator_has_them():
    p = rig()
    speed = _speed(p, B)
    three, four = np.array([-2.0, 0.7, 2.2]), np.array([1.0, 4.5])
    found = basins(p, speed, three, four, 20.0)
    assert np.all(found.end >= 0)
    assert np.all(found.sure)
    for i, j in ((0, 0), (1, 2), (0, 1)):
        start = locked_state(p, speed, 0.0, three[j], four[i])
        end = found.ends[found.end[i, j]]
        assert _gap(_later(p, speed, start, 60.0)[2:4], end.start[2:4]) < 2e-3
    assert np.sum(found.shares) == pytest.approx(1.0)


def test_pendulums_that_are_alike_may_change_places():
    p = rig()
    angles = np.array([0.3, 1.9, 4.0])
    found = basins(p, _speed(p, E), angles, angles, 20.0)
    other = np.array([1, 0])
    off = ~np.eye(3, dtype=bool)  # released together they are a case of their own
    assert np.array_equal(other[found.end][off], found.end.T[off])
    assert np.allclose(found.settled_s[off], found.settled_s.T[off], atol=2.5 * 2 * math.pi / found.speed_rad_s)


def test_what_is_cut_short_is_not_settled():
    found = basins(rig(), _speed(rig(), B), [0.1], [3.0], 0.5)
    assert found.end[0, 0] == -1
    assert math.isnan(found.caught_s[0, 0])
    assert math.isnan(found.settled_s[0, 0])
    assert found.shares[-1] == 1.0


def test_what_is_left_at_the_end_of_the_time_is_the_motions_own():
    p = rig()
    speed = _speed(p, B)
    turning = RevolutionMap.of(p, speed)
    found = basins(p, speed, [2.2], [4.5], 20.0)
    assert found.end[0, 0] >= 0
    turns = math.ceil(20.0 / turning.period_s)
    before = turning.after(locked_state(p, speed, 0.0, 2.2, 4.5)[None, :], turns - 1)[0]
    assert found.amplitude_m[0, 0] == pytest.approx(turning.mean_radius(before), rel=0.05)


def test_chaotic_transients_are_at_a_boundary():
    p = rig(damping=1e-4)
    found = basins(p, _speed(p, E), np.linspace(-2.5, 3.0, 6), np.linspace(0.2, 6.0, 4), 20.0)
    assert not np.all(found.sure)
    assert np.all(np.isinf(found.apart_rad[~found.sure]))


def test_slipping_cells_have_a_slipping_orbit(slipping):
    turning, orbit, _ = slipping
    found = basins(turning.parameters, turning.speed_rad_s, [-1.0, 2.0], [0.5, 3.0], 20.0)
    assert [end.name for end in found.ends] == ["slipping"]
    assert np.all(found.end == 0)
    own = found.ends[0].slipping
    assert own is not None
    assert np.allclose(own.turns_per_revolution, orbit.turns_per_revolution, atol=1e-8)
    assert np.allclose(found.amplitude_m, orbit.amplitude_m, rtol=0.02)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"a": Pendulum(0.075, 0.054, 1e-3, friction_arm_m=1e-5)}, "friction"),
        ({"a": Pendulum.absent(), "b": Pendulum.absent()}, "pendulum"),
        ({"imbalance_radius_m": 0.0}, "imbalance"),
        ({"a": Pendulum(1e-8, 0.054, 50.0)}, "steps"),
    ],
)
def test_what_has_no_basins_is_refused(changed, message):
    p = replace(rig(), **changed)
    with pytest.raises(OutsideDomain, match=message):
        basins(p, _speed(p, E), [0.1], [3.0], 1.0)


def test_numbers_that_mean_nothing_are_refused():
    p = rig()
    turning = RevolutionMap.of(p, _speed(p, E))
    with pytest.raises(OutsideDomain, match="theta3_rad"):
        basins(p, _speed(p, E), [math.nan], [3.0])
    with pytest.raises(OutsideDomain, match="seconds"):
        follow(turning, np.zeros((1, 8)), [], 0.0)
    with pytest.raises(OutsideDomain, match="stated_error"):
        follow(turning, np.zeros((1, 8)), [], 1.0, stated_error_rad=1.0)
    with pytest.raises(OutsideDomain, match="as many speeds"):
        release_ends([p, p], [1.0], (0.0, 3.0))
    with pytest.raises(OutsideDomain, match="as many speeds"):
        stable_motions([p, p], [1.0])


def test_one_release_of_each_rig():
    p, damped = rig(), rig(zeta=0.05)
    rubbing = replace(p, a=replace(p.a, friction_arm_m=1e-5))
    speeds = [_speed(p, E), _speed(p, D), _speed(damped, D), _speed(p, B), _speed(rubbing, E)]
    found = release_ends([p, p, damped, p, rubbing], speeds, (0.003, 3.14), 20.0)
    assert found.name.tolist() == ["I", "III", "slipping", "not settled", "refused"]
    assert "friction" in found.refused[4]
    state = next(s for s in steady_states(p, speeds[1], 1e-6) if s.stable)
    assert _gap(found.theta_rad[1], state.theta_rad) < 1e-4
    assert found.multiplier[1] == pytest.approx(state.multiplier_max, abs=1e-5)
    assert found.turns_per_revolution[2] == pytest.approx([-0.0462726] * 2, abs=1e-6)
    assert found.settled_s[0] < 5.0


def test_types_by_angles():
    p = rig()
    assert kind_of(p, (1.89, 4.39)) == "I"
    assert kind_of(p, (5.28, 5.28)) == "III"
    assert kind_of(p, (0.0, 3.1)) == "II"
    assert kind_of(replace(p, b=Pendulum.absent()), (0.0, 3.1)) == "one"


def test_stable_motions_along_a_row():
    rigs = [rig(zeta=z) for z in (0.02, 0.05, 0.052)]
    found = stable_motions(rigs, [_speed(p, D) for p in rigs])
    assert [each.names for each in found] == [("III",), ("slipping",), ("slipping",)]
    rates = [each.slipping[0].turns_per_revolution[0] for each in found[1:]]
    assert rates[0] == pytest.approx(-0.0462726, abs=1e-6)
    assert rates[1] < rates[0]
    assert found[2].slipping[0].residual < 1e-5


def test_an_orbit_that_releases_miss_comes_from_a_neighbour(monkeypatch):
    p, damped = rig(zeta=0.02), rig(zeta=0.05)
    near = [rig(zeta=z) for z in (0.049, 0.051)]
    rigs = [
        near[0],
        p,
        near[1],
        damped,
    ]  # two rows: the orbit is continued down, then to the right
    released = coexisting.slipping_orbit
    first = _speed(near[0], D)
    monkeypatch.setattr(
        coexisting,
        "slipping_orbit",
        lambda turning, strobe, near_rad: (
            released(turning, strobe, near_rad) if turning.parameters == near[0] else None
        ),
    )
    found = stable_motions(rigs, [first, *(_speed(one, D) for one in rigs[1:])], columns=2)
    assert [each.names for each in found] == [("slipping",), ("III",), ("slipping",), ("slipping",)]
    monkeypatch.undo()
    alone = stable_motions([damped], [_speed(damped, D)])[0].slipping[0]
    assert found[3].slipping[0].turns_per_revolution == pytest.approx(alone.turns_per_revolution, abs=1e-9)
    assert found[3].slipping[0].multiplier_across == pytest.approx(alone.multiplier_across, abs=1e-6)
    with pytest.raises(OutsideDomain, match="columns must divide the 4 points"):
        stable_motions(rigs, [first] * 4, columns=3)


def test_a_slipping_orbit_whose_period_is_doubled():
    p = replace(rig(zeta=0.05), k2_N_per_m=8.0 * rig().k1_N_per_m)
    speed = _speed(p, 3.428571428571429)
    found = stable_motions([p], [speed])[0]
    assert found.names == ("slipping",)
    orbit = found.slipping[0]
    assert orbit.winding == (2, 2), "passed once, the pendulums turn twice: the simple curve has a multiplier of −1.11"
    assert not orbit.catches
    turning = RevolutionMap.of(p, speed)
    strobe = turning.strobed(locked_state(p, speed, 0.0, 1.5, 3.6), 4000)[-2000:]
    assert orbit.turns_per_revolution == pytest.approx(mean_rates(strobe[:, 2:4]), abs=1e-8)


def test_multiplier_across_is_what_motions_near_the_orbit_shrink_by():
    p = rig(zeta=0.05)
    turning = RevolutionMap.of(p, _speed(p, D))
    strobe = turning.strobed(locked_state(p, turning.speed_rad_s, 0.0, 1.5, 3.6), 1500)[-700:]
    orbit = slipping_orbit(turning, strobe, None)
    assert orbit is not None
    nearby = orbit.values[0].copy()
    nearby[turning.free] += 1e-3 * turning.units[turning.free]
    apart = _off_curve(orbit, turning.strobed(nearby, 60)[15:], turning)
    slope = np.polyfit(np.arange(len(apart)), np.log(apart), 1)[0]
    assert math.exp(slope) == pytest.approx(orbit.multiplier_across, abs=0.005)


def _off_curve(orbit, states, turning):
    """Distances of states from a curve, in units, across it."""
    turns = np.zeros(8)
    turns[2:4] = 2 * math.pi * np.array(orbit.winding)
    places = np.linspace(0, 1, 20001)[:-1]
    curve = series(orbit.values, places) + np.outer(places, turns)
    found = []
    for state in states:
        gap = state - curve
        gap[:, 2:4] = (gap[:, 2:4] + math.pi) % (2 * math.pi) - math.pi
        gap = (gap / turning.units)[:, turning.free]
        i = int(np.argmin(np.linalg.norm(gap, axis=1)))
        along = ((curve[(i + 1) % len(curve)] - curve[i - 1]) / turning.units)[turning.free]
        along /= np.linalg.norm(along)
        found.append(np.linalg.norm(gap[i] - along * (along @ gap[i])))
    return np.array(found)


def test_maps_that_vary_faster_than_their_curve_take_more_steps():
    p = rig(zeta=0.013895)
    found = release_ends([p], [_speed(p, 4.036364)], (0.003, 3.14), 20.0)
    assert not found.refused
    assert found.name.tolist() == ["slipping"]
    assert found.multiplier[0] < 1.0
