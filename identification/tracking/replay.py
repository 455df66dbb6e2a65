"""A recorded run through the tracker, as it would have looked live; on request once more, backwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification.errors import NotIdentifiable
from identification.tracking.reference import FilterpyFilter
from identification.tracking.tracker import STATE_NAMES, Sensors, Tracked, Tracker
from identification.tracking.unscented import LN_C3, filter_readings

TrackingSetting = Literal["fast", "reference"]
"""fast: the compiled filter; reference: filterpy's filter around the same motion, and its smoother."""
_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_TIMES = 1.96  # standard deviations of a 95 % interval
_FILTERING = 0.5  # share of the reference's work; the rest is smoothing


@dataclass(frozen=True)
class SmoothedRun:
    """The same instants with all readings of the run, later ones too.

    Attributes:
        values, std, low, high: c3, c4, their standard deviations and 95 % intervals, shape (n, 2).
        states, state_std: in STATE_NAMES' order, shape (n, 8).
        stretches: parts of the run that no new start of the filter interrupts; each is smoothed by itself.
        kept: share of the steps at which the filter's own estimate stands.
    """

    values: np.ndarray
    std: np.ndarray
    low: np.ndarray
    high: np.ndarray
    states: np.ndarray
    state_std: np.ndarray
    stretches: int
    kept: float


@dataclass(frozen=True)
class TrackedRun:
    """What the tracker said over a run, one row per batch of readings.

    Attributes:
        time_s: since the run's start, shape (n,).
        values, std, low, high: c3, c4, their standard deviations and 95 % intervals, shape (n, 2).
        states, state_std: in STATE_NAMES' order, shape (n, 8).
        phase_rad, speed_rad_s: the rotor's ψ and its rate from the marks, shape (n,); zeros without marks.
        trusted: shape (n,).
        last: the estimate at the end.
        smoothed: by the reference setting; None with the fast one.
    """

    time_s: np.ndarray
    values: np.ndarray
    std: np.ndarray
    low: np.ndarray
    high: np.ndarray
    states: np.ndarray
    state_std: np.ndarray
    phase_rad: np.ndarray
    speed_rad_s: np.ndarray
    trusted: np.ndarray
    last: Tracked
    smoothed: SmoothedRun | None = None


def track(
    run: Run,
    physics: RotorParameters,
    *,
    damping_std: float = 1.0,
    imbalance_std: float = 0.05,
    batch_s: float = 0.05,
    lasers: bool = False,
    run_out_m: tuple[complex, complex] = (0j, 0j),
    setting: TrackingSetting = "fast",
    tell: Callable[[float], None] | None = None,
) -> TrackedRun:
    """Follow a recorded run with the online tracker.

    Args:
        run: angles are needed, marks are used where there are any.
        physics: the rig with its bow; its c3, c4 are the start values.
        damping_std: standard deviation of ln c3, ln c4 at the start.
        imbalance_std: relative standard deviation of S_P.
        batch_s: readings handed over at once.
        lasers: use them too. Only for signals without offset, along the stiffness axes and on the encoders' clock to
            a fraction of a millisecond: a delay of two turns the disk's orbit by six degrees, and damping with it.
        run_out_m: of the surfaces that the lasers read, as Tracker takes it.
        setting: "reference" gives the same rows by filterpy, and smoothed ones beside them.
        tell: told the share done, 0 … 1.
    Raises:
        NotIdentifiable: no angles of both pendulums.
        FitFailed: the reference's covariance broke down, or the run has too many steps for it.
        ValueError: another setting.
    """
    if setting not in get_args(TrackingSetting):
        raise ValueError(f"setting: expected {', '.join(get_args(TrackingSetting))}, got {setting!r}")
    if run.angle_rad.ndim != 2 or not np.isfinite(run.angle_rad).any(axis=0).all() or run.angle_rad.size == 0:
        raise NotIdentifiable(f"{run.source}: angles of both pendulums are needed to track their damping")
    reference = FilterpyFilter(run.source) if setting == "reference" else None
    # a pendulum that is let go during the run is locked before; in a spin-down both are free all along
    let_go = {r.pendulum for r in run.releases}
    tracker = Tracker(
        physics,
        Sensors(encoder_step_rad=run.angle_step_rad),
        damping_std,
        (0 not in let_go, 1 not in let_go),
        imbalance_std=imbalance_std,
        run_out_m=run_out_m,
        filtering=reference or filter_readings,
    )
    begin, end = float(run.angle_time_s[0]), float(run.angle_time_s[-1])
    for release in run.releases:
        tracker.release(release.pendulum, int(_ns(release.time_s)))
    rows: list[Tracked] = []
    phases: list[tuple[float, float]] = []
    steps: list[int] = []
    share = _FILTERING if reference else 1.0
    for start in np.arange(begin, end, batch_s):
        _hand_over(tracker, run, (float(start), float(start + batch_s)), lasers)
        now = tracker.estimate()
        if now.time_ns is None or (rows and now.time_ns == rows[-1].time_ns):
            continue  # nothing was read
        rows.append(now)
        phases.append(tracker.phase_at(now.time_ns))
        steps.append(reference.steps - 1 if reference else 0)
        if tell is not None:
            tell(share * (start - begin) / (end - begin))
    if not rows:
        raise NotIdentifiable(f"{run.source}: {end - begin:.2g} s are too short to track")
    forward = _rows(rows, phases)
    if reference is None:
        return forward
    return _smoothed(forward, reference, np.array(steps), tell)


