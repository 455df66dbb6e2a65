"""Plain run-down of one pendulum: bound, coverage, friction, bad readings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.signals.phase_noise import encoder_step
from identification.errors import FitFailed, NotIdentifiable
from identification.pendulums.decline import decline_of
from identification.pendulums.quantiser import quantised_posterior
from identification.pendulums.run_down import RunDown, fit_run_down, run_down_angle
from identification.pendulums.spin_down import fit_spin_down
from tests.count_limits import rms_limits
from tests.effort import cases

INERTIA, SPEED, STEP = 2.187e-4, 2 * np.pi * 5, 2 * np.pi / 2000


def run_down(
    seed: int, damping: float = 1e-3, jitter: float = 0.0, share: float = 0.0, speed: float = SPEED
) -> tuple[np.ndarray, np.ndarray]:
    """Eight time constants from full speed on, 2 % of samples lost; speed and damping vary a little with the seed."""
    rng = np.random.default_rng(seed)
    rate = damping / INERTIA
    t = np.arange(0, min(10.0, 8 / rate), 1e-3)
    t = t[rng.random(len(t)) > 0.02]
    s = np.minimum(t, np.log1p(1 / share) / rate) if share else t
    angle = rng.uniform(0, 6) + speed * ((1 + share) / rate * (1 - np.exp(-rate * s)) - share * s)
    return t, np.round(angle / STEP + jitter * rng.normal(size=len(t))) * STEP


def after_rest(t: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with a second at rest before."""
    rest = np.arange(0, 1.0, 1e-3)
    return np.r_[rest, t + 1.0], np.r_[np.full(len(rest), angle[0]), angle]


