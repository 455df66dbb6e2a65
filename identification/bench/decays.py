"""Synthetic ring-downs, sample by sample from the closed form, and their bounds.

y_i = Re(a e^{λ t_i}) + b + noise with λ = −ζω + iω sqrt(1 − ζ²). With two axes, sensor x measures x cos β + y sin β and
sensor y measures −x sin β + y cos β, each with its own offset.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.bench.fisher import bound
from identification.bench.trials import SyntheticRecord

NOISE_M, RATE_HZ = 10e-6, 1000.0
_OFFSET_M = 0.3e-3


@dataclass(frozen=True)
class DecayTrial:
    """Record of a ring-down, the input of a method.

    Attributes:
        time_s: time, s, shape (n,).
        displacement_m: displacement, m, shape (n,), or (n, 2) for two sensors.
    """

    time_s: np.ndarray
    displacement_m: np.ndarray


def one_mode(
    rng: np.random.Generator, zeta: float, frequency_Hz: float = 3.0, amplitude_m: float = 1e-3, record_s: float = 20.0
) -> SyntheticRecord:
    """Draw one mode in one sensor with random phase and offset, and a frequency within 2 % that lies on no grid."""
    time = np.arange(round(record_s * RATE_HZ)) / RATE_HZ
    frequency = frequency_Hz * (1 + 0.02 * rng.uniform(-1, 1))
    start = amplitude_m * np.exp(2j * np.pi * rng.uniform())
    theta = np.array([frequency, zeta, start.real, start.imag, _OFFSET_M * rng.uniform(-1, 1)])

    def mean(at: np.ndarray) -> np.ndarray:
        return _wave(at[0], at[1], complex(at[2], at[3]), time) + at[4]

    step = np.array([1e-5 / record_s, min(1e-3 * zeta, 1e-6), *3 * [1e-4 * amplitude_m]])
    std = bound(mean, theta, step, NOISE_M)
    record = DecayTrial(time, mean(theta) + NOISE_M * rng.normal(size=len(time)))
    return SyntheticRecord(record, {"f1_Hz": frequency, "zeta1": zeta}, {"f1_Hz": std[0], "zeta1": std[1]})


def two_axes(
    rng: np.random.Generator, frequencies_Hz: tuple[float, float], zeta: float, axis_angle_deg: float, record_s: float
) -> SyntheticRecord:
    """Draw two modes of 1 mm in two sensors that are turned relative to them, with random phases."""
    time = np.arange(round(record_s * RATE_HZ)) / RATE_HZ
    common = 1 + 0.02 * rng.uniform(-1, 1)
    first, second = (common * f for f in frequencies_Hz)
    starts = 1e-3 * np.exp(2j * np.pi * rng.uniform(size=2))
    amplitudes = [starts[0].real, starts[0].imag, starts[1].real, starts[1].imag]
    offsets = _OFFSET_M * rng.uniform(-1, 1, 2)
    theta = np.array([first, zeta, second, zeta, np.radians(axis_angle_deg), *amplitudes, *offsets])

    def mean(at: np.ndarray) -> np.ndarray:
        x = _wave(at[0], at[1], complex(at[5], at[6]), time)
        y = _wave(at[2], at[3], complex(at[7], at[8]), time)
        cos, sin = np.cos(at[4]), np.sin(at[4])
        return np.column_stack([x * cos + y * sin + at[9], -x * sin + y * cos + at[10]])

    pair = [1e-5 / record_s, min(1e-3 * zeta, 1e-6)]
    std = bound(mean, theta, np.array([*pair, *pair, 1e-5, *6 * [1e-7]]), NOISE_M)
    names = ("f1_Hz", "zeta1", "f2_Hz", "zeta2")
    record = DecayTrial(time, mean(theta) + NOISE_M * rng.normal(size=(len(time), 2)))
    return SyntheticRecord(
        record, dict(zip(names, theta.tolist(), strict=False)), dict(zip(names, std.tolist(), strict=False))
    )


def with_outliers(rng: np.random.Generator, trial: SyntheticRecord, share: float, size_m: float) -> SyntheticRecord:
    """Replace a share of the samples by random values within ± size; the bound remains that of the clean record."""
    displacement = trial.record.displacement_m.copy()
    bad = rng.random(len(displacement)) < share
    displacement[bad] = size_m * rng.uniform(-1, 1, np.count_nonzero(bad))
    return replace(trial, record=replace(trial.record, displacement_m=displacement))


def clipped_at(trial: SyntheticRecord, rail_m: float) -> SyntheticRecord:
    """Clip the record at the sensor's range ± rail; the bound remains that of the whole motion."""
    displacement = np.clip(trial.record.displacement_m, -rail_m, rail_m)
    return replace(trial, record=replace(trial.record, displacement_m=displacement))


def _wave(frequency_Hz: float, zeta: float, start: complex, time: np.ndarray) -> np.ndarray:
    omega = 2 * np.pi * frequency_Hz
    return (start * np.exp(omega * complex(-zeta, np.sqrt(1 - zeta * zeta)) * time)).real
