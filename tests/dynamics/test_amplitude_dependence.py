"""Springs that harden, damping that grows with the speed, air that drags the pendulums: the kernels' further terms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds.motion import Mechanics, SwingingMass, Turning, moved
from dynamics import Pendulum, RotorParameters, Scene, SpeedHistory, simulate
from dynamics.equations.kernels import jacobian, rates
from dynamics.errors import OutsideDomain
from dynamics.stability.turn_map import turn_derivatives
from identification.pendulums.frictional_motion import frictional_motion
from identification.pendulums.variational import PARAMETER_COLUMNS, free_motion
from tests.dynamics.nominal import rig as nominal

SPEED = 62.0  # point D
START = np.array([3e-3, -1e-3, 0.2, 3.0, 0.05, 0.2, 2.0, -3.0])


def rig() -> RotorParameters:
    p = nominal()
    return replace(
        p,
        hardening_per_m2=(5e3, 2e3),
        damping_growth_s_per_m=(1.0, 0.5),
        bow_x_m=5e-5,
        a=replace(p.a, drag_Nms2_per_rad2=2e-5),
        b=replace(p.b, drag_Nms2_per_rad2=4e-5),
    )


def as_world(p: RotorParameters) -> Mechanics:
    """The same numbers for the simulation that shares no line with the packages."""

    def swinging(q: Pendulum) -> SwingingMass:
        return SwingingMass(q.mass_kg, q.length_m, q.damping_Nms_per_rad, q.drag_Nms2_per_rad2)

    return Mechanics(
        p.total_mass_kg,
        (p.k1_N_per_m, p.k2_N_per_m),
        p.damping_Ns_per_m,
        p.imbalance_moment_kg_m,
        swinging(p.a),
        swinging(p.b),
        p.hardening_per_m2,
        p.damping_growth_s_per_m,
        abs(p.bow_m),
        float(np.angle(p.bow_m)),
    )


@pytest.mark.parametrize("released", [True, False])
def test_the_motion_is_that_of_an_independent_simulation(released: bool) -> None:
    """Two seconds at D; without the terms the angles are tenths of a radian elsewhere."""
    p, times = rig(), np.linspace(0.0, 2.0, 201)
    start = START if released else np.r_[START[:2], 0.0, math.pi, START[4:6], 0.0, 0.0]
    history = SpeedHistory.constant(SPEED)
    scene = Scene(history, (released, released), start)
    found = simulate(p, scene, times, 1e-7)
    expected = moved(as_world(p), Turning.steady(0.0, SPEED), times, start, released, 2.5e-5)
    assert np.max(np.abs(found.state[:, :2] - expected[:, :2])) < 1e-8
    assert np.max(np.abs(found.state[:, 2:4] - expected[:, 2:4])) < 2e-6
    plain = simulate(nominal(), scene, times, 1e-6)
    assert np.max(np.abs(plain.state[:, :2] - expected[:, :2])) > 1e-4


def test_the_kernels_own_derivatives() -> None:
    """Complex steps through |v| v, on both sides of zero, against differences."""
    packed, found = rig().packed(), np.empty((8, 8))
    for sign in (1.0, -1.0):
        state = START * np.r_[np.ones(4), np.full(4, sign)]
        jacobian(state, 0.3, SPEED, 0.0, packed, 1.0, 1.0, found)
        for j, h in enumerate([1e-7] * 2 + [1e-6] * 6):
            ends = np.empty((2, 8))
            for i, side in enumerate((1, -1)):
                rates(state + side * h * np.eye(8)[j], 0.3, SPEED, 0.0, packed, 1.0, 1.0, ends[i])
            assert np.allclose(found[:, j], (ends[0] - ends[1]) / (2 * h), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("frictional", [False, True])
def test_derivatives_of_the_free_motion(frictional: bool) -> None:
    """Derivatives by the start state and by k, c and S_P, compared with motions with changed parameters."""
    packed, history = rig().packed(), SpeedHistory.constant(SPEED)
    times = np.array([0.1, 0.25])

    def motion(p: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        arguments = start, 0.0, times, 1e-4, history.knots_s, history.coefficients, p
        return frictional_motion(*arguments, np.full(2, 1e-5)) if frictional else free_motion(*arguments)

    _, found = motion(packed, START)
    scale = np.max(np.abs(found), axis=(0, 2))
    for column in range(15):
        at = None if column < 8 else PARAMETER_COLUMNS[column - 8]
        h = 1e-6 * (1e-2 if column < 2 else 1.0) if at is None else 1e-5 * packed[at]
        ends = []
        for side in (1, -1):
            p, start = packed.copy(), START.copy()
            if at is None:
                start[column] += side * h
            else:
                p[at] += side * h
            ends.append(motion(p, start)[0])
        slope = (ends[0] - ends[1]) / (2 * h)
        size = np.maximum(np.max(np.abs(slope), axis=0), 1e-3 * scale)
        assert np.all(np.abs(found[:, :, column] - slope) < 1e-3 * size), column


def test_derivatives_of_the_map_over_a_revolution() -> None:
    p = rig()
    found = turn_derivatives(p, SPEED, START[None, :])
    assert found is not None
    period = 2 * math.pi / SPEED

    def after(start: np.ndarray) -> np.ndarray:
        scene = Scene(SpeedHistory.constant(SPEED), start=start)
        return simulate(p, scene, np.array([0.0, period]), 1e-9).state[-1]

    for j, h in enumerate([1e-6] * 2 + [1e-5] * 2 + [1e-5] * 2 + [1e-4] * 2):
        slope = (after(START + h * np.eye(8)[j]) - after(START - h * np.eye(8)[j])) / (2 * h)
        assert np.allclose(found[0, :, j], slope, rtol=1e-3, atol=1e-3 * np.max(np.abs(slope))), j


def test_what_a_rig_cannot_have_is_refused() -> None:
    with pytest.raises(OutsideDomain, match="hardening_per_m2"):
        replace(rig(), hardening_per_m2=(math.nan, 0.0))
    with pytest.raises(OutsideDomain, match=r"a\.drag"):
        replace(rig(), a=replace(rig().a, drag_Nms2_per_rad2=-1.0))
    assert not rig().is_isotropic
    assert nominal().suspension_is_linear
