"""Slip of the pendulums: difference between their mean speed and the rotor's, as an order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.times import checked_times


@dataclass(frozen=True)
class SlipTrack(Tabular):
    """Motion of the pendulums relative to the rotor, in rows of whole turns.

    Attributes:
        time_s, speed_rad_s: middle of each row and speed of the rotor, shapes (n,).
        angle_rad: mean angle in the rotor's frame, unwrapped, shape (n, pendulums).
        slip_order: (pendulum's speed − rotor's) / rotor's: 0 if it turns with the rotor, −1 if it is at rest in space.
        std: standard deviation of the slip order from the scatter of the row's readings, shape (n, pendulums).
    """

    time_s: Array
    speed_rad_s: Array
    angle_rad: Array
    slip_order: Array
    std: Array

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each time; the pendulums are numbered from 3, as θ3 and θ4."""
        found: dict[str, Column] = {"time_s": self.time_s, "speed_rad_s": self.speed_rad_s}
        for j, columns in enumerate(zip(self.angle_rad.T, self.slip_order.T, self.std.T, strict=True), 3):
            found |= dict(zip((f"theta{j}_rad", f"slip{j}_order", f"slip{j}_std"), columns, strict=True))
        return found


def slip_track(time_s: ArrayLike, angle_rad: ArrayLike, phase_rad: ArrayLike, *, revolutions: int = 4) -> SlipTrack:
    """Return the slip order of each pendulum in rows of whole turns: slope of its angle over the rotor's phase.

    The angle may oscillate once and twice per revolution. These orders are fitted together with the slope.

    Args:
        time_s: times of the readings, shape (n,), s.
        angle_rad: θ in the rotor's frame, unwrapped, shape (n, pendulums) or (n,), rad.
        phase_rad: ψ at the readings, unwrapped, shape (n,), rad; NaN if unknown.
        revolutions: length of a row.
    Raises:
        ValueError: shapes differ, times are dates or run backwards, or no row is complete.

    Example:
        >>> import numpy as np
        >>> from analysis import slip_track
        >>> time = np.arange(0.0, 2.0, 1e-3)
        >>> phase = 40.0 * time
        >>> slip_track(time, -0.1 * phase, phase).slip_order[:, 0].round(6)
        array([-0.1, -0.1, -0.1])
    """
    time, psi = checked_times(time_s, ValueError), np.asarray(phase_rad, np.float64)
    angle = np.asarray(angle_rad, np.float64)
    angle = angle[:, None] if angle.ndim == 1 else angle
    if not len(time) == len(angle) == len(psi):
        raise ValueError(
            f"slip: expected as many times as angles and phases, got {len(time)}, {len(angle)}, {len(psi)}"
        )
    good = np.isfinite(psi) & np.isfinite(time)
    time, psi, angle = time[good], psi[good], angle[good]
    way = np.abs(psi - psi[0]) if len(psi) else psi
    count = int(way[-1] / (2 * np.pi * revolutions)) if len(way) else 0
    if count < 1:
        raise ValueError(
            f"slip: expected {number_of(revolutions, 'whole turn')}, got {way[-1] / 2 / np.pi if len(way) else 0:.3g}"
        )
    edges = np.searchsorted(way, 2 * np.pi * revolutions * np.arange(count + 1))
    parts = [slice(int(a), int(b)) for a, b in pairwise(edges) if b - a >= _MIN_READINGS]
    if not parts:
        raise ValueError(
            f"slip: expected {_MIN_READINGS} readings in {number_of(revolutions, 'turn')}, got fewer in every row"
        )
    rows = [_row(psi[part], angle[part]) for part in parts]
    middle = np.array([time[part].mean() for part in parts])
    speed = np.array([(psi[p][-1] - psi[p][0]) / (time[p][-1] - time[p][0]) for p in parts])
    means, slopes, stds = (np.array(column) for column in zip(*rows, strict=True))
    return SlipTrack(middle, speed, means, slopes, stds)


_MIN_READINGS = 16


def _row(psi: Array, angle: Array) -> tuple[Array, Array, Array]:
    """Return mean angles, slopes over the phase and their deviations, shapes (pendulums,)."""
    middle = float(psi.mean())
    columns = [np.ones_like(psi), psi - middle] + [f(k * psi) for k in (1, 2) for f in (np.cos, np.sin)]
    basis = np.stack(columns, axis=1)
    means, slopes, stds = (np.full(angle.shape[1], np.nan) for _ in range(3))
    for j, values in enumerate(angle.T):
        there = np.isfinite(values)
        if there.sum() < _MIN_READINGS:
            continue
        normal = np.linalg.pinv(basis[there].T @ basis[there])
        fit = normal @ (basis[there].T @ values[there])
        rest = values[there] - basis[there] @ fit
        variance = float(rest @ rest) / max(int(there.sum()) - len(fit), 1)
        means[j], slopes[j], stds[j] = fit[0], fit[1], np.sqrt(variance * normal[1, 1])
    return means, slopes, stds
