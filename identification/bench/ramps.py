"""Synthetic run-ups: two oscillators driven by a rotating imbalance, exact at every sample, and their bounds.

    ḧ + 2ζω ḣ + ω² h = u,    u = (ψ̇² − iψ̈) e^{iψ},

at rest at t = 0; x = Re(A h1), y = Im(A h2) in the stiffness axes. With λ = −ζω + iω sqrt(1 − ζ²) and its conjugate
h = (q(λ) − q(λ̄)) / (λ − λ̄), q̇ = λ q + u. From sample to sample q(t + Δ) = e^{λΔ} q(t) + ∫ e^{λ(Δ − s)} u(t + s) ds, and
eight Gauss points make the integral exact to rounding, because u is smooth over a sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import signal as scipy_signal

from identification.bench.fisher import bound
from identification.bench.trials import SyntheticRecord

NOISE_M, RATE_HZ = 10e-6, 1000.0
_FROM_HZ, _TO_HZ = 0.5, 7.0
_RIPPLE = 0.005  # of the speed, once a revolution
_GAUSS_POINTS = 8
_ECCENTRICITY_M = 50e-6


@dataclass(frozen=True)
class RampRecord:
    """Record of a run-up, the input of a method.

    Attributes:
        time_s: time, s, shape (n,).
        displacement_m: displacements of sensors x and y, m, shape (n, 2).
        phase_rad: rotor phase at the same instants, rad, shape (n,).
    """

    time_s: np.ndarray
    displacement_m: np.ndarray
    phase_rad: np.ndarray


def passage(
    rng: np.random.Generator, zeta: float, record_s: float, frequencies_Hz: tuple[float, float], axis_angle_deg: float
) -> SyntheticRecord:
    """Draw a run-up through both resonances, with random direction of the imbalance and offsets of the sensors."""
    samples = round(record_s * RATE_HZ)
    first, second = frequencies_Hz
    amplitude = _ECCENTRICITY_M * np.exp(2j * np.pi * rng.uniform())
    theta = np.r_[
        first,
        zeta,
        second,
        zeta,
        np.radians(axis_angle_deg),
        2 * [amplitude.real, amplitude.imag],
        1e-3 * rng.uniform(-1, 1, 2),
    ]
    step = np.r_[1e-6, 1e-3 * zeta, 1e-6, 1e-3 * zeta, 1e-5, np.full(6, 1e-7)]

    def mean(at: np.ndarray) -> np.ndarray:
        x = (complex(at[5], at[6]) * _response(at[0], at[1], samples)).real
        y = (complex(at[7], at[8]) * _response(at[2], at[3], samples)).imag
        cos, sin = np.cos(at[4]), np.sin(at[4])
        return np.column_stack([x * cos + y * sin + at[9], -x * sin + y * cos + at[10]])

    std = bound(mean, theta, step, NOISE_M)
    names = ("f1_Hz", "zeta1", "f2_Hz", "zeta2")
    time = np.arange(samples) / RATE_HZ
    signal = mean(theta) + NOISE_M * rng.normal(size=(samples, 2))
    record = RampRecord(time, signal, _phase(time, record_s)[0])
    return SyntheticRecord(
        record, dict(zip(names, theta.tolist(), strict=False)), dict(zip(names, std.tolist(), strict=False))
    )


def _phase(time: np.ndarray, record_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ψ, ψ̇ and ψ̈ of a linear ramp with a ripple once per revolution."""
    ramp = 2 * np.pi * (_TO_HZ - _FROM_HZ) / record_s
    speed = 2 * np.pi * _FROM_HZ + ramp * time
    turn = 2 * np.pi * _FROM_HZ * time + 0.5 * ramp * time**2
    ripple = 1 + _RIPPLE * np.sin(turn)
    return (
        turn - _RIPPLE * np.cos(turn),
        speed * ripple,
        ramp * ripple + _RIPPLE * speed**2 * np.cos(turn),
    )


@lru_cache(maxsize=2)
def _force(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return u at the Gauss points of every interval, shape (n − 1, 8), with their relative places and weights."""
    nodes, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    share = 0.5 * (nodes + 1)
    time = (np.arange(samples - 1)[:, None] + share) / RATE_HZ
    phase, speed, acceleration = _phase(time, samples / RATE_HZ)
    return (speed**2 - 1j * acceleration) * np.exp(1j * phase), share, 0.5 * weights


@lru_cache(maxsize=24)  # the records of a case and their differences use the same few responses
def _response(frequency_Hz: float, zeta: float, samples: int) -> np.ndarray:
    """Return complex h at the samples, shape (n,)."""
    omega = 2 * np.pi * frequency_Hz
    force, share, weight = _force(samples)
    step = 1 / RATE_HZ
    parts: list[NDArray[np.complex128]] = []
    for sign in (1, -1):
        rate = omega * complex(-zeta, sign * np.sqrt(1 - zeta * zeta))
        inflow = force @ (step * weight * np.exp(rate * step * (1 - share)))
        filtered = cast("Any", scipy_signal).lfilter([1.0], [1.0, -np.exp(rate * step)], inflow)  # scipy has no types
        parts.append(np.r_[0, filtered])
    return (parts[0] - parts[1]) / (2j * omega * np.sqrt(1 - zeta * zeta))
