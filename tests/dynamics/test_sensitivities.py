"""Derivatives of motions against central differences, an independent variational solution, and closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from dynamics.motions.integrate import locked_state, simulate
from dynamics.motions.locked_motion import locked_state_derivatives
from dynamics.motions.sensitivities import packed_derivatives, sensitivities

ARM = 0.054


def rig(damping: float = 1e-3) -> RotorParameters:
    pendulum = Pendulum(0.075, ARM, damping)
    k1 = 7.27 * (2 * math.pi * 3) ** 2
    return RotorParameters(7.0, 0.12, 0.02117, pendulum, pendulum, k1, 14.9 * k1, 0.02, 0.03)


def central_difference(p: RotorParameters, scene: Scene, times: np.ndarray, name: str) -> np.ndarray:
    if name.startswith("start_"):
        assert scene.start is not None
        moved, step = [], 1e-5
        for sign in (1, -1):
            start = scene.start.copy()
            start[int(name[-1])] += sign * step
            moved.append(simulate(p, dataclasses.replace(scene, start=start), times, 1e-11).state)
    else:
        value = p.identified()[name]
        step = 1e-5 * value
        moved = [simulate(p.with_values(**{name: value + s * step}), scene, times, 1e-11).state for s in (1, -1)]
    return (moved[0] - moved[1]) / (2 * step)


@pytest.mark.parametrize("method", ["explicit", "implicit"])
def test_sensitivities_are_central_differences(method: str) -> None:
    """Through a ramp with one release in the middle of the run."""
    p = rig()
    history = SpeedHistory.ramp(25.0, 35.0, 2.0)
    start = locked_state(p, 25.0, 0.0, 0.4, 2.0)
    scene, times = Scene(history, (True, True), start, (0.0, 0.7)), np.linspace(0, 3, 31)
    names = [*p.identified(), *(f"start_{i}" for i in range(8))]
    motion, found = sensitivities(p, scene, times, names, 1e-10, method)
    assert motion.method == method
    assert found.shape == (31, 8, 15)
    held = names.index("start_7")  # B is locked at first: its speed then means nothing, and one is refused
    for i, name in enumerate(names):
        if i == held:
            continue
        expected = central_difference(p, scene, times, name)
        assert np.max(np.abs(found[:, :, i] - expected)) < 1e-5 * np.max(np.abs(expected)) + 1e-9, name
    assert np.all(found[:, :, held] == 0.0)


def test_strong_magnets_too() -> None:
    p = rig(20.0)
    start = locked_state(p, 30.0, 0.0, 0.4, 2.0)
    scene, times = Scene(SpeedHistory.constant(30.0), start=start), np.linspace(0, 2, 11)
    motion, found = sensitivities(p, scene, times, ["c3_Nms_per_rad", "k1_N_per_m"], 1e-9)
    assert motion.method == "implicit"
    for i, name in enumerate(["c3_Nms_per_rad", "k1_N_per_m"]):
        expected = central_difference(p, scene, times, name)
        assert np.max(np.abs(found[:, :, i] - expected)) < 1e-5 * np.max(np.abs(expected))


@pytest.mark.parametrize("method", ["explicit", "implicit"])
def test_a_locked_orbit_in_closed_form(method: str) -> None:
    """Without a start state the motion stays on the locked orbit, and so do its derivatives."""
    p = dataclasses.replace(rig(), gravity_m_per_s2=9.81)
    speed, times = 30.0, np.linspace(0, 4, 41)
    names = list(p.identified())
    _, found = sensitivities(p, Scene(SpeedHistory.constant(speed), (False, False)), times, names, 1e-10, method)
    for i, name in enumerate(names):
        closed = np.array([locked_state_derivatives(p, speed, speed * t, 0.0, math.pi)[name] for t in times])
        scale = np.max(np.abs(closed))
        assert np.max(np.abs(found[:, :, i] - closed)) <= 1e-7 * scale, name
        assert (scale > 0) == (name not in ("c3_Nms_per_rad", "c4_Nms_per_rad"))


def test_an_independent_variational_solution() -> None:
    """Pendulums on a disk that hardly moves: θ̈ = −c θ̇/J on a resting rotor, ∂θ/∂c in closed form."""
    k = 1e9
    pendulum = Pendulum(1e-6, ARM, 1e-8)
    p = RotorParameters(7.0, 0.12, 0.0, pendulum, pendulum, k, k, 0.02, 0.02)
    start = np.array([0, 0, 0.3, 0.3 + math.pi, 0, 0, 5.0, 5.0])
    times = np.linspace(0, 1.0, 11)
    scene = Scene(SpeedHistory.constant(0.0), start=start)
    _, found = sensitivities(p, scene, times, ["c3_Nms_per_rad", "start_6"], 1e-9)
    j = pendulum.inertia_kg_m2
    decay = 1e-8 / j
    e = np.exp(-decay * times)
    assert np.allclose(found[:, 6, 1], e, rtol=1e-6)
    by_c = 5.0 * (times * e / decay - (1 - e) / decay**2) / j
    assert np.allclose(found[:, 2, 0], by_c, rtol=1e-6, atol=1e-6 * np.max(np.abs(by_c)))


def test_derivatives_of_packed_numbers_and_of_the_locked_state() -> None:
    p = dataclasses.replace(rig(), gravity_m_per_s2=9.81)
    for name, derivative in packed_derivatives(p).items():
        step = 1e-6 * p.identified()[name]
        more, less = (p.with_values(**{name: p.identified()[name] + s * step}) for s in (1, -1))
        expected = (more.packed() - less.packed()) / (2 * step)
        assert np.allclose(derivative, expected, rtol=1e-7, atol=1e-7 * np.max(np.abs(expected)))
        moved = [locked_state(q, 30.0, 0.7, 0.2, 2.0) for q in (more, less)]
        expected = (moved[0] - moved[1]) / (2 * step)
        found = locked_state_derivatives(p, 30.0, 0.7, 0.2, 2.0)[name]
        assert np.allclose(found, expected, rtol=1e-6, atol=1e-7 * np.max(np.abs(expected)))


def test_what_has_no_sensitivity_is_refused() -> None:
    scene = Scene(SpeedHistory.constant(30.0))
    with pytest.raises(OutsideDomain, match=r"no sensitivity to \['k3'\]"):
        sensitivities(rig(), scene, 1.0, ["k3"])
    rubbing = dataclasses.replace(rig(), a=Pendulum(0.075, ARM, 1e-3, 1e-4))
    with pytest.raises(OutsideDomain, match="dry friction"):
        sensitivities(rubbing, scene, 1.0, ["zeta1"])


def test_no_names_and_no_time() -> None:
    scene = Scene(SpeedHistory.constant(30.0), start=locked_state(rig(), 30.0, 0.0, 0.4, 2.0))
    assert sensitivities(rig(), scene, np.array([0.0, 1.0]), [])[1].shape == (2, 8, 0)
    _, found = sensitivities(rig(), scene, np.array([0.0]), ["start_2", "zeta1"])
    assert np.array_equal(found[0].T, [np.eye(8)[2], np.zeros(8)])
