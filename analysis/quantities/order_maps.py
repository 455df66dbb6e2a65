"""Angular resampling: order vectors and order maps by Fourier transforms over whole revolutions.

The conventional method, with which `order_track` is compared. A signal sampled at even angles of the rotor has its
orders in bins at any speed. An amplitude that changes within the window is smeared over it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from analysis.quantities.order_tracking import OrderTrack
from rig_basics.arrays import Array, Complex
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.times import checked_times


@dataclass(frozen=True)
class OrderMap(Tabular):
    """Amplitudes over time and order.

    Attributes:
        time_s, speed_rad_s: time and speed of each window's middle, shapes (n,).
        order: orders, shape (m,), in steps of one over the revolutions of a window.
        vectors_m: complex amplitudes relative to the rotor's phase, shape (n, m).
    """

    time_s: Array
    speed_rad_s: Array
    order: Array
    vectors_m: Complex

    @property
    def amplitude_m(self) -> Array:
        """Absolute values of the vectors, m."""
        return np.abs(self.vectors_m)

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each order of each window."""
        return {
            "time_s": np.repeat(self.time_s, len(self.order)),
            "speed_rad_s": np.repeat(self.speed_rad_s, len(self.order)),
            "order": np.tile(self.order, len(self.time_s)),
            "amplitude_m": self.amplitude_m.ravel(),
            "phase_rad": np.angle(self.vectors_m).ravel(),
        }


def order_map(
    time_s: ArrayLike, displacement_m: ArrayLike, phase_rad: ArrayLike, *, revolutions: int = 8, highest: float = 8.0
) -> OrderMap:
    """Return amplitudes by order in windows of whole revolutions (Hann, overlap of one half).

    Args:
        time_s, displacement_m, phase_rad: samples, shapes (n,); NaN are left out, the phase rises or falls.
        revolutions: length of a window; orders are resolved that differ by two over this.
        highest: highest order; reduced if the fastest turn has too few samples.
    Raises:
        ValueError: shapes differ, times are dates or run backwards, or no window is complete.
    """
    time, signal, turned = _by_angle(time_s, displacement_m, phase_rad)
    fastest = float(np.max(np.diff(turned) / np.diff(time)))
    rate = 1 / float(np.median(np.diff(time)))
    a_turn = int(2 ** np.floor(np.log2(np.clip(rate / max(fastest, 1e-9), 8, 512))))
    length = a_turn * revolutions
    even = turned[0] + np.arange(int((turned[-1] - turned[0]) * a_turn)) / a_turn
    if len(even) < length:
        raise ValueError(
            f"order map: expected {number_of(revolutions, 'whole revolution')}, got {len(even) / a_turn:.3g}"
        )
    at = cast("Array", np.interp(even, turned, time))
    values = np.asarray(CubicSpline(time, signal)(at), np.float64)
    window = np.hanning(length + 1)[:-1]
    starts = np.arange(0, len(even) - length + 1, length // 2)
    parts = values[starts[:, None] + np.arange(length)]
    parts = parts - parts.mean(axis=1, keepdims=True)
    lines = np.fft.rfft(parts * window, axis=1) * 2 / window.sum()
    order = cast("Array", np.arange(lines.shape[1]) / revolutions)
    lines = lines * np.exp(-2j * np.pi * order * even[starts][:, None])  # relative to the phase, not the window's start
    kept = order <= min(highest, a_turn / 2.5)
    ends = np.minimum(starts + length, len(at) - 1)
    speed = 2 * np.pi * (even[ends] - even[starts]) / (at[ends] - at[starts])
    return OrderMap(at[starts + length // 2], speed, order[kept], lines[:, kept])


def resampled_order_track(
    time_s: ArrayLike,
    displacement_m: ArrayLike,
    phase_rad: ArrayLike,
    orders: Sequence[int] = (1,),
    *,
    revolutions: int = 4,
) -> OrderTrack:
    """Return order vectors by angular resampling; their deviations follow from the lines between the orders.

    Arguments and errors as for `order_map`.
    """
    found = order_map(time_s, displacement_m, phase_rad, revolutions=revolutions, highest=max(orders) + 1)
    at = [round(k * revolutions) for k in orders]
    between = [round((k + side) * revolutions) for k in orders for side in (-0.5, 0.5)]
    rest = np.abs(found.vectors_m[:, between]).reshape(len(found.time_s), len(orders), 2)
    std = np.sqrt(np.mean(rest**2, axis=2) / 2)
    rows = len(found.time_s)
    return OrderTrack(
        found.time_s,
        tuple(orders),
        found.vectors_m[:, at],
        std,
        np.zeros(rows),
        np.sqrt(np.mean(std**2, axis=1)),
        np.full(rows, len(np.asarray(time_s)) // max(rows, 1)),
        found.speed_rad_s,
        np.full(len(orders), 0.5 * rows + 0.5),
    )


def _by_angle(time_s: ArrayLike, values: ArrayLike, phase_rad: ArrayLike) -> tuple[Array, Array, Array]:
    """Return times, values and turns of the rotor with rising turns."""
    time = checked_times(time_s, ValueError)
    signal, psi = (np.asarray(a, np.float64) for a in (values, phase_rad))
    if not time.shape == signal.shape == psi.shape or time.ndim != 1:
        raise ValueError(f"time, displacement and phase must be alike, got {time.shape}, {signal.shape}, {psi.shape}")
    good = np.isfinite(signal) & np.isfinite(psi) & np.isfinite(time)
    time, signal, turned = time[good], signal[good], psi[good] / (2 * np.pi)
    highest = np.maximum.accumulate(turned) if len(turned) else turned
    rising = np.diff(highest, prepend=-np.inf) > 1e-9
    if rising.sum() < 16:
        raise ValueError(f"order map: expected a rising phase, got {number_of(int(rising.sum()), 'sample')} with one")
    return time[rising], signal[rising], turned[rising]
