"""Means over the windows of a motion that is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

WINDOW_S = 1.02


def windows(count: int) -> np.ndarray:
    """Edges of consecutive windows, s."""
    edges = np.arange(count + 1) * WINDOW_S
    return np.stack([edges[:-1], edges[1:]], axis=1)


def means(motion: Callable[[np.ndarray], np.ndarray], edges: np.ndarray) -> np.ndarray:
    """Of a motion with time counted back from the last window's end."""
    share = np.linspace(0, 1, 101)
    return motion(edges[:, :1] + np.diff(edges, axis=1) * share - edges[-1, 1]).mean(axis=1)


def average(rate: float, begin: float, end: float) -> float:
    """Mean of e^{−rate t} from begin to end."""
    return float((np.exp(-rate * begin) - np.exp(-rate * end)) / (rate * (end - begin)))
