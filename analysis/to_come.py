"""Remaining approach at the end of a point's run: estimates of the limits of angles and orbit.

The means of the last seconds lag behind the limit of a slow approach. The window means since the release are
extrapolated to their limit (daq.signals.limit), angles and order-1 orbit together, because they approach at the same
rates. If no approach explains the means, the mean of the last seconds is used. Its standard uncertainty is then the
bound of the settling check on its distance from the end, over √3.
Source: docs/theory/detection_of_steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.signals.clock_rates import rate_std_between
from daq.signals.decay import MIN_WINDOWS
from daq.signals.limit import ApproachLimit, limit
from daq.signals.rounding import rounding_covariance
from daq.signals.run import Run
from daq.signals.window_means import WindowMeans, angle_means, orbit_means, whole_revolutions
from rig_basics.arrays import Array

UNEXPLAINED = "unexplained"
_WINDOW_S = 1.0
_MAX_WINDOWS = 30
_MIN_NOISE_RAD, _MIN_NOISE_M = 1e-9, 1e-12  # least noise of a mean: constant signals have no noise
_MAX_CHANGE = 0.1  # change of an orbit over its radius up to which radius and arc describe it
_SECOND_ORDER = 2.0  # second-order over first-order terms per radian of remaining angle; 1.1 and 1.3 at C of two rigs
_NAMES = ("θ3", "θ4", "x", "y")


@dataclass(frozen=True)
class ToCome:
    """Extrapolation of the means of the last seconds. Order: θ3, θ4 (rad), Re x, Im x, Re y, Im y (m).

    Attributes:
        shift: estimated limit minus mean over the last seconds, shape (6,); 0 if unexplained.
        covariance: covariance of the limits, shape (6, 6): noise, rounding and remaining approach, no calibration.
        to_come: limit minus the motion at the run's end, shape (6,).
        model: "none", "one rate", "two rates", "oscillation" or "unexplained".
        rate_per_s: rate of the approach, 1/s; NaN without an approach.
        windows: number of windows of about one second behind the estimate.
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
        """The extrapolation in words if it clearly exceeds its own uncertainty; else empty."""
        if self.model == UNEXPLAINED:
            return ""
        std = self.std
        angles = [
            f"{name} by {_stated(math.degrees(move), math.degrees(s))}°"
            for name, move, s in zip(_NAMES, self.shift[:2], std[:2], strict=False)
            if abs(move) > 2 * s
        ]
        orbit = [
            f"{name} by {_stated(1e6 * move, 1e6 * s)} µm"
            for name, move, s in zip(_NAMES[2:], np.hypot(self.shift[2::2], self.shift[3::2]), std[2::2], strict=True)
            if move > 3 * s
        ]
        return f"extrapolated to where it ends: {', '.join(angles + orbit)}" if angles or orbit else ""

    def to_json(self) -> dict[str, object]:
        """Return plain values with units in the names; unknown values are None."""
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
    """Format a number with its uncertainty, both to the uncertainty's first digit."""
    digits = max(0, -math.floor(math.log10(max(std, 1e-9))))
    return f"{value:.{digits}f} ± {std:.{digits}f}".replace("-", "−")


def to_come(run: Run, release_s: float, end_s: float, means: Array, stds: Array) -> ToCome:
    """Extrapolate the motion of a point to its limit.

    Args:
        run: run of the point.
        release_s, end_s: last release and end of the plateau, s since the run's start.
        means, stds: means of the last seconds, shape (6,), with the standard uncertainties that hold if no approach
            explains the means: statistics, rounding and the bound on the remaining approach.
    """
    found = _limit(run, release_s, end_s, means)
    if found is None:
        return ToCome(np.zeros(6), np.diag(stds**2), np.zeros(6), UNEXPLAINED, math.nan, 0)
    shift = found.values - means
    shift[:2] = (shift[:2] + math.pi) % (2 * math.pi) - math.pi
    return ToCome(shift, found.covariance, found.to_come, found.model, found.rate_per_s, found.windows)


