"""Results computed from the incoming signals: 1× vectors of a run-up, damping of the pendulums, steady states.

One thread of the page's own process computes them. For a replayed log they are complete soon after it is opened.
"""

from __future__ import annotations

import math
import threading
from collections import deque

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import lock_tolerance_deg
from daq.channels import LOCK_A_CLOSED, LOCK_B_CLOSED
from identification.tracking.tracker import SensorNoise, Tracker
from live.model import LiveModel
from live.planned import SpeedRamp, simulated_ramp
from live.signals import Signals
from live.vectors import LiveVectors
from rig_basics.arrays import Array
from rig_configs.schema import Rig

_INTERVAL_S = 0.1  # time between two updates
_MAX_TRACKED = 20_000
_BATCH_S = 0.1  # encoder samples per call of the tracker
_ROW_S = 0.2
_COMPILED_RPM = 400.0  # speed of the calls that compile the code
_PENDULUMS = ("A", "B")
_NO_RANGE = (math.inf, -math.inf)
_C3, _C4 = "c3_Nms_per_rad", "c4_Nms_per_rad"


def compile_followers(rig: Rig, model: LiveModel) -> None:
    """Compile all code of the followers in advance, which takes tens of seconds once."""
    model.compute_states(_COMPILED_RPM)
    simulated_ramp(rig, model, SpeedRamp(0.0, _COMPILED_RPM, 2.0))
    tracker = Tracker(model.physics)
    tracker.feed_marks(np.array([0, 10**8]), np.array([0.0, 2 * math.pi]))
    tracker.feed_encoders(np.arange(0, 10**9, 10**7), np.zeros((100, 2)))


class Damping:
    """c3 and c4 by the online tracker; NaN for a pendulum that is locked.

    A pendulum counts as locked while its lock is reported closed, and until it has moved by more than a closed lock
    allows: an encoder without reports of locks has the same flags for open and closed ones, and a pendulum that stands
    still would otherwise be tracked as one with a very large damping.

    Args:
        signals: signals of a rig with encoders.
        model: model with the initial values.
    """

    def __init__(self, signals: Signals, model: LiveModel) -> None:
        roles = signals.rig.roles
        self._signals, self._phase = signals, roles.phase
        step = roles.angles.step_rad if roles.angles else SensorNoise.encoder_step_rad
        self._tracker = Tracker(model.physics, SensorNoise(encoder_step_rad=step), released=(False, False))
        self._closed: list[bool | None] = [None, None]
        self._ranges: list[tuple[float, float]] = [_NO_RANGE, _NO_RANGE]
        self._least_rad: float = math.radians(lock_tolerance_deg(roles.zero_std_deg))
        self._done_s = self._marks_s = -math.inf
        self._rows: deque[tuple[float, float, float, float, float]] = deque(maxlen=_MAX_TRACKED)
        a, b = model.physics.a, model.physics.b
        self.start: tuple[float, float] = (a.damping_Nms_per_rad, b.damping_Nms_per_rad)

    def follow(self, until_s: float) -> None:
        """Process all new samples up to an instant in batches."""
        begin = self._signals.by_name["flags"].between(self._done_s, until_s)[0]
        if not len(begin):
            return
        at_s = float(begin[0]) - 1e-9 if math.isinf(self._done_s) else self._done_s
        while at_s < until_s:
            self._batch(at_s, min(at_s + _BATCH_S, until_s))
            at_s += _BATCH_S
        self._done_s = until_s

    def _batch(self, start_s: float, end_s: float) -> None:
        of = self._signals.by_name
        with self._signals.lock:
            marks, turns = of["turns"].between(start_s, end_s)
            times, flags = of["flags"].between(start_s, end_s)
            _, a = of["turned3"].between(start_s, end_s)
            _, b = of["turned4"].between(start_s, end_s)
        if len(marks):
            index = math.radians(self._phase.index_angle_deg if self._phase else 0.0)
            self._tracker.feed_marks(_ns(marks), 2 * np.pi * turns + index)
        if not len(times):
            return
        self._locks(times, flags.astype(np.int64))
        self._ranges = [_widened(range_rad, angle) for range_rad, angle in zip(self._ranges, (a, b), strict=True)]
        self._tracker.feed_encoders(_ns(times), np.column_stack([a, b]))
        now, locked = self._tracker.estimate(), self.locked
        if now.trusted and len(locked) < len(_PENDULUMS) and (not self._rows or end_s - self._rows[-1][0] >= _ROW_S):
            shown = [
                (math.nan, math.nan) if name in locked else (now.values[c], now.std[c])
                for name, c in zip(_PENDULUMS, (_C3, _C4), strict=True)
            ]
            self._rows.append((end_s, *shown[0], *shown[1]))

    @property
    def locked(self) -> tuple[str, ...]:
        """Names of the pendulums that are locked."""
        return tuple(
            name
            for name, closed, (low, high) in zip(_PENDULUMS, self._closed, self._ranges, strict=True)
            if closed or high - low <= self._least_rad
        )

    def _locks(self, times: Array, flags: NDArray[np.int64]) -> None:
        for pendulum, flag in enumerate((LOCK_A_CLOSED, LOCK_B_CLOSED)):
            closed = (flags & flag) != 0
            before = self._closed[pendulum]
            for i in np.flatnonzero(closed != np.r_[not closed[0] if before is None else before, closed[:-1]]):
                switch = self._tracker.lock if closed[i] else self._tracker.release
                switch(pendulum, int(_ns(times[i : i + 1])[0]))
                self._ranges[pendulum] = _NO_RANGE
            self._closed[pendulum] = bool(closed[-1])

    def between(self, since_s: float, at_s: float) -> Array:
        """Return rows (time, c3, std, c4, std) of an interval, s and N m s/rad, shape (n, 5)."""
        return np.array([row for row in list(self._rows) if since_s <= row[0] <= at_s]).reshape(-1, 5)


