"""Sentences on a rotor phase that is read in steps, integrated from a noisy speed, or moves at rest."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from daq.signals.phase_noise import encoder_step, phase_remarks, white_and_walk
from daq.signals.run import Run

RPM = math.pi / 30
TIME_S = np.arange(20_000) * 1e-3


def run_with(phase_rad: np.ndarray, test: str = "point-A", time_s: np.ndarray = TIME_S) -> Run:
    none = np.empty(0)
    empty = Run(test, "made.mcap", 0.0, none, none, none, none, none, np.empty((0, 2)), none, none)
    return replace(empty, phase_time_s=time_s, phase_rad=phase_rad)


def turning(rpm: float = 200.0, ramp: float = 0.0) -> np.ndarray:
    return rpm * RPM * TIME_S + 0.5 * ramp * TIME_S**2


def number(sentence: str, before: str) -> float:
    found = re.search(r"([0-9.e+-]+)" + before, sentence)
    assert found, sentence
    return float(found[1])


@settings(max_examples=30, deadline=None)
@given(
    step_deg=st.floats(0.05, 0.5), rpm=st.floats(60.0, 600.0), ramp=st.sampled_from([0.0, 0.4]), start=st.floats(0, 1)
)
def test_steps_of_an_encoder_are_named_with_their_size(step_deg: float, rpm: float, ramp: float, start: float) -> None:
    step = math.radians(step_deg)
    phase = turning(rpm, ramp)
    uneven = phase + start + 0.02 * np.sin(phase)  # a rotor does not turn by a whole number of steps between readings
    (sentence,) = phase_remarks(run_with(np.round(uneven / step) * step), turns=True)
    assert "steps" in sentence
    assert number(sentence, "°") == pytest.approx(step_deg, rel=0.06)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("digits", [12, 6])
@pytest.mark.parametrize("rpm_noise", [0.05, 0.2, 1.0])
def test_an_integrated_noisy_speed_is_named_with_its_noise(seed: int, digits: int, rpm_noise: float) -> None:
    rng = np.random.default_rng(seed)
    speed = 200 * RPM + rpm_noise * RPM * rng.standard_normal(len(TIME_S))
    shown = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 1e-3)]
    (sentence,) = phase_remarks(run_with(np.round(shown, digits)), turns=True)
    assert number(sentence, " rpm of noise") == pytest.approx(rpm_noise, rel=0.15)


@pytest.mark.parametrize("seed", range(20))
def test_a_sound_phase_gives_no_remark(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ripple = 0.01 * np.sin(2 * turning())
    white = 10 ** rng.uniform(-6, -3) * rng.standard_normal(len(TIME_S))
    assert phase_remarks(run_with(turning() + ripple + white), turns=True) == []
    assert phase_remarks(run_with(1.3 + white), turns=False) == []
    assert phase_remarks(run_with(np.empty(0), time_s=np.empty(0)), turns=True) == []


@pytest.mark.parametrize(("rpm", "step_deg"), [(0.1, 0.005), (0.1, 0.1), (-0.02, 0.0), (2.0, 0.35)])
def test_a_rotor_that_creeps_in_a_test_at_rest_is_named_with_its_speed(rpm: float, step_deg: float) -> None:
    rng = np.random.default_rng(1)
    phase = 0.7 + rpm * RPM * TIME_S + 1e-5 * rng.standard_normal(len(TIME_S))
    read = np.round(phase / math.radians(step_deg)) * math.radians(step_deg) if step_deg else phase
    (sentence,) = phase_remarks(run_with(read, "spin-down"), turns=False)
    assert number(sentence, " rpm") == pytest.approx(abs(rpm), rel=0.06)


def test_a_rotor_at_rest_whose_encoder_stands_on_an_edge_does_not_creep() -> None:
    rng = np.random.default_rng(2)
    step = math.radians(0.1)
    flips = np.round(0.5 + 0.05 * rng.standard_normal(len(TIME_S))) * step
    assert phase_remarks(run_with(flips, "spin-down"), turns=False) == []


def test_white_noise_and_a_walk_are_distinguished() -> None:
    rng = np.random.default_rng(3)
    white = 1e-4 * rng.standard_normal(50_000)
    walk = np.cumsum(1e-4 * rng.standard_normal(50_000))
    assert white_and_walk(white, 0.0, 1e-3) == (pytest.approx(1e-8, rel=0.05), 0.0)
    variance, density = white_and_walk(walk, 0.0, 1e-3)
    assert density == pytest.approx(1e-8 / 1e-3, rel=0.1)
    assert variance < 1e-9


def test_a_grid_that_a_file_rounded_is_found_all_the_same() -> None:
    step = 2 * math.pi / 4096
    angle: NDArray[np.float64] = np.asarray(
        np.round(np.cumsum(np.round(3 * np.sin(np.arange(5000) / 50)) * step), 9), np.float64
    )
    assert encoder_step(angle) == pytest.approx(step, rel=1e-6)
