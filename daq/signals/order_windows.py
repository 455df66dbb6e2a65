"""A signal's samples in windows of whole revolutions, and the orders in each window."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.signals.order_noise import OrderNoise, order_noise
from rig_basics.arrays import Array

# A window is used if at least this share of its expected samples is present.
_MIN_SHARE = 0.4
_MIN_SAMPLES = 20
_MIN_GOOD_SHARE = 0.75  # share of the newest windows that must have enough samples, including the last one


@dataclass(frozen=True)
class Cut:
    """Samples by window.

    Attributes:
        phase, values: samples of all windows, shapes (s,), (columns, s).
        where: index of each window's first sample and of the end, shape (n + 1,).
        enough: True for windows with enough samples, shape (n,).
        edges: start and end of each window, shape (n, 2), s.
    """

    phase: Array
    values: Array
    where: NDArray[np.int64]
    enough: NDArray[np.bool_]
    edges: Array

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of samples per window."""
        return np.diff(self.where)

    def mean(self, values: NDArray[Any], kept: NDArray[np.bool_] | None = None) -> Array:
        """Means per window (NaN for an empty one), of all windows or of `kept`; shape (windows, columns)."""
        where = np.minimum(self.where, values.shape[1])
        counts = np.diff(where)
        some = counts > 0
        means = np.full((len(counts), len(values)), np.nan)
        means[some] = (np.add.reduceat(values[:, : where[-1]], where[:-1][some], axis=1) / counts[some]).T
        return means if kept is None else means[kept]

    def orders(self) -> NDArray[np.floating]:
        """Amplitudes of 1, cos ψ, sin ψ, cos 2ψ, sin 2ψ by least squares, shape (5, n, columns).

        The amplitudes are 0 in windows without enough samples.
        """
        basis = self._basis
        fit = np.zeros((len(self.enough), 5, len(self.values)))
        kept = np.flatnonzero(self.enough)
        gram, right = np.empty((len(kept), 5, 5)), np.empty((len(kept), 5, len(self.values)))
        for k, j in enumerate(kept):
            inside = basis[:, self.where[j] : self.where[j + 1]]
            part = self.values[:, self.where[j] : self.where[j + 1]]
            gram[k], right[k] = inside @ inside.T, inside @ (part - part[:, :1]).T
        fit[kept] = np.linalg.solve(gram, right)
        fit[kept, 0] += self.values[:, self.where[kept]].T
        return fit.transpose(1, 0, 2)

    def residual(self, fit: NDArray[np.floating]) -> Array:
        """Residuals of the values after the orders are removed, shape (columns, s)."""
        residual = self.values.copy()
        for j in np.flatnonzero(self.enough):
            part = slice(self.where[j], self.where[j + 1])
            residual[:, part] -= fit[:, j].T @ self._basis[:, part]
        return residual

    def order_noise(self, fit: NDArray[np.floating], white: float) -> OrderNoise:
        """Noise of the first column's order-1 vectors; white: deviation of their parts from white noise."""
        kept = np.flatnonzero(self.enough)
        residual = self.residual(fit)[0]
        parts = [slice(self.where[j], self.where[j + 1]) for j in kept]
        spans = [self.phase[part][-1] - self.phase[part][0] for part in parts]
        turns = round(float(np.median(spans)) / (2 * math.pi))
        windows = [(self.phase[part], residual[part]) for part in parts]
        return order_noise(windows, fit[1, kept, 0] - 1j * fit[2, kept, 0], white, turns)

    @cached_property
    def _basis(self) -> Array:
        out = np.empty((5, len(self.phase)))
        out[0] = 1.0
        cos, sin = np.cos(self.phase, out=out[1]), np.sin(self.phase, out=out[2])
        np.multiply(2 * cos, cos, out=out[3])
        out[3] -= 1.0
        np.multiply(2 * cos, sin, out=out[4])
        return out


def cut_windows(
    time: Array, values: Array, mark_time: Array, mark_phase: Array, edges: Array, newest: int
) -> Cut | None:
    """Cut samples into windows; None if too many are missing in the newest windows.

    Args:
        time, values: samples, shapes (k,), (k,) or (k, columns); NaN is omitted.
        mark_time, mark_phase: times of the tachometer marks, s, and ψ there, rad.
        edges: edges of the windows, shape (n + 1,), s.
        newest: number of windows, counted from the end, that must have enough samples.
    """
    begin, end = np.searchsorted(time, edges[[0, -1]])
    time, table = time[begin:end], np.ascontiguousarray(np.atleast_2d(values.T)[:, begin:end])
    good = np.isfinite(table[0])
    for column in table[1:]:
        good &= np.isfinite(column)
    if not good.all():
        time, table = time[good], table[:, good]
    if len(time) < _MIN_SAMPLES:
        return None
    where = np.searchsorted(time, edges).astype(np.int64)
    counts = np.diff(where)
    usual = np.diff(edges) / np.median(np.diff(time))
    enough = (counts >= _MIN_SAMPLES) & (counts >= _MIN_SHARE * usual)
    late = enough[-newest:]
    if not late[-1] or late.sum() < _MIN_GOOD_SHARE * newest:
        return None
    phase = np.interp(time, mark_time, mark_phase)
    return Cut(phase, table, where, enough, np.stack([edges[:-1], edges[1:]], axis=1))
