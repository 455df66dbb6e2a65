"""Order vectors: complex amplitudes of signal components synchronous with the rotor, over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.quantities.envelopes import Envelopes, fit_envelopes
from rig_basics.arrays import Array, Complex, Indices
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.times import checked_times


@dataclass(frozen=True)
class OrderTrack(Tabular):
    """Order vectors over time; the signal is offset + Re Σ A_k e^{ikψ} about each row's time.

    A positive angle of A_k leads: the signal is largest where kψ = −arg A_k. The sign is that of the signal: a laser's
    distance increases away from the sensor.

    Attributes:
        time_s: time of each row, shape (n,), s.
        orders: requested orders.
        amplitude_m: complex amplitudes A_k, shape (n, len(orders)), m.
        std_m: standard deviation of the real and of the imaginary part, each, by noise. An unknown lag of the stamps
            behind those of the phase turns A_k in addition by k ω times the lag (`analysis.quantities.stamp_lag`).
        offset_m: mean of the signal, shape (n,), m.
        residual_m: rms residual of the fit, shape (n,), m.
        samples: number of finite samples of each row, shape (n,).
        speed_rad_s: speed of the rotor, shape (n,), rad/s.
        independent: number of independent rows of each order, shape (len(orders),).
    """

    time_s: Array
    orders: tuple[int, ...]
    amplitude_m: Complex
    std_m: Array
    offset_m: Array
    residual_m: Array
    samples: NDArray[np.int64]
    speed_rad_s: Array
    independent: Array

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each time: amplitude, phase and deviation of each order."""
        found: dict[str, Column] = {"time_s": self.time_s, "speed_rad_s": self.speed_rad_s}
        for order in self.orders:
            amplitude, std = self.of(order)
            size, phase = np.abs(amplitude), np.angle(amplitude)
            found |= {f"amplitude{order}_m": size, f"phase{order}_rad": phase, f"std{order}_m": std}
        return found | {"offset_m": self.offset_m, "residual_m": self.residual_m, "samples": self.samples}

    def mean(self, order: int) -> tuple[complex, float]:
        """Return the mean amplitude of one order over the rows, and the standard deviation of its parts.

        The deviation is the larger of that from the residuals and that from the rows' scatter.
        """
        j = self.orders.index(order)
        track = self.amplitude_m[:, j]
        n = float(self.independent[j])
        white = float(np.sqrt(np.mean(self.std_m[:, j] ** 2) / n))
        scatter = float(np.sqrt(0.5 * np.var(track, ddof=1) / n)) if n > 2 else 0.0
        return complex(track.mean()), max(white, scatter)

    def of(self, order: int) -> tuple[Complex, Array]:
        """Return amplitudes of one order and the standard deviations of their parts, shapes (n,)."""
        j = self.orders.index(order)
        return self.amplitude_m[:, j], self.std_m[:, j]


def order_track(
    time_s: ArrayLike,
    displacement_m: ArrayLike,
    phase_rad: ArrayLike,
    orders: Sequence[int] = (1,),
    *,
    revolutions: int | None = None,
    harmonics: int = 3,
) -> OrderTrack:
    """Return complex order amplitudes at constant speed, through a run-up or through a run-down.

    Without `revolutions` the amplitudes may change at any time (`analysis.quantities.envelopes`): one row per
    revolution, with bandwidths estimated from the data. With it they are means over consecutive windows of so many
    revolutions.

    Args:
        time_s, displacement_m: samples, shape (n,); NaN displacements are left out.
        phase_rad: rotor phase ψ at the samples (unwrapped), shape (n,), rad.
        orders: requested whole orders, 1 for once per revolution.
        revolutions: length of a window.
        harmonics: orders 0 … harmonics are fitted together, so that lost samples cause no leakage between them.
    Raises:
        ValueError: shapes differ, an order is not positive, times are dates or run backwards, or there are less than
            four revolutions (one window).
    Source: docs/theory/order_tracking.md.

    Example:
        The Bode plot of a run-up from parameters alone, and the orbit at one speed:

        >>> import numpy as np
        >>> from analysis import orbit_ellipse, order_track
        >>> from dynamics import Scene, SpeedHistory, simulate
        >>> from rig_configs import load_rig
        >>> run_up = SpeedHistory.ramp(10.0, 30.0, duration_s=10.0)
        >>> motion = simulate(load_rig("virtual"), Scene(run_up, released=(False, False)), 10.0)
        >>> phase = run_up.phase(motion.time_s)[:, 0]
        >>> x, y = (order_track(motion.time_s, signal, phase) for signal in motion.displacement_m.T)
        >>> size = np.abs(x.amplitude_m[:, 0])
        >>> print(f"{1e3 * size.max():.2f} mm at {x.speed_rad_s[size.argmax()]:.1f} rad/s")
        4.72 mm at 21.5 rad/s
        >>> at = np.searchsorted(x.speed_rad_s, 25.0)
        >>> orbit = orbit_ellipse(x.amplitude_m[at, 0], y.amplitude_m[at, 0])
        >>> orbit.precession, round(1e3 * orbit.major_m, 2)
        ('backward', 1.76)
    """
    time = checked_times(time_s, ValueError)
    x, psi = (np.asarray(a, np.float64) for a in (displacement_m, phase_rad))
    if not time.shape == x.shape == psi.shape or time.ndim != 1:
        raise ValueError(f"time, displacement and phase must be alike, got {time.shape}, {x.shape}, {psi.shape}")
    if not orders or min(orders) < 1:
        raise ValueError(f"order tracking: expected orders of at least 1, got {tuple(orders)}")
    good = np.isfinite(x) & np.isfinite(psi) & np.isfinite(time)
    time, x, psi = time[good], x[good], psi[good]
    highest = max(harmonics, *orders)
    if revolutions is None:
        return _followed(time, x, psi, tuple(orders), highest)
    return _in_windows(time, x, psi, tuple(orders), highest, revolutions)


