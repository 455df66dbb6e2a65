# pyright: strict
"""Means of a run's signals over windows of whole revolutions, each with how far it may be from the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.signals.rounding import code_noise, half_width, rounding_terms

Array = NDArray[np.float64]

_LEAST_SHARE = 0.4  # of a window's samples that must have come
_LEAST_SAMPLES = 20
_GOOD_OF_NEWEST = 0.75  # share of the newest windows that must be good, the last one among them
_DEVIATIONS = 3.5  # of a mean's noise that its width holds
_RIPPLES = 0.5  # of a step: a code that wobbles by more visits several
_STANDS = 0.25  # of a step from window to window: slower than that a pendulum's codes show the noise
_NO_STEP_RAD = 1e-9  # smaller changes of an angle are floating point noise
_DEFAULT_STEP_RAD = 2 * math.pi / 4096  # of a code that never changes


@dataclass(frozen=True)
class WindowMeans:
    """Means per window and quantity.

    Attributes:
        edges_s: start and end of each window that has enough samples, shape (n, 2), s.
        means: shape (n, 2): θ3 and θ4 in rad, or the order-1 amplitudes of x and y in m.
        width: how far a mean may be from the truth, shape (2,).
        noise: standard deviation of a mean's noise, shape (2,).
        rounding: amplitudes of the rounding error's Fourier terms, rms over what is not known of them, shape (2, k),
            unit of the means (daq.signals.rounding); empty where nothing is rounded.
        step: of the code, unit of the means; 0 where nothing is rounded.
    """

    edges_s: Array
    means: Array
    width: Array
    noise: Array
    rounding: Array
    step: float = 0.0


def whole_revolutions(mark_time_s: Array, mark_phase_rad: Array, window_s: float, most: int) -> Array:
    """Edges of up to `most` windows of whole revolutions that end with the last mark, shape (n + 1,); n may be 0."""
    if len(mark_time_s) < 3:
        return np.empty(0)
    late = mark_time_s >= mark_time_s[-1] - window_s * 2
    if late.sum() < 2:
        return np.empty(0)
    speed = (mark_phase_rad[-1] - mark_phase_rad[late][0]) / (mark_time_s[-1] - mark_time_s[late][0])
    turn = 2 * math.pi * max(1, math.ceil(window_s * speed / (2 * math.pi)))
    count = min(most, int((mark_phase_rad[-1] - mark_phase_rad[0]) / turn + 1e-9))
    phases = mark_phase_rad[-1] - turn * np.arange(count, -1, -1)
    return np.asarray(np.interp(phases, mark_phase_rad, mark_time_s), np.float64)


def angle_means(
    time_s: Array, angles_rad: Array, mark_time_s: Array, mark_phase_rad: Array, edges: Array, step_rad: float | None,
    newest: int,
) -> WindowMeans | None:  # fmt: skip
    """Mean angles; None when too many samples are missing in the newest windows.

    Args:
        step_rad: of the encoders' code; None: the smallest change in the samples.
        newest: how many windows, counted from the end, must be good.
    """
    cut = _cut(time_s, angles_rad, mark_time_s, mark_phase_rad, edges, newest)
    if cut is None:
        return None
    step = _step(angles_rad) if step_rad is None else step_rad
    fit = cut.orders()
    kept = cut.enough
    noise = np.sqrt(cut.mean(_squared(np.diff(cut.rest(fit))), kept) / (2 * cut.counts[kept, None]))
    once, twice = (np.median(np.hypot(*fit[k : k + 2, kept]), axis=0) for k in (1, 3))
    codes = cut.values / step if step > 0 else np.zeros_like(cut.values)
    off = codes - np.repeat(codes[:, cut.where[:-1].clip(max=codes.shape[1] - 1)], cut.counts, axis=1)
    off -= np.repeat(np.rint(cut.mean(off)).T, cut.counts, axis=1)
    seen = code_noise(cut.mean(1.0 * (off < -0.5), kept), cut.mean(1.0 * (off > 0.5), kept), cut.counts[kept, None])
    means = np.asarray(fit[0, kept], np.float64)
    change = np.abs(np.diff(means, axis=0, prepend=means[:1], append=means[-1:]))
    moving = np.maximum(change[1:], change[:-1]) > _STANDS * step  # what sweeps over codes is no noise
    seen = np.where(moving, np.nan, seen)
    half = np.array([
        half_width(step, _usual(s) if max(a, b) < 0.5 * step else 0.0, a, b)
        for s, a, b in zip(seen.T, once, twice, strict=True)
    ])  # fmt: skip
    white = np.median(noise, axis=0)
    scatter = white * math.sqrt(float(np.median(cut.counts[kept])))
    rounding = [
        rounding_terms(step, _dither(_usual(s), float(all_), max(a, b), step), a, b)
        for s, all_, a, b in zip(seen.T, scatter, once, twice, strict=True)
    ]
    return WindowMeans(cut.edges[kept], means, half + _DEVIATIONS * white, white, np.array(rounding), step)


def _usual(noise: Array) -> float:
    """The noise that most windows show; 0 where too few show any."""
    known = noise[np.isfinite(noise)]
    return float(np.median(known)) if len(known) >= 3 else 0.0


def _dither(seen: float, scatter: float, ripple: float, step: float) -> float:
    """Noise before rounding, in steps: as the codes show it, or what a code that ripples over steps scatters more.

    Rounding itself scatters by 1/√12 of a step; without a ripple a code that flips on an edge would look like noise.

    Args:
        seen: noise that the codes show, in steps.
        scatter: standard deviation of a sample, unit of `step`.
        ripple: largest amplitude of what repeats with the rotor, unit of `step`.
        step: of the code; 0: nothing is rounded.
    """
    rippling = step > 0 and ripple >= _RIPPLES * step
    return math.sqrt(max(0.0, (scatter / step) ** 2 - 1 / 12)) if rippling else seen


def amplitude_means(
    x_time_s: Array, x_m: Array, y_time_s: Array, y_m: Array, mark_time_s: Array, mark_phase_rad: Array, edges: Array,
    newest: int,
) -> WindowMeans | None:  # fmt: skip
    """Order-1 amplitudes of x and y in the windows in which both were seen; None when too many are missing."""
    x = _cut(x_time_s, x_m, mark_time_s, mark_phase_rad, edges, newest)
    y = _cut(y_time_s, y_m, mark_time_s, mark_phase_rad, edges, newest)
    if x is None or y is None:
        return None
    kept = x.enough & y.enough
    columns: list[Array] = []
    width: list[float] = []
    for cut in (x, y):
        columns.append(np.hypot(*cut.orders()[1:3, kept, 0]))
        noise = np.sqrt(cut.mean(_squared(np.diff(cut.values, 2)), kept)[:, 0] / (3 * cut.counts[kept]))
        width.append(_DEVIATIONS * float(np.median(noise)))
    noise = np.array(width) / _DEVIATIONS
    return WindowMeans(x.edges[kept], np.stack(columns, axis=1), np.array(width), noise, np.empty((2, 0)))


def orbit_means(
    x_time_s: Array, x_m: Array, y_time_s: Array, y_m: Array, mark_time_s: Array, mark_phase_rad: Array, edges: Array,
    newest: int,
) -> WindowMeans | None:  # fmt: skip
    """Complex order-1 amplitudes of x and y in the windows in which both were seen; None when too many are missing.

    The columns are Re X, Im X, Re Y, Im Y with x = Re(X e^{iψ}), y the same, m; `width` and `noise` have four places.
    """
    x = _cut(x_time_s, x_m, mark_time_s, mark_phase_rad, edges, newest)
    y = _cut(y_time_s, y_m, mark_time_s, mark_phase_rad, edges, newest)
    if x is None or y is None:
        return None
    kept = x.enough & y.enough
    columns: list[Array] = []
    noise: list[float] = []
    for cut in (x, y):
        fit = cut.orders()
        columns += [np.asarray(fit[1, kept, 0], np.float64), -np.asarray(fit[2, kept, 0], np.float64)]
        white = np.sqrt(cut.mean(_squared(np.diff(cut.rest(fit), 2)), kept)[:, 0] / (3 * cut.counts[kept]))
        noise += 2 * [float(np.median(white))]
    white = np.array(noise)
    return WindowMeans(x.edges[kept], np.stack(columns, axis=1), _DEVIATIONS * white, white, np.empty((4, 0)))


@dataclass(frozen=True)
class _Cut:
    """Samples by window.

    Attributes:
        phase, values: of all windows, shapes (s,), (columns, s).
        where: index of each window's first sample and of the end, shape (n + 1,).
        enough: whether a window has enough samples, shape (n,).
        edges: start and end of each window, shape (n, 2), s.
    """

    phase: Array
    values: Array
    where: NDArray[np.int64]
    enough: NDArray[np.bool_]
    edges: Array

    @property
    def counts(self) -> NDArray[np.int64]:
        """Samples per window."""
        return np.diff(self.where)

    def mean(self, values: NDArray[Any], kept: NDArray[np.bool_] | None = None) -> Array:
        """Means per window (nan in an empty one), of all windows or of some; shape (windows, columns)."""
        where = np.minimum(self.where, values.shape[1])
        counts = np.diff(where)
        some = counts > 0
        means = np.full((len(counts), len(values)), np.nan)
        means[some] = (np.add.reduceat(values[:, : where[-1]], where[:-1][some], axis=1) / counts[some]).T
        return means if kept is None else means[kept]

    def orders(self) -> NDArray[np.floating]:
        """Amplitudes of 1, cos ψ, sin ψ, cos 2ψ, sin 2ψ by least squares, shape (5, n, columns).

        In each window that has enough samples; 0 in the others.
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

    def rest(self, fit: NDArray[np.floating]) -> Array:
        """What the orders leave of the values, shape (columns, s)."""
        rest = self.values.copy()
        for j in np.flatnonzero(self.enough):
            part = slice(self.where[j], self.where[j + 1])
            rest[:, part] -= fit[:, j].T @ self._basis[:, part]
        return rest

    @cached_property
    def _basis(self) -> Array:
        out = np.empty((5, len(self.phase)))
        out[0] = 1.0
        cos, sin = np.cos(self.phase, out=out[1]), np.sin(self.phase, out=out[2])
        np.multiply(2 * cos, cos, out=out[3])
        out[3] -= 1.0
        np.multiply(2 * cos, sin, out=out[4])
        return out


