"""Steady motions and the locked orbit of a nonlinear suspension, compared with an independent simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds.motion import Turning, moved
from dynamics import choose_model, locked_orbit, steady_states
from dynamics.equations.model import HALF_REVOLUTION
from dynamics.errors import OutsideDomain
from dynamics.motions.locked_motion import locked_state, locked_state_derivatives
from tests.dynamics.nominal import rig as nominal
from tests.dynamics.test_amplitude_dependence import as_world

HARD, DRAGGED = {"hardening_per_m2": (4800.0, 1600.0)}, {"damping_growth_s_per_m": (1.0, 0.5)}


@pytest.mark.parametrize("terms", [HARD, DRAGGED, HARD | DRAGGED])
@pytest.mark.parametrize("ratio", [0.83, 3.3])
def test_a_steady_state_repeats_itself(terms: dict[str, tuple[float, float]], ratio: float) -> None:
    """Without the terms θ3 is elsewhere by a degree and more, and the state moves at once."""
    p = replace(nominal(), **terms)
    speed = p.speed_rad_s(ratio)
    state = steady_states(p, speed, 1e-6)[0]
    assert state.stable
    period = np.array([0.0, 2 * math.pi / speed])
    end = moved(as_world(p), Turning.steady(0.0, speed), period, state.start, True, 2.5e-5)[-1]
    scale = np.r_[1e-8, 1e-8, 1e-5, 1e-5, 1e-6, 1e-6, 1e-4, 1e-4]
    assert np.all(np.abs(end - state.start) < scale)
    plain = steady_states(nominal(), speed, 1e-6)[0]
    assert np.max(np.abs(np.exp(1j * np.array(plain.theta_rad)) - np.exp(1j * np.array(state.theta_rad)))) > 5e-3


@pytest.mark.parametrize("terms", [HARD, HARD | DRAGGED])
def test_multipliers_are_those_of_the_independent_map_over_a_revolution(terms: dict[str, tuple[float, float]]) -> None:
    p = replace(nominal(), **terms)
    speed = p.speed_rad_s(3.3)
    state, period = steady_states(p, speed, 1e-6)[0], np.array([0.0, 2 * math.pi / speed])
    slope = np.empty((8, 8))
    for j, h in enumerate([1e-7] * 2 + [1e-6] * 4 + [1e-5] * 2):
        ends = [
            moved(as_world(p), Turning.steady(0.0, speed), period, state.start + sign * h * np.eye(8)[j], True, 1e-5)
            for sign in (1, -1)
        ]
        slope[:, j] = (ends[0][-1] - ends[1][-1]) / (2 * h)
    assert abs(state.multiplier_max - np.max(np.abs(np.linalg.eigvals(slope)))) < 1e-6
    assert 0 < state.error_estimate < 1e-6


@pytest.mark.parametrize("terms", [HARD, DRAGGED, HARD | DRAGGED])
@pytest.mark.parametrize("bow", [0.0, 1e-4])
def test_the_locked_orbit_repeats_itself(terms: dict[str, tuple[float, float]], bow: float) -> None:
    p = replace(nominal(), **terms, bow_x_m=bow)
    for ratio in (0.9, 3.6):
        speed = p.speed_rad_s(ratio)
        start = locked_state(p, speed, 0.7, 0.1, 3.0)
        period = np.array([0.0, 2 * math.pi / speed])
        end = moved(as_world(p), Turning.steady(0.7, speed), period, start, False, 2.5e-5)[-1]
        assert np.all(np.abs(end - start)[:2] < 1e-9)
        assert np.all(np.abs(end - start)[4:6] < 1e-7)
        linear = locked_orbit(nominal(), speed, 0.1, 3.0)
        found = locked_orbit(p, speed, 0.1, 3.0)
        assert max(abs(a - b) for a, b in zip(linear, found, strict=True)) > 1e-6


def test_the_locked_orbits_derivatives() -> None:
    p = replace(nominal(), **HARD, **DRAGGED)
    found = locked_state_derivatives(p, 16.0, 0.3, 0.1, 3.0)["k1_N_per_m"]
    h = 1e-3 * p.k1_N_per_m
    ends = [locked_state(p.with_values(k1_N_per_m=p.k1_N_per_m + s * h), 16.0, 0.3, 0.1, 3.0) for s in (1, -1)]
    assert np.allclose(found, (ends[0] - ends[1]) / (2 * h), rtol=1e-3, atol=1e-10)


def test_no_closed_form_is_chosen_and_a_resonance_that_is_bent_over_is_refused() -> None:
    p = replace(nominal(), **HARD)
    for released in ((True, True), (False, False)):
        assert choose_model(p, released).name == HALF_REVOLUTION
    alike = replace(nominal(), k2_N_per_m=nominal().k1_N_per_m, **HARD)
    assert "depends on the motion" in choose_model(alike).why
    state = steady_states(p, p.speed_rad_s(0.9), 1e-6, (False, False))[0]
    assert abs(state.x_m - locked_orbit(p, p.speed_rad_s(0.9))[0]) < 1e-8
    with pytest.raises(OutsideDomain, match="bent over"):
        locked_orbit(replace(p, hardening_per_m2=(-1e5, 0.0), **DRAGGED), p.speed_rad_s(0.9))
