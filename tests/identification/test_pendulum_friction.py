"""Dry friction in spin-downs and releases, phases that are not exact, and releases that no model follows."""

from __future__ import annotations

import dataclasses
import re
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp
from synthetic import Campaign

from dynamics.equations.speed_history import SpeedHistory
from identification import FitFailed, NotIdentifiable, fit_release, fit_spin_down_run, identify
from identification.identify import _left_out
from identification.least_squares import minimise
from identification.methods import advice
from identification.pendulums.frictional_motion import COLUMNS, frictional_motion
from identification.pendulums.recorded_speed import speed_of_marks, speed_of_samples
from identification.pendulums.release import ReleaseLeftOut
from identification.pendulums.run_down import run_down_angle
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientProblem
from identification.pendulums.variational import free_motion

STEP = 2 * np.pi / 4096


def nominal() -> Campaign:
    return Campaign(6, clock_rate_std=0.0)


def known(campaign: Campaign) -> Knowledge:
    true = campaign.truth.identified()
    found = {n: true[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    return Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-3 * v for n, v in found.items()})


def motion(
    packed: np.ndarray, speed: float, start: np.ndarray, time: np.ndarray, torque: float
) -> tuple[np.ndarray, np.ndarray]:
    history = SpeedHistory.constant(speed, 0.3)
    return frictional_motion(
        start, float(time[0]), time, 5e-4, history.knots_s, history.coefficients, packed, np.full(2, torque)
    )


def test_without_friction_it_is_the_free_motion() -> None:
    packed, time = nominal().truth.packed(), np.arange(0, 1.0, 0.004)
    start = np.array([0, 0, 0.01, 3.1, 0, 0, 0.0, 0.0])
    history = SpeedHistory.constant(100.0, 0.3)
    smooth, by = free_motion(start, 0.0, time, 5e-4, history.knots_s, history.coefficients, packed)
    dry, dry_by = motion(packed, 100.0, start, time, 0.0)
    assert dry == pytest.approx(smooth, abs=1e-6)
    scale = np.maximum(np.abs(by).max(axis=0), 1e-9)
    assert dry_by[:, :, :15] / scale == pytest.approx(by / scale, abs=1e-4)


@given(st.floats(0, 6.3), st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.sampled_from([20.0, 109.0]))
def test_released_at_rest_without_friction_it_is_the_free_motion(
    phase: float, a: float, x_rate: float, y_rate: float, speed: float
) -> None:
    """One that begins to slide changes the torque that holds the other, and may turn its sign."""
    packed, time = nominal().truth.packed(), np.arange(0, 0.1, 0.004)
    start = np.array([-4e-4, 6e-5, 2e-3 * a, np.pi + 1e-3, 0.1 * x_rate, 0.1 * y_rate, 0.0, 0.0])
    history = SpeedHistory.constant(speed, phase)
    given_to = (start, 0.0, time, 5e-4, history.knots_s, history.coefficients, packed)
    smooth, dry = free_motion(*given_to)[0], frictional_motion(*given_to, np.zeros(2))[0]
    assert dry[:, 2:4] == pytest.approx(smooth[:, 2:4], abs=1e-6)


def test_friction_stops_a_pendulum_when_the_closed_form_predicts() -> None:
    packed, time = nominal().truth.packed(), np.arange(0, 2.0, 0.004)
    packed[0] = 1e6  # a disk too heavy to move
    inertia, damping, torque = packed[8], packed[10], 1e-3
    start = np.array([0, 0, 0.2, 3.0, 0, 0, 10.0, 0.0])
    states, by = motion(packed, 0.0, start, time, torque)
    theta = np.r_[0.2, 10.0, np.log(damping / inertia), torque / (damping * 10.0)]
    angle, slope = run_down_angle(time, theta)
    assert states[:, 2] == pytest.approx(angle, abs=1e-6)
    assert states[-1, 6] == 0.0
    by_torque = slope[:, 3] / (damping * 10.0)
    assert by[:, 2, 15] == pytest.approx(by_torque, abs=1e-4 * np.max(np.abs(by_torque)))


def test_slides_and_sticks_on_a_turning_rotor_as_a_stiff_solver_finds_them() -> None:
    truth = nominal().truth
    packed, speed, torque = truth.packed(), 30.0, 5e-4
    mass, k1, k2, c1, c2, sa, sb, sp, ja, jb, ca, cb = packed[:12]

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        psi, matrix, force = 0.3 + speed * t, np.diag([mass, mass, ja, jb]), np.zeros(4)
        force[0] = -k1 * y[0] - c1 * y[4] + sp * speed**2 * np.cos(psi)
        force[1] = -k2 * y[1] - c2 * y[5] + sp * speed**2 * np.sin(psi)
        for i, (s, c) in enumerate(((sa, ca), (sb, cb))):
            phi, rate = psi + y[2 + i], speed + y[6 + i]
            matrix[0, 2 + i] = matrix[2 + i, 0] = -s * np.sin(phi)
            matrix[1, 2 + i] = matrix[2 + i, 1] = s * np.cos(phi)
            force[0] += s * rate**2 * np.cos(phi)
            force[1] += s * rate**2 * np.sin(phi)
            force[2 + i] = -c * y[6 + i] - torque * np.tanh(y[6 + i] / 1e-4)
        return np.r_[y[4:], np.linalg.solve(matrix, force)]

    start, time = np.array([1e-3, 0, 0.01, 3.1, 0, 0, 2.0, -1.0]), np.arange(0, 0.8, 0.02)
    exact = solve_ivp(slope, (0, time[-1]), start, "LSODA", time, rtol=1e-8, atol=1e-10).y.T
    states, _ = motion(packed, speed, start, time, torque)
    assert states[:, 2:4] == pytest.approx(exact[:, 2:4], abs=3e-4)


