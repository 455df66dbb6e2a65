# pyright: strict
"""What a point's run was still to change by at its end: the limits of angles and orbit, as estimates.

The means of the last seconds lag behind where a slow approach ends. The window means since the release are continued
to their limit (daq.signals.limit), angles and order-1 orbit together, for they approach with the same rates. Where no
approach explains them, the mean of the last seconds stands, with settling's bound on its distance from the end, over
√3, as its standard uncertainty.
Source: docs/theory/steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.signals.limit import LEAST_WINDOWS, Limit, limit
from daq.signals.rounding import rounding_covariance
from daq.signals.run import Run
from daq.signals.window_means import WindowMeans, angle_means, orbit_means, whole_revolutions

Array = NDArray[np.float64]

UNEXPLAINED = "unexplained"
_WINDOW_S = 1.0
_MOST_WINDOWS = 30
_LEAST_RAD, _LEAST_M = 1e-9, 1e-12  # a mean's noise is not taken smaller: signals that do not change at all have none
_NAMES = ("θ3", "θ4", "x", "y")


@dataclass(frozen=True)
class ToCome:
    """What was added to the means of the last seconds. Order: θ3, θ4 (rad), Re x, Im x, Re y, Im y (m).

    Attributes:
        shift: estimated limit minus mean over the last seconds, shape (6,); 0 where unexplained.
        covariance: of the limits, shape (6, 6): noise, rounding and what is to come; no calibration.
        to_come: limit minus the motion at the run's end, shape (6,).
        model: "none", "one rate", "two rates", "oscillation" or "unexplained".
        rate_per_s: of the approach, 1/s; nan where nothing moves.
        windows: how many windows of about a second it rests on.
    """

    shift: Array
    covariance: Array
    to_come: Array
    model: str
    rate_per_s: float
    windows: int

    @property
    def std(self) -> Array:
        """Standard deviations of the limits, shape (6,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sentence(self) -> str:
        """What was extrapolated, where that is clearly more than its own uncertainty; else empty."""
        if self.model == UNEXPLAINED:
            return ""
        std = self.std
        angles = [
            f"{name} moved on by {_stated(math.degrees(move), math.degrees(s))}°"
            for name, move, s in zip(_NAMES, self.shift[:2], std[:2], strict=False)
            if abs(move) > 2 * s
        ]
        orbit = [
            f"{name} moved on by {_stated(1e6 * move, 1e6 * s)} µm"
            for name, move, s in zip(_NAMES[2:], np.hypot(self.shift[2::2], self.shift[3::2]), std[2::2], strict=True)
            if move > 3 * s
        ]
        return f"{', '.join(angles + orbit)} in the limit" if angles or orbit else ""

    def to_json(self) -> dict[str, object]:
        """Plain values, units in the names; what is not known is None."""
        shift, std = self.shift, self.std
        own: dict[str, object] = {"model": self.model, "windows": self.windows}
        own["rate_per_s"] = self.rate_per_s if math.isfinite(self.rate_per_s) else None
        for j, name in enumerate(("theta3", "theta4")):
            own[f"{name}_shift_deg"], own[f"{name}_std_deg"] = math.degrees(shift[j]), math.degrees(std[j])
        for j, name in ((2, "x"), (4, "y")):
            own[f"{name}_shift_um"] = 1e6 * float(np.hypot(*shift[j : j + 2]))
            own[f"{name}_std_um"] = 1e6 * float(np.hypot(*std[j : j + 2])) / math.sqrt(2)
        return own


def _stated(value: float, std: float) -> str:
    """A number with its uncertainty, both to the uncertainty's first digit."""
    digits = max(0, -math.floor(math.log10(max(std, 1e-9))))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def to_come(run: Run, release_s: float, end_s: float, means: Array, stds: Array) -> ToCome:
    """Where a point's motion ends.

    Args:
        release_s, end_s: last release and end of the plateau, s since the run's start.
        means, stds: of the last seconds, shape (6,), with the standard uncertainties that hold where no approach
            explains the means: statistics, rounding and the bound on what is to come.
    """
    found = _limit(run, release_s, end_s)
    if found is None:
        return ToCome(np.zeros(6), np.diag(stds**2), np.zeros(6), UNEXPLAINED, math.nan, 0)
    shift = found.values - means
    shift[:2] = (shift[:2] + math.pi) % (2 * math.pi) - math.pi
    return ToCome(shift, found.covariance, found.to_come, found.model, found.rate_per_s, found.windows)


def _limit(run: Run, release_s: float, end_s: float) -> Limit | None:
    """The windows since the release, and where they lead."""
    marks = (run.mark_time_s >= release_s) & (run.mark_time_s <= end_s)
    time, phase = run.mark_time_s[marks], run.mark_phase_rad[marks]
    edges = whole_revolutions(time, phase, _WINDOW_S, _MOST_WINDOWS)
    if len(edges) <= LEAST_WINDOWS:
        return None
    angles = angle_means(
        run.angle_time_s, run.angle_rad, time, phase, edges, run.angle_step_rad, LEAST_WINDOWS
    )  # fmt: skip
    orbit = orbit_means(run.x_time_s, run.x_m, run.y_time_s, run.y_m, time, phase, edges, LEAST_WINDOWS)
    if angles is None or orbit is None:
        return None
    _, a, o = np.intersect1d(angles.edges_s[:, 0], orbit.edges_s[:, 0], return_indices=True)
    if len(a) < LEAST_WINDOWS:
        return None
    turning, whirling = angles.means[a], orbit.means[o]
    of_orbit = orbit.noise_covariance(_LEAST_M)[:, o][:, :, o]
    noise = np.concatenate([_angle_noise(angles, turning), of_orbit])
    return limit(angles.edges_s[a], np.concatenate([turning, whirling], axis=1), noise)


def _angle_noise(seen: WindowMeans, means: Array) -> Array:
    """Covariance of each angle's errors over the windows, shape (2, n, n)."""
    white = np.eye(len(means))
    return np.stack(
        [
            max(noise, _LEAST_RAD) ** 2 * white + rounding_covariance(terms, seen.step, column)
            for noise, terms, column in zip(seen.noise, seen.rounding, means.T, strict=True)
        ]
    )
