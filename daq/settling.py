"""Has the rig settled? Asked online by the guided test and afterwards by the analysis.

Judged on means over whole revolutions in consecutive windows, so that the wobble of a periodic orbit does not
matter. Two questions are asked of the last windows: how much do their means still change, and do the changes
shrink? An exponential approach loses the share 1 − r of what is left per window, so after a change Δ there is
Δ r/(1 − r) still to come. Changes that do not shrink mean an approach without end: a creeping pendulum, or one that
leaves an unstable balance, where the drift is tiny for many seconds and grows. Neither is settled, however small
the drift is; the orbit's amplitude alone would not show it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

_NOT_SHRINKING = 0.97  # changes that keep this share per window are taken as not shrinking
_SAME_GAP = math.radians(5.0)  # pendulums this close to their gap at release may still stand on a saddle
_QUANTISATION_BIAS = 0.05  # of an encoder step: what averaging a dithered code leaves
_LEAST_SHARE = 0.4  # of a window's samples that must have come


@dataclass(frozen=True)
class Settling:
    """The answer, with what it rests on.

    Attributes:
        settled: nothing still to come that matters.
        slipping: a pendulum turns steadily relative to the rotor.
        why: one sentence.
        drift_rad: change of the mean angles from window to window, the larger pendulum's, rad (nan: no angles).
        remaining_rad: estimated change of the angles still to come, rad; inf when changes do not shrink.
        drift_m, remaining_m: the same for the order-1 amplitudes of x and y, m.
        span_s: how far back the windows reach, s.
    """

    settled: bool
    slipping: bool
    why: str
    drift_rad: float
    remaining_rad: float
    drift_m: float
    remaining_m: float
    span_s: float


def settled(
    time_s: np.ndarray,
    angles_rad: np.ndarray,
    mark_time_s: np.ndarray,
    mark_phase_rad: np.ndarray,
    x_time_s: np.ndarray,
    x_m: np.ndarray,
    y_time_s: np.ndarray,
    y_m: np.ndarray,
    *,
    angle_tolerance_rad: float = math.radians(0.1),
    amplitude_tolerance_m: float = 3e-6,
    window_s: float = 1.0,
    windows: int = 9,
    release_time_s: float | None = None,
    linger_s: float = 30.0,
) -> Settling:
    """Whether released pendulums and the orbit have reached their steady state at the end of the signals.

    Args:
        time_s, angles_rad: encoder samples, shapes (k,), (k, 2), rad, unwrapped.
        mark_time_s, mark_phase_rad: tachometer marks and ψ there (rad, unwrapped), shape (n,).
        x_time_s, x_m, y_time_s, y_m: lasers, each with its own times; NaN where invalid.
        angle_tolerance_rad, amplitude_tolerance_m: how much may still be to come.
        window_s, windows: least length of a window (rounded up to whole revolutions) and how many.
        release_time_s: when the pendulums were let go; None when not known.
        linger_s: a pendulum pair that still has the gap it was released with is not called settled earlier than
            this after release: from an unstable balance it leaves exponentially, unseen at first.
    Returns:
        Settling; `settled` is False, with the reason, when the signals are too short or too sparse.
    Source: docs/theory/steady_states.md.
    """
    edges = _windows(mark_time_s, mark_phase_rad, window_s, windows)
    if edges is None or (release_time_s is not None and edges[0] < release_time_s):
        return _unknown(f"fewer than {windows} windows of {window_s:g} s since release")
    angles, angle_noise = _angle_means(time_s, angles_rad, mark_time_s, mark_phase_rad, edges)
    orbit, orbit_noise = _amplitudes(mark_time_s, mark_phase_rad, x_time_s, x_m, y_time_s, y_m, edges)
    if angles is None or orbit is None:
        missing = "pendulum angles" if angles is None else "displacements"
        return _unknown(f"too many samples of the {missing} are missing")
    slip = _slipping(angles)
    drift, remaining = _to_come(angles, angle_noise, angle_tolerance_rad / 30)
    drift_m, remaining_m = _to_come(orbit, orbit_noise, amplitude_tolerance_m / 30)
    held = release_time_s is not None and _still_as_released(
        time_s, angles_rad, angles[-1], edges[-1], release_time_s, linger_s
    )
    why = (
        _speed_change(mark_time_s, mark_phase_rad, edges)
        or slip
        or ("pendulums still stand as released; they may be on an unstable balance" if held else "")
        or _reason("pendulum angles", np.degrees(drift), np.degrees(remaining), np.degrees(angle_tolerance_rad), "°")
        or _reason("amplitudes", drift_m * 1e6, remaining_m * 1e6, amplitude_tolerance_m * 1e6, " µm")
    )
    return Settling(
        not why, bool(slip), why or "angles and amplitudes are steady", drift, remaining, drift_m, remaining_m,
        float(edges[-1] - edges[0]),
    )  # fmt: skip


def locked_settled(
    mark_time_s: np.ndarray,
    mark_phase_rad: np.ndarray,
    x_time_s: np.ndarray,
    x_m: np.ndarray,
    y_time_s: np.ndarray,
    y_m: np.ndarray,
    *,
    amplitude_tolerance_m: float = 5e-6,
    window_s: float = 1.0,
    windows: int = 9,
) -> Settling:
    """Whether the locked orbit is steady, before the pendulums are released; arguments as in `settled`."""
    edges = _windows(mark_time_s, mark_phase_rad, window_s, windows)
    if edges is None:
        return _unknown(f"fewer than {windows} windows of {window_s:g} s at speed")
    orbit, noise = _amplitudes(mark_time_s, mark_phase_rad, x_time_s, x_m, y_time_s, y_m, edges)
    if orbit is None:
        return _unknown("too many samples of the displacements are missing")
    drift, remaining = _to_come(orbit, noise, amplitude_tolerance_m / 30)
    why = _speed_change(mark_time_s, mark_phase_rad, edges) or _reason(
        "amplitudes", drift * 1e6, remaining * 1e6, amplitude_tolerance_m * 1e6, " µm"
    )
    span = float(edges[-1] - edges[0])
    return Settling(not why, False, why or "amplitudes are steady", math.nan, math.nan, drift, remaining, span)


def _unknown(why: str) -> Settling:
    return Settling(False, False, why, math.nan, math.inf, math.nan, math.inf, 0.0)


def _windows(mark_time_s: np.ndarray, mark_phase_rad: np.ndarray, window_s: float, count: int) -> np.ndarray | None:
    """Edges of `count` windows of whole revolutions that end with the last mark, shape (count + 1,)."""
    if len(mark_time_s) < 3:
        return None
    late = mark_time_s >= mark_time_s[-1] - window_s * 2
    if late.sum() < 2:
        return None
    speed = (mark_phase_rad[-1] - mark_phase_rad[late][0]) / (mark_time_s[-1] - mark_time_s[late][0])
    turns = max(1, math.ceil(window_s * speed / (2 * np.pi)))
    phases = mark_phase_rad[-1] - 2 * np.pi * turns * np.arange(count, -1, -1)
    return np.interp(phases, mark_phase_rad, mark_time_s) if phases[0] >= mark_phase_rad[0] else None


def _fit(phase: np.ndarray, values: np.ndarray, orders: int) -> np.ndarray | None:
    """Least squares of 1, cos kψ, sin kψ; shape (1 + 2 orders, …); None with too few samples."""
    if len(values) < 4 * (1 + 2 * orders):
        return None
    columns = [np.ones_like(phase)]
    for k in range(1, orders + 1):
        columns += [np.cos(k * phase), np.sin(k * phase)]
    return np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0]


def _cut(time: np.ndarray, values: np.ndarray, edges: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Finite samples in each window; an empty list when a window is too thin."""
    good = np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
    time, values = time[good], values[good]
    where = np.searchsorted(time, edges)
    counts = np.diff(where)
    steps = np.diff(time[where[0] : where[-1]])
    if counts.min() < 8 or counts.min() < _LEAST_SHARE * np.diff(edges).max() / np.median(steps):
        return []
    return [(time[a:b], values[a:b]) for a, b in pairwise(where)]


