"""Both settings of tracking on the same motion, and what the smoother adds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st
from synthetic import Campaign

from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification import FitFailed
from identification.tracking import reference
from identification.tracking.reference import FilterpyFilter
from identification.tracking.replay import TrackedRun, track
from identification.tracking.unscented import STATES, TALLY
from tests.effort import cases

TRUTH = Campaign(6, clock_rate_std=0.0).truth
WRONG = TRUTH.with_values(c3_Nms_per_rad=3e-3, c4_Nms_per_rad=3e-4)


def release(campaign: Campaign, record_s: float) -> Run:
    """A release at a point, from half a second before it on."""
    run = campaign.point("E", record_s)
    kept = run.angle_time_s > run.releases[0].time_s - 0.5
    return dataclasses.replace(run, angle_time_s=run.angle_time_s[kept], angle_rad=run.angle_rad[kept])


@pytest.fixture(scope="module", params=["release", "flicks"])
def both(request: pytest.FixtureRequest) -> tuple[TrackedRun, TrackedRun]:
    """A release at speed, and two flicks one after the other at rest: fast and reference, from wrong dampings."""
    campaign = Campaign(6, clock_rate_std=0.0)
    if request.param == "release":
        run = release(campaign, cases(6, 15) / 10)
    else:
        run = campaign.spin_down(record_s=3.0, apart_s=1.0)
    return track(run, WRONG), track(run, WRONG, setting="reference")


def test_both_settings_give_the_same_filtered_states(both: tuple[TrackedRun, TrackedRun]) -> None:
    fast, slow = both
    assert fast.smoothed is None
    assert np.array_equal(fast.time_s, slow.time_s)
    assert np.all(np.diff(fast.time_s) > 0)
    assert np.max(np.abs(fast.states - slow.states) / fast.state_std) < 1e-5
    assert np.max(np.abs(fast.values - slow.values) / fast.std) < 1e-5
    assert slow.std == pytest.approx(fast.std, rel=1e-6)
    assert slow.state_std == pytest.approx(fast.state_std, rel=1e-6)
    assert slow.last.counts == {**fast.last.counts, "repairs": 0}
    assert np.array_equal(fast.trusted, slow.trusted)


def test_the_smoother_is_never_less_certain_and_ends_as_the_filter(both: tuple[TrackedRun, TrackedRun]) -> None:
    slow = both[1]
    found = slow.smoothed
    assert found is not None
    assert np.all(found.state_std <= (1 + 1e-12) * slow.state_std)
    assert np.all(found.std / found.values <= (1 + 1e-12) * slow.std / slow.values)
    for own, filtered in ((found.values, slow.values), (found.std, slow.std), (found.states, slow.states)):
        assert own[-1] == pytest.approx(filtered[-1], rel=1e-12)
    assert found.kept < 0.01


def test_the_smoother_carries_later_readings_back(both: tuple[TrackedRun, TrackedRun]) -> None:
    """At the start, before a release and before the flicks, the filter has nothing but its start values."""
    slow, true = both[1], TRUTH.identified()
    found = slow.smoothed
    assert found is not None
    assert found.stretches == 1
    for i, name in enumerate(("c3_Nms_per_rad", "c4_Nms_per_rad")):
        assert slow.values[0, i] == pytest.approx((3e-3, 3e-4)[i], rel=1e-6)
        assert found.low[0, i] < true[name] < found.high[0, i]
        assert found.std[0, i] / found.values[0, i] < 0.2 * slow.std[0, i] / slow.values[0, i]


class Watched(Campaign):
    """Keeps the pendulums' true rates."""

    def encoder(
        self, time: np.ndarray, angle: np.ndarray, rate: np.ndarray, marks: np.ndarray, phase: np.ndarray
    ) -> dict[str, np.ndarray]:
        found = super().encoder(time, angle, rate, marks, phase)
        self.true_time_s, self.true_rate = self._stamped(time, self._encoder_clock), rate
        return found


