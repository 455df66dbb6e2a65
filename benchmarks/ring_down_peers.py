"""What a practitioner would otherwise use on a ring-down, on the same data as ours: part of benchmarks.ring_down_bound.

Log decrement (peaks of both signs after a low-pass), half-power width of the spectrum and a matrix pencil on block
averages are written here; pyOMA2 and PyDMD take part where they can be imported.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt, find_peaks

from identification import fit_ring_down

Answer = tuple[float, float]


def ours(t: np.ndarray, y: np.ndarray) -> Answer:
    fit = fit_ring_down(t, y)
    return fit.values["f1_Hz"], fit.values["zeta1"]


def log_decrement(t: np.ndarray, y: np.ndarray) -> Answer:
    """Straight line through the logarithm of all extrema above a fifth of the first, after a low-pass at 30 Hz."""
    rate = 1 / (t[1] - t[0])
    smooth = filtfilt(*butter(2, 30 / (rate / 2)), y - np.mean(y[-len(y) // 4 :]))
    peaks, _ = find_peaks(np.abs(smooth), distance=max(1, int(rate / 40)))
    peaks = peaks[np.abs(smooth[peaks]) > 0.2 * np.max(np.abs(smooth))]
    if len(peaks) < 3:
        raise ValueError("fewer than three extrema")
    slope, _ = np.polyfit(t[peaks], np.log(np.abs(smooth[peaks])), 1)
    half_period = np.polyfit(np.arange(len(peaks)), t[peaks], 1)[0]
    wave = np.pi / half_period
    omega = np.hypot(wave, slope)
    return omega / (2 * np.pi), -slope / omega


def half_power(t: np.ndarray, y: np.ndarray) -> Answer:
    """Peak and width at 1/√2 of the amplitude spectrum, four times zero-padded."""
    size = 4 * len(y)
    spectrum = np.abs(np.fft.rfft(y - y.mean(), size))
    frequency = np.fft.rfftfreq(size, t[1] - t[0])
    k = int(np.argmax(np.where(frequency > 1, spectrum, 0)))
    low = high = k
    while spectrum[low] > spectrum[k] / np.sqrt(2):
        low -= 1
    while spectrum[high] > spectrum[k] / np.sqrt(2):
        high += 1
    return float(frequency[k]), float((frequency[high] - frequency[low]) / (2 * frequency[k]))


def _blocks(t: np.ndarray, y: np.ndarray, rate: float = 50.0) -> tuple[np.ndarray, float]:
    width = round(1 / (rate * (t[1] - t[0])))
    n = len(y) // width
    return y[: n * width].reshape(n, width).mean(axis=1), width * (t[1] - t[0])


def _strongest(rates: np.ndarray) -> Answer:
    rates = rates[(rates.imag > 2 * np.pi) & (rates.real < 0)]
    if len(rates) == 0:
        raise ValueError("no oscillating pole")
    lam = rates[np.argmin(-rates.real / np.abs(rates))]
    return float(abs(lam) / (2 * np.pi)), float(-lam.real / abs(lam))


def matrix_pencil(t: np.ndarray, y: np.ndarray) -> Answer:
    """HTLS of order 3 on 50 Hz block averages with a square Hankel matrix; as good as ERA of the same order."""
    values, step = _blocks(t, y)
    hankel = np.lib.stride_tricks.sliding_window_view(values, len(values) // 2)
    left = np.linalg.svd(hankel, full_matrices=False)[0][:, :3]
    vectors = np.linalg.svd(np.column_stack([left[:-1], left[1:]]))[2].T
    poles = np.linalg.eigvals(-vectors[:3, 3:] @ np.linalg.inv(vectors[3:, 3:]))
    return _strongest(np.log(poles.astype(complex)) / step)


def optimised_dmd() -> Callable[[np.ndarray, np.ndarray], Answer]:
    """PyDMD's BOPDMD on two-fold delays of 50 Hz block averages."""
    from pydmd import BOPDMD

    def solve(t: np.ndarray, y: np.ndarray) -> Answer:
        values, step = _blocks(t, y)
        delays = 4
        stacked = np.array([values[i : len(values) - delays + i] for i in range(delays)])
        model = BOPDMD(svd_rank=3)
        model.fit(stacked - values[-len(values) // 4 :].mean(), t=step * np.arange(stacked.shape[1]))
        return _strongest(np.asarray(model.eigs))

    return solve


def subspace() -> Callable[[np.ndarray, np.ndarray], Answer]:
    """pyOMA2's SSI (covariances) of order 2 on 50 Hz block averages, 30 block rows."""
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    def solve(t: np.ndarray, y: np.ndarray) -> Answer:
        values, step = _blocks(t, y)
        setup = SingleSetup(np.column_stack([values, np.roll(values, 1)])[1:], fs=1 / step)
        algorithm = SSI(name="ssi", method="cov", br=30, ordmax=4)
        setup.add_algorithms(algorithm)
        setup.run_by_name("ssi")
        frequency, damping = algorithm.result.Fn_poles[:, 2], algorithm.result.Xi_poles[:, 2]
        good = np.isfinite(frequency) & np.isfinite(damping)
        if not good.any():
            raise ValueError("no pole left")
        return float(frequency[good][0]), float(damping[good][0])

    return solve


def _peers() -> dict[str, Callable[[np.ndarray, np.ndarray], Answer]]:
    found: dict[str, Callable[[np.ndarray, np.ndarray], Answer]] = {
        "ours": ours,
        "log decrement": log_decrement,
        "half-power": half_power,
        "matrix pencil": matrix_pencil,
    }
    for name, make in (("PyDMD BOPDMD", optimised_dmd), ("pyOMA2 SSI-cov", subspace)):
        try:
            found[name] = make()
        except ImportError as error:
            print(f"  {name}: not here ({error})")
    return found


def compare_peers(runs: int, seed: int, draw: Callable[[float, float, np.random.Generator], tuple[Any, ...]]) -> None:
    """One line per method and damping ratio.

    Args:
        draw: (ζ, noise over amplitude, generator) to (time, signal, truth by name, bound by name).
    """
    for name, method in _peers().items():
        for zeta in (1e-4, 1e-3, 0.01, 0.05, 0.2):
            rows, seconds, failed = [], [], 0
            for k in range(runs):
                t, y, true, floor = draw(zeta, 0.01, np.random.default_rng([seed, 500, k]))
                began = time.perf_counter()
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        f, z = method(t, y)
                except Exception:  # a peer may fail in any way it likes; it is counted
                    failed += 1
                    continue
                seconds.append(time.perf_counter() - began)
                off = z - true["zeta1"]
                rows.append((off / true["zeta1"], off / floor["zeta1"], (f - true["f1_Hz"]) / floor["f1_Hz"]))
            if not rows:
                print(f"  {name:15} ζ {zeta:<6g} failed {failed} of {runs}", flush=True)
                continue
            bias, of_zeta, of_f = np.array(rows).T
            print(
                f"  {name:15} ζ {zeta:<6g} bias {100 * bias.mean():+9.3f} %  rms/bound "
                f"{np.sqrt(np.mean(of_zeta**2)):8.2f} [{np.sqrt(np.mean(of_f**2)):8.2f}]  "
                f"{1e3 * np.median(seconds):6.1f} ms  failed {failed} of {runs}",
                flush=True,
            )