def _angle_means(
    time: np.ndarray, angles: np.ndarray, mark_time: np.ndarray, mark_phase: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray]:
    """Mean angles per window, shape (windows, 2), and the noise of one mean, shape (2,)."""
    means, noise = [], []
    for t, values in _cut(time, angles, edges):
        fit = _fit(np.interp(t, mark_time, mark_phase), values, 2)
        if fit is None:
            return None, np.zeros(2)
        means.append(fit[0])
        steps = np.diff(values, axis=0)
        code = np.min(np.abs(steps[steps != 0]), initial=np.inf)  # the encoder's step, when it shows
        bias = _QUANTISATION_BIAS * code if np.isfinite(code) else 0.0
        noise.append(np.hypot(steps.std(axis=0) / math.sqrt(2 * len(values)), bias))
    return (np.array(means), np.median(noise, axis=0)) if means else (None, np.zeros(2))


def _amplitudes(
    mark_time: np.ndarray, mark_phase: np.ndarray,
    x_time: np.ndarray, x: np.ndarray, y_time: np.ndarray, y: np.ndarray, edges: np.ndarray,
) -> tuple[np.ndarray | None, np.ndarray]:  # fmt: skip
    """Order-1 amplitudes of x and y per window, shape (windows, 2), and their noise, shape (2,)."""
    columns, noise = [], []
    for time, values in ((x_time, x), (y_time, y)):
        track, scatter = [], []
        for t, v in _cut(time, values, edges):
            fit = _fit(np.interp(t, mark_time, mark_phase), v, 2)
            if fit is None:
                return None, np.zeros(2)
            track.append(math.hypot(fit[1], fit[2]))
            scatter.append(np.diff(v, 2).std() / math.sqrt(6) * math.sqrt(2 / len(v)))
        if not track:
            return None, np.zeros(2)
        columns.append(track)
        noise.append(np.median(scatter))
    return np.array(columns).T, np.array(noise)


