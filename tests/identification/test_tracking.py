"""The filter against filterpy's, and the tracker through a bad day."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
from hypothesis import given, settings, strategies as st
from synthetic import Campaign

from dynamics.equations.kernels import rk4_step
from dynamics.equations.speed_history import SpeedHistory
from identification import NotIdentifiable
from identification.tracking.phase_clock import PhaseClock
from identification.tracking.release_start import damping_start
from identification.tracking.replay import track
from identification.tracking.tracker import SensorNoise, Tracker
from identification.tracking.unscented import TALLY, cholesky, filter_readings
from rig_configs.load import load_rig

RIG = load_rig("virtual").physics
SPEED, STEP = 50.0, 1e-3
BEGIN = np.r_[1e-4, 0, 0.3, 2.8, 0, 5e-3, 0, 0, np.log(1e-3), np.log(1e-3)]
SPREAD = np.r_[1e-4, 1e-4, 0.01, 0.01, 1e-2, 1e-2, 0.1, 0.1, 0.5, 0.5] ** 2
NOISE = np.r_[np.zeros(4), 1e-7, 1e-7, 1e-4, 1e-4, 1e-5, 1e-5]
NOISES = np.r_[1e-5, 1e-5, 1e-3, 1e-3]


def moved(y: np.ndarray, dt: float, psi: float) -> np.ndarray:
    out = y.copy()
    phases = np.array([[psi + SPEED * dt * s, SPEED, 0.0] for s in (0.0, 0.5, 1.0)])
    p = RIG.with_values(c3_Nms_per_rad=float(np.exp(y[8])), c4_Nms_per_rad=float(np.exp(y[9]))).packed()
    rk4_step(out[:8], dt, *phases, p, 1.0, 1.0, *np.empty((5, 8)))
    return out


def readings(steps: int, seed: int = 0) -> np.ndarray:
    rng, y, out = np.random.default_rng(seed), BEGIN.copy(), []
    y[8:] += 0.5
    for i in range(steps):
        y = moved(y, STEP, SPEED * STEP * i)
        out.append(y[:4] + NOISES * rng.standard_normal(4))
    return np.array(out)


def own(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n = len(data)
    times = np.repeat(STEP * np.arange(1, n + 1), 4)
    phases = np.column_stack([SPEED * np.r_[0.0, times[:-1]], np.full(4 * n, SPEED), np.zeros(4 * n)])
    mean, cov = BEGIN.copy(), np.diag(SPREAD)
    filter_readings(
        mean,
        cov,
        times,
        np.zeros(4 * n),
        np.tile(np.arange(4), n),
        data.ravel(),
        np.tile(NOISES**2, n),
        phases,
        np.ones((4 * n, 2)),
        RIG.packed(),
        NOISE,
        1.0,
        8.0,
        -1.0,
        np.zeros(TALLY),
        np.empty(4 * n),
    )
    return mean, cov


def test_the_compiled_filter_is_filterpy_s() -> None:
    data = readings(150)
    peer = UnscentedKalmanFilter(10, 4, STEP, lambda y: y[:4], moved, JulierSigmaPoints(10, kappa=0.0))
    peer.x, peer.P, peer.Q, peer.R = BEGIN.copy(), np.diag(SPREAD), np.diag(NOISE) * STEP, np.diag(NOISES**2)
    for i, reading in enumerate(data):
        peer.predict(psi=SPEED * STEP * i)
        peer.update(reading)
    mean, cov = own(data)
    std = np.sqrt(np.diag(peer.P))
    assert (mean - peer.x) / std == pytest.approx(np.zeros(10), abs=1e-6)
    assert cov / np.outer(std, std) == pytest.approx(peer.P / np.outer(std, std), abs=1e-6)


def test_covariance_stays_symmetric_and_positive() -> None:
    _, cov = own(readings(400, 1))
    assert np.array_equal(cov, cov.T)
    assert np.min(np.linalg.eigvalsh(cov / np.sqrt(np.outer(np.diag(cov), np.diag(cov))))) > 0


def test_a_broken_covariance_is_repaired() -> None:
    for broken in (np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros((2, 2)), np.array([[np.nan, 0.0], [0.0, -1.0]])):
        factor = np.zeros((2, 2))
        assert cholesky(broken, factor) > 0
        assert np.all(np.isfinite(factor))
        assert np.all(np.diag(factor) > 0)


@pytest.mark.parametrize("wrong", [1.0, 10.0])
def test_a_release_is_followed(wrong: float) -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run, true = campaign.point("E"), campaign.truth.identified()
    physics = campaign.truth.with_values(**{n: wrong * true[n] for n in ("c3_Nms_per_rad", "c4_Nms_per_rad")})
    followed = track(run, physics)
    assert followed.last.trusted
    for i, (name, (low, high)) in enumerate(followed.last.intervals.items()):
        assert low < true[name] < high
        assert followed.last.values[name] == pytest.approx(true[name], rel=0.3)
        assert followed.high[-1, i] / followed.low[-1, i] < followed.high[20, i] / followed.low[20, i]
    assert followed.states.shape == (len(followed.time_s), 8)
    at = np.interp(followed.time_s[-1], run.angle_time_s, run.angle_rad[:, 0])
    assert followed.states[-1, 2] == pytest.approx(at, abs=0.02)


def test_loss_outliers_disorder_and_clock_jumps_end_nothing() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run, rng = campaign.point("E"), np.random.default_rng(0)
    tracker = Tracker(campaign.truth, released=(False, False))
    tracker.feed_marks((run.mark_time_s * 1e9).astype(np.int64), run.mark_phase_rad)
    for release in run.releases:
        tracker.release(release.pendulum, int(release.time_s * 1e9))
    angle = run.angle_rad.copy()
    angle[rng.random(len(angle)) < 0.03] += 2.0
    angle[rng.random(len(angle)) < 0.03] = np.nan
    time = (run.angle_time_s * 1e9).astype(np.int64)
    kept = np.flatnonzero((run.angle_time_s < 5.0) | (run.angle_time_s > 5.4))  # four tenths of radio silence
    parts = np.array_split(kept, 400)
    for i in range(0, 399, 2):
        parts[i], parts[i + 1] = parts[i + 1], parts[i]
    for part in parts:
        tracker.feed_encoders(time[part], angle[part])
    found, true = tracker.estimate(), campaign.truth.identified()
    assert found.counts["refused"] > 100
    assert found.counts["late"] < len(kept) / 20
    for name, value in found.values.items():
        assert value == pytest.approx(true[name], rel=0.5)
    tracker.feed_encoders(time[:2000], angle[:2000])  # the node has restarted
    after = tracker.estimate()
    assert after.counts["restarts"] >= 1
    assert all(np.isfinite(v) for v in (*after.values.values(), *after.states.values(), *after.std.values()))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(-(10**12), 10**12),
            st.floats(allow_nan=True, allow_infinity=True),
            st.floats(-1e9, 1e9),
            st.sampled_from(["encoders", "lasers", "marks", "release", "lock"]),
        ),
        max_size=40,
    )
)
def test_nothing_that_arrives_raises(batches: list[tuple[int, float, float, str]]) -> None:
    tracker = Tracker(RIG, lag_s=0.0)
    for time, one, other, kind in batches:
        at = np.array([time])
        if kind == "encoders":
            tracker.feed_encoders(at, np.array([[one, other]]))
        elif kind == "lasers":
            tracker.feed_lasers(at, np.array([one]), at, np.array([other]))
        elif kind == "marks":
            tracker.feed_marks(at, np.array([one]))
        elif kind == "release":
            tracker.release(0, time)
        else:
            tracker.lock(1, time)
        found = tracker.estimate()
        assert all(np.isfinite(v) for v in found.values.values())


def test_the_filter_starts_the_fit_near_enough() -> None:
    campaign = Campaign(6, clock_rate_std=0.0)
    run = campaign.point("E")
    history = SpeedHistory.from_phases(run.mark_time_s, run.mark_phase_rad)
    far = campaign.truth.with_values(c3_Nms_per_rad=1e-2, c4_Nms_per_rad=1e-4)
    found = damping_start(run, far, history, run.releases[0].time_s)
    assert found is not None
    assert found == pytest.approx(np.log([1e-3, 1e-3]), abs=1.0)


def test_phase_between_and_beyond_marks() -> None:
    clock = PhaseClock()
    time = np.array([0.0, 0.1, 0.2, 0.3])
    phase = 60.0 * time + 20.0 * time**2
    clock.feed(time, phase)
    clock.feed(np.array([0.25, np.nan]), np.array([1.0, 2.0]))
    assert clock.refused == 2
    at = clock.at(np.array([0.25, 0.31]))
    assert at[0] == pytest.approx([60 * 0.25 + 20 * 0.0625, 70.0, 40.0], rel=1e-6)
    assert at[1] == pytest.approx([60 * 0.31 + 20 * 0.31**2, 72.0, 0.0], rel=1e-2)
    assert np.all(PhaseClock().at(np.array([1.0])) == 0)


def test_a_run_without_angles_is_refused() -> None:
    campaign = Campaign(6)
    with pytest.raises(NotIdentifiable, match="angles"):
        track(dataclasses.replace(campaign.ring_down("x"), angle_time_s=np.empty(0), angle_rad=np.empty((0, 2))), RIG)


def test_a_settled_pendulum_teaches_nothing_of_its_damping() -> None:
    tracker = Tracker(RIG, SensorNoise(), damping_std=0.5)
    rng, time_ns = np.random.default_rng(5), np.arange(0, 20_000_000_000, 1_000_000)
    resting = np.column_stack([np.full(len(time_ns), 0.3), np.full(len(time_ns), -0.2)])
    angle = np.round((resting + 3e-4 * rng.standard_normal(resting.shape)) * 4096 / 2 / np.pi) * 2 * np.pi / 4096
    for part in range(0, len(time_ns), 200):
        tracker.feed_encoders(time_ns[part : part + 200], angle[part : part + 200])
    now = tracker.estimate()
    for name, start in (("c3_Nms_per_rad", RIG.a), ("c4_Nms_per_rad", RIG.b)):
        assert now.values[name] == pytest.approx(start.damping_Nms_per_rad, rel=0.05)
        assert now.std[name] / now.values[name] > 1.2  # CAUTION times the 0.5 of the start


def test_a_flick_of_one_pendulum_is_found_during_the_motion_of_the_other() -> None:
    campaign = Campaign(5, clock_rate_std=0.0)
    run = campaign.spin_down(
        record_s=6.0, apart_s=2.0
    )  # one runs down, then the other is flicked; the first is at rest
    last = track(run, campaign.truth.with_values(c3_Nms_per_rad=3e-3, c4_Nms_per_rad=3e-4)).last
    assert last.trusted
    for name, true in campaign.truth.identified().items():
        if name in last.values:
            assert last.intervals[name][0] < true < last.intervals[name][1] < 4 * true


def test_garbage_of_one_encoder_is_not_trusted() -> None:
    campaign = Campaign(5, clock_rate_std=0.0)
    run = campaign.spin_down()
    broken = run.angle_rad.copy()
    broken[:, 1] = np.random.default_rng(0).uniform(-100, 100, len(broken))
    last = track(dataclasses.replace(run, angle_rad=broken), campaign.truth).last
    assert not last.trusted
    assert last.counts["refused"] > 0.4 * len(broken)