@pytest.mark.parametrize("damping", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_damping_is_covered_and_near_the_bound(damping: float, jitter: float) -> None:
    z, bound = [], []
    for seed in range(cases(3, 6)):
        time, angle = run_down(seed, damping, jitter)
        fit = fit_spin_down(time, angle, INERTIA)
        z.append((fit.values["c_Nms_per_rad"] - damping) / fit.std["c_Nms_per_rad"])
        jacobian = run_down_angle(time[time < 5 * INERTIA / damping], np.r_[0, SPEED, np.log(damping / INERTIA)])[1]
        white = STEP * np.sqrt(1 / 12 + jitter**2)
        bound.append(white * np.sqrt(np.linalg.inv(jacobian[:, :3].T @ jacobian[:, :3])[2, 2]))
        assert "coulomb_Nm" not in fit.values
        assert fit.model == "viscous damping"
    assert np.max(np.abs(z)) < 4
    low, high = rms_limits(0.4, 1.6, 6, len(z))
    assert low < np.sqrt(np.mean(np.square(z))) < high
    assert fit.std["c_Nms_per_rad"] / damping < 1.5 * np.mean(bound)


@pytest.mark.parametrize("damping", [1e-4, 1e-3, 1e-2])
def test_friction_is_found_and_estimated(damping: float) -> None:
    for seed in range(cases(1, 2)):
        fit = fit_spin_down(*run_down(seed, damping, 0.3, 2e-3), INERTIA)
        true = 2e-3 * damping * SPEED
        assert abs(fit.values["coulomb_Nm"] - true) < 4 * fit.std["coulomb_Nm"]
        assert abs(fit.values["c_Nms_per_rad"] - damping) < 4 * fit.std["c_Nms_per_rad"]
        assert [row.chosen for row in fit.model_table] == [False, True]
        assert any("dry friction" in w for w in fit.warnings)


@pytest.mark.parametrize(("setting", "damping"), [("fast", 3e-4), ("fast", 1e-2), ("reference", 1e-2)])
def test_other_settings_cover(setting, damping: float) -> None:
    for seed in range(cases(1, 2)):
        fit = fit_spin_down(*run_down(seed, damping, 0.3), INERTIA, setting=setting)
        low, high = fit.intervals["c_Nms_per_rad"]
        assert low < fit.values["c_Nms_per_rad"] < high
        assert abs(fit.values["c_Nms_per_rad"] - damping) < 4 * fit.std["c_Nms_per_rad"] < 0.03 * damping


@pytest.mark.parametrize("damping", [1e-3, 1e-2])
def test_rest_before_wrapping_gaps_and_glitches_change_little(damping: float) -> None:
    time, angle = run_down(3, damping, 0.3)
    plain = fit_spin_down(time, angle, INERTIA)
    changed = after_rest(time, angle)
    rng = np.random.default_rng(0)
    spiked = angle.copy()
    spiked[rng.choice(len(angle), 3, replace=False)] += 0.7
    holed = angle.copy()
    holed[rng.choice(len(angle), len(angle) // 10, replace=False)] = np.nan
    wrapped = np.mod(angle, 2 * np.pi) if np.ptp(angle) > 2 * np.pi else angle
    for case in (changed, (time, spiked), (time, holed), (time, wrapped), (time, -angle)):
        fit = fit_spin_down(*case, INERTIA)
        gap = fit.values["c_Nms_per_rad"] - plain.values["c_Nms_per_rad"]
        assert abs(gap) < 2.5 * np.hypot(fit.std["c_Nms_per_rad"], plain.std["c_Nms_per_rad"])
        assert fit.std["c_Nms_per_rad"] < 1.6 * plain.std["c_Nms_per_rad"]


def test_a_second_push_ends_the_stretch() -> None:
    time, rate = np.arange(0, 5, 1e-3), 3e-4 / INERTIA
    first, second = np.minimum(time, 2.0), np.maximum(time - 2.0, 0.0)
    angle = SPEED / rate * (1 - np.exp(-rate * first)) + 0.8 * SPEED / rate * (1 - np.exp(-rate * second))
    fit = fit_spin_down(time, np.round(angle / STEP) * STEP, INERTIA)
    assert 1.5 < fit.end_s <= 2.01
    assert abs(fit.values["c_Nms_per_rad"] - 3e-4) < 4 * fit.std["c_Nms_per_rad"]


@pytest.mark.parametrize("samples_per_s", [1000, 5000])
def test_a_faster_encoder_loses_nothing(samples_per_s: int) -> None:
    for seed in range(cases(1, 2)):
        time = np.arange(0, 12.0, 1 / samples_per_s)
        jitter = 0.3 * np.random.default_rng(seed).standard_normal(len(time))
        fit = fit_spin_down(time, np.round(40 * (1 - np.exp(-0.5 * time)) / STEP + jitter) * STEP)
        assert fit.end_s > 8
        assert fit.warnings == []
        assert abs(fit.values["rate_per_s"] - 0.5) < 4 * fit.std["rate_per_s"]
        assert fit.std["rate_per_s"] < 1.5e-6 * np.sqrt(1000 / samples_per_s)


def test_a_stretch_cut_short_has_a_warning() -> None:
    time, angle = run_down(1, 1e-4, 0.3)
    assert any("record ends there" in w for w in fit_spin_down(time[:4000], angle[:4000]).warnings)
    pushed = np.r_[angle[:4000], angle[3999] + 0.5 * (angle[:500] - angle[0])]
    fit = fit_spin_down(time[:4500], pushed)
    assert any("second push" in w for w in fit.warnings)


@pytest.mark.parametrize("share", [0.5, 1.0, 3.0])
def test_much_dry_friction_is_estimated(share: float) -> None:
    fit = fit_spin_down(*run_down(0, 1e-4, 0.3, share), INERTIA)
    true = share * 1e-4 * SPEED
    assert abs(fit.values["coulomb_Nm"] - true) < 4 * fit.std["coulomb_Nm"] < 0.02 * true
    assert abs(fit.values["c_Nms_per_rad"] - 1e-4) < 4 * fit.std["c_Nms_per_rad"] < 1e-5
    assert fit.model == "viscous damping and dry friction"


def test_dry_friction_alone_is_named() -> None:
    time = np.arange(0, 8, 2e-3)
    moving = np.minimum(time, 5.0)
    with pytest.raises(FitFailed, match="dry friction dominates"):
        fit_spin_down(time, np.round((20 * moving - 2 * moving**2) / STEP) * STEP)


def test_samples_out_of_order_are_sorted() -> None:
    time, angle = run_down(1)
    order = np.random.default_rng(0).permutation(len(time))
    assert fit_spin_down(time[order], angle[order]).values == fit_spin_down(time, angle).values


def test_a_rotor_that_moves_has_a_warning() -> None:
    time, angle = run_down(1, 1e-3, 0.3)
    fit = fit_spin_down(time, angle + 0.01 * np.sin(2 * np.pi * 3 * time), INERTIA)
    assert any("scaled up" in w for w in fit.warnings)
    assert abs(fit.values["c_Nms_per_rad"] - 1e-3) < 4 * fit.std["c_Nms_per_rad"]
    with pytest.raises((FitFailed, NotIdentifiable)):
        fit_spin_down(time, angle + 2.0 * np.sin(2 * np.pi * 3 * time), INERTIA)


def test_an_angle_without_steps_is_fitted_with_its_own_noise() -> None:
    time, angle = run_down(1, 1e-3)
    smooth = run_down_angle(time, np.r_[0.0, SPEED, np.log(1e-3 / INERTIA)])[0]
    noisy = smooth + 1e-5 * np.random.default_rng(0).normal(size=len(time))
    assert encoder_step(noisy) == 0.0
    fit = fit_spin_down(time, noisy, INERTIA)
    assert abs(fit.values["c_Nms_per_rad"] - 1e-3) < 4 * fit.std["c_Nms_per_rad"] < 1e-3 * 1e-4
    assert encoder_step(angle) == pytest.approx(STEP, rel=1e-9)


def test_the_digits_of_a_file_are_no_encoder_s_step() -> None:
    _, angle = run_down(1, 1e-3)
    written = np.radians([float(f"{d:.7g}") for d in np.degrees(angle)])
    assert encoder_step(written) == pytest.approx(STEP, rel=1e-4)


def test_derivatives_are_those_of_the_angle() -> None:
    time, theta = np.linspace(0, 2, 50), np.r_[0.3, 20.0, np.log(4.0), 0.02]
    _, jacobian = run_down_angle(time, theta)
    for j in range(4):
        move = 1e-6 * np.eye(4)[j]
        numeric = (run_down_angle(time, theta + move)[0] - run_down_angle(time, theta - move)[0]) / 2e-6
        assert jacobian[:, j] == pytest.approx(numeric, rel=1e-4, abs=1e-6)


def test_whole_steps_know_more_than_white_noise() -> None:
    time, angle = run_down(5, 1e-2)
    data = RunDown(time, angle, 0.3 * STEP, STEP)
    least = fit_run_down(data.until(5 * INERTIA / 1e-2), np.r_[angle[0], SPEED, np.log(1e-2 / INERTIA)])
    draws = quantised_posterior(data, least.theta, least.covariance, 200)[:, 2]
    low, high = np.quantile(draws, [0.005, 0.995])
    assert low < np.log(1e-2 / INERTIA) < high
    assert np.std(draws) < 0.8 * np.sqrt(least.covariance[2, 2])


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.integers(-3, 3), min_size=60, max_size=200),
    st.sampled_from([0.0, np.nan, 1e6, np.inf]),
    st.integers(0, 59),
)
def test_any_readings_give_a_fit_or_a_reason(steps: list[int], odd: float, where: int) -> None:
    angle = STEP * np.cumsum(np.array(steps, float))
    angle[where] = odd
    time = 1e-3 * np.arange(len(angle))
    try:
        fit = fit_spin_down(time, angle)
    except (NotIdentifiable, FitFailed):
        return
    assert np.all(np.isfinite(list(fit.values.values())))


def test_too_little_is_refused() -> None:
    time = np.arange(0, 5, 1e-3)
    with pytest.raises(NotIdentifiable, match="flick"):
        fit_spin_down(time, np.round(0.3 * np.random.default_rng(0).normal(size=5000)) * STEP)
    with pytest.raises(NotIdentifiable, match="too few"):
        fit_spin_down(time[:20], time[:20])
    for inertia in (0.0, -INERTIA, np.nan):
        with pytest.raises(NotIdentifiable, match="inertia"):
            fit_spin_down(*run_down(1), inertia)
    with pytest.raises(NotIdentifiable, match="shapes"):
        decline_of(time, np.zeros((5000, 2)))
