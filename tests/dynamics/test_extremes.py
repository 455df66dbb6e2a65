"""The corners of the domain of validity: results within the requested accuracy, or an error with the next step.

The references are ball arithmetic (dynamics.bench.arb_peer) and heyoka (dynamics.bench.heyoka_peer); thousands of
draws are held against them by benchmarks/dynamics_extremes.py, this file keeps the named extremes and a few draws.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from dynamics import (
    Motion,
    Pendulum,
    RotorParameters,
    Scene,
    SpeedHistory,
    SteadyState,
    multipliers,
    simulate,
    steady_states,
)
from dynamics.bench import arb_peer, heyoka_peer
from dynamics.errors import NoBalancedState, NotConverged, OutsideDomain
from dynamics.motions.locked_motion import locked_state
from tests.dynamics.nominal import from_domain, rig
from tests.effort import THOROUGH, cases, thorough

ACCURACY = 1e-8
S = 0.075 * 0.054  # first mass moment of the nominal pendulum, kg m
LIGHT = 1.0  # mass of an imbalance whose radius in m is then its first moment to the last bit


def moments(sp: float, mass_a: float = 0.075, mass_b: float = 0.075, **more: float) -> RotorParameters:
    """A rig whose S_P is a given number to the last bit."""
    damping, ball, ratio = more.pop("damping", 0.001), more.pop("ball", 0.0), more.pop("ratio", 14.9)
    a, b = (Pendulum(m, 0.054, damping, ball_radius_m=ball) for m in (mass_a, mass_b))
    k1 = (7.0 + LIGHT + mass_a + mass_b) * (6 * math.pi) ** 2
    zeta = more.pop("zeta", 0.02)
    return RotorParameters(7.0, LIGHT, sp, a, b, k1, ratio * k1, more.pop("zeta1", zeta), more.pop("zeta2", zeta))


def true_to_the_reference(p: RotorParameters, speed_ratio: float, accuracy: float = ACCURACY) -> SteadyState:
    """`multipliers` answers; the answer and its own estimate hold against ball arithmetic, angles included."""
    pytest.importorskip("flint")
    speed = p.speed_rad_s(speed_ratio)
    found = multipliers(p, speed, accuracy)
    true = arb_peer.reference(p, speed, seconds=3.0)
    scale = max(1.0, true.largest)
    assert true.error < 1e-13
    error = abs(found.multiplier_max - true.largest)
    assert error <= accuracy * scale
    assert error <= found.error_estimate + true.error * scale
    assert found.error_estimate <= accuracy * scale * (1 + 1e-12)
    assert np.all(np.isfinite(found.multipliers))
    gap = np.exp(1j * np.array(found.theta_rad)) - np.exp(1j * np.array(true.theta_rad))
    assert np.max(np.abs(gap)) <= 1e-14
    return found


def contains_advice(message: str) -> bool:
    """Expected, came, what to do: two numbers at least and an advice or a rule."""
    numbers = re.findall(r"\d", message)
    return len(numbers) >= 2 and bool(re.search(r"ask|raise|use|give|needs|expected|must|shorten|start from", message))


NAMED = {
    "zeta exactly 0": (moments(0.6 * S, zeta=0.0), 1.6),
    "zeta1 0, zeta2 2": (moments(0.6 * S, zeta1=0.0, zeta2=2.0), 1.6),
    "zeta 2": (moments(0.6 * S, zeta=2.0), 1.6),
    "c34 exactly 0": (moments(0.6 * S, damping=0.0), 1.6),
    "zeta and c34 exactly 0": (moments(0.6 * S, damping=0.0, zeta=0.0), 2.6),
    "c34 1e-8": (moments(0.6 * S, damping=1e-8), 1.6),
    "c34 50": (moments(0.6 * S, damping=50.0), 1.6),
    "K 1e-2": (moments(0.6 * S, ratio=1e-2), 1.6),
    "K 1e4": (moments(0.6 * S, ratio=1e4), 20.0),
    "K 1, isotropic": (moments(0.6 * S, ratio=1.0), 1.6),
    "K one ulp above 1": (moments(0.6 * S, ratio=math.nextafter(1.0, 2.0)), 1.6),
    "speed ratio 1e-3": (moments(0.6 * S, ratio=1.3), 1e-3),
    "speed ratio 1e-2": (moments(0.6 * S, ratio=2.0), 1e-2),
    "speed ratio 100": (moments(0.6 * S), 100.0),
    "undamped at resonance": (moments(0.6 * S, zeta=0.0), 1.0),
    "S_P 0, S_A = S_B": (moments(0.0), 1.6),
    "S_P 1e-15": (moments(1e-15), 1.6),
    "S_P 1e-300": (moments(1e-300), 1.6),
    "S_A + S_B = S_P": (moments(2 * S), 1.6),
    "S_A + S_B = S_P, c34 0": (moments(2 * S, damping=0.0), 1.6),
    "S_A + S_B one ulp above S_P": (moments(math.nextafter(2 * S, 0.0)), 1.6),
    "S_A + S_B one ulp above S_P, c34 0": (moments(math.nextafter(2 * S, 0.0), damping=0.0), 1.6),
    "S_A + S_B one ulp below S_P": (moments(math.nextafter(2 * S, 1.0)), 1.6),
    "|S_A − S_B| = S_P": (moments(abs(S - 0.019 * 0.054), mass_b=0.019), 1.6),
    "|S_A − S_B| one ulp above S_P": (moments(math.nextafter(abs(S - 0.019 * 0.054), 0.0), mass_b=0.019), 1.6),
    "|S_A − S_B| one ulp below S_P": (moments(math.nextafter(abs(S - 0.019 * 0.054), 1.0), mass_b=0.019), 1.6),
    "pendulums of 1e-9 kg": (moments(0.6e-9 * 0.054, 1e-9, 1e-9, damping=1e-12), 1.6),
    "pendulums of 1e-9 kg, stiff": (moments(0.6e-9 * 0.054, 1e-9, 1e-9), 1.6),
    "pendulums of 7 kg": (moments(0.4, 7.0, 7.0, damping=0.1), 1.6),
    "balls": (moments(0.6 * S, ball=0.01), 1.6),
}


SUITE = {
    "zeta1 0, zeta2 2",
    "zeta and c34 exactly 0",
    "K 1e4",
    "K one ulp above 1",
    "speed ratio 1e-3",
    "speed ratio 100",
    "S_P 1e-300",
    "S_A + S_B one ulp above S_P, c34 0",
    "|S_A − S_B| one ulp below S_P",
    "pendulums of 1e-9 kg, stiff",
    "balls",
    "nominal",
    "c34 50",
    "ramp of 1000 rpm/s",
}
"""One of each kind; the others are in the thorough run."""


def sweep(names: Iterable[str]) -> list[Any]:
    """The names as parameters, those outside the suite marked."""
    return [name if name in SUITE else pytest.param(name, marks=thorough) for name in names]


@pytest.mark.parametrize("name", sweep(NAMED))
def test_multipliers_at_a_named_extreme_are_true(name: str) -> None:
    true_to_the_reference(*NAMED[name])


IN_PAIRS = {(1e-2, 30.0), (1e-5, 0.83), (1e-10, 3.3), (1e-11, 0.1)}  # the suite has each accuracy and each speed once


@pytest.mark.parametrize("accuracy", [1e-2, 1e-5, 1e-10, 1e-11])
def test_the_accuracy_asked_is_met_at_every_setting(accuracy: float) -> None:
    for speed_ratio in (0.1, 0.83, 3.3, 30.0):
        if THOROUGH or (accuracy, speed_ratio) in IN_PAIRS:
            true_to_the_reference(rig(), speed_ratio, accuracy)


@settings(max_examples=cases(8, 25), deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32 - 1))
def test_multipliers_of_a_draw_are_true_or_refused(seed: int) -> None:
    pytest.importorskip("flint")
    p, speed_ratio = from_domain(np.random.default_rng(seed), balanced=True)
    speed = p.speed_rad_s(speed_ratio)
    try:
        true = arb_peer.reference(p, speed, seconds=0.4)
    except NotConverged:
        return
    scale = max(1.0, true.largest)
    refusal = ""
    try:
        found = multipliers(p, speed, ACCURACY)
    except NotConverged as error:
        refusal = str(error)
    if refusal:
        assert contains_advice(refusal)
        return
    error = abs(found.multiplier_max - true.largest)
    assert error <= min(ACCURACY * scale, found.error_estimate + true.error * scale)


def test_more_than_rounding_outside_the_triangle_is_refused() -> None:
    for p in (moments(2 * S * (1 + 1e-12)), moments(abs(S - 0.019 * 0.054) * (1 - 1e-12), mass_b=0.019)):
        with pytest.raises(NoBalancedState) as refusal:
            multipliers(p, p.speed_rad_s(1.6))
        assert contains_advice(str(refusal.value))


@pytest.mark.parametrize(
    ("speed_rad_s", "accuracy"),
    [(0.0, 1e-8), (-1.0, 1e-8), (math.nan, 1e-8), (math.inf, 1e-8), (30.0, 0.0), (30.0, 1e-14), (30.0, math.nan)],
)
def test_what_means_nothing_is_refused(speed_rad_s: float, accuracy: float) -> None:
    for service in (multipliers, steady_states):
        with pytest.raises(OutsideDomain) as refusal:
            service(rig(), speed_rad_s, accuracy)
        assert "expected" in str(refusal.value)
        assert "got" in str(refusal.value)


@pytest.mark.parametrize("accuracy", [1e-12])
@pytest.mark.parametrize("stiffness_ratio", [1e4])
def test_beyond_double_precision_there_is_a_refusal_not_a_number(stiffness_ratio: float, accuracy: float) -> None:
    p = moments(0.6 * S, ratio=stiffness_ratio, zeta=0.0)
    with pytest.raises(NotConverged) as refusal:
        multipliers(p, p.speed_rad_s(1e-3), accuracy)
    assert contains_advice(str(refusal.value))


def test_states_of_a_pivot_shift_as_large_as_the_eccentricity_whirl_about_the_pivot() -> None:
    base = rig(stiffness_ratio=1.0, zeta=0.05)
    shift = base.imbalance_moment_kg_m / base.total_mass_kg  # R_C = e
    p = replace(base, pivot_shift_m=shift)
    found = steady_states(p, p.speed_rad_s(20.0), ACCURACY)
    resting = [s for s in found if s.type == "I"]
    assert len(resting) == 2
    w, c = p.speed_rad_s(20.0), p.damping_Ns_per_m[0]
    for state in resting:
        assert state.amplitude_m == pytest.approx(shift, rel=1e-10)
        made = sum(S * np.exp(1j * t) for t in state.theta_rad)  # M_S R_C − S_P − (k + iωc) R_C/ω², M_S R_C = S_P
        assert abs(made + (p.k1_N_per_m + 1j * w * c) * shift / w**2) < 1e-12 * S
        assert np.all(np.isfinite(state.multipliers))


def release(p: RotorParameters, speed_ratio: float, duration_s: float, accuracy: float, ramp: float = 0.0) -> Motion:
    """Both pendulums released 0.2° and 0.1° from 0° and 180°: the motion is finite and agrees with heyoka."""
    pytest.importorskip("heyoka")
    speed = p.speed_rad_s(speed_ratio)
    start = locked_state(p, speed, 0.0, math.radians(0.2), math.pi + math.radians(0.1))
    history = (
        SpeedHistory.constant(speed) if ramp == 0 else SpeedHistory.ramp(speed, speed + ramp * duration_s, duration_s)
    )
    times = np.linspace(0.0, duration_s, 33)
    motion = simulate(p, Scene(history, start=start), times, accuracy)
    hy = heyoka_peer.heyoka()
    assert hy is not None
    system = heyoka_peer.equations(p, speed, ramp)
    true = hy.taylor_adaptive(system, start, tol=1e-16, compact_mode=True).propagate_grid(times)[-1]
    error = float(np.max(np.abs(motion.state - true)[:, :4] / np.array([0.054, 0.054, 1.0, 1.0])))
    assert error <= accuracy
    assert error <= motion.error_estimate
    assert np.all(np.isfinite(motion.state))
    return motion


RELEASES = {
    "nominal": (rig(), 1.6, 2.0, 0.0),
    "zeta 2": (rig(zeta=2.0), 1.6, 2.0, 0.0),
    "c34 50": (rig(damping=50.0), 1.6, 0.2, 0.0),
    "K 1e4": (rig(stiffness_ratio=1e4), 1.6, 0.2, 0.0),
    "speed ratio 100": (rig(), 100.0, 0.05, 0.0),
    "ramp of 1000 rpm/s": (rig(), 0.5, 1.0, 1000 * math.pi / 30),
    "ramp of 0.01 rpm/s": (rig(), 0.9, 1.0, 0.01 * math.pi / 30),
}


@pytest.mark.parametrize("name", sweep(RELEASES))
def test_a_release_at_a_named_extreme_is_true(name: str) -> None:
    p, speed_ratio, duration, ramp = RELEASES[name]
    release(p, speed_ratio, duration, 1e-8, ramp)


@pytest.mark.parametrize(("speed_ratio", "work_limit"), [(1.6, 2_000_000), (1e-3, 50_000_000)])
def test_a_million_revolutions_beyond_the_work_limit_are_refused_at_once(speed_ratio: float, work_limit: int) -> None:
    p = rig()
    speed = p.speed_rad_s(speed_ratio)
    times = np.array([0.0, 2 * math.pi * 1e6 / speed])
    with pytest.raises(NotConverged, match="limit") as refusal:
        simulate(p, Scene(SpeedHistory.constant(speed)), times, 1e-8, work_limit=work_limit)
    assert contains_advice(str(refusal.value))
    assert "steps done" not in str(refusal.value)  # nothing was tried


def test_ten_thousand_revolutions_end_on_the_balanced_state() -> None:
    pytest.importorskip("flint")
    p = rig()
    speed = p.speed_rad_s(1.6)
    start = locked_state(p, speed, 0.0, math.radians(0.2), math.pi + math.radians(0.1))
    end = 2 * math.pi * 1e4 / speed
    motion = simulate(p, Scene(SpeedHistory.constant(speed), start=start), np.array([0.0, end]), 1e-8)
    assert motion.error_estimate <= 1e-8
    true = arb_peer.balanced_directions(p)
    there = [complex(float(cos), float(sin)) for cos, sin in true]
    angles = np.exp(1j * motion.angles_rad[-1])
    assert min(np.max(np.abs(angles - there)), np.max(np.abs(angles - np.conj(there)))) <= 1e-8
    assert np.max(np.abs(motion.displacement_m[-1])) <= 1e-8 * 0.054


def test_an_unstable_motion_over_too_long_a_time_is_refused() -> None:
    p = rig(zeta=0.0, damping=0.0)
    speed = p.speed_rad_s(0.9)
    start = locked_state(p, speed, 0.0, 0.3, 2.0)
    with pytest.raises(NotConverged) as refusal:
        simulate(
            p, Scene(SpeedHistory.constant(speed), start=start), np.linspace(0, 400.0, 5), 1e-10, work_limit=2_000_000
        )
    assert contains_advice(str(refusal.value))


def test_the_reference_agrees_with_itself_by_both_ways() -> None:
    pytest.importorskip("flint")
    p = moments(0.6 * S, ratio=2.0, zeta=0.1)
    speed = p.speed_rad_s(10.0)
    proven = arb_peer.reference(p, speed)
    observed = arb_peer.reference(p, speed, method="collocation")
    assert proven.method == "taylor"
    assert abs(proven.largest - observed.largest) <= proven.error + observed.error
    assert proven.error < 1e-14
