"""The tracker over a recorded run, as online, and optionally with a smoother."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification.errors import NotIdentifiable
from identification.tracking.reference import FilterpyFilter
from identification.tracking.tracker import STATE_NAMES, SensorNoise, Tracked, Tracker
from identification.tracking.unscented import LN_C3, filter_readings
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular

TrackingSetting = Literal["fast", "reference"]
"""fast: compiled filter; reference: filterpy's filter with the same motion, and its smoother."""
_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_TIMES = 1.96  # standard deviations of a 95 % interval
_FILTERING = 0.5  # share of filtering in the work of the reference setting; the rest is smoothing


@dataclass(frozen=True)
class SmoothedRun:
    """Estimates at the same instants from all readings of the run, later ones included.

    Attributes:
        values, std, low, high: c3, c4, their standard deviations and 95 % intervals, N m s/rad, shape (n, 2).
        states, state_std: states and standard deviations in the order of STATE_NAMES, SI, shape (n, 8).
        stretches: number of parts of the run without a restart of the filter; each part is smoothed separately.
        kept: share of the steps with the filter's estimate instead of the smoothed one.
    """

    values: Array
    std: Array
    low: Array
    high: Array
    states: Array
    state_std: Array
    stretches: int
    kept: float


@dataclass(frozen=True)
class TrackedRun(Tabular):
    """Estimates of the tracker over a run, one row per batch of readings.

    Attributes:
        time_s: time since the run's start, s, shape (n,).
        values, std, low, high: c3, c4, their standard deviations and 95 % intervals, N m s/rad, shape (n, 2).
        states, state_std: states and standard deviations in the order of STATE_NAMES, SI, shape (n, 8).
        phase_rad, speed_rad_s: rotor phase ψ and speed from the marks, shape (n,); zeros without marks.
        trusted: whether the filter follows the readings, shape (n,).
        last: estimate at the end.
        smoothed: smoothed estimates of the reference setting; None for the fast setting.
    """

    time_s: Array
    values: Array
    std: Array
    low: Array
    high: Array
    states: Array
    state_std: Array
    phase_rad: Array
    speed_rad_s: Array
    trusted: NDArray[np.bool_]
    last: Tracked
    smoothed: SmoothedRun | None = None

    def columns(self) -> Mapping[str, Column]:
        """Return the estimates at each instant, the smoothed ones if there are any."""
        found = self.smoothed or self
        table: dict[str, Column] = {"time_s": self.time_s, "speed_rad_s": self.speed_rad_s, "trusted": self.trusted}
        for i, name in enumerate(("c3_Nms_per_rad", "c4_Nms_per_rad")):
            table |= {name: found.values[:, i], f"{name}_std": found.std[:, i]}
        for i, name in enumerate(STATE_NAMES):
            table |= {name: found.states[:, i], f"{name}_std": found.state_std[:, i]}
        return table


