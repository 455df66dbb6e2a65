"""Ring-downs with disturbances: hum, lines close to modes, coloured noise, holds, weak signals of the other sensor."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from synthetic import Campaign

from identification import NotIdentifiable, fit_ring_down, fit_run_up_run
from identification.colour import colour_of
from identification.lines import steady_lines
from identification.ring_down.release_instant import release_instant
from identification.ring_down.resolution import Resolution
from identification.ring_down.result import _unresolved
from identification.samples import block_averages, clipped
from tests.count_limits import rms_limits
from tests.effort import cases, thorough

RATE = 1000.0
F, ZETA = (3.0, 11.6), (0.012, 0.008)
NAMES = ("f1_Hz", "zeta1", "f2_Hz", "zeta2")


def pluck(
    seed: int, axis: int = 0, cross: float = 0.04, held_m: float = 4e-3, beta_deg: float = 2.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, sensors x and y with 4 µm of white noise, and more random numbers: rest, pull, hold, free."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(13.0 * RATE)) / RATE
    release = 1.4
    start = held_m * np.where(np.arange(2) == axis, 1.0, cross)
    pulled = np.clip((t - 0.5) / 0.3, 0, 1)
    motion = (pulled**2 * (3 - 2 * pulled))[:, None] * start
    free = t >= release
    for i in range(2):
        w = 2 * np.pi * F[i]
        wave, s = w * np.sqrt(1 - ZETA[i] ** 2), t[free] - release
        motion[free, i] = (
            start[i] * np.exp(-ZETA[i] * w * s) * (np.cos(wave * s) + ZETA[i] * w / wave * np.sin(wave * s))
        )
    b = np.radians(beta_deg)
    turn = np.array([[np.cos(b), np.sin(b)], [-np.sin(b), np.cos(b)]])
    return t, motion @ turn.T + 4e-6 * rng.normal(size=(len(t), 2)), rng.normal(size=(len(t) + 4000, 2))


def assert_true(fit, names=NAMES) -> None:
    truth = dict(zip(NAMES, (F[0], ZETA[0], F[1], ZETA[1]), strict=True))
    for name in names:
        assert abs(fit.values[name] - truth[name]) < 4.5 * fit.std[name], name


def line(t: np.ndarray, f: float, x_m: float, y_m: float, wander_Hz: float = 0.0) -> np.ndarray:
    phase = 2 * np.pi * f * t + wander_Hz * 9.0 * np.sin(2 * np.pi * t / 9.0)
    return np.column_stack([x_m * np.cos(phase + 0.4), y_m * np.cos(phase + 2.0)])


@pytest.mark.parametrize("axis", [0, 1])
def test_hum_is_named_and_fitted_out(axis: int) -> None:
    t, signal, _ = pluck(1, axis)
    quiet, hum = fit_ring_down(t, signal), fit_ring_down(t, signal + line(t, 50.0, 30e-6, 20e-6))
    assert_true(hum)
    assert any(
        re.search(r"50\.00 Hz, (30|29\.9|30\.1) µm in x, (20|19\.9|20\.1) µm in y: mains hum\?", w)
        for w in hum.warnings
    )
    assert not any("Hz" in w for w in quiet.warnings)
    for name in NAMES:
        assert hum.std[name] == pytest.approx(quiet.std[name], rel=0.05)


@pytest.mark.parametrize(
    ("f", "wander"),
    [
        (2.85, 0.0),
        (60.0, 0.05),
        *(
            pytest.param(*line, marks=thorough)
            for line in ((24.3, 0.0), (3.4, 0.0), (12.0, 0.0), (6.0, 0.0), (50.0, 0.05))
        ),
    ],
)
def test_any_steady_line_is_found(f: float, wander: float) -> None:
    t, signal, _ = pluck(2)
    fit = fit_ring_down(t, signal + line(t, f, 25e-6, 15e-6, wander))
    assert_true(fit)
    assert any(f"{f + s:.2f} Hz" in w for w in fit.warnings for s in (-0.01, 0, 0.01))


def test_a_line_beyond_half_the_sampling_rate_is_found_where_it_appears() -> None:
    t, signal, _ = pluck(3)
    coarse = signal[::2] + line(t[::2], 470.0, 25e-6, 15e-6)
    fit = fit_ring_down(t[::2], coarse)
    assert_true(fit)
    assert any("30.00 Hz" in w for w in fit.warnings)


def test_hum_alone_is_no_ring_down() -> None:
    t = np.arange(12_000) / RATE
    with pytest.raises(NotIdentifiable, match="nothing rings"):
        fit_ring_down(t, line(t, 50.0, 30e-6, 20e-6) + 4e-6 * np.random.default_rng(0).normal(size=(len(t), 2)))


@pytest.mark.parametrize("zeta", [1e-4, 1e-3, 0.02])
def test_a_mode_is_no_line(zeta: float) -> None:
    t = np.arange(20_000) / RATE
    w = 2 * np.pi * np.array([3.1, 9.7])
    y = (np.exp(-zeta * w * t[:, None]) * np.cos(w * t[:, None]) * [1e-3, 2e-4]).sum(axis=1)
    y += 4e-6 * np.random.default_rng(4).normal(size=len(t))
    assert steady_lines(t, y, np.ones(len(t), bool)) == []


@pytest.mark.parametrize(
    ("corner_Hz", "rms_m"),
    [
        (2.0, 30e-6),
        (20.0, 10e-6),
        pytest.param(2.0, 10e-6, marks=thorough),
        pytest.param(20.0, 30e-6, marks=thorough),
    ],
)
def test_coloured_noise_neither_refuses_nor_shrinks(corner_Hz: float, rms_m: float) -> None:
    z = []
    for seed in range(cases(2, 4)):
        t, signal, white = pluck(10 + seed, seed % 2, held_m=4.5e-3)
        keep = np.exp(-2 * np.pi * corner_Hz / RATE)
        noise = lfilter([1], [1, -keep], white, axis=0)[-len(t) :]
        fit = fit_ring_down(t, signal + rms_m * noise / noise.std(axis=0))
        own = NAMES[:2] if seed % 2 == 0 else NAMES[2:]
        assert_true(fit, own)
        assert "noise is not white" in fit.verdict
        truth = dict(zip(NAMES, (F[0], ZETA[0], F[1], ZETA[1]), strict=True))
        z += [(fit.values[n] - truth[n]) / fit.std[n] for n in own]
    low, high = rms_limits(0.3, 1.8, 8, len(z))
    assert low < np.sqrt(np.mean(np.square(z))) < high


def test_a_sensor_that_hardly_moves_vetoes_nothing() -> None:
    """The cross sensor holds steps and drift that no decay explains; the one that moves is as good as ever."""
    t, signal, _ = pluck(5, 0, cross=0.0, beta_deg=0.0)
    signal[:, 1] += 4e-4 * (np.floor(t / 1.7) % 2) + 1e-4 * np.sin(2 * np.pi * 0.7 * t**1.3)
    fit = fit_ring_down(t, signal)
    assert_true(fit, NAMES[:2])
    assert "f2_Hz" not in fit.values
    assert any("sensor y" in w for w in fit.warnings)


@pytest.mark.parametrize("step_m", [0.0, 1e-6])
@pytest.mark.parametrize("hold_s", [0.1, 0.5, 5.0])
def test_a_column_held_still_is_no_rail(hold_s: float, step_m: float) -> None:
    zeta, w, release = 0.01, 2 * np.pi * 3, 1.3 + hold_s
    t = np.arange(round((release + 12) * RATE)) / RATE
    pulled, s = np.clip((t - 1) / 0.3, 0, 1), np.maximum(t - release, 0)
    wave = w * np.sqrt(1 - zeta**2)
    free = np.exp(-zeta * w * s) * (np.cos(wave * s) + zeta * w / wave * np.sin(wave * s))
    y = 4e-3 * np.where(t < release, pulled**2 * (3 - 2 * pulled), free)
    y += np.where(t < release, 0.0, 2e-6 * np.random.default_rng(1).normal(size=len(t)))
    if step_m:
        y = np.round(y / step_m) * step_m
    fit = fit_ring_down(t, y)
    assert not any("rail" in w for w in fit.warnings)
    assert 0 <= fit.release_s[0] - release < 0.1
    assert fit.values["zeta1"] == pytest.approx(zeta, rel=1e-3)


def test_a_flickering_hold_is_no_rail_but_repeated_clipping_is() -> None:
    hold = np.where(np.arange(500) % 9 < 6, 4.0, 3.999)
    swing = 3.9 * np.exp(-np.arange(4000) / 2000) * np.cos(np.arange(4000) / 50)
    assert not clipped(np.r_[hold, swing]).any()
    assert clipped(np.clip(5 * np.cos(np.arange(4000) / 50), -4, 4)).sum() > 1000


def test_a_colour_whitens() -> None:
    rng = np.random.default_rng(6)
    noise = lfilter([1], [1, -0.9], rng.normal(size=6000))
    colour = colour_of(noise, 1e-6, 4e-3, [(3.0, 0.05)])
    assert colour is not None
    assert colour.noise == pytest.approx(1e-6, rel=0.05)
    white = colour.whitened(noise) * 1e-6 / colour.noise
    assert np.var(white) == pytest.approx(1, rel=0.06)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.05
    assert colour_of(rng.normal(size=6000), 1e-6, 4e-3, [(3.0, 0.05)]) is None


def test_a_run_up_under_hum() -> None:
    campaign = Campaign(3)
    run = campaign.run_up(ramp_s=20.0)
    hum = {
        "x_m": run.x_m + 30e-6 * np.cos(2 * np.pi * 50 * run.x_time_s),
        "y_m": run.y_m + 20e-6 * np.cos(2 * np.pi * 50 * run.y_time_s),
    }

    fit = fit_run_up_run(replace(run, **hum))
    quiet = fit_run_up_run(run)
    assert any("50.00 Hz, 30 µm in x: mains hum?" in w for w in fit.warnings)
    for name in NAMES:
        assert abs(fit.values[name] - quiet.values[name]) < 0.5 * quiet.std[name]
        assert fit.std[name] < 1.3 * quiet.std[name]


def coloured(white: np.ndarray, n: int, corner_Hz: float, rms_m: float) -> np.ndarray:
    noise = lfilter([1], [1, -np.exp(-2 * np.pi * corner_Hz / RATE)], white, axis=0)[-n:]
    return rms_m * noise / noise.std(axis=0)


def test_a_hold_that_noise_makes_restless_is_not_fitted() -> None:
    """Half of a hold shakes more than the other; the fit begins after it all the same, with modes of the column."""
    t, signal, white = pluck(7, 1, held_m=3.5e-3)
    signal = signal + coloured(white, len(t), 20.0, 20e-6)
    shaking = np.clip((t - 1.05) / 0.05, 0, 1) * (t < 1.4)
    signal = signal + 220e-6 * (shaking * np.sin(2 * np.pi * 11.0 * t))[:, None]
    means = [block_averages(t, own, 4e-3, 4e-6) for own in signal.T]
    assert 1.4 <= release_instant(means) < 1.5
    fit = fit_ring_down(t, signal)
    assert fit.release_s[0] >= 1.39
    assert_true(fit, NAMES[2:])


@pytest.mark.parametrize("phase", [0.4, 2.0])
def test_a_floor_that_rings_longer_is_no_cross_mode(phase: float) -> None:
    """The column hardly moves across; what rings there does not move square to the other mode."""
    for axis, cross in ((0, 0.003), (1, 0.0)):
        t, signal, _ = pluck(8, axis, cross=cross)
        s = np.maximum(t - 1.4, 0)
        floor = np.where(t >= 1.4, np.exp(-0.15 * s), 0.0)
        shape = np.column_stack([25e-6 * np.cos(2 * np.pi * 17.3 * s), 15e-6 * np.cos(2 * np.pi * 17.3 * s + phase)])
        fit = fit_ring_down(t, signal + floor[:, None] * shape)
        assert_true(fit, [n for n in NAMES if n in fit.values])
        assert NAMES[2 * axis] in fit.values
        assert any("17.30 Hz" in w for w in fit.warnings)


@pytest.mark.parametrize("zeta", [0.57, 0.8])
def test_what_decays_within_a_period_is_no_mode(zeta: float) -> None:
    rng = np.random.default_rng(9)
    t = np.arange(8000) / RATE
    w = 2 * np.pi * 0.9
    y = 3e-3 * np.exp(-zeta * w * t) * np.cos(w * np.sqrt(1 - zeta**2) * t) + 4e-6 * rng.normal(size=len(t))
    with pytest.raises(NotIdentifiable, match=r"decays within 0\.\d+ of its period \(ζ = 0\.\d+, mode 1\)"):
        fit_ring_down(t, y)


def test_an_unresolved_pair_is_given_the_criterion_that_it_fails() -> None:
    found = Resolution(split=61.0, split_std=0.2, axis_std_rad=np.radians(5.1), gain=4000.0)
    assert not found.resolved
    text = _unresolved(found)
    assert "uncertain by 5.1°, 3° are needed" in text
    assert "half-bandwidths" not in text
    assert "second mode" not in text


def one_over_f(count: int, seed: int) -> np.ndarray:
    """1/f noise from 0.02 Hz on for two sensors, rms 1."""
    rng = np.random.default_rng([seed, 9])
    frequency = np.fft.rfftfreq(8 * count, 1 / RATE)
    shape = np.where(frequency >= 0.02, np.maximum(frequency, 0.02) ** -0.5, 0.0)[:, None]
    drawn = rng.standard_normal((len(shape), 2)) + 1j * rng.standard_normal((len(shape), 2))
    noise = np.fft.irfft(shape * drawn, axis=0)[:count]
    return noise / noise.std(axis=0)


def test_wander_of_a_laser_is_named_with_its_figures() -> None:
    t, signal, _ = pluck(1)
    noise = 1e-5 * one_over_f(len(t), 1) * [1.0, 0.0]  # of x alone
    warnings = [w for w in fit_ring_down(t, signal + noise).warnings if "wanders" in w]
    assert len(warnings) == 1
    found = re.fullmatch(r"laser x wanders: ([0-9.]+) µm rms below 1 Hz, spectrum about 1/f.*", warnings[0])
    assert found
    assert 2 < float(found[1]) < 10


def test_quiet_lasers_do_not_wander() -> None:
    for seed in range(cases(2, 3)):
        t, signal, _ = pluck(20 + seed, seed % 2)
        assert not any("wander" in w for w in fit_ring_down(t, signal).warnings)
