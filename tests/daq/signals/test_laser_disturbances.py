"""Wander and lines of a laser: found with their figures, and no false findings."""

import numpy as np
import pytest

from daq.signals.laser_disturbances import SteadyLine, Wander, lines_in, sentences, wander_in

RATE, WHITE_M = 1000.0, 4e-6
LEVEL = 2 * WHITE_M**2 / RATE
TIME = np.arange(0.0, 24.0, 1 / RATE)


def lines_of(value: np.ndarray, *known) -> list[SteadyLine]:
    return lines_in(TIME, value, (TIME, value), *known)


def white(seed: int) -> np.ndarray:
    return WHITE_M * np.random.default_rng(seed).standard_normal(len(TIME))


def wandering(seed: int, power: float, below_1_Hz_m: float) -> np.ndarray:
    """White noise and wander of a given rms between 0.02 and 1 Hz, cut out of a longer record."""
    rng = np.random.default_rng([seed, 7])
    frequency = np.fft.rfftfreq(4 * len(TIME), 1 / RATE)
    shape = np.zeros(len(frequency))
    shape[frequency >= 0.02] = frequency[frequency >= 0.02] ** (-power / 2)
    slow = shape[frequency <= 1.0]
    noise = np.fft.irfft(shape * (rng.standard_normal(len(shape)) + 1j * rng.standard_normal(len(shape))))
    unit = np.sqrt(np.sum(slow**2) / np.sum(shape**2)) * noise.std()
    return white(seed) + noise[: len(TIME)] * below_1_Hz_m / unit


def test_white_noise_is_neither() -> None:
    for seed in range(40):
        assert wander_in(TIME, white(seed), LEVEL) is None
        assert lines_of(white(seed)) == []


@pytest.mark.parametrize(("power", "words"), [(1.0, "about 1/f"), (2.0, "about 1/f^")])
def test_wander_is_found_with_its_size_and_slope(power: float, words: str) -> None:
    found = [wander_in(TIME, wandering(seed, power, 6e-6), LEVEL) for seed in range(12)]
    assert all(each is not None for each in found)
    seen = [each for each in found if each is not None]
    assert np.median([each.slope for each in seen]) == pytest.approx(power, abs=0.4)
    assert 3e-6 < np.median([each.rms_m for each in seen]) < 8e-6  # slower parts than the record are removed
    assert any(words in each.words for each in seen)


def test_a_drift_of_temperature_is_no_wander() -> None:
    assert wander_in(TIME, white(1) + 1e-6 * TIME, LEVEL) is None


def test_a_record_too_short_yields_nothing() -> None:
    some = TIME < 4.0
    assert wander_in(TIME[some], wandering(0, 1.0, 6e-6)[some], LEVEL) is None
    assert lines_in(TIME[some], white(0)[some], (TIME[some], white(0)[some])) == []


@pytest.mark.parametrize("frequency", [50.0, 60.0, 23.37])
def test_a_steady_line_is_found_with_its_figures(frequency: float) -> None:
    found = lines_of(white(2) + 3e-5 * np.cos(2 * np.pi * frequency * TIME + 1.0))
    assert len(found) == 1
    assert found[0].frequency_Hz == pytest.approx(frequency, abs=0.01)
    assert found[0].amplitude_m == pytest.approx(3e-5, rel=0.02)
    off = found[0].at(TIME) - 3e-5 * np.cos(2 * np.pi * frequency * TIME + 1.0)
    assert np.abs(off).max() < 1e-6
    assert ("mains hum?" in found[0].words) == (frequency != 23.37)


def test_what_rings_or_is_known_is_no_line() -> None:
    ringing = 1e-4 * np.exp(-0.2 * TIME) * np.sin(2 * np.pi * 11.6 * TIME)
    assert lines_of(white(3) + ringing) == []
    known = white(3) + 3e-5 * np.sin(2 * np.pi * 16.0 * TIME)
    assert lines_of(known)
    assert lines_of(known, [(8.0, 0.0), (16.0, 0.0)]) == []
    assert lines_of(known, [(15.0, 1.0)]) == []
    assert lines_of(known, (), 4e-5) == []


def test_an_alias_in_thinned_samples_is_no_line() -> None:
    fast = 3e-5 * np.cos(2 * np.pi * 470.0 * TIME)
    thin = TIME[::4]
    assert lines_in(TIME, white(4) + fast, (thin, (white(4) + fast)[::4])) == []  # appears at 30 Hz


def test_sentences_name_all_with_figures() -> None:
    found = sentences("laser x", Wander(5.8e-6, 1.1), [SteadyLine(50.003, 3e-5), SteadyLine(150.0, 6e-6)])
    assert found == [
        "laser x wanders: 5.8 µm rms below 1 Hz, spectrum about 1/f",
        "laser x shows steady lines at 50.00 Hz, 30 µm: mains hum?; 150.00 Hz, 6 µm: mains hum?",
    ]
    assert sentences("laser x", None, []) == []