def _limit(run: Run, release_s: float, end_s: float, means: Array) -> ApproachLimit | None:
    """Fit the windows since the release and return their limit; None with too few windows or no fit."""
    marks = (run.mark_time_s >= release_s) & (run.mark_time_s <= end_s)
    time, phase = run.mark_time_s[marks], run.mark_phase_rad[marks]
    edges = whole_revolutions(time, phase, _WINDOW_S, _MAX_WINDOWS)
    if len(edges) <= MIN_WINDOWS:
        return None
    angles = angle_means(run.angle_time_s, run.angle_rad, time, phase, edges, run.angle_step_rad, MIN_WINDOWS)
    orbit = orbit_means(run.x_time_s, run.x_m, run.y_time_s, run.y_m, time, phase, edges, MIN_WINDOWS)
    if angles is None or orbit is None:
        return None
    _, a, o = np.intersect1d(angles.edges_s[:, 0], orbit.edges_s[:, 0], return_indices=True)
    if len(a) < MIN_WINDOWS:
        return None
    seen = np.concatenate([angles.means[a], orbit.means[o]], axis=1)
    noise = np.concatenate([_angle_noise(angles, angles.means[a]), orbit.noise_covariance(_MIN_NOISE_M)[:, o][:, :, o]])
    middle = angles.edges_s[a].mean(axis=1)
    turns = (middle - middle[-1]) * float(phase[-1] - phase[0]) / float(time[-1] - time[0])
    back, held = np.eye(6), np.ones(6)
    for signal, at in (("x", slice(2, 4)), ("y", slice(4, 6))):
        local = _radius_and_arc(seen[:, at], noise[at], means[at], turns * rate_std_between(run, signal, "phase"))
        if local is not None:
            seen[:, at], noise[at], back[at, at] = local
            held[at.stop - 1] = 0.0  # the limit along the arc depends on the clocks; the mean is used
    found = limit(angles.edges_s[a], seen, noise, lambda means: _bends(means, held))
    if found is None:
        return None
    return replace(
        found,
        values=back @ (held * found.values),
        covariance=back @ found.covariance @ back.T,
        to_come=back @ (held * found.to_come),
    )


def _radius_and_arc(vectors: Array, noise: Array, mean: Array, turn_std: Array) -> tuple[Array, Array, Array] | None:
    """Return a sensor's order-1 vectors as radius and arc from the mean's direction, m; None if they still change.

    Args:
        vectors: vector of each window, shape (n, 2).
        noise: covariance of both columns, shape (2, n, n).
        mean: mean of the last seconds, shape (2,).
        turn_std: standard deviation of each window's rotation by the clocks, rad, shape (n,).
    Returns:
        Radii and arcs (n, 2); their noise, that of the arcs with the clocks' (2, n, n); the matrix from both back to
        the vectors' axes (2, 2).
    """
    radius = math.hypot(*mean)
    if not np.max(np.hypot(*(vectors[-MIN_WINDOWS:] - mean).T)) < _MAX_CHANGE * radius:
        return None
    c, s = mean / radius
    back = np.array([[c, -s], [s, c]])
    along, across = (vectors @ back).T
    arcs = radius * np.unwrap(np.arctan2(across, along)[::-1])[::-1]
    own = np.tensordot(back.T**2, noise, 1)
    own[1] += radius**2 * np.outer(turn_std, turn_std)
    return np.column_stack([np.hypot(along, across), arcs]), own, back


def _bends(seen: Array, held: Array) -> Array:
    """Return the prior deviation of the second-order change over the windows, shape (6,), unit of the means.

    Angles enter force and moment through sine and cosine. A second-order change is the first-order change times the
    remaining angle, rad, times a number of order one. Columns as in ToCome. Arcs (held = 0) rotate with the clocks and
    are left out.
    """
    change = held * np.ptp(seen, axis=0)
    left = float(change[:2].max())
    return _SECOND_ORDER * left * np.r_[np.full(2, left), np.full(4, change[2:].max())]


def _angle_noise(seen: WindowMeans, means: Array) -> Array:
    """Return the covariance of each angle's errors over the windows, shape (2, n, n)."""
    white = np.eye(len(means))
    return np.stack(
        [
            max(noise, _MIN_NOISE_RAD) ** 2 * white + rounding_covariance(terms, seen.step, column)
            for noise, terms, column in zip(seen.noise, seen.rounding, means.T, strict=True)
        ]
    )