_MIN_ROWS, _MAX_KNOTS, _SAMPLES_PER_KNOT = 4, 1600, 8.0
_KNOTS_PER_TURN = 2.0
_OWN_WIDTH, _OTHER_WIDTH, _OFFSET_WIDTH = 1.2, 0.3, 0.15


def _followed(time: Array, x: Array, psi: Array, orders: tuple[int, ...], highest: int) -> OrderTrack:
    """Return envelopes that change, one row per revolution."""
    turned = float(psi.max() - psi.min()) / (2 * np.pi) if len(psi) else 0.0
    if turned < _MIN_ROWS or len(x) < 8 * _SAMPLES_PER_KNOT:
        raise ValueError(f"order tracking needs {_MIN_ROWS} whole revolutions, got {turned:.3g}")
    if np.any(np.diff(time) <= 0):
        raise ValueError("order tracking: expected times that rise from sample to sample")
    rows, speed = _revolutions(time, psi)
    duration = float(time[-1] - time[0])
    fastest = float(np.max(speed)) / (2 * np.pi)
    knot = max(1 / (_KNOTS_PER_TURN * fastest), duration / _MAX_KNOTS, duration * _SAMPLES_PER_KNOT / len(x))
    widths = np.full(highest + 1, _OTHER_WIDTH)
    widths[0], widths[list(orders)] = _OFFSET_WIDTH, _OWN_WIDTH
    found = fit_envelopes(time, x, psi, highest, knot, widths)
    near = _coloured(min(orders), highest, found.residuals(time, x, psi), psi, found.noise)
    if near > found.noise:  # otherwise the filter takes slow noise for changes of the vector
        found = fit_envelopes(time, x, psi, highest, knot, widths, least_noise=near)
    values, variance = found.at(rows)
    real, imaginary = np.array([2 * k - 1 for k in orders]), np.array([2 * k for k in orders])
    amplitude = values[:, real] + 1j * values[:, imaginary]
    rest = found.residuals(time, x, psi)
    own = 0.5 * (variance[:, real] + variance[:, imaginary])
    own *= np.stack([_noise_near(k, time, rest, psi, rows, found.noise) for k in orders], axis=1)
    std = np.sqrt(own + _undefined(found, rows, speed, real, imaginary, amplitude) ** 2)
    edges = np.searchsorted(time, np.concatenate([[time[0]], 0.5 * (rows[1:] + rows[:-1]), [time[-1]]]))
    count = np.diff(edges)
    squares = np.add.reduceat(rest**2, np.minimum(edges[:-1], len(rest) - 1))
    residual = np.sqrt(np.where(count > 0, squares / np.maximum(count, 1), found.noise**2))
    independent = np.minimum(np.maximum(found.freedom[list(orders)] / 2, 1.0), float(len(rows)))
    return OrderTrack(rows, orders, amplitude, std, values[:, 0], residual, count, speed, independent)


def _revolutions(time: Array, psi: Array) -> tuple[Array, Array]:
    """Return the times of the rotor's half revolution and of each further whole one, and the speeds there."""
    way = np.maximum.accumulate(np.abs(psi - psi[0]))  # forward or backward
    rising = np.flatnonzero(np.diff(way, prepend=-1.0) > 0)
    middles = np.arange(np.pi, way[-1] - 0.5 * np.pi, 2 * np.pi)
    rows = np.interp(middles, way[rising], time[rising])
    around = np.interp(np.stack([middles - np.pi, middles + np.pi]), way[rising], time[rising])
    turned = np.minimum(middles + np.pi, way[-1]) - (middles - np.pi)
    return rows, turned / np.maximum(around[1] - around[0], 1e-12)


_BLOCK_TURNS, _BLOCKS_AROUND = 4, 9


