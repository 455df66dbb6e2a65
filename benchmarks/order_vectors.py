"""Order vectors through run-ups whose truth is known: coverage, error, time; against angular resampling.

    python -m benchmarks.order_vectors [--runs 20] [--rate 4000]

Truths: the exact motion of one resonance (its free vibration too), and its steady response to each speed. 60 s from 60
or 300 rpm at 10 rpm/s, offset and second order added to it. Printed per cell: share of rows inside 1.96 deviations,
largest error of size and angle where the vector exceeds 0.3 of its peak, milliseconds for one signal; the same of
angular resampling over four turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from analysis import order_track
from analysis.quantities.order_maps import resampled_order_track
from analysis.quantities.order_tracking import OrderTrack

CELLS = (
    ("motion", 3.0, 0.02, 1e-6),
    ("motion", 3.0, 0.02, 1e-5),
    ("motion", 3.0, 0.02, 5e-5),
    ("motion", 11.6, 0.02, 1e-5),
    ("motion", 6.0, 0.1, 5e-5),
    ("steady", 3.0, 0.02, 1e-5),
    ("steady", 3.0, 0.05, 5e-5),
    ("steady", 11.6, 0.02, 5e-5),
)
QUICKENS = 10 * np.pi / 30


def signal(
    kind: str, f_Hz: float, zeta: float, noise_m: float, rate: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, displacements, phases, true vectors."""
    t = np.arange(int(60 * rate)) / rate
    begin = (60 if f_Hz < 5 else 300) * np.pi / 30
    psi = 0.3 + begin * t + 0.5 * QUICKENS * t**2
    speed, w0 = begin + QUICKENS * t, 2 * np.pi * f_Hz
    if kind == "steady":
        vector = 350e-6 * speed**2 / (w0**2 - speed**2 + 2j * zeta * w0 * speed)
    else:
        vector = _motion(t, begin, w0, zeta, rate) * np.exp(-1j * psi)
    x = (vector * np.exp(1j * psi) + 5e-5 * np.exp(1j * (2 * psi + 1))).real + 2e-4
    return t, x + noise_m * np.random.default_rng(seed).standard_normal(len(t)), psi, vector


def _motion(t: np.ndarray, begin: float, w0: float, zeta: float, rate: float) -> np.ndarray:
    """q̈ + 2ζω0 q̇ + ω0² q = e (ω² − iω̇) e^{iψ}, exact from sample to sample but for Simpson's rule."""

    def force(at: np.ndarray) -> np.ndarray:
        turned = 0.3 + begin * at + 0.5 * QUICKENS * at**2
        return 350e-6 * ((begin + QUICKENS * at) ** 2 - 1j * QUICKENS) * np.exp(1j * turned)

    mode = complex(-zeta * w0, w0 * np.sqrt(1 - zeta**2))
    out = np.zeros(len(t), complex)
    for root, share in ((mode, 1 / (2j * mode.imag)), (mode.conjugate(), -1 / (2j * mode.imag))):
        step = np.exp(root / rate)
        middle = 4 * force(t[:-1] + 0.5 / rate) * np.exp(0.5 * root / rate)
        grown = (force(t[:-1]) * step + middle + force(t[1:])) / (6 * rate)
        out += share * lfilter([1], [1, -step], np.concatenate([[force(t[:1])[0] / (1j * begin - root)], grown]))
    return out


def judged(track: OrderTrack, t: np.ndarray, vector: np.ndarray) -> tuple[float, float, float]:
    """Share covered, largest relative error and largest angle in degrees where the vector is large."""
    truth = np.interp(track.time_s, t, vector.real) + 1j * np.interp(track.time_s, t, vector.imag)
    off = track.amplitude_m[:, 0] - truth
    z = np.stack([off.real, off.imag]) / track.std_m[:, 0]
    large = np.abs(truth) > 0.3 * np.abs(truth).max()
    ratio = (track.amplitude_m[:, 0] / truth)[large]
    return (
        float(np.mean(np.abs(z) < 1.96)),
        float(np.abs(np.abs(ratio) - 1).max()),
        float(np.abs(np.degrees(np.angle(ratio))).max()),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--rate", type=float, default=4000.0)
    given = parser.parse_args()
    methods: dict[str, Callable[..., OrderTrack]] = {"order_track": order_track, "resampled": resampled_order_track}
    order_track(*signal("steady", 3.0, 0.1, 1e-5, given.rate, 0)[:3])  # compiles
    print(f"{'truth':8}{'f, Hz':>6}{'ζ':>6}{'noise':>7}  method        covered   size %   angle °    ms")
    for kind, f_Hz, zeta, noise in CELLS:
        for name, method in methods.items():
            rows, spent = [], []
            for seed in range(given.runs):
                t, x, psi, vector = signal(kind, f_Hz, zeta, noise, given.rate, seed)
                began = time.perf_counter()
                track = method(t, x, psi)
                spent.append(1e3 * (time.perf_counter() - began))
                rows.append(judged(track, t, vector))
            covered, size, angle = np.mean([r[0] for r in rows]), max(r[1] for r in rows), max(r[2] for r in rows)
            print(
                f"{kind:8}{f_Hz:6.1f}{zeta:6.2f}{1e6 * noise:5.0f}µm  {name:12}{100 * covered:8.1f} %"
                f"{100 * size:9.3f}{angle:10.3f}{np.median(spent):6.0f}"
            )


if __name__ == "__main__":
    main()