def test_smoothed_rates_are_nearer_to_the_truth() -> None:
    campaign = Watched(6, clock_rate_std=0.0)
    run = release(campaign, cases(4, 10) / 10)
    slow = track(run, WRONG, setting="reference", batch_s=0.01)
    found = slow.smoothed
    assert found is not None
    late = slow.time_s > run.releases[0].time_s + 0.05
    true = np.column_stack(
        [np.interp(slow.time_s[late], campaign.true_time_s, campaign.true_rate[:, j]) for j in (0, 1)]
    )
    ours, filters = (np.sqrt(np.mean((one[late, 6:8] - true) ** 2)) for one in (found.states, slow.states))
    assert ours < 0.8 * filters


def _one_reading(peer: FilterpyFilter, cov: np.ndarray) -> None:
    physics: RotorParameters = TRUTH
    mean = np.r_[np.zeros(3), np.pi, np.zeros(4), np.log([1e-3, 1e-3])]
    tally = np.zeros(TALLY)
    peer(
        mean,
        cov,
        np.array([1e-3]),
        np.zeros(1),
        np.array([2]),
        np.zeros(1),
        np.full(1, 1e-6),
        np.zeros((1, 3)),
        np.ones((1, 2)),
        physics.packed(),
        np.full(STATES, 1e-8),
        1e-3,
        6.0,
        -1.0,
        tally,
        np.empty(1),
    )


def test_a_covariance_that_breaks_down_is_an_error_with_a_way_out() -> None:
    broken = np.eye(STATES)
    broken[0, 1] = broken[1, 0] = 2.0
    with pytest.raises(FitFailed, match=r"run.mcap: filterpy.*not positive definite.*fast setting"):
        _one_reading(FilterpyFilter("run.mcap"), broken)


def test_a_record_too_long_to_be_kept_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    peer = FilterpyFilter("run.mcap")
    _one_reading(peer, 1e-4 * np.eye(STATES))
    assert peer.steps == 1
    monkeypatch.setattr(reference, "MOST_STEPS", 1)
    with pytest.raises(FitFailed, match=r"run.mcap: .*at most 1 steps.*fast setting"):
        _one_reading(peer, 1e-4 * np.eye(STATES))


def test_another_setting_is_refused() -> None:
    with pytest.raises(ValueError, match="expected fast, reference, got 'slow'"):
        track(Campaign(6).spin_down(), TRUTH, setting="slow")


@given(st.integers(0, 10**6), st.integers(1, 2**STATES - 2))
def test_what_goes_on_across_a_new_start_is_conditioned_upon_exactly(seed: int, bits: int) -> None:
    """The step before a new start, against the Gaussian conditional worked out from a reading of what goes on."""
    rng = np.random.default_rng(seed)
    same = np.array([bool(bits >> j & 1) for j in range(STATES)])
    root = rng.normal(size=(STATES, STATES)) + 2 * np.eye(STATES)
    cov, mean = root @ root.T, rng.normal(size=STATES)
    observed = rng.normal(size=(int(same.sum()), STATES)) * same  # a reading of the components that go on, only
    noise = np.eye(len(observed))
    gain = cov @ observed.T @ np.linalg.inv(observed @ cov @ observed.T + noise)
    reading = rng.normal(size=len(observed))
    exact = mean + gain @ (reading - observed @ mean), cov - gain @ observed @ cov
    motion = reference._Motion(1, np.zeros(3), np.zeros(20), np.ones(2))
    last = reference._Step(1e-3, motion, np.zeros(STATES), mean, cov)
    found = reference._before_begun(last, same, exact)
    assert found is not None
    assert found[0] == pytest.approx(exact[0], abs=1e-6)
    assert found[1] == pytest.approx(exact[1], abs=1e-6 * np.max(cov))


@given(st.integers(0, 10**6), st.floats(0.5, 1.5))
def test_no_smoothed_variance_exceeds_the_filter_s(seed: int, level: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(STATES, STATES)) + 2 * np.eye(STATES)
    cov = root @ root.T
    filtered = np.diag(np.diag(cov) / rng.uniform(level, 1.9, STATES))
    found = reference._at_most(np.zeros(STATES), cov, filtered)
    assert found is not None
    assert np.all(np.diag(found[1]) <= (1 + 1e-12) * np.diag(filtered))
    assert np.min(np.linalg.eigvalsh(found[1])) > 0
    assert reference._at_most(np.zeros(STATES), cov, np.diag(np.diag(cov) / 2.1)) is None
