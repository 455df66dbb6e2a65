"""Signals of known truth for the ring-down benchmark, with the bound of each: part of benchmarks.ring_down_bound.

Made sample by sample in closed form, damage included. Bounds come from the numerical Fisher information of all samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

RATIO_STD = 2e-3  # what the fit may know about the sensors' gains


@dataclass(frozen=True)
class Drawn:
    """One run.

    Attributes:
        time_s, signal_m: what the estimator is given, shape (n,) and (n,) or (n, 2).
        true: by name.
        bound: standard deviation that no unbiased estimator beats, by name.
        left: the same of the samples that damage left over; empty where there is none.
    """

    time_s: np.ndarray
    signal_m: np.ndarray
    true: dict[str, float]
    bound: dict[str, float]
    left: dict[str, float] = field(default_factory=dict)


Draw = Callable[[np.random.Generator], Drawn]


def wave(t: np.ndarray, f: float, zeta: float, amplitude: float, phase: float) -> np.ndarray:
    """A decaying oscillation, sample by sample."""
    w = 2 * np.pi * f
    return amplitude * np.exp(-zeta * w * t) * np.cos(w * np.sqrt(1 - zeta**2) * t + phase)


def two_axes(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Sensors x and y; q = f1, ζ1, f2, ζ2, β, ln ρ, a1, φ1, a2, φ2, offset x, offset y. Shape (n, 2)."""
    x, y = wave(t, q[0], q[1], q[6], q[7]), wave(t, q[2], q[3], q[8], q[9])
    cos, sin = np.cos(q[4]), np.sin(q[4])
    return np.column_stack([cos * x + sin * y + q[10], np.exp(q[5]) * (-sin * x + cos * y) + q[11]])


