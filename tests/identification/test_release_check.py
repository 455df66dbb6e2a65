"""The release against the model: calibrated where the model is right, and able to find what is wrong."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.linalg import block_diag
from synthetic import STEP, Campaign

from daq.signals.run import Run
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import locked_state
from identification.pendulums.frictional_motion import frictional_motion
from identification.pendulums.release_problem import RecordedRelease
from identification.pendulums.suspension_knowledge import Knowledge
from identification.release_check import ReleaseRows, check_releases
from identification.release_check.attempts import Attempts
from identification.release_check.model import Misfit
from identification.release_check.together import fitted_at
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, Rig
from rig_configs.error_label import ErrorLabel
from rig_configs.known import BOW, FRICTION, ZERO_A, ZERO_B
from rig_configs.suspension_terms import TERMS
from tests.count_limits import mean_square_limit
from tests.effort import cases

SHARE = {
    "k1_N_per_m": 1e-4,
    "k2_N_per_m": 1e-4,
    "zeta1": 2e-3,
    "zeta2": 2e-3,
    "c3_Nms_per_rad": 4e-3,
    "c4_Nms_per_rad": 4e-3,
    "SP_kg_m": 1e-3,
}


def identified(campaign: Campaign, seed: int) -> IdentifiedParameters:
    """What an identification would have found, with its errors drawn."""
    true = campaign.truth.identified()
    std = np.array([SHARE[name] * true[name] for name in PARAMETER_UNITS])
    drawn = std * np.random.default_rng(seed).standard_normal(len(std))
    return IdentifiedParameters({n: true[n] + float(e) for n, e in zip(true, drawn, strict=True)}, np.diag(std**2))


def covariance(rows: ReleaseRows, found: IdentifiedParameters) -> np.ndarray:
    """Of the rows, with everything that is uncertain."""
    total = rows.own + rows.by_parameter @ found.own_covariance @ rows.by_parameter.T
    return total + sum(np.outer(shift, shift) for shift in rows.shared.values())


def best_size(rows: ReleaseRows, found: IdentifiedParameters, direction: np.ndarray) -> tuple[float, float]:
    """Size of one cause along a direction, and its standard deviation."""
    weighted = np.linalg.solve(covariance(rows, found), direction)
    information = float(weighted @ direction)
    return float(weighted @ rows.values) / information, information**-0.5


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return Campaign(3, clock_rate_std=0.0)


@pytest.fixture(scope="module")
def release_d(campaign: Campaign) -> Run:
    return campaign.point("D", 6.0)


def checked(run: Run, rig: Rig, found: IdentifiedParameters) -> ReleaseRows:
    (rows,) = check_releases([run], rig, found)
    return rows


def test_what_is_left_after_the_known_errors_is_the_noise_that_was_promised() -> None:
    chi2, whole, count = 0.0, 0.0, 0
    for seed in range(cases(2, 6)):
        campaign = Campaign(40 + seed, clock_rate_std=0.0)
        found, true = identified(campaign, seed), campaign.truth.identified()
        runs = [campaign.point(name, 6.0) for name in "ADE"]
        error = np.array([value - true[name] for name, value in found.values.items()])
        for rows in check_releases(runs, campaign.rig, found):
            zero_std = math.radians(campaign.rig.roles.zero_std_deg)
            noise = rows.values - rows.by_parameter @ error
            for name, zero in zip((ZERO_A, ZERO_B), campaign.zero, strict=True):
                noise = noise + rows.shared[ErrorLabel("known", name)] / zero_std * zero
            chi2 += float(noise @ np.linalg.solve(rows.own, noise))
            whole += float(rows.values @ np.linalg.solve(covariance(rows, found), rows.values))
            count += len(rows.values)
            assert np.linalg.norm(rows.values) > 5 * math.sqrt(len(rows.values))  # the errors were there to be seen
    of = count * 6 // cases(2, 6)
    low, high = (mean_square_limit(limit, of, count) for limit in (0.75, 1.3))
    assert low < chi2 / count < high
    low, high = (mean_square_limit(limit, of, count) for limit in (0.5, 1.6))
    assert low < whole / count < high


@pytest.mark.parametrize("share", [0.02, -0.1])
def test_wrong_damping_is_found_with_its_sign(campaign: Campaign, release_d: Run, share: float) -> None:
    found = identified(campaign, 5)
    name = "c3_Nms_per_rad"
    true = campaign.truth.identified()[name]
    values = {**found.values, name: true * (1 + share)}
    std = dict(zip(PARAMETER_UNITS, np.sqrt(np.diag(found.covariance)), strict=True))
    wrong = dataclasses.replace(found, values=values)
    rows = checked(release_d, campaign.rig, wrong)
    at = rows.parameters.index(name)
    size, size_std = best_size(rows, wrong, -rows.by_parameter[:, at])
    assert size_std < 1.1 * std[name]
    assert abs(size + share * true) < 4 * std[name]
    assert -size / size_std * np.sign(share) > 3


def test_a_wrong_pendulum_mass_in_the_rig_file_is_found(campaign: Campaign, release_d: Run) -> None:
    found = identified(campaign, 6)
    true = campaign.rig.physics.a.mass_kg
    rig = campaign.rig.with_number("pendulums.a.mass_kg", 1.002 * true)
    rows = checked(release_d, rig, found)
    size, std = best_size(rows, found, -rows.by_number["pendulums.a.mass_kg"])
    assert abs(size + 0.002 * true) < 4 * std
    assert std < 0.001 * true


def test_releases_together_are_met_to_the_noise_by_one_wrong_mass_alone() -> None:
    """Rows that are linear about each release's own fit, far apart along what a release hardly shows, are not."""
    left, count = 0.0, 0
    for seed in range(cases(1, 3)):
        campaign = Campaign(60 + seed, clock_rate_std=0.0)
        found, name = identified(campaign, seed), "pendulums.b.mass_kg"
        rig = campaign.rig.with_number(name, 1.003 * campaign.rig.physics.b.mass_kg)
        rows = check_releases([campaign.point(point, 6.0) for point in "ABCDE"], rig, found)
        values, by = np.concatenate([r.values for r in rows]), np.concatenate([r.by_parameter for r in rows])
        total = block_diag(*(r.own for r in rows)) + by @ found.own_covariance @ by.T
        for label in rows[0].shared:
            shift = np.concatenate([r.shared[label] for r in rows])
            total = total + np.outer(shift, shift)
        direction = np.concatenate([r.by_number[name] for r in rows])
        weighted = np.linalg.solve(total, direction)
        size = float(weighted @ values) / float(weighted @ direction)
        rest = values - size * direction
        left += float(rest @ np.linalg.solve(total, rest))
        count += len(values) - 1
        assert size == pytest.approx(0.003 * campaign.rig.physics.b.mass_kg, rel=0.2)
    assert left / count < mean_square_limit(1.3, count * 3 // cases(1, 3), count)


def test_all_that_tests_share_is_held_where_releases_agree(campaign: Campaign, release_d: Run) -> None:
    """If one of them stays at its first point, a release at D ends in a side minimum with χ² 15 per reading."""
    found = identified(campaign, 10)
    known = dataclasses.replace(Knowledge.nominal(found.applied_to(campaign.rig.physics)), terms=TERMS)
    release = RecordedRelease.of(release_d, known, 3 * math.radians(campaign.rig.roles.zero_std_deg), "balanced")
    fitted = Attempts(found, frozenset()).fitted(release)
    shared = {"pendulums.b.mass_kg": 1e-6, BOW[0]: 1e-8, **dict(zip(TERMS, (20.0, -20.0, 0.01, 0.02), strict=True))}
    there = fitted_at(fitted, shared, Misfit(1.0, 1.0))
    assert there is not None
    assert there.moved == pytest.approx(shared)
    before, after = (each.release.knowledge.physics for each in (fitted, there))
    assert after.b.mass_kg - before.b.mass_kg == pytest.approx(1e-6)
    assert after.bow_x_m - before.bow_x_m == pytest.approx(1e-8)
    terms = (*after.hardening_per_m2, *after.damping_growth_s_per_m)
    assert terms == pytest.approx((20.0, -20.0, 0.01, 0.02))


def test_a_pendulum_that_stays_in_its_lock_fails_plainly(campaign: Campaign, release_d: Run) -> None:
    held = release_d.angle_rad.copy()
    held[:, 0] = held[0, 0]
    rows = checked(dataclasses.replace(release_d, angle_rad=held), campaign.rig, identified(campaign, 7))
    assert len(rows.rows) == 1
    assert not rows.followed
    assert rows.values[0] > 20
    assert "follow" in rows.sentence


def test_a_release_that_was_used_states_for_which_parameters(campaign: Campaign, release_d: Run) -> None:
    found = identified(campaign, 8)
    tests = [
        {"test": "point-D", "log": release_d.source, "values": {"c3_Nms_per_rad": 1.0, "c4_Nms_per_rad": 1.0}},
        {"test": "spin-down", "log": "other.mcap", "values": {"k1_N_per_m": 1.0}},
    ]
    used = dataclasses.replace(found, provenance={"tests": tests})
    assert checked(release_d, campaign.rig, used).used_for == ("c3_Nms_per_rad", "c4_Nms_per_rad")
    assert checked(release_d, campaign.rig, found).used_for == ()


def test_what_is_not_identified_is_left_open(campaign: Campaign, release_d: Run) -> None:
    found = identified(campaign, 9)
    rows = checked(release_d, campaign.rig, found.without(["c3_Nms_per_rad"]))
    assert "c3_Nms_per_rad" not in rows.parameters
    reduced = found.without(["c3_Nms_per_rad"])
    assert rows.values @ np.linalg.solve(covariance(rows, reduced), rows.values) < 3 * len(rows.values)


def with_dry_friction(campaign: Campaign, run: Run, torque_Nm: float) -> Run:
    """The same release of pendulums that dry friction brakes too."""
    go, rng = run.releases[0].time_s, np.random.default_rng(11)
    turn = np.polynomial.Polynomial.fit(run.mark_time_s, run.mark_phase_rad, 1)
    phase, speed = float(turn(go)), float(turn.deriv()(go))
    history = SpeedHistory.constant(speed, phase - speed * go)
    start = locked_state(campaign.truth, speed, phase, 2e-3, math.pi - 1e-3)
    time = np.arange(go, run.angle_time_s[-1], 1e-3)
    packed = campaign.truth.packed()
    moved, _ = frictional_motion(
        start, go, time, 5e-4, history.knots_s, history.coefficients, packed, np.full(2, torque_Nm)
    )
    angle = np.stack([np.interp(run.angle_time_s, time, moved[:, i], left=start[i]) for i in (2, 3)], axis=1)
    noisy = (angle + campaign.zero) / STEP + 0.3 * rng.standard_normal(angle.shape)
    return dataclasses.replace(run, angle_rad=np.round(noisy) * STEP)


def test_dry_friction_that_an_identification_found_is_in_the_model() -> None:
    campaign, torque = Campaign(12, clock_rate_std=0.0), 4e-5
    run, found = with_dry_friction(campaign, campaign.point("E", 6.0), torque), identified(campaign, 10)
    friction = {"coulomb_a_Nm": 0.8 * torque, "coulomb_b_Nm": 1.2 * torque}
    entry = {"test": "spin-down", "log": "spin-down.mcap", "values": {}, "friction": friction}
    knowing = dataclasses.replace(found, provenance={"tests": [entry]})
    rows = checked(run, campaign.rig, knowing)
    chi2 = rows.values @ np.linalg.solve(covariance(rows, knowing), rows.values)
    assert rows.chi2_per_dof < 1.3
    assert chi2 < 3 * len(rows.values)
    without = checked(run, campaign.rig, found)
    assert without.values @ np.linalg.solve(covariance(without, found), without.values) > 3 * chi2
    assert "only with dry friction" in without.sentence
    shown = -without.values[-2:] / [without.by_number[name][-2 + i] for i, name in enumerate(FRICTION)]
    assert shown == pytest.approx([torque, torque], rel=0.15)


def test_with_nothing_identified_everything_is_left_open(campaign: Campaign, release_d: Run) -> None:
    rows = checked(release_d, campaign.rig, IdentifiedParameters({}, np.empty((0, 0))))
    assert rows.followed
    assert rows.by_parameter.shape == (len(rows.rows), 0)
    zero = {**identified(campaign, 5).values, "zeta1": 0.0}
    none = checked(release_d, campaign.rig, IdentifiedParameters(zero, np.zeros((7, 7))))
    assert not none.followed
    assert "zeta1" in none.sentence


def test_a_run_without_a_release_brings_no_rows(campaign: Campaign, release_d: Run) -> None:
    found = identified(campaign, 9)
    assert check_releases([dataclasses.replace(release_d, releases=())], campaign.rig, found) == []
    late = dataclasses.replace(
        release_d, angle_time_s=release_d.angle_time_s[:200], angle_rad=release_d.angle_rad[:200]
    )
    none = checked(late, campaign.rig, found)
    assert none.rows == ()
    assert not none.followed
    assert "only 0 encoder samples after the release" in none.sentence
