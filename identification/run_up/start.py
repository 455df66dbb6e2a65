"""Start values for a run-up without any prior guess, and the naive half-power reading beside them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dynamics.speed_history import SpeedHistory
from identification.errors import NotIdentifiable
from identification.run_up.forced_oscillator import STEP_S, Drive
from identification.samples import Averages


def transfer_function_start(channel: Averages, drive: Drive, imaginary: bool) -> tuple[float, float]:
    """ω and ζ of the resonance that dominates a sensor.

    With X, U, V the Fourier transforms of the signal and of the force's real and imaginary part, the oscillator gives
        X (ω0² − w² + i w γ) = a U + b V + p + i w q
    where p, q are what motion before and after the record adds. It is linear in (ω0², γ, a, b, p, q); a few rounds
    weighted by 1/|ω0² − w² + i w γ| undo the weighting that multiplying the denominator out brought in. It holds for
    any sweep rate.

    Returns:
        ω in rad/s, ζ.
    """
    t = drive.start_s + 8 * STEP_S * np.arange((len(drive.force) - 1) // 16)
    force = drive.force[::16][: len(t)]
    signal = np.interp(t, channel.time_s, channel.value) - np.mean(channel.value)
    top = float(np.abs(drive.force[-1])) ** 0.5
    w = 2 * np.pi * np.fft.rfftfreq(len(t), 8 * STEP_S)
    band = (w > 2 * np.pi * 0.5) & (w < 1.1 * top)
    if np.count_nonzero(band) < 30:
        raise NotIdentifiable("the run-up is too short to hold a resonance")
    x, u, v = (np.fft.rfft(s)[band] for s in (signal, np.real(force), np.imag(force)))
    w = w[band]
    weight = 1 / (w**2)
    square, damping = 0.0, 0.0
    for _ in range(12):
        one = np.ones_like(x)
        matrix = np.column_stack([x, 1j * w * x, -u, -v, -one, -1j * w]) * weight[:, None]
        target = w**2 * x * weight
        scale = np.linalg.norm(matrix, axis=0) + 1e-300
        rows = np.concatenate([(matrix / scale).real, (matrix / scale).imag])
        solution = np.linalg.lstsq(rows, np.concatenate([target.real, target.imag]), rcond=None)[0] / scale
        square, damping = float(solution[0]), float(solution[1])
        if square <= 0:
            raise NotIdentifiable(f"sensor {'xy'[imaginary]} shows no resonance in the run-up")
        weight = 1 / np.abs(square - w**2 + 1j * w * damping)
    omega = np.sqrt(square)
    return float(omega), float(np.clip(damping / (2 * omega), 1e-5, 0.7))


def half_power(channel: Averages, history: SpeedHistory) -> tuple[float, float]:
    """Frequency and damping ratio read off the peak and its width at 1/√2; what a hurried reader would find.

    Returns:
        f in Hz, ζ; NaN where the curve has no two sides.
    """
    psi, speed, _ = history.phase(channel.time_s).T
    step = float(np.median(np.diff(channel.time_s)))
    order = 2 * gaussian_filter1d((channel.value - np.mean(channel.value)) * np.exp(-1j * psi), 0.25 / step)
    size = np.abs(order) / np.maximum(speed, 1.0) ** 2
    size[speed < 2 * np.pi] = 0.0
    peak = int(np.argmax(size))
    below = np.flatnonzero(size[:peak] < size[peak] / np.sqrt(2))
    above = np.flatnonzero(size[peak:] < size[peak] / np.sqrt(2))
    if len(below) == 0 or len(above) == 0:
        return float("nan"), float("nan")
    width = speed[peak + above[0]] - speed[below[-1]]
    return float(speed[peak] / (2 * np.pi)), float(width / (2 * speed[peak]))