def one_axis(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """One sensor; q = f, ζ, a, φ, offset. Shape (n,)."""
    return wave(t, *q[:4]) + q[4]


def bound(
    signal: Callable[[np.ndarray, np.ndarray], np.ndarray],
    t: np.ndarray,
    q: np.ndarray,
    sigma: float,
    known: dict[int, float] | None = None,
) -> np.ndarray:
    """Standard deviations that no unbiased estimator beats, by central differences of the signal itself.

    Args:
        known: place in q → standard deviation of prior knowledge.
    """
    steps = 1e-6 * np.maximum(np.abs(q), 1e-4)
    # the derivative by f grows with time: a step small against 1/T and by ζ likewise
    jacobian = np.column_stack(
        [
            (signal(t, q + h * e) - signal(t, q - h * e)).ravel() / (2 * h)
            for h, e in zip(steps, np.eye(len(q)), strict=True)
        ]
    )
    scale = np.linalg.norm(jacobian, axis=0) + 1e-300
    information = (jacobian / scale).T @ (jacobian / scale) / sigma**2
    for place, std in (known or {}).items():
        information[place, place] += 1 / (std * scale[place]) ** 2
    return np.sqrt(np.diag(np.linalg.inv(information))) / scale


def _named(q: np.ndarray) -> dict[str, float]:
    return {"f1_Hz": float(q[0]), "zeta1": float(q[1])}


def one_mode(zeta: float, relative_noise: float, record_s: float = 20.0, rate: float = 1000.0) -> Draw:
    """A drawn frequency and phase at a given damping ratio and noise; zeta or noise of 0 draws them too."""

    def draw(rng: np.random.Generator) -> Drawn:
        t = np.arange(round(record_s * rate)) / rate
        damping = zeta or float(np.exp(rng.uniform(np.log(1e-4), np.log(0.2))))
        sigma = 1e-3 * (relative_noise or float(np.exp(rng.uniform(np.log(1e-3), np.log(1e-1)))))
        q = np.array([rng.uniform(2.5, 12), damping, 1e-3, rng.uniform(0, 2 * np.pi), 1e-3 * rng.normal()])
        floor = bound(one_axis, t, q, sigma)
        y = one_axis(t, q) + sigma * rng.normal(size=len(t))
        return Drawn(t, y, _named(q), _named(floor))

    return draw


PAIR = ["f1_Hz", "zeta1", "f2_Hz", "zeta2", "axis_angle_deg"]


def pair(f: float, zeta: float, split: float, sigma: float, record_s: float, other_zeta: float = 1.0) -> Draw:
    """Two modes `split` half-bandwidths apart, seen by sensors turned by up to 20°."""

    def draw(rng: np.random.Generator) -> Drawn:
        t = np.arange(round(record_s * 1000)) / 1000
        half = zeta * f * split * (-1 if split < 2 and rng.random() < 0.5 else 1)
        q = np.array(
            [
                f,
                zeta,
                f + half,
                zeta * other_zeta,
                np.radians(rng.uniform(-20, 20)),
                0.0,
                1e-3,
                rng.uniform(0, 6.28),
                1e-3 * rng.uniform(0.4, 1),
                rng.uniform(0, 6.28),
                1e-4,
                -2e-4,
            ]
        )
        floor = bound(two_axes, t, q, sigma, {5: RATIO_STD, 4: np.radians(30)})
        signal = two_axes(t, q) + sigma * rng.normal(size=(len(t), 2))
        unit = np.array([1, 1, 1, 1, np.degrees(1)])
        return Drawn(
            t, signal, dict(zip(PAIR, q[:5] * unit, strict=True)), dict(zip(PAIR, floor[:5] * unit, strict=True))
        )

    return draw


RESOLVED = {
    "3 and 5 Hz, ζ 0.01, 10 µm, 20 s": pair(3, 0.01, 200 / 3, 1e-5, 20),
    "3 and 11.6 Hz, ζ 0.02, 4 µm, 12 s": pair(3, 0.02, 143.3, 4e-6, 12),
    "3 and 11.6 Hz, ζ 0.2, 10 µm, 5 s": pair(3, 0.2, 14.33, 1e-5, 5),
    "split 1, ζ 0.001, 10 µm, 60 s": pair(3, 0.001, 1.0, 1e-5, 60),
    "split 1, ζ 0.05, 10 µm, 20 s": pair(3, 0.05, 1.0, 1e-5, 20),
    "split 0.3, ζ 0.01, 3 µm, 20 s": pair(3, 0.01, 0.3, 3e-6, 20),
    "split 0.15, ζ 0.01, 3 µm, 20 s": pair(3, 0.01, 0.15, 3e-6, 20),
    "split 0.12, ζ 0.001, 1 µm, 60 s": pair(6, 0.001, 0.12, 1e-6, 60),
    "split 0.12, ζ 0.1, 1 µm, 10 s": pair(8, 0.1, 0.12, 1e-6, 10),
    "same f, ζ 0.01 and 0.02, 10 µm, 20 s": pair(4, 0.01, 0.0, 1e-5, 20, 2.0),
}
UNRESOLVED = {
    "split 0.08, ζ 0.01, 1 µm, 20 s": pair(3, 0.01, 0.08, 1e-6, 20),
    "split 0.05, ζ 0.01, 3 µm, 20 s": pair(3, 0.01, 0.05, 3e-6, 20),
    "split 0.05, ζ 0.05, 10 µm, 20 s": pair(5, 0.05, 0.05, 1e-5, 20),
    "split 0.02, ζ 0.001, 10 µm, 60 s": pair(3, 0.001, 0.02, 1e-5, 60),
    "split 0, ζ 0.01, 10 µm, 20 s": pair(3, 0.01, 0.0, 1e-5, 20),
    "split 0, ζ 0.2, 10 µm, 20 s": pair(6, 0.2, 0.0, 1e-5, 20),
}


def _bursts(rng: np.random.Generator, n: int, share: float, length: int) -> np.ndarray:
    lost = np.zeros(n, bool)
    while lost.mean() < share:
        at = rng.integers(n)
        lost[at : at + 1 + rng.geometric(1 / length)] = True
    return lost


def damaged(kind: str, zeta: float, sigma: float = 1e-5, rail: float = 5e-3) -> Draw:
    """One mode of which 5 % of the samples are spoilt, or 8 mm of motion on a ±5 mm sensor; with the bound of the clean
    record and of the samples that were not spoilt."""

    def draw(rng: np.random.Generator) -> Drawn:
        t, n = np.arange(20000) / 1000, 20000
        amplitude = 8e-3 if kind.startswith("clip") else 1e-3
        q = np.array([rng.uniform(2.5, 8), zeta, amplitude, rng.uniform(0, 6.28), 0.0])
        floor = bound(one_axis, t, q, sigma)
        clean = one_axis(t, q)
        noise = sigma * rng.normal(size=n)
        y = clean + noise
        spikes, gaps = rng.random(n) < 0.05, _bursts(rng, n, 0.05, 30)
        lost = np.zeros(n, bool)
        if kind == "outliers":
            lost = spikes
            y[spikes] = rng.uniform(-rail, rail, int(spikes.sum()))
        elif kind == "bursts to the rail":
            y[gaps] = rail
        elif kind == "bursts to zero":
            y[gaps] = 0.0
        elif kind == "bursts, last value held":
            y = y[np.maximum.accumulate(np.where(gaps, 0, np.arange(n)))]
        elif kind == "NaN":
            y[gaps] = np.nan
        elif kind == "clip":
            lost = np.abs(y) >= rail
            y = np.clip(y, -rail, rail)
        elif kind == "clip, noise after it":
            lost = np.abs(clean) >= rail
            y = np.clip(clean, -rail, rail) + noise
        elif kind == "wander 20 µm at 0.11 Hz":
            y += 2e-5 * np.sin(2 * np.pi * 0.11 * t + rng.uniform(0, 6.28))
        elif kind == "1 µm steps":
            y = np.round(y / 1e-6) * 1e-6
        if kind.startswith("bursts") or kind == "NaN":
            lost = gaps
        left = bound(one_axis, t[~lost], q, sigma)
        return Drawn(t, y, _named(q), _named(floor), _named(left))

    return draw


DAMAGE = [
    (kind, zeta)
    for kind in (
        "outliers",
        "bursts to the rail",
        "bursts to zero",
        "bursts, last value held",
        "NaN",
        "clip",
        "clip, noise after it",
        "wander 20 µm at 0.11 Hz",
        "1 µm steps",
    )
    for zeta in ((1e-4, 0.01, 0.2) if not kind.startswith("clip") else (0.001, 0.01, 0.2))
]
