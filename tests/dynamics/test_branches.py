"""Steady states along one number: borders in closed form, branches without jumps, what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dynamics import Pendulum, RotorParameters, steady_branches, steady_states
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.steady import branches
from tests.dynamics.nominal import rig


def _over_imbalance(ratio: float, mass_b: float, zeta: float = 0.05):
    p = rig(1.0, zeta, mass_b=mass_b)

    def at(value: float) -> tuple[RotorParameters, float]:
        return p.with_values(SP_kg_m=value), p.speed_rad_s(ratio)

    return p, at


@pytest.mark.parametrize("mass_b", [0.019, 0.037, 0.055])
def test_above_resonance_the_borders_are_difference_and_sum(mass_b: float) -> None:
    p, at = _over_imbalance(2.5, mass_b)
    found = steady_branches(at, np.linspace(5e-4, 0.012, 24))
    a, b = p.a.first_moment_kg_m, p.b.first_moment_kg_m
    assert [(one.before, one.after) for one in found.break_points] == [(("II",), ("I",)), (("I",), ("III",))]
    assert [one.value for one in found.break_points] == pytest.approx([a - b, a + b], rel=2e-6)


def test_below_resonance_type_iii_begins_where_the_singular_point_is_lost() -> None:
    p, at = _over_imbalance(0.8, 0.037)
    found = steady_branches(at, np.linspace(0, 0.012, 25))
    lag = math.atan2(2 * 0.05 * 0.8, 1 - 0.8**2)
    (only,) = found.break_points
    assert (only.before, only.after) == ((), ("III",))
    assert only.value == pytest.approx((p.a.first_moment_kg_m + p.b.first_moment_kg_m) * math.sin(lag), rel=2e-6)


def test_branches_hold_the_states_and_do_not_jump() -> None:
    _, at = _over_imbalance(2.5, 0.037)
    found = steady_branches(at, np.linspace(5e-4, 0.012, 47))
    assert sorted(b.type for b in found.stable_branches()) == ["I", "I", "II", "III"]
    for b in found.branches:
        assert np.abs(np.diff(b.theta_rad, axis=0)).max() < 0.6
    third = max(found.stable_branches(), key=lambda b: b.values[-1])
    (state,) = [s for s in steady_states(*at(0.012)) if s.stable]
    assert third.amplitude_m[-1] == pytest.approx(state.amplitude_m, rel=1e-12)
    assert third.theta_rad[-1] == pytest.approx(state.theta_rad)
    assert found.locked_amplitude_m[-1] > state.amplitude_m, "locked pendulums balance nothing"


def test_two_break_points_between_two_values() -> None:
    _, at = _over_imbalance(2.5, 0.037)
    found = steady_branches(at, np.array([0.001, 0.011]))
    assert [(one.before, one.after) for one in found.break_points] == [(("II",), ("I",)), (("I",), ("III",))]


def test_a_value_on_the_border_is_one_break_point() -> None:
    p, at = _over_imbalance(2.5, 0.075)
    border = p.a.first_moment_kg_m + p.b.first_moment_kg_m
    found = steady_branches(at, np.array([0.5 * border, border, 1.5 * border]))
    (only,) = found.break_points
    assert only.value == pytest.approx(border, rel=2e-6)
    assert (only.before, only.after) == (("I",), ("III",))


def test_without_imbalance_a_circle_of_states_counts_as_stable() -> None:
    _, at = _over_imbalance(2.5, 0.075)
    found = steady_branches(at, np.array([0.0, 0.001, 0.002]))
    assert found.break_points == ()


def test_periodic_orbits_are_followed_too() -> None:
    p = rig()
    found = steady_branches(lambda ratio: (p, p.speed_rad_s(ratio)), np.linspace(2.7, 3.1, 3), 1e-8)
    assert [(one.before, one.after) for one in found.break_points] == [(("I",), ()), ((), ("III",))]
    before, after = (found.break_points[0].value + side * 1e-4 for side in (-1, 1))
    assert max(s.stable for s in steady_states(p, p.speed_rad_s(before)))
    assert not any(s.stable for s in steady_states(p, p.speed_rad_s(after)))


def test_what_cannot_be_judged_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    _, at = _over_imbalance(2.5, 0.037)

    def refuse(rig: RotorParameters, speed: float, accuracy: float):
        if rig.imbalance_moment_kg_m > 0.008:
            raise NotConverged("too far")
        return steady_states(rig, speed, accuracy)

    monkeypatch.setattr(branches, "steady_states", refuse)
    found = steady_branches(at, np.array([0.007, 0.009]))
    assert found.break_points[0].after == ("?",)
    assert found.unresolved[0] == (0.009, "too far")


@pytest.mark.parametrize("values", [[1.0], [2.0, 1.0], [1.0, 1.0], [1.0, math.nan], [[1.0, 2.0]]])
def test_values_must_rise(values: list[float]) -> None:
    with pytest.raises(OutsideDomain, match="at least two, ascending"):
        steady_branches(lambda ratio: (rig(), ratio), values)


def test_an_undamped_resonance_has_no_locked_amplitude() -> None:
    none = Pendulum.absent()
    p = RotorParameters(3.0, 1.0, 0.01, none, none, 16.0, 16.0, 0.0, 0.0)
    found = steady_branches(lambda speed: (p, speed), np.array([1.0, 2.0, 3.0]))
    assert np.isnan(found.locked_amplitude_m[list(found.values).index(2.0)])
    assert found.locked_amplitude_m[0] == pytest.approx(0.01 / (16 - 4))
