"""Where an approach ends: limits whose intervals hold what they say, for approaches, standing codes and noise."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import daq.signals.limit as limit_module
from daq.signals.limit import Limit, limit
from daq.signals.rounding import rounding_covariance, rounding_terms
from daq.signals.window_means import half_width

WINDOW_S = 1.02
STEP = 2 * math.pi / 4096

Motion = Callable[[np.ndarray], np.ndarray]


def windows(count: int) -> np.ndarray:
    edges = np.arange(count + 1) * WINDOW_S
    return np.stack([edges[:-1], edges[1:]], axis=1)


def means(motion: Motion, edges: np.ndarray) -> np.ndarray:
    """Of a motion with time counted from the last window's end."""
    share = np.linspace(0, 1, 41)
    return motion(edges[:, :1] + np.diff(edges, axis=1) * share - edges[-1, 1]).mean(axis=1)


def white(count: int, quantities: int, std: float = 1.0) -> np.ndarray:
    return np.broadcast_to(std**2 * np.eye(count), (quantities, count, count))


def rate(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def nothing(rng: np.random.Generator) -> Motion:
    return lambda t: 0 * t


def one_rate(rng: np.random.Generator) -> list[Motion]:
    slow = rate(rng, 0.07, 0.6)
    return [lambda t, a=a: a * np.exp(-slow * t) for a in 10 * rng.standard_normal(3)]


def two_rates(rng: np.random.Generator) -> list[Motion]:
    slow = rate(rng, 0.1, 0.25)
    fast = rate(rng, 3.0, 6.0) * slow
    both = rng.standard_normal((3, 2)) * [10.0, 300.0]  # σ: the slow one at the end, the fast one 20 s before
    return [lambda t, a=a: a[0] * np.exp(-slow * t) + a[1] * np.exp(-fast * (t + 20.0)) for a in both]


def oscillation(rng: np.random.Generator) -> list[Motion]:
    decay, turn = rate(rng, 0.1, 0.4), rate(rng, 0.3, 2.0)
    both = 3 * rng.standard_normal((3, 2))
    return [lambda t, a=a: np.exp(-decay * t) * (a[0] * np.cos(turn * t) + a[1] * np.sin(turn * t)) for a in both]


def standing(rng: np.random.Generator) -> list[Motion]:
    return [lambda t: 0 * t] * 3


def drawn(kind: Callable[[np.random.Generator], list[Motion]], seed: int) -> tuple[Limit | None, np.ndarray]:
    """One draw's limits of three quantities, and the true ones."""
    rng = np.random.default_rng([seed, 7])
    edges = windows(int(rng.integers(15, 31)))
    ends = 100 * rng.standard_normal(3)
    seen = np.stack([means(m, edges) + end for m, end in zip(kind(rng), ends, strict=True)], axis=1)
    return limit(edges, seen + rng.standard_normal(seen.shape), white(len(edges), 3)), ends


@pytest.mark.parametrize("kind", [standing, one_rate, two_rates, oscillation])
def test_intervals_of_95_percent_hold_the_limit(
    kind: Callable[[np.random.Generator], list[Motion]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the share for approaches that are not exponential: here they all are."""
    monkeypatch.setattr(limit_module, "MODEL_SHARE", 0.0)
    off, refused = [], 0
    for seed in range(90):
        found, ends = drawn(kind, seed)
        if found is None:
            refused += 1
        else:
            off.append((found.values - ends) / np.sqrt(np.diag(found.covariance)))
    z = np.array(off)
    print(kind.__name__, refused, np.mean(np.abs(z) < 1.96), np.mean(z**2), np.mean(z))
    assert refused <= 2
    assert 0.92 <= np.mean(np.abs(z) < 1.96) <= 0.995
    assert 0.4 < np.mean(z**2) < 1.4
    assert abs(np.mean(z)) < 0.25