def track(
    run: Run,
    physics: RotorParameters,
    *,
    damping_std: float = 1.0,
    imbalance_std: float = 0.05,
    batch_s: float = 0.05,
    laser_run_out_m: tuple[complex, complex] | None = None,
    setting: TrackingSetting = "fast",
    progress: Callable[[float], None] | None = None,
) -> TrackedRun:
    """Run the online tracker over a recorded run.

    Args:
        run: recording with angles; marks are used if there are any.
        physics: parameters including the bow; c3 and c4 are the start values.
        damping_std: standard deviation of ln c3, ln c4 at the start.
        imbalance_std: relative standard deviation of S_P.
        batch_s: duration of one batch of readings, s.
        laser_run_out_m: run-out of the surfaces that the lasers measure, as in `Tracker`; None: lasers are not used.
            Their signals must have no offset, lie along the stiffness axes and have the encoders' clock to a fraction
            of a millisecond: 2 ms turn the orbit by six degrees and bias the damping.
        setting: "reference" adds smoothed estimates and computes the rows by filterpy.
        progress: called with the completed share, 0 … 1.
    Raises:
        NotIdentifiable: the run has no angles of both pendulums, or is too short.
        FitFailed: the covariance of the reference filter is not positive definite, or the run has too many steps.
        ValueError: the setting is unknown.
    """
    if setting not in get_args(TrackingSetting):
        raise ValueError(f"setting: expected {', '.join(get_args(TrackingSetting))}, got {setting!r}")
    if run.angle_rad.ndim != 2 or not np.isfinite(run.angle_rad).any(axis=0).all() or run.angle_rad.size == 0:
        raise NotIdentifiable(f"{run.source}: angles of both pendulums are needed to track their damping")
    reference = FilterpyFilter(run.source) if setting == "reference" else None
    # a pendulum that is released later is locked before; in a spin-down both are free
    released = {r.pendulum for r in run.releases}
    tracker = Tracker(
        physics,
        SensorNoise(encoder_step_rad=run.angle_step_rad),
        damping_std,
        (0 not in released, 1 not in released),
        imbalance_std=imbalance_std,
        run_out_m=laser_run_out_m or (0j, 0j),
        filtering=reference or filter_readings,
    )
    for release in run.releases:
        tracker.release(release.pendulum, int(_ns(release.time_s)))
    batches, begin, end = _Batches(), float(run.angle_time_s[0]), float(run.angle_time_s[-1])
    for start in np.arange(begin, end, batch_s):
        _hand_over(tracker, run, (float(start), float(start + batch_s)), laser_run_out_m is not None)
        added = batches.add(tracker, reference.steps if reference else 0)
        if added and progress is not None:
            progress((_FILTERING if reference else 1.0) * (start - begin) / (end - begin))
    if not batches.rows:
        raise NotIdentifiable(f"{run.source}: {end - begin:.2g} s of angles are too short to track; record longer")
    forward = _rows(batches.rows, batches.phases)
    if reference is None:
        return forward
    return _smoothed(forward, reference, np.array(batches.steps), progress)


@dataclass
class _Batches:
    """Estimates after each batch of readings.

    Attributes:
        rows: estimates.
        phases: rotor phase in rad and speed in rad/s at the estimates.
        steps: index of the last step of the reference filter at the estimates; -1 for the fast setting.
    """

    rows: list[Tracked] = field(default_factory=list[Tracked])
    phases: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    steps: list[int] = field(default_factory=list[int])

    def add(self, tracker: Tracker, steps: int) -> bool:
        """Add the current estimate; return False if the last batch had no readings."""
        now = tracker.estimate()
        if now.time_ns is None or (self.rows and now.time_ns == self.rows[-1].time_ns):
            return False
        self.rows.append(now)
        self.phases.append(tracker.phase_at(now.time_ns))
        self.steps.append(steps - 1)
        return True


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
    forward: TrackedRun, reference: FilterpyFilter, steps: NDArray[np.int64], progress: Callable[[float], None] | None
) -> TrackedRun:
    """Return the rows with the smoothed estimates added.

    The smoothed standard deviations have the same factors, CAUTION and the excess of the innovations, as those of the
    filter at the same instant.
    """

    def second_part(share: float) -> None:
        if progress is not None:
            progress(_FILTERING + (1 - _FILTERING) * share)

    found = reference.smoothed(second_part)
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
    def part(time: Array) -> slice:
        first, last = np.searchsorted(time, span_s)
        return slice(int(first), int(last))

    m, x, y, a = part(run.mark_time_s), part(run.x_time_s), part(run.y_time_s), part(run.angle_time_s)
    if m.stop > m.start:
        tracker.feed_marks(_ns(run.mark_time_s[m]), run.mark_phase_rad[m])
    if lasers:
        tracker.feed_lasers(_ns(run.x_time_s[x]), run.x_m[x], _ns(run.y_time_s[y]), run.y_m[y])
    if a.stop > a.start:
        tracker.feed_encoders(_ns(run.angle_time_s[a]), run.angle_rad[a])


def _ns(time_s: Array | float) -> NDArray[np.int64]:
    return np.round(np.asarray(time_s) * 1e9).astype(np.int64)