def _widened(range_rad: tuple[float, float], angle_rad: Array) -> tuple[float, float]:
    """Return the range of an angle with new readings; NaN is left out."""
    known = angle_rad[np.isfinite(angle_rad)]
    low, high = float(np.min(known, initial=math.inf)), float(np.max(known, initial=-math.inf))
    return min(range_rad[0], low), max(range_rad[1], high)


class Followers:
    """All followers with their thread; a context in which the thread runs.

    Args:
        signals: signals of the rig.
        model: model of the rig.
    """

    def __init__(self, signals: Signals, model: LiveModel) -> None:
        self._signals, self._model = signals, model
        self.vectors: LiveVectors = LiveVectors(signals)
        self.damping: Damping | None = Damping(signals, model) if signals.rig.roles.angles is not None else None
        self.trouble: str = ""
        self.wanted_rpm: float = math.nan
        self.wanted_ramp: SpeedRamp | None = None
        self.planned: tuple[SpeedRamp, Array] | None = None  # the newest requested ramp with its vectors
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="followers", daemon=True)

    def __enter__(self) -> Followers:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._ending.wait(_INTERVAL_S):
            try:
                self.follow()
            except Exception as error:  # the page displays the error and continues without followers
                self.trouble = f"{type(error).__name__}: {error}"
                return

    def follow(self) -> None:
        """Process all new samples."""
        ramp = self.wanted_ramp
        if ramp is not None and (self.planned is None or self.planned[0] != ramp):
            self.planned = ramp, simulated_ramp(self._signals.rig, self._model, ramp)
        until_s = self._signals.newest_s
        if not math.isfinite(until_s):
            return
        self.vectors.follow(until_s)
        if math.isfinite(self.wanted_rpm):
            self._model.compute_states(abs(self.wanted_rpm))
        if self.damping is not None:
            self.damping.follow(until_s)


def _ns(time_s: Array) -> NDArray[np.int64]:
    return np.round(time_s * 1e9).astype(np.int64)