def _to_come(means: np.ndarray, noise: np.ndarray, unseen: float) -> tuple[float, float]:
    """Change per window now, and what is still to come (inf when the changes do not shrink).

    The changes of both columns are taken together; their mean squares over the first and the second half of the
    windows, freed of noise, give the share r that a change keeps per window. r is taken two standard deviations
    high. Changes from window to window that are lost in the noise, or below `unseen`, are judged on the means of
    the thirds instead.
    """
    changes = np.diff(means, axis=0)
    power = np.sum(changes**2, axis=1)
    noise_power = 2 * float(np.sum(np.maximum(noise, unseen) ** 2))
    half = len(power) // 2
    apart = len(power) - half
    early, late = float(power[:half].mean()), float(power[-half:].mean())
    drift = float(np.sqrt(np.mean(changes[-half:] ** 2, axis=0)).max())
    early_net, late_net = early - noise_power, late - noise_power
    if late < 4 * noise_power:  # no drift to be seen
        return drift, _slow_change(means, noise)
    if early_net <= 0:
        return drift, math.inf
    keep = (late_net / early_net) ** (0.5 / apart)
    spread = math.sqrt(noise_power / (2 * half) * (1 / late_net + 1 / early_net)) / apart
    keep *= math.exp(2 * spread)
    if keep >= _NOT_SHRINKING:
        return drift, math.inf
    last = drift / math.sqrt(np.mean(keep ** (-2.0 * np.arange(half))))  # of a geometric row with that rms
    return last, last * keep / (1 - keep)


def _slow_change(means: np.ndarray, noise: np.ndarray) -> float:
    """What is still to come of a drift too slow to be seen from window to window; inf when it does not shrink.

    Two consecutive differences between the means of the thirds. The noise is not divided by the number of windows:
    a code's quantisation bias stays the same in all of them.
    """
    first, middle, last = (part.mean(axis=0) for part in np.array_split(means, 3))
    before, now = np.linalg.norm(middle - first), np.linalg.norm(last - middle)
    sigma = float(np.linalg.norm(noise)) * math.sqrt(2)
    if now < 2.5 * sigma:
        return float(math.sqrt(max(now**2 - sigma**2, 0.0)))
    keep = (now + sigma) / max(before - sigma, 1e-3 * sigma)
    return float(now * keep / (1 - keep)) if keep < _NOT_SHRINKING ** (len(means) / 3) else math.inf


def _slipping(angles: np.ndarray) -> str:
    """A sentence when a pendulum turns steadily relative to the rotor, otherwise empty."""
    for name, column in zip("AB", angles.T, strict=True):
        steps = np.diff(column)
        half = len(steps) // 2
        steady = abs(steps[-half:].mean()) > 0.5 * abs(steps[:half].mean())
        if abs(column[-1] - column[0]) > np.pi and steady and (np.all(steps > 0) or np.all(steps < 0)):
            turns = (column[-1] - column[0]) / (2 * np.pi)
            return f"pendulum {name} slips: {turns:+.1f} turns relative to the rotor in the last windows"
    return ""


def _still_as_released(
    time: np.ndarray, angles: np.ndarray, now: np.ndarray, end: float, release: float, linger: float
) -> bool:
    before = (time > release - 0.5) & (time < release) & np.isfinite(angles).all(axis=1)
    if end - release > linger or not before.any():
        return False
    start = angles[before].mean(axis=0)
    change = (now[1] - now[0]) - (start[1] - start[0])
    return abs((change + np.pi) % (2 * np.pi) - np.pi) < _SAME_GAP


def _speed_change(mark_time: np.ndarray, mark_phase: np.ndarray, edges: np.ndarray) -> str:
    """A sentence when the speed changes by more than 0.1 % over the windows, otherwise empty."""
    speeds = np.diff(np.interp(edges, mark_time, mark_phase)) / np.diff(edges)
    change = (speeds[-2:].mean() - speeds[:2].mean()) / speeds.mean()
    return f"the speed still changes, by {100 * change:+.2f} % over the last windows" if abs(change) > 1e-3 else ""


def _reason(what: str, drift: float, remaining: float, tolerance: float, unit: str) -> str:
    if math.isinf(remaining):
        return f"{what} drift by {drift:.2g}{unit} per window and the drift does not shrink"
    if remaining > tolerance:
        return f"{what} still have about {remaining:.2g}{unit} to go, wanted below {tolerance:.2g}{unit}"
    return ""