def _coloured(order: int, highest: int, rest: Array, psi: Array, noise: float) -> float:
    """Return the noise of one sample if all frequencies had the power near an order; `noise` if it is white.

    The envelopes have absorbed the noise near the orders. It is therefore extrapolated as a power of the frequency
    from the residuals midway between orders above the highest one (median over blocks of turns).
    """
    way = np.abs(psi - psi[0])
    blocks = int(way[-1] / (2 * np.pi * _BLOCK_TURNS))
    if blocks < 2 * _BLOCKS_AROUND:
        return noise
    borders: Array = np.linspace(0.0, float(way[-1]), blocks + 1)[:-1]
    edges: Indices = np.unique(np.searchsorted(way, borders))
    count = np.diff(np.append(edges, len(rest)))
    at = highest + 0.5 + np.arange(1, 6)
    powers = [np.abs(np.add.reduceat(rest * np.exp(-1j * h * psi), edges)) ** 2 / count for h in at]
    logs = np.log([float(np.median(power)) / math.log(2) + 1e-300 for power in powers])
    distance = np.log(at / order)
    slope, level = (float(v) for v in np.polyfit(distance, logs, 1))
    doubt = 1.2 / math.sqrt(len(edges)) / float(np.sqrt(np.sum((distance - distance.mean()) ** 2)))
    if slope > -4 * doubt:
        return noise
    return max(noise, math.exp(0.5 * (level + min(slope + 3.0, 0.0) * float(distance.mean()))))


def _noise_near(order: int, time: Array, rest: Array, psi: Array, rows: Array, noise: float) -> Array:
    """Return the noise variance half an order from an order over that of all samples where it is larger; else 1."""
    way = np.abs(psi - psi[0])
    blocks = max(1, int(way[-1] / (2 * np.pi * _BLOCK_TURNS)))
    borders: Array = np.linspace(0.0, float(way[-1]), blocks + 1)[:-1]
    edges: Indices = np.unique(np.searchsorted(way, borders))
    count = np.diff(np.append(edges, len(rest)))
    power = np.zeros(len(edges))
    for neighbour in (order - 0.5, order + 0.5):
        power += 0.5 * np.abs(np.add.reduceat(rest * np.exp(-1j * neighbour * psi), edges)) ** 2 / count
    around = min(_BLOCKS_AROUND, len(power))
    total = np.concatenate([[0.0], np.cumsum(power)])
    first = np.clip(np.arange(len(power)) - around // 2, 0, len(power) - around)
    ratio = (total[first + around] - total[first]) / (around * max(noise**2, 1e-300))
    spread = 1 / np.sqrt(2 * around)
    ratio = np.where(ratio > 1 + 4 * spread, ratio, 1.0)  # below 1 where an envelope has absorbed the noise
    middles = time[np.minimum(edges + count // 2, len(time) - 1)]
    return np.interp(rows, middles, ratio)


def _undefined(
    found: Envelopes,
    rows: Array,
    speed: Array,
    real: NDArray[np.int64],
    imaginary: NDArray[np.int64],
    amplitude: Complex,
) -> Array:
    """Return the ambiguity of a vector that changes within a revolution (Bedrosian), per row and order.

    The part of a change faster than once per revolution belongs to another order. For a spectrum that falls
    exponentially, as that of a resonance, it is the square of the part that changes at half that rate, over the size.
    """
    half = np.pi / np.maximum(speed, 1e-9)
    places = rows[:, None] + half[:, None] * np.arange(-2, 3)
    values = found.values_at(np.clip(places, rows[0], rows[-1]).ravel()).reshape(*places.shape, -1)
    vectors = values[..., real] + 1j * values[..., imaginary]
    quick = np.abs(np.einsum("rak,a->rk", vectors, np.array([0.25, -1.0, 1.5, -1.0, 0.25])))
    size = np.maximum(np.abs(vectors).max(axis=1), np.abs(amplitude))
    return quick**2 / np.maximum(size, 1e-300)


def _in_windows(
    time: Array, x: Array, psi: Array, orders: tuple[int, ...], highest: int, revolutions: int
) -> OrderTrack:
    """Fit constant amplitudes by least squares in consecutive windows of whole revolutions, up to the end."""
    span = 2 * np.pi * revolutions
    count = int((psi[-1] - psi[0]) / span + 1e-9) if len(psi) else 0
    if count < 1:
        raise ValueError(f"order tracking needs {number_of(revolutions, 'whole revolution')}, got less")
    edges = cast("Indices", np.searchsorted(psi, psi[-1] - span * np.arange(count, -1, -1)))
    edges[-1] = len(psi)
    windows = [
        _window(time[a:b], x[a:b], psi[a:b], highest, orders)
        for a, b in pairwise(edges)
        if b - a >= 4 * (2 * highest + 1)
    ]
    if not windows:
        raise ValueError("order tracking: too few valid samples in every window")
    middle, amplitude, std, offset, residual, samples, speed = (np.array(c) for c in zip(*windows, strict=True))
    independent = np.full(len(orders), float(len(windows)))
    return OrderTrack(middle, orders, amplitude, std, offset, residual, samples, speed, independent)


def _window(
    time: Array, x: Array, psi: Array, highest: int, orders: Sequence[int]
) -> tuple[float, Complex, Array, float, float, int, float]:
    """Fit one window: time, amplitudes, their standard deviations, offset, residual, samples, speed."""
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
    speed = float((psi[-1] - psi[0]) / (time[-1] - time[0]))
    vectors = fit[real] + 1j * fit[imaginary]
    return float(time.mean()), vectors, spread, float(fit[0]), float(np.sqrt(variance)), len(x), speed