def _rows(rows: list[Tracked], phases: list[tuple[float, float]]) -> TrackedRun:
    phase = np.array(phases)
    return TrackedRun(
        np.array([(r.time_ns or 0) * 1e-9 for r in rows]),
        np.array([[r.values[n] for n in _NAMES] for r in rows]),
        np.array([[r.std[n] for n in _NAMES] for r in rows]),
        np.array([[r.intervals[n][0] for n in _NAMES] for r in rows]),
        np.array([[r.intervals[n][1] for n in _NAMES] for r in rows]),
        np.array([[r.states[n] for n in STATE_NAMES] for r in rows]),
        np.array([[r.state_std[n] for n in STATE_NAMES] for r in rows]),
        phase[:, 0],
        phase[:, 1],
        np.array([r.trusted for r in rows]),
        rows[-1],
    )


def _smoothed(
    forward: TrackedRun, reference: FilterpyFilter, steps: np.ndarray, tell: Callable[[float], None] | None
) -> TrackedRun:
    """The rows with the smoother's beside them.

    Its standard deviations are stretched as the filter's are at the same instant: caution and excess are the same.
    """
    found = reference.smoothed(None if tell is None else lambda share: tell(_FILTERING + (1 - _FILTERING) * share))
    own = np.diagonal(found.cov, axis1=1, axis2=2)[steps]
    shrunk = np.sqrt(own / reference.variances(steps))
    values = np.exp(found.mean[steps, LN_C3:])
    relative = forward.std / forward.values * shrunk[:, LN_C3:]
    reach = np.exp(np.minimum(_TIMES * relative, 50.0))
    states_std = forward.state_std * shrunk[:, :LN_C3]
    smoothed = SmoothedRun(
        values,
        values * relative,
        values / reach,
        values * reach,
        found.mean[steps, :LN_C3],
        states_std,
        found.stretches,
        found.kept / reference.steps,
    )
    return replace(forward, smoothed=smoothed)


def _hand_over(tracker: Tracker, run: Run, span_s: tuple[float, float], lasers: bool) -> None:
    def part(time: np.ndarray) -> slice:
        first, last = np.searchsorted(time, span_s)
        return slice(int(first), int(last))

    m, x, y, a = part(run.mark_time_s), part(run.x_time_s), part(run.y_time_s), part(run.angle_time_s)
    if m.stop > m.start:
        tracker.feed_marks(_ns(run.mark_time_s[m]), run.mark_phase_rad[m])
    if lasers:
        tracker.feed_lasers(_ns(run.x_time_s[x]), run.x_m[x], _ns(run.y_time_s[y]), run.y_m[y])
    if a.stop > a.start:
        tracker.feed_encoders(_ns(run.angle_time_s[a]), run.angle_rad[a])


def _ns(time_s: np.ndarray | float) -> np.ndarray:
    return np.round(np.asarray(time_s) * 1e9).astype(np.int64)