def test_derivatives_pass_through_the_switches() -> None:
    packed, time = nominal().truth.packed(), np.arange(0, 1.5, 0.01)
    start, torque = np.array([0, 0, 0.01, 3.1, 0, 0, 6.0, -5.0]), 4e-4
    _, by = motion(packed, 0.0, start, time, torque)
    assert by.shape == (len(time), 8, COLUMNS)
    high, low = (motion(packed, 0.0, start, time, torque + d)[0] for d in (1e-9, -1e-9))
    assert (by[:, 2:4, 15] + by[:, 2:4, 16]) == pytest.approx((high - low)[:, 2:4] / 2e-9, rel=1e-3, abs=1.0)


def with_friction(campaign: Campaign, torque: float) -> dict[str, np.ndarray]:
    """Encoder samples of both pendulums flicked at once on a resting rotor, with dry friction."""
    start = np.array([0, 0, 0.001, np.pi, 0, 0, 10.0, -11.0])
    free = np.arange(0, 3.0, 1e-3)
    states, _ = motion(campaign.truth.packed(), 0.0, start, free, torque)
    rest = np.tile(start[2:4], (500, 1))
    angle = np.vstack([rest, states[:, 2:4]])
    time = np.arange(len(angle)) * 1e-3
    jitter = 0.3 * np.random.default_rng(1).standard_normal(angle.shape)
    return {"angle_time_s": time, "angle_rad": np.round(angle / STEP + jitter) * STEP}


@pytest.mark.parametrize("torque", [0.0, 1e-4, 2e-3])
def test_a_spin_down_decides_for_friction_by_its_readings(torque: float) -> None:
    campaign = nominal()
    run = dataclasses.replace(campaign.spin_down(), **with_friction(campaign, torque))
    fit = fit_spin_down_run(run, known(campaign))
    for name, value in fit.values.items():
        assert abs(value - campaign.truth.identified()[name]) < 4 * fit.std[name] < 0.2 * value
    if torque == 0.0:
        assert fit.friction is None
        return
    assert fit.friction is not None
    for found, std in zip(fit.friction.torque_Nm, fit.friction.torque_std_Nm, strict=True):
        assert abs(found - torque) < 4 * std + 1e-3 * torque
    assert any("dry friction" in w for w in fit.warnings)
    assert "with friction" in fit.model


def test_a_phase_in_steps_has_a_steady_speed() -> None:
    time = np.arange(3.0, 14.0, 1e-3)
    for speed in (30.0, 62.8, 109.0):
        step = np.radians(0.1)
        found = speed_of_samples(time, np.round((0.7 + speed * time) / step) * step)
        psi, rate, acceleration = found.history.phase(time[500:-500:50]).T
        assert np.max(np.abs(psi - 0.7 - speed * time[500:-500:50])) < 0.2 * step
        assert np.max(np.abs(rate - speed)) < 1e-3
        assert np.max(np.abs(acceleration)) < 1e-3


def test_an_integrated_noise_is_a_walk_and_its_errors_are_left_open() -> None:
    time, rng, inside = np.arange(0, 12.0, 5e-4), np.random.default_rng(2), []
    for _ in range(5):
        noise = 0.02 * rng.standard_normal(len(time)) * 5e-4
        found = speed_of_samples(time, 100.0 * time + np.cumsum(noise))
        assert len(found.modes) >= 2
        error = found.history.phase(time[::400])[:, 1] - 100.0
        assert np.max(np.abs(found.history.phase(time[::400])[:, 2])) < 0.01
        inside.append(float(np.sqrt(np.mean(error**2))))
    assert np.median(inside) < 5e-4


def test_a_speed_that_varies_is_followed() -> None:
    time, step = np.arange(0, 12.0, 1e-3), np.radians(0.1)
    wobble = 0.05 / 4.4 * np.sin(4.4 * time)
    found = speed_of_samples(time, np.round((100.0 * time + wobble) / step) * step)
    assert found.history.phase(time[500:-500])[:, 0] == pytest.approx((100.0 * time + wobble)[500:-500], abs=1e-3)
    marks = np.arange(0, 12.0, 0.06)
    assert speed_of_marks(marks, 100.0 * marks).phase(6.0)[0, 1] == pytest.approx(100.0, abs=1e-9)


