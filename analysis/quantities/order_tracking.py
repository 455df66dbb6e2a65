"""Order tracking: the complex amplitude of what turns with the rotor, window by window of whole revolutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class OrderTrack:
    """Order amplitudes over time; the signal is offset + Re Σ A_k e^{ikψ} inside each window.

    Attributes:
        time_s: middle of each window, shape (n,), s.
        orders: the orders asked for.
        amplitude_m: complex amplitudes A_k, shape (n, len(orders)), m.
        std_m: standard deviation of the real and of the imaginary part, each, from the fit's residuals (white).
        offset_m: mean of the signal, shape (n,), m.
        residual_m: rms of what the fit leaves, shape (n,), m.
        samples: finite samples in each window, shape (n,).
    """

    time_s: np.ndarray
    orders: tuple[int, ...]
    amplitude_m: np.ndarray
    std_m: np.ndarray
    offset_m: np.ndarray
    residual_m: np.ndarray
    samples: np.ndarray

    def mean(self, order: int) -> tuple[complex, float]:
        """Mean amplitude of one order over the windows and the standard deviation of its real or imaginary part.

        The deviation is the larger of what the residuals and what the windows' scatter say.
        """
        j = self.orders.index(order)
        track = self.amplitude_m[:, j]
        n = len(track)
        white = float(np.sqrt(np.mean(self.std_m[:, j] ** 2) / n))
        scatter = float(np.sqrt(0.5 * np.var(track, ddof=1) / n)) if n > 2 else 0.0
        return complex(track.mean()), max(white, scatter)


def order_track(
    time_s: np.ndarray,
    displacement_m: np.ndarray,
    phase_rad: np.ndarray,
    orders: Sequence[int] = (1,),
    *,
    revolutions: int = 4,
    harmonics: int = 3,
) -> OrderTrack:
    """Complex order amplitudes by least squares in consecutive windows of whole revolutions.

    Args:
        time_s, displacement_m: samples, shape (n,); NaN displacements are left out.
        phase_rad: rotor phase ψ at the samples (unwrapped, rising), shape (n,), rad.
        orders: whole orders wanted, 1 for once per revolution.
        revolutions: length of a window.
        harmonics: orders 0 … harmonics are fitted together, so that none leaks into another when samples are lost.
    Raises:
        ValueError: shapes differ, or there is not one whole window.
    Source: docs/theory/steady_states.md.
    """
    time_s, x, psi = (np.asarray(a, float) for a in (time_s, displacement_m, phase_rad))
    if not time_s.shape == x.shape == psi.shape or time_s.ndim != 1:
        raise ValueError(f"time, displacement and phase must be alike, got {time_s.shape}, {x.shape}, {psi.shape}")
    good = np.isfinite(x) & np.isfinite(psi)
    time_s, x, psi = time_s[good], x[good], psi[good]
    span = 2 * np.pi * revolutions
    count = int((psi[-1] - psi[0]) / span + 1e-9) if len(psi) else 0
    if count < 1:
        raise ValueError(f"order tracking needs {revolutions} whole revolutions, got less")
    highest = max(harmonics, *orders)
    edges = np.searchsorted(psi, psi[-1] - span * np.arange(count, -1, -1))
    edges[-1] = len(psi)
    windows = [
        _window(time_s[a:b], x[a:b], psi[a:b], highest, orders)
        for a, b in pairwise(edges)
        if b - a >= 4 * (2 * highest + 1)
    ]
    if not windows:
        raise ValueError("order tracking: too few valid samples in every window")
    time, amplitude, std, offset, residual, samples = (np.array(c) for c in zip(*windows, strict=True))
    return OrderTrack(time, tuple(orders), amplitude, std, offset, residual, samples)


def _window(
    time: np.ndarray, x: np.ndarray, psi: np.ndarray, highest: int, orders: Sequence[int]
) -> tuple[float, np.ndarray, np.ndarray, float, float, int]:
    """One window's fit: time, amplitudes, their standard deviations, offset, residual, samples."""
    columns = [np.ones_like(psi)]
    for k in range(1, highest + 1):
        columns += [np.cos(k * psi), -np.sin(k * psi)]
    basis = np.stack(columns, axis=1)
    normal = np.linalg.inv(basis.T @ basis)
    fit = normal @ (basis.T @ x)
    rest = x - basis @ fit
    variance = rest @ rest / (len(x) - len(fit))
    real, imaginary = np.array([2 * k - 1 for k in orders]), np.array([2 * k for k in orders])
    spread = np.sqrt(variance * 0.5 * (np.diag(normal)[real] + np.diag(normal)[imaginary]))
    return float(time.mean()), fit[real] + 1j * fit[imaginary], spread, float(fit[0]), float(np.sqrt(variance)), len(x)
