"""Slow roll: sensor signals at a speed without vibration, and order vectors without them."""

from __future__ import annotations

import dataclasses

import numpy as np

from analysis.quantities.order_tracking import OrderTrack
from rig_basics.units import TO_RPM


def slow_roll_vector(track: OrderTrack, order: int = 1, *, below_rad_s: float | None = None) -> tuple[complex, float]:
    """Return the weighted mean vector of the slow rows and its standard deviation (of either part), m.

    Args:
        track: order vectors over the speed.
        order: order of the vector.
        below_rad_s: highest speed of the rows used; by default the lowest decile of the speeds.
    Raises:
        ValueError: no row is slow enough.
    """
    limit = float(np.quantile(track.speed_rad_s, 0.1)) if below_rad_s is None else below_rad_s
    slow = track.speed_rad_s <= limit
    if not slow.any():
        least = float(track.speed_rad_s.min()) * TO_RPM if len(track.speed_rad_s) else float("nan")
        raise ValueError(f"slow roll: expected rows below {limit * TO_RPM:.4g} rpm, the slowest has {least:.4g} rpm")
    vectors, std = track.of(order)
    vectors, weights = vectors[slow], 1 / np.maximum(std[slow], 1e-300) ** 2
    mean = complex(np.sum(weights * vectors) / weights.sum())
    scatter = float(np.sqrt(np.sum(weights * np.abs(vectors - mean) ** 2) / (2 * weights.sum())))
    independent = max(1.0, slow.mean() * float(track.independent[track.orders.index(order)]))
    return mean, float(np.hypot(scatter, np.sqrt(1 / weights.mean())) / np.sqrt(independent))


def without_slow_roll(track: OrderTrack, vector_m: complex, std_m: float = 0.0, order: int = 1) -> OrderTrack:
    """Return the track minus a constant vector of one order, with both uncertainties."""
    j = track.orders.index(order)
    amplitude, std = track.amplitude_m.copy(), track.std_m.copy()
    amplitude[:, j] -= vector_m
    std[:, j] = np.hypot(std[:, j], std_m)
    return dataclasses.replace(track, amplitude_m=amplitude, std_m=std)