def test_stamping_noise_is_no_wobble_and_a_wobble_is_found() -> None:
    rng, turns = np.random.default_rng(4), np.arange(47)
    phase, lively = 2 * np.pi * turns, 0
    for _ in range(200):
        time = turns / 4.8 + 1e-6 * rng.standard_normal(len(turns))
        lively += len(speed_of_marks(time, phase).knots_s) > 2
    assert lively <= 4
    moved = phase + 2e-3 * np.sin(1.5 * turns / 4.8)
    found = speed_of_marks(turns / 4.8 + 1e-6 * rng.standard_normal(len(turns)), moved)
    assert len(found.knots_s) > 2
    assert found.phase(turns / 4.8)[:, 0] == pytest.approx(moved, abs=1e-4)


def test_a_release_whose_phase_comes_in_steps_is_followed() -> None:
    campaign = nominal()
    run, step = campaign.point("E"), np.radians(0.1)
    time = np.arange(run.mark_time_s[0], run.mark_time_s[-1], 1e-3)
    phase = np.round(np.interp(time, run.mark_time_s, run.mark_phase_rad) / step) * step
    turns = np.arange(np.ceil(phase[0] / (2 * np.pi)), phase[-1] // (2 * np.pi)) * 2 * np.pi
    rows = dataclasses.replace(
        run, phase_time_s=time, phase_rad=phase, mark_time_s=np.interp(turns, phase, time), mark_phase_rad=turns
    )
    fit = fit_release(rows, known(campaign), np.radians(0.05))
    for name, value in fit.values.items():
        assert abs(value - campaign.truth.identified()[name]) < 4 * fit.std[name] < 0.05 * value


def test_a_wrong_mass_is_found_out_and_not_tried_for_ever() -> None:
    campaign, messages = Campaign(34, {"virtual.truth.pendulums.a.mass_kg": 0.0744}, clock_rate_std=0.0), list[str]()
    true = campaign.truth
    found = {n: true.identified()[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    # the file's mass; the other tests measure frequencies and the locked rig's moment, and so carry its error
    grown = campaign.rig.physics.total_mass_kg / true.total_mass_kg
    moment = true.a.first_moment_kg_m - true.b.first_moment_kg_m
    found = {n: v * (grown if n.startswith("k") else 1.0) for n, v in found.items()}
    found["SP_kg_m"] = (found["SP_kg_m"] + moment) * grown - (
        campaign.rig.physics.a.first_moment_kg_m - campaign.rig.physics.b.first_moment_kg_m
    )
    knowledge = Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-3 * v for n, v in found.items()})
    with pytest.raises(ReleaseLeftOut) as refused:
        fit_release(campaign.point("E"), knowledge, np.radians(0.05), notify=messages.append)
    assert re.match(r"pendulum A's mass -0\.[789]", refused.value.causes[0])
    assert len(messages) < 10


def test_a_plateau_ends_an_iteration() -> None:
    def slope(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # a slow descent together with a constant residual
        falling = np.exp(-theta)
        return np.r_[np.full(50, 100.0), falling], np.vstack([np.zeros((50, 1)), -falling[None]])

    stopped, whole = (minimise(slope, np.array([-3.0]), 60, plateau=p) for p in (5.0, None))
    assert not stopped.converged
    assert stopped.iterations < whole.iterations


def test_advice_never_names_what_was_given() -> None:
    campaign = nominal()
    given = [campaign.spin_down()]
    assert "record spin-down" not in advice(["c3_Nms_per_rad"], given)
    assert "the given spin-down" in advice(["c3_Nms_per_rad"], given)
    assert "record spin-down" in advice(["c3_Nms_per_rad"], [])


def test_several_releases_left_out_share_one_advice() -> None:
    both = [(f"point-{n}", ReleaseLeftOut(f"{n}.mcap: not followed", ["A's mass −1 %"])) for n in "DE"]
    lines = _left_out(both)
    assert len(lines) == 3
    assert sum("Weigh" in line for line in lines) == 1
    assert _left_out([]) == []


def test_a_fit_that_has_not_settled_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = nominal()
    run = campaign.spin_down()
    fit = fit_spin_down_run(run, known(campaign))
    assert fit.settled
    # the module, which the package's function of the same name hides
    module = sys.modules["identification.identify"]
    monkeypatch.setattr(module, "fit_spin_down_run", lambda *_, **__: dataclasses.replace(fit, settled=False))
    with pytest.raises(NotIdentifiable, match="spin-down left out: its fit had not settled"):
        identify([run], campaign.rig)


def test_a_spin_down_whose_friction_does_not_settle_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = nominal()
    run = campaign.spin_down()
    monkeypatch.setattr(TransientProblem, "opened", lambda *_: None)
    with pytest.raises(FitFailed, match="does not separate viscous damping from dry friction"):
        fit_spin_down_run(run, known(campaign))


def test_errors_stay_in_the_tree() -> None:
    assert issubclass(ReleaseLeftOut, FitFailed)
    assert not issubclass(ReleaseLeftOut, NotIdentifiable)
