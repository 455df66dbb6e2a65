"""OutsideDomain is raised for values that are not numbers, pairs or scenes, and for numbers outside the domain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dynamics import (
    RotorParameters,
    Scene,
    SpeedHistory,
    multipliers,
    release_outcome,
    sensitivities,
    simulate,
    simulate_batch,
    steady_states,
)
from dynamics.equations.parameters import imbalance_radius
from dynamics.equations.scene import time_at_speed
from dynamics.errors import DynamicsError, OutsideDomain
from dynamics.stability.stability_map import stability_map
from dynamics.steady.singular_points import singular_points
from tests.dynamics.nominal import rig

NO_NUMBERS: list[Any] = ["3", None, [1.0, 2.0], 1j, True, {}, np.array([1.0, 2.0])]


@pytest.mark.parametrize("wrong", NO_NUMBERS, ids=repr)
def test_an_argument_that_is_not_a_number_is_refused_by_name(wrong: Any) -> None:
    p = rig()
    scene = Scene(SpeedHistory.constant(30.0))
    requests = {
        "speed": lambda: steady_states(p, wrong),
        "accuracy": lambda: multipliers(p, 30.0, wrong),
        "accuracy of a run": lambda: simulate(p, scene, 1.0, wrong),
        "history": lambda: SpeedHistory.constant(wrong),
        "ramp": lambda: SpeedHistory.ramp(0.0, wrong, 1.0),
        "map": lambda: stability_map(p, np.array([1.0]), np.array([2.0]), wrong),
        "release": lambda: release_outcome(p, wrong),
        "mass": lambda: replace(p, rotor_mass_kg=wrong),
        "zeta": lambda: replace(p, zeta1=wrong),
    }
    for name, request in requests.items():
        with pytest.raises(OutsideDomain, match="number") as refusal:
            request()
        assert "TypeError" not in str(refusal.value), name


@pytest.mark.parametrize("wrong", ["ab", None, (1.0,), ("a", "b"), ((1, 2), (3,)), (math.nan, 0.0)], ids=repr)
def test_what_is_no_pair_or_row_is_refused(wrong: Any) -> None:
    p = rig()
    history = SpeedHistory.constant(30.0)
    for request in (
        lambda: steady_states(p, 30.0, released=wrong),
        lambda: release_outcome(p, 30.0, wrong),
        lambda: Scene(history, wrong),
        lambda: simulate(p, Scene(history, start=wrong if wrong is not None else "x"), 1.0),
        lambda: simulate(p, wrong, 1.0),
        lambda: simulate(p, Scene(history), wrong if wrong != (1.0,) else "x"),
    ):
        with pytest.raises(OutsideDomain):
            request()


def test_times_that_are_dates_or_run_backwards_are_refused() -> None:
    history = SpeedHistory.constant(30.0)
    time = np.arange(6.0)
    motion = simulate(rig(), Scene(history), time / 100, dense=True)
    requests: list[Callable[[Any], object]] = [
        motion.at,
        history.phase,
        lambda t: SpeedHistory.from_phases(t, 30.0 * time),
        lambda t: simulate(rig(), Scene(history), t),
        lambda t: simulate_batch([rig()], Scene(history), t),
        lambda t: sensitivities(rig(), Scene(history), t, ["zeta1"]),
    ]
    for request in requests:
        with pytest.raises(OutsideDomain, match=r"got an array of datetime64\[s\]; convert dates"):
            request(time.astype("datetime64[s]"))
        with pytest.raises(OutsideDomain, match="rows of unequal lengths"):
            request([[1.0, 2.0], [3.0]])
    for request in requests[2:]:
        with pytest.raises(OutsideDomain, match=r"runs backwards after sample 1 \(2 s\)"):
            request([0.0, 2.0, 1.0, 3.0, 4.0, 5.0])


def test_a_rate_on_a_locked_pendulum_is_refused() -> None:
    start = np.zeros(8)
    start[7] = 2.0
    with pytest.raises(OutsideDomain, match="pendulum B is locked"):
        simulate(rig(), Scene(SpeedHistory.constant(30.0), (True, False), start), 1.0)
    with pytest.raises(OutsideDomain, match="pendulum B is locked"):
        simulate(rig(), Scene(SpeedHistory.constant(30.0), start=start, release_time_s=(0.0, 0.5)), 1.0)
    simulate(rig(), Scene(SpeedHistory.constant(30.0), start=start), 0.1)


def test_a_constant_speed_is_passed_at_no_time() -> None:
    with pytest.raises(OutsideDomain, match="constant 30 rad/s"):
        time_at_speed(SpeedHistory.constant(30.0), 30.0, 0.0, 10.0)


EXTREMES = st.sampled_from([0.0, 5e-324, 1e-300, 1e-12, 1e12, 1e300, -1.0, math.nan, math.inf])
FIELDS = st.sampled_from(
    [
        "rotor_mass_kg",
        "imbalance_mass_kg",
        "imbalance_radius_m",
        "k1_N_per_m",
        "k2_N_per_m",
        "zeta1",
        "zeta2",
        "pivot_shift_m",
        "gravity_m_per_s2",
        "a.mass_kg",
        "a.length_m",
        "a.damping_Nms_per_rad",
        "b.mass_kg",
    ]
)


def changed(p: RotorParameters, field: str, value: float) -> RotorParameters:
    owner, _, name = field.rpartition(".")
    return replace(p, **({owner: replace(getattr(p, owner), **{name: value})} if owner else {name: value}))


@given(FIELDS, EXTREMES, FIELDS, EXTREMES)
def test_extreme_numbers_are_answered_or_refused(one: str, first: float, other: str, second: float) -> None:
    """No division by zero and no NaN in the closed forms that every service begins with."""
    try:
        p = changed(changed(rig(), one, first), other, second)
        speed = p.speed_rad_s(1.6)
        points = singular_points(p, speed)
        assert np.all(np.isfinite(p.packed()))
    except DynamicsError:
        return
    assert all(math.isfinite(a) for point in points for a in point.theta_rad)


@pytest.mark.parametrize("field", ["rotor_mass_kg", "k1_N_per_m", "k2_N_per_m", "a.length_m", "a.mass_kg"])
def test_numbers_beyond_any_rig_are_refused(field: str) -> None:
    for value in (1e-300, 1e300) if field != "a.mass_kg" else (1e-300,):
        with pytest.raises(OutsideDomain, match=field.rpartition(".")[2]):
            changed(rig(), field, value)


def test_a_moment_needs_a_mass_to_make_it() -> None:
    assert imbalance_radius(0.0, 0.0) == 0.0
    with pytest.raises(OutsideDomain, match=r"imbalance\.mass_kg above 0"):
        imbalance_radius(1e-3, 0.0)
    with pytest.raises(OutsideDomain, match=r"imbalance\.mass_kg above 0"):
        replace(rig(), imbalance_mass_kg=0.0).with_values(SP_kg_m=1e-3)


def test_a_motion_that_separates_beyond_rounding_is_refused_before_it_is_refined() -> None:
    """At 10⁵ rad/s errors grow by 10¹⁰ and more in a tenth of a second: no tolerance of a double is enough."""
    with pytest.raises(DynamicsError, match="neighbouring motions diverge") as refusal:
        simulate(rig(), Scene(SpeedHistory.constant(1e5)), 0.3, 1e-8)
    assert float(str(refusal.value).split("(")[1].split(" steps")[0]) < 3e5


@pytest.mark.parametrize("speed", [5e-324, 1e-300, 1e-150, 1e150, 1e300, 1.7e308])
@pytest.mark.parametrize("service", [steady_states, multipliers, release_outcome])
def test_a_speed_beyond_the_resolution_of_numbers_is_refused_with_the_range(service: Any, speed: float) -> None:
    with pytest.raises(OutsideDomain, match=r"speed: expected .* to .* rad/s, 1e-8 to 1e8 natural frequencies"):
        service(rig(), speed)


def test_speeds_within_the_range_have_states() -> None:
    slow, fast = min(rig().natural_frequencies_rad_s), max(rig().natural_frequencies_rad_s)
    for speed in (1.1e-8 * slow, 0.9e8 * fast):
        assert steady_states(rig(), speed, 1e-6)
