"""A recorded run through the tracker, as it would have looked live."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification.errors import NotIdentifiable
from identification.tracking.tracker import STATE_NAMES, Sensors, Tracked, Tracker

_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")


@dataclass(frozen=True)
class TrackedRun:
    """What the tracker said over a run, one row per batch of readings.

    Attributes:
        time_s: since the run's start, shape (n,).
        values, low, high: c3, c4 and their 95 % intervals, shape (n, 2).
        states, state_std: in STATE_NAMES' order, shape (n, 8).
        trusted: shape (n,).
        last: the estimate at the end.
    """

    time_s: np.ndarray
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    states: np.ndarray
    state_std: np.ndarray
    trusted: np.ndarray
    last: Tracked


def track(
    run: Run,
    physics: RotorParameters,
    *,
    damping_std: float = 1.0,
    imbalance_std: float = 0.05,
    batch_s: float = 0.05,
    lasers: bool = False,
) -> TrackedRun:
    """Follow a recorded run with the online tracker.

    Args:
        run: angles are needed, marks are used where there are any.
        physics: the rig; its c3, c4 are the start values.
        damping_std: standard deviation of ln c3, ln c4 at the start.
        imbalance_std: relative standard deviation of S_P.
        batch_s: readings handed over at once.
        lasers: use them too. Only for signals without offset, along the stiffness axes and on the encoders' clock to
            a fraction of a millisecond: a delay of two turns the disk's orbit by six degrees, and damping with it.
    Raises:
        NotIdentifiable: no angles of both pendulums.
    """
    if run.angle_rad.ndim != 2 or not np.isfinite(run.angle_rad).any(axis=0).all() or run.angle_rad.size == 0:
        raise NotIdentifiable(f"{run.source}: angles of both pendulums are needed to track their damping")
    # a pendulum that is let go during the run is locked before; in a spin-down both are free all along
    let_go = {r.pendulum for r in run.releases}
    tracker = Tracker(
        physics,
        Sensors(encoder_step_rad=run.angle_step_rad),
        damping_std,
        (0 not in let_go, 1 not in let_go),
        imbalance_std=imbalance_std,
    )
    begin, end = float(run.angle_time_s[0]), float(run.angle_time_s[-1])
    for release in run.releases:
        tracker.release(release.pendulum, int(_ns(release.time_s)))
    rows: list[Tracked] = []
    for start in np.arange(begin, end, batch_s):
        _hand_over(tracker, run, (float(start), float(start + batch_s)), lasers)
        rows.append(tracker.estimate())
    rows = [r for r in rows if r.time_ns is not None]
    if not rows:
        raise NotIdentifiable(f"{run.source}: {end - begin:.2g} s are too short to track")
    return TrackedRun(
        np.array([(r.time_ns or 0) * 1e-9 for r in rows]),
        np.array([[r.values[n] for n in _NAMES] for r in rows]),
        np.array([[r.intervals[n][0] for n in _NAMES] for r in rows]),
        np.array([[r.intervals[n][1] for n in _NAMES] for r in rows]),
        np.array([[r.states[n] for n in STATE_NAMES] for r in rows]),
        np.array([[r.state_std[n] for n in STATE_NAMES] for r in rows]),
        np.array([r.trusted for r in rows]), rows[-1],
    )  # fmt: skip


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
