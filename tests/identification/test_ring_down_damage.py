"""Ring-downs of damaged records: outliers, dropouts, rails, drift, motion before the release, wrong models."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification import FitFailed, NotIdentifiable, fit_ring_down
from tests.effort import thorough

TIME = np.arange(20_000) / 1000
SIGMA = 1e-5


def decay(t: np.ndarray, f: float, zeta: float, amplitude: float = 1e-3, phase: float = 0.4) -> np.ndarray:
    w = 2 * np.pi * f
    return amplitude * np.exp(-zeta * w * t) * np.cos(w * np.sqrt(1 - zeta**2) * t + phase)


def noisy(signal: np.ndarray, seed: int = 0) -> np.ndarray:
    return signal + SIGMA * np.random.default_rng(seed).normal(size=signal.shape)


def assert_found(fit, f: float, zeta: float, wider: float = 1.0) -> None:
    """Within 4.5 std, and std no more than `wider` times the clean record's bound for a long record."""
    assert abs(fit.values["f1_Hz"] - f) < 4.5 * fit.std["f1_Hz"]
    assert abs(fit.values["zeta1"] - zeta) < 4.5 * fit.std["zeta1"]
    clean = fit_ring_down(TIME, noisy(decay(TIME, f, zeta)))
    assert fit.std["zeta1"] < wider * clean.std["zeta1"]


