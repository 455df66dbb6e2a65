"""Means of a run's signals over windows of whole revolutions, each with its largest error."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from daq.signals.order_noise import OrderNoise
from daq.signals.order_windows import cut_windows
from daq.signals.rounding import code_noise, half_width, rounding_terms
from rig_basics.arrays import Array

_DEVIATIONS = 3.5  # standard deviations of a mean's noise in its width
# A code whose ripple is larger than this share of a step takes several values.
_MIN_RIPPLE = 0.5
# The codes of a pendulum that moves by less than this share of a step from window to window show the noise.
_MAX_CHANGE = 0.25
# Windows meet if they are less than this share of a window's length apart.
_MEETING = 1e-6


@dataclass(frozen=True)
class WindowMeans:
    """Means per window and quantity.

    Attributes:
        edges_s: start and end of each window that has enough samples, shape (n, 2), s.
        means: shape (n, 2): θ3 and θ4 in rad, or the order-1 amplitudes of x and y in m.
        width: largest error of a mean, shape (2,).
        noise: standard deviation of a mean's noise, shape (2,).
        rounding: amplitudes of the rounding error's Fourier terms, shape (2, k), unit of the means
            (daq.signals.rounding): rms over their unknown part; empty if nothing is rounded.
        step: step of the code, unit of the means; 0 if nothing is rounded.
        neighbours: correlation of the noise of two adjacent windows, shape (2,); empty without correlation.
        coloured: True if noise other than white noise was found.
    """

    edges_s: Array
    means: Array
    width: Array
    noise: Array
    rounding: Array
    step: float = 0.0
    neighbours: Array = field(default_factory=lambda: np.empty(0))
    coloured: bool = False

    def noise_covariance(self, least: float) -> Array:
        """Covariance of each quantity's means over the windows without rounding, shape (quantities, n, n).

        Args:
            least: lower limit of the standard deviation of a mean's noise.
        """
        meet = np.abs(self.edges_s[1:, 0] - self.edges_s[:-1, 1]) < _MEETING * np.diff(self.edges_s, axis=1)[1:, 0]
        adjacent = np.diag(1.0 * meet, 1) + np.diag(1.0 * meet, -1)
        shared = self.neighbours if len(self.neighbours) else np.zeros(len(self.noise))
        variance = np.maximum(self.noise, least) ** 2
        return variance[:, None, None] * (np.eye(len(self.edges_s)) + shared[:, None, None] * adjacent)


def whole_revolutions(mark_time_s: Array, mark_phase_rad: Array, window_s: float, most: int) -> Array:
    """Edges of up to `most` windows of whole revolutions that end at the last mark, shape (n + 1,); n may be 0."""
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
    time_s: Array,
    angles_rad: Array,
    mark_time_s: Array,
    mark_phase_rad: Array,
    edges: Array,
    step_rad: float,
    newest: int,
) -> WindowMeans | None:
    """Return the mean angles; None if too many samples are missing in the newest windows.

    Args:
        step_rad: step of the encoders' code; 0 if the angles are not rounded.
        newest: number of windows, counted from the end, that must have enough samples.
    """
    cut = cut_windows(time_s, angles_rad, mark_time_s, mark_phase_rad, edges, newest)
    if cut is None:
        return None
    fit = cut.orders()
    kept = cut.enough
    noise = np.sqrt(cut.mean(np.square(np.diff(cut.residual(fit))), kept) / (2 * cut.counts[kept, None]))
    once, twice = (np.median(np.hypot(*fit[k : k + 2, kept]), axis=0) for k in (1, 3))
    codes = cut.values / step_rad if step_rad > 0 else np.zeros_like(cut.values)
    off = codes - np.repeat(codes[:, cut.where[:-1].clip(max=codes.shape[1] - 1)], cut.counts, axis=1)
    off -= np.repeat(np.rint(cut.mean(off)).T, cut.counts, axis=1)
    seen = code_noise(cut.mean(1.0 * (off < -0.5), kept), cut.mean(1.0 * (off > 0.5), kept), cut.counts[kept, None])
    means = np.asarray(fit[0, kept], np.float64)
    change = np.abs(np.diff(means, axis=0, prepend=means[:1], append=means[-1:]))
    moving = np.maximum(change[1:], change[:-1]) > _MAX_CHANGE * step_rad  # a sweep over codes is not noise
    seen = np.where(moving, np.nan, seen)
    half = np.array(
        [
            half_width(step_rad, _usual(s) if max(a, b) < 0.5 * step_rad else 0.0, a, b)
            for s, a, b in zip(seen.T, once, twice, strict=True)
        ]
    )
    white = np.median(noise, axis=0)
    scatter = white * math.sqrt(float(np.median(cut.counts[kept])))
    rounding = [
        rounding_terms(step_rad, _dither(_usual(s), float(all_), max(a, b), step_rad), a, b)
        for s, all_, a, b in zip(seen.T, scatter, once, twice, strict=True)
    ]
    return WindowMeans(cut.edges[kept], means, half + _DEVIATIONS * white, white, np.array(rounding), step_rad)


def _usual(noise: Array) -> float:
    """Return the median of the noise estimates; 0 if too few windows have one."""
    known = noise[np.isfinite(noise)]
    return float(np.median(known)) if len(known) >= 3 else 0.0


def _dither(seen: float, scatter: float, ripple: float, step: float) -> float:
    """Return the noise before rounding, in steps: from the codes, or from the scatter of a code with a large ripple.

    Rounding itself scatters by 1/√12 of a step. Without a ripple, a code that alternates on an edge would look like
    noise.

    Args:
        seen: noise estimated from the codes, in steps.
        scatter: standard deviation of a sample, unit of `step`.
        ripple: largest amplitude of the parts that repeat with the rotor, unit of `step`.
        step: step of the code; 0 if nothing is rounded.
    """
    rippling = step > 0 and ripple >= _MIN_RIPPLE * step
    return math.sqrt(max(0.0, (scatter / step) ** 2 - 1 / 12)) if rippling else seen


def orbit_means(
    x_time_s: Array,
    x_m: Array,
    y_time_s: Array,
    y_m: Array,
    mark_time_s: Array,
    mark_phase_rad: Array,
    edges: Array,
    newest: int,
) -> WindowMeans | None:
    """Complex order-1 amplitudes of x and y in the windows with samples of both; None if too many are missing.

    The columns are Re X, Im X, Re Y, Im Y in m, with x = Re(X e^{iψ}) and y alike; `width` and `noise` are of four.
    Displacements are not rounded.
    """
    x = cut_windows(x_time_s, x_m, mark_time_s, mark_phase_rad, edges, newest)
    y = cut_windows(y_time_s, y_m, mark_time_s, mark_phase_rad, edges, newest)
    if x is None or y is None:
        return None
    kept = x.enough & y.enough
    columns, noise, beyond = list[Array](), list[float](), list[OrderNoise]()
    for cut in (x, y):
        fit = cut.orders()
        columns += [fit[1, kept, 0], -fit[2, kept, 0]]
        each = np.sqrt(cut.mean(np.square(np.diff(cut.residual(fit), 2)), kept)[:, 0] / (3 * cut.counts[kept]))
        white = float(np.median(each))
        beyond.append(cut.order_noise(fit, white))
        noise += [white * beyond[-1].real, white * beyond[-1].imaginary]
    deviation = np.array(noise)
    return WindowMeans(
        x.edges[kept],
        np.asarray(np.stack(columns, axis=1), np.float64),
        _DEVIATIONS * deviation,
        deviation,
        np.empty((4, 0)),
        neighbours=np.array([each.neighbours for each in beyond for _ in range(2)]),
        coloured=any(each != OrderNoise() for each in beyond),
    )


def amplitude_means(
    x_time_s: Array,
    x_m: Array,
    y_time_s: Array,
    y_m: Array,
    mark_time_s: Array,
    mark_phase_rad: Array,
    edges: Array,
    newest: int,
) -> WindowMeans | None:
    """Order-1 amplitudes of x and y in the windows with samples of both; None if too many samples are missing."""
    lasers = (x_time_s, x_m, y_time_s, y_m)
    orbit = orbit_means(*lasers, mark_time_s, mark_phase_rad, edges, newest)
    if orbit is None:
        return None
    noise = orbit.noise.reshape(2, 2).max(axis=1)
    return replace(
        orbit,
        means=np.hypot(orbit.means[:, ::2], orbit.means[:, 1::2]),
        width=_DEVIATIONS * noise,
        noise=noise,
        rounding=np.empty((2, 0)),
        neighbours=orbit.neighbours[::2],
    )