def _squared(values: NDArray[Any]) -> Array:
    return values * values


def _cut(time: Array, values: Array, mark_time: Array, mark_phase: Array, edges: Array, newest: int) -> _Cut | None:
    begin, end = np.searchsorted(time, edges[[0, -1]])
    time, table = time[begin:end], np.ascontiguousarray(np.atleast_2d(values.T)[:, begin:end])
    good = np.isfinite(table[0])
    for column in table[1:]:
        good &= np.isfinite(column)
    if not good.all():
        time, table = time[good], table[:, good]
    if len(time) < _LEAST_SAMPLES:
        return None
    where = np.searchsorted(time, edges).astype(np.int64)
    counts = np.diff(where)
    usual = np.diff(edges) / np.median(np.diff(time))
    enough = (counts >= _LEAST_SAMPLES) & (counts >= _LEAST_SHARE * usual)
    late = enough[-newest:]
    if not late[-1] or late.sum() < _GOOD_OF_NEWEST * newest:
        return None
    phase = np.interp(time, mark_time, mark_phase)
    return _Cut(phase, table, where, enough, np.stack([edges[:-1], edges[1:]], axis=1))


def _step(angles: Array) -> float:
    """The encoders' step as the samples show it."""
    changes = np.abs(np.diff(angles, axis=0))
    changes = changes[changes > _NO_STEP_RAD]  # comparisons with nan are False
    return float(changes.min()) if len(changes) else _DEFAULT_STEP_RAD