def spikes(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    at = rng.random(len(y)) < 0.05
    return np.where(at, rng.uniform(-5e-3, 5e-3, len(y)), y)


def bursts(value: float | None) -> Callable[[np.ndarray, np.random.Generator], np.ndarray]:
    def spoil(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        lost = np.zeros(len(y), bool)
        for at in rng.integers(0, len(y), 30):
            lost[at : at + 33] = True
        if value is None:  # the last good value is held
            return y[np.maximum.accumulate(np.where(lost, 0, np.arange(len(y))))]
        return np.where(lost, value, y)

    return spoil


@pytest.mark.parametrize("zeta", [1e-4, 0.01, 0.2])
@pytest.mark.parametrize("spoil", [spikes, bursts(5e-3), bursts(0.0), bursts(np.nan), bursts(None)])
def test_five_percent_spoilt_cost_little(
    zeta: float, spoil: Callable[[np.ndarray, np.random.Generator], np.ndarray]
) -> None:
    fit = fit_ring_down(TIME, spoil(noisy(decay(TIME, 4.0, zeta)), np.random.default_rng(7)))
    assert_found(fit, 4.0, zeta, wider=1.3 if zeta < 0.1 else 2.0)  # a burst may hit the best part of a short decay


@pytest.mark.parametrize("zeta", [1e-3, 0.01, 0.2])
def test_motion_beyond_the_rail(zeta: float) -> None:
    signal = decay(TIME, 4.0, zeta, amplitude=8e-3)
    fit = fit_ring_down(TIME, np.clip(noisy(signal), -5e-3, 5e-3))
    clean = fit_ring_down(TIME, noisy(signal))
    assert any("rail" in w for w in fit.warnings)
    assert abs(fit.values["zeta1"] / zeta - 1) < 5e-4
    assert abs(fit.values["zeta1"] - zeta) < 4.5 * fit.std["zeta1"]
    assert fit.std["zeta1"] < 4 * clean.std["zeta1"]


@pytest.mark.parametrize(("f", "begin", "length", "phase"), [(4.7, 147, 126, 1.4), (2.5, 216, 60, 2.0)])
@pytest.mark.parametrize("value", [0.0, np.nan, 5e-3])
def test_a_gap_in_the_first_of_few_cycles(f: float, begin: int, length: int, phase: float, value: float) -> None:
    """The remaining samples of a strongly damped motion have one frequency, which the start values must contain."""
    y = noisy(decay(TIME, f, 0.2, phase=phase))
    y[begin : begin + length] = value
    y[9000:9030] = y[15000:15030] = value
    fit = fit_ring_down(TIME, y)
    assert abs(fit.values["f1_Hz"] - f) < 4.5 * fit.std["f1_Hz"]
    assert abs(fit.values["zeta1"] - 0.2) < 4.5 * fit.std["zeta1"]
    assert fit.std["zeta1"] < 3e-3
    assert fit.chi2_per_dof < 1.2


def test_a_noisy_rail_that_is_soon_left() -> None:
    """Noise after the limiter: 2 % of the record is more than all that was spent at the rail."""
    signal = decay(TIME, 7.774, 0.012, amplitude=8e-3)
    fit = fit_ring_down(TIME, noisy(np.clip(signal, -5e-3, 5e-3)))
    assert any("rail" in w for w in fit.warnings)
    assert abs(fit.values["zeta1"] / 0.012 - 1) < 5e-4
    assert abs(fit.values["zeta1"] - 0.012) < 4.5 * fit.std["zeta1"]


def test_ten_times_the_rate_with_outliers() -> None:
    """Statistics come from a subset of so many samples; std must still fall with the square root of the rate."""
    t = np.arange(200_000) / 10_000
    fit = fit_ring_down(t, spikes(noisy(decay(t, 4.0, 0.01)), np.random.default_rng(7)))
    slow = fit_ring_down(TIME, noisy(decay(TIME, 4.0, 0.01)))
    for name, true in (("f1_Hz", 4.0), ("zeta1", 0.01)):
        assert abs(fit.values[name] - true) < 4.5 * fit.std[name]
        assert fit.std[name] * np.sqrt(10 * 0.95) == pytest.approx(slow.std[name], rel=0.03)


def dragged() -> np.ndarray:
    """Damping that grows with amplitude: ζ = 0.01 + 2/m · a, 0.012 at the first millimetre."""
    w, zeta0, slope, amplitude = 2 * np.pi * 4.0, 0.01, 2.0, 1e-3
    level = amplitude * np.exp(-zeta0 * w * TIME) / (1 + slope * amplitude / zeta0 * (1 - np.exp(-zeta0 * w * TIME)))
    return noisy(level * np.cos(w * TIME + 0.3))


def test_damping_that_grows_with_amplitude_is_fitted_and_named() -> None:
    fit = fit_ring_down(TIME, dragged())
    assert [w.partition(":")[0] for w in fit.warnings] == ["direction 1's damping grows with amplitude"]
    assert fit.verdict.startswith("adequate")
    (term,) = fit.nonlinear
    assert term.kinds == ("damping",)
    assert abs(term.zeta_slope_per_m - 2.0) < 4.5 * term.zeta_slope_std
    assert abs(fit.values["zeta1"] - 0.01) < 4.5 * fit.std["zeta1"]
    (dependence,) = fit.amplitude
    assert dependence.zeta_slope_per_m == pytest.approx(2.0, rel=0.2)


def test_misfit_does_not_pass_for_outliers() -> None:
    """Without terms of amplitude a dependence on it is not trimmed away; the mean's interval covers the change."""
    fit = fit_ring_down(TIME, dragged(), setting="fast")
    assert fit.nonlinear == []
    assert not any("left out" in w for w in fit.warnings)
    assert fit.chi2_per_dof > 1.1
    low, high = fit.intervals["zeta1"]
    assert low < 0.0115
    assert high > 0.0102


def test_constant_damping_raises_no_alarm() -> None:
    fit = fit_ring_down(TIME, noisy(decay(TIME, 4.0, 0.01), 3))
    assert fit.warnings == []
    assert fit.verdict.startswith("adequate")
    assert fit.whiteness.p > 1e-3
    (dependence,) = fit.amplitude
    assert len(dependence.amplitude_m) >= 4
    assert abs(dependence.zeta_slope_per_m) < 4 * dependence.zeta_slope_std


@pytest.mark.parametrize(
    ("drift", "model"),
    [
        (0.0 * TIME, "one mode, offset"),
        (2e-5 * TIME / 20, "one mode, offset and slope"),
        (1e-4 * (TIME / 20 - 0.5) ** 3, "one mode, offset and cubic drift"),
    ],
)
def test_drift_is_modelled_as_far_as_it_is_there(drift: np.ndarray, model: str) -> None:
    fit = fit_ring_down(TIME, noisy(decay(TIME, 4.0, 0.05) + drift))
    assert fit.model == model
    assert_found(fit, 4.0, 0.05, wider=1.1)
    chosen = [c for c in fit.model_table if c.chosen]
    assert [c.name for c in chosen] == [model]
    assert all(c.criterion >= 0 for c in fit.model_table)


def test_slow_wander_is_cut_off_and_covered() -> None:
    for seed in range(8):
        wander = 2e-5 * np.sin(2 * np.pi * 0.11 * TIME + seed)
        fit = fit_ring_down(TIME, noisy(decay(TIME, 3.0, 0.2) + wander, seed))
        assert abs(fit.values["zeta1"] - 0.2) < 4 * fit.std["zeta1"]
        assert fit.std["zeta1"] < 0.004


@pytest.mark.parametrize(
    ("zeta", "sigma"),
    [
        pytest.param(zeta, sigma, marks=() if (zeta, sigma) in ((1e-3, 1e-5), (0.02, 1e-6), (0.2, 1e-4)) else thorough)
        for zeta in (1e-3, 0.02, 0.2)
        for sigma in (1e-6, 1e-5, 1e-4)
    ],
)
def test_what_was_before_the_release_does_not_count(zeta: float, sigma: float) -> None:
    """Quiet, pull, hold, release at 2.2 s."""
    rng = np.random.default_rng(5)
    pull = 1e-3 * np.clip((TIME - 1.0) / 0.3, 0, 1)
    free = TIME >= 2.2
    t = TIME[free] - 2.2
    w = 2 * np.pi * 3.5
    wave = w * np.sqrt(1 - zeta**2)
    signal = pull.copy()
    signal[free] = 1e-3 * np.exp(-zeta * w * t) * (np.cos(wave * t) + zeta * w / wave * np.sin(wave * t))
    fit = fit_ring_down(TIME, signal + sigma * rng.normal(size=len(TIME)))
    assert 2.2 - 0.06 < fit.release_s[0] < 2.2 + 0.3
    assert abs(fit.values["f1_Hz"] - 3.5) < 4.5 * fit.std["f1_Hz"]
    assert abs(fit.values["zeta1"] - zeta) < 4.5 * fit.std["zeta1"]


def test_a_knock_after_quiet() -> None:
    free = TIME >= 3.0
    signal = np.where(free, decay(np.maximum(TIME - 3.0, 0), 5.0, 0.01, phase=-np.pi / 2), 0.0)
    fit = fit_ring_down(TIME, noisy(signal))
    assert 2.95 < fit.release_s[0] < 3.4
    assert abs(fit.values["zeta1"] - 0.01) < 4.5 * fit.std["zeta1"]


@pytest.mark.parametrize("rate", [200, 1000, 20_000])
def test_sampling_rates(rate: int) -> None:
    t = np.arange(6 * rate) / rate
    fit = fit_ring_down(t, noisy(decay(t, 12.0, 0.01)))
    expected = 4 * (SIGMA / 1e-3) * np.sqrt(0.01 * 2 * np.pi * 12 / rate)
    assert fit.std["zeta1"] / 0.01 == pytest.approx(expected, rel=0.12)
    assert abs(fit.values["zeta1"] - 0.01) < 4.5 * fit.std["zeta1"]


def test_times_need_not_be_uniform() -> None:
    t = np.sort(np.random.default_rng(2).uniform(0, 20, 20_000))
    fit = fit_ring_down(t, noisy(decay(t, 4.0, 0.01)))
    assert abs(fit.values["f1_Hz"] - 4) < 4.5 * fit.std["f1_Hz"]
    assert abs(fit.values["zeta1"] - 0.01) < 4.5 * fit.std["zeta1"]
    assert fit.noise[0] == pytest.approx(SIGMA, rel=0.05)


def test_hum_outside_the_mode_s_band_widens_little_and_inside_it_does() -> None:
    rng = np.random.default_rng(4)
    clean = fit_ring_down(TIME, noisy(decay(TIME, 4.0, 0.02)))
    hum = fit_ring_down(TIME, noisy(decay(TIME, 4.0, 0.02)) + 2e-5 * np.sin(2 * np.pi * 31.0 * TIME))
    assert hum.std["zeta1"] < 1.5 * clean.std["zeta1"]
    walk = np.convolve(rng.normal(size=len(TIME) + 199), np.ones(200) / 200, "valid") * 1e-4
    coloured = fit_ring_down(TIME, noisy(decay(TIME, 4.0, 0.02)) + walk)
    assert coloured.std["zeta1"] > 2 * clean.std["zeta1"]
    assert not coloured.verdict.startswith("adequate")


@pytest.mark.parametrize("setting", ["fast", "balanced", "reference"])
def test_every_setting_gives_the_same_answer(setting) -> None:
    y = noisy(decay(TIME, 4.0, 0.02), 8)
    fit = fit_ring_down(TIME, y, setting=setting)
    assert fit.setting == setting
    assert_found(fit, 4.0, 0.02, wider=1.05)
    low, high = fit.intervals["zeta1"]
    assert high - low == pytest.approx(2 * 1.96 * fit.std["zeta1"], rel=0.02)


def test_too_little_information_is_refused() -> None:
    t = np.arange(300) / 1000
    with pytest.raises(NotIdentifiable, match="cycles"):
        fit_ring_down(t, noisy(decay(t, 3.0, 0.01)))
    t = np.arange(1500) / 1000
    lost, found = (decay(t, 3.0, 1e-4) + 1e-4 * np.random.default_rng(s).normal(size=len(t)) for s in (0, 4))
    with pytest.raises(NotIdentifiable, match="lost in noise"):
        fit_ring_down(t, lost)
    fit = fit_ring_down(t, found)
    assert any("not distinguishable from zero" in w for w in fit.warnings)
    assert fit.intervals["zeta1"][0] == 0.0


def test_three_cycles_of_strong_damping_are_enough() -> None:
    t = np.arange(1000) / 1000
    fit = fit_ring_down(t, noisy(decay(t, 3.0, 0.2)))
    assert abs(fit.values["zeta1"] - 0.2) < 4.5 * fit.std["zeta1"]
    assert fit.std["zeta1"] < 2e-3


@pytest.mark.parametrize(
    ("time", "value", "match"),
    [
        (TIME[::-1], decay(TIME, 3.0, 0.01), "backwards"),
        (TIME[:50], decay(TIME, 3.0, 0.01), "one length"),
        (TIME, np.full(len(TIME), np.nan), "valid"),
        (TIME, np.zeros((len(TIME), 3)), "shape"),
        (TIME, np.zeros(len(TIME)), "nothing rings down|valid"),
    ],
)
def test_bad_input_is_named(time: np.ndarray, value: np.ndarray, match: str) -> None:
    with pytest.raises(NotIdentifiable, match=match):
        fit_ring_down(time, value)


def test_what_is_no_decay_is_refused_or_doubted() -> None:
    rng = np.random.default_rng(3)
    square = 1e-3 * np.sign(np.sin(2 * np.pi * 3 * TIME)) * np.exp(-0.2 * TIME) + SIGMA * rng.normal(size=len(TIME))
    try:
        fit = fit_ring_down(TIME, square)
    except (FitFailed, NotIdentifiable):
        return
    assert not fit.verdict.startswith("adequate")
    assert fit.warnings
