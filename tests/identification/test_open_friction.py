"""Dry friction left open in each pendulum test and shared by all: the algebra, and hidden friction that biased c."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import binom
from synthetic import STEP, Campaign

from dynamics.equations.kernels import FA, FB
from dynamics.equations.speed_history import SpeedHistory
from identification import NotIdentifiable, fit_release, fit_spin_down_run
from identification.errors import FitFailed
from identification.estimate import Estimate
from identification.joint.shared_friction import friction_messages, with_shared_friction
from identification.joint.weighting import weighted
from identification.pendulums.frictional_motion import frictional_motion
from identification.pendulums.open_friction import OpenFriction, alone, inverse, pooled, together
from identification.pendulums.suspension_knowledge import Knowledge
from rig_configs.error_label import ErrorLabel
from rig_configs.load import load_rig
from tests.effort import cases

K1, K2, Z1, Z2 = 2469.0683568334575, 38836.57537306929, 0.017445223022521494, 0.03700809357651274
C3, C4, SP = 0.0004782124803139431, 0.0003601631340764401, 0.0024757151721370866
FRICTION = np.array([2.179873723228012e-07, 2.1829942077468535e-07])
UNIT = np.array([1e-3, 1e-3, 1e-6, 1e-6, 1e-9, 1e-9])
NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")


def run_down_covariance(noise: float = 1e-3) -> np.ndarray:
    """Of c, M, F by one exponential run-down of each pendulum, shape (6, 6), in UNIT."""
    t = np.linspace(0, 4.5, 400)
    fallen = 1 - np.exp(-t)
    design = np.column_stack(
        [t * (1 - fallen) - fallen, fallen - t, (1 - np.exp(-2 * t)) / 2 - fallen, 1 + 0 * t, fallen]
    )
    one = np.linalg.inv(design.T @ design / noise**2)[:3, :3]
    out = np.zeros((6, 6))
    for i in range(2):
        out[np.ix_([i, 2 + i, 4 + i], [i, 2 + i, 4 + i])] = one
    return out


def test_shared_friction_is_least_squares_over_damping_and_friction() -> None:
    rng, tests = np.random.default_rng(1), list[OpenFriction]()
    for _ in range(3):
        root = rng.standard_normal((6, 6)) * 1e-3
        tests.append(
            OpenFriction(
                np.r_[1e-3, 8e-4, np.zeros(4)] + 1e-3 * rng.standard_normal(6) * UNIT,
                (root @ root.T + 1e-8 * np.eye(6)) * np.outer(UNIT, UNIT),
            )
        )
    shared, whole = together(tests), pooled(tests)
    estimates = [
        Estimate(f"t{i}", (f"t{i}",), NAMES, c, own, {ErrorLabel("friction", f"{k}"): v for k, v in enumerate(by.T)})
        for i, (c, own, by) in enumerate(zip(shared.damping, shared.own, shared.shared, strict=True))
    ]
    joint = weighted(estimates)
    assert joint.values == pytest.approx(whole.values[:2], abs=1e-12)
    assert joint.covariance == pytest.approx(whole.covariance[:2, :2], rel=1e-6)


@pytest.mark.parametrize("size", [0.0, 0.3, 1.0, 3.0, 30.0])
def test_a_test_alone_covers_with_any_friction(size: float) -> None:
    covariance, rng = run_down_covariance(), np.random.default_rng(2)
    root, inside, n = np.linalg.cholesky(covariance), 0, cases(30, 100)
    friction = np.r_[0, 0, 0, 0, size * np.sqrt(np.diag(covariance))[4:]]
    for _ in range(n):
        found = alone(
            OpenFriction((friction + root @ rng.standard_normal(6)) * UNIT, covariance * np.outer(UNIT, UNIT))
        )
        inside += int(abs(found.damping[0]) < 1.96 * np.sqrt(found.covariance[0, 0]))
    assert inside >= binom.ppf(0.006, n, 0.95)


def test_a_covariance_without_information_does_not_end_in_an_exception() -> None:
    flat = np.ones((6, 6)) * np.outer(UNIT, UNIT)
    assert np.all(np.isfinite(inverse(flat / np.outer(UNIT, UNIT))))
    assert np.all(np.isfinite(alone(OpenFriction(np.zeros(6), flat)).covariance))
    with pytest.raises(FitFailed, match="no finite covariance"):
        OpenFriction(np.zeros(6), np.full((6, 6), np.nan))


def test_a_torque_at_one_speed_does_not_determine_its_parts() -> None:
    found = OpenFriction.of_torque_at(np.r_[1e-3, 1e-3, 1e-4, 1e-4, 0, 0], np.diag([1e-12] * 4), 1e4)
    design = np.array([0, 0, 1.0, 0, 1e4, 0])
    assert design @ found.covariance @ design == pytest.approx(1e-12, rel=1e-3)
    assert found.covariance[4, 4] > (1e-7) ** 2


def known(campaign: Campaign) -> Knowledge:
    true = campaign.truth.identified()
    found = {n: true[n] for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")}
    return Knowledge.nominal(campaign.rig.physics).with_found(found, {n: 1e-3 * v for n, v in found.items()})


@pytest.mark.parametrize("contact", [0.0, 6e-8, 3e-7])
def test_hidden_contact_friction_does_not_bias_a_spin_down_beyond_its_interval(contact: float) -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    packed, history = campaign.truth.packed(), SpeedHistory.constant(0.0, 0.3)
    packed[[FA, FB]] = contact
    start, free = np.array([0, 0, 0.001, np.pi, 0, 0, 10.0, -11.0]), np.arange(0, 3.0, 1e-3)
    states, _ = frictional_motion(start, 0.0, free, 5e-4, history.knots_s, history.coefficients, packed, np.zeros(2))
    angle = np.vstack([np.tile(start[2:4], (500, 1)), states[:, 2:4]])
    jitter = 0.3 * np.random.default_rng(1).standard_normal(angle.shape)
    run = dataclasses.replace(
        campaign.spin_down(),
        angle_time_s=np.arange(len(angle)) * 1e-3,
        angle_rad=np.round(angle / STEP + jitter) * STEP,
    )
    fit = fit_spin_down_run(run, known(campaign))
    for name, true in campaign.truth.identified().items():
        if name in fit.values:
            assert fit.intervals[name][0] < true < fit.intervals[name][1]
            assert abs(fit.values[name] - true) < 1.96 * fit.std[name] < 0.02 * true
    assert "does not exclude dry friction" in fit.undecided
    assert "releases at two speeds" in fit.undecided
    assert fit.undecided in fit.warnings


def test_sticking_and_sliding_at_the_limit_goes_on() -> None:
    physics = load_rig("virtual").physics.with_values(
        k1_N_per_m=K1, k2_N_per_m=K2, zeta1=Z1, zeta2=Z2, c3_Nms_per_rad=C3, c4_Nms_per_rad=C4, SP_kg_m=SP
    )
    packed, speed = physics.packed(), 2 * np.pi * 17.4
    packed[[FA, FB]] = FRICTION
    history, lock = SpeedHistory.constant(speed, 0.4), np.radians([0.1, 180.15])
    damping = 2 * np.array([Z1, Z2]) * np.sqrt(np.array([K1, K2]) * 7.27)
    moment = SP + 0.075 * 0.054 * np.exp(1j * lock).sum()
    x, y = (moment * speed**2 / (k - 7.27 * speed**2 + 1j * speed * c) for k, c in zip((K1, K2), damping, strict=True))
    turn = np.exp(0.4j)
    orbit = [(x * turn).real, (y * turn).imag], [(1j * speed * x * turn).real, (1j * speed * y * turn).imag]
    start = np.r_[orbit[0], lock, orbit[1], 0, 0]
    times = np.arange(0, 5.0, 0.004)
    states, by = frictional_motion(start, 0.0, times, 5e-4, history.knots_s, history.coefficients, packed, np.zeros(2))
    assert np.all(np.isfinite(states))
    assert np.all(np.isfinite(by))


def test_a_release_after_which_nothing_moves_is_refused() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run = campaign.point("E")
    stuck = np.where(run.angle_time_s[:, None] > 3.0, run.angle_rad[:1] + 1e-4, run.angle_rad)
    with pytest.raises(
        NotIdentifiable, match=r"A moves by .*° and B by .*°; a lock did not open, or dry friction holds"
    ):
        fit_release(dataclasses.replace(run, angle_rad=stuck), known(campaign), np.radians(0.05))


def test_two_tests_share_their_friction_and_one_stands_alone() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    spin, point = campaign.spin_down(apart_s=0.0), campaign.point("E")
    fits = {
        (spin.source,): fit_spin_down_run(spin, known(campaign)),
        (point.source,): fit_release(point, known(campaign), np.radians(0.05)),
    }
    own = [
        Estimate(
            "t",
            s,
            NAMES,
            np.array(list(f.values.values())),
            f.covariance,
            {ErrorLabel("clock", "e"): np.ones(2) * 1e-9},
        )
        for s, f in fits.items()
    ]
    both, shared = with_shared_friction(own, fits)
    assert shared is not None
    assert friction_messages(shared) == []
    assert {label for e in both for label in e.shared} == {
        ErrorLabel("clock", "e"),
        *(ErrorLabel("friction", f"{k + 1}") for k in range(4)),
    }
    true, joint = campaign.truth.identified(), weighted(both)
    assert np.all(np.abs(joint.values - [true[n] for n in NAMES]) < 4 * np.sqrt(np.diag(joint.covariance)))
    assert np.sqrt(joint.covariance[0, 0]) < 0.5 * own[0].std[NAMES[0]]
    one, nothing = with_shared_friction(both[:1], fits)
    assert nothing is None
    assert one[0].values == pytest.approx(own[0].values)
    assert set(one[0].shared) == {ErrorLabel("clock", "e")}
