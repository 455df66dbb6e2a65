"""Pendulums that move although their locks should hold them: in a ring-down, in a run-up, and before a release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.acquisition.lock_positions import lock_tolerance_deg
from daq.signals.run import Run
from rig_basics.arrays import Array

_BLOCK_S = 0.1  # the median over this time is free of single wrong readings
_FEWEST = 3  # blocks


@dataclass(frozen=True)
class LooseLock:
    """Motion of a pendulum that should be locked.

    Attributes:
        pendulum: "A" or "B".
        moved_deg: range of its angle.
        at_s: instant at which it left its first angle, s since the run's start.
    """

    pendulum: str
    moved_deg: float
    at_s: float

    @property
    def sentence(self) -> str:
        """The motion in words."""
        return (
            f"pendulum {self.pendulum} moves by {self.moved_deg:.1f}° from {self.at_s:.1f} s on although its lock "
            "should hold it. Look at the lock and the encoder's coupling, and record the test again"
        )


def loose_locks(run: Run, until_s: float = np.inf) -> list[LooseLock]:
    """Return the pendulums that move by more than a closed lock allows.

    Args:
        run: recording in which both pendulums should be locked.
        until_s: last instant at which they should be locked, s since the run's start.
    """
    tolerance, found = lock_tolerance_deg(0.0), list[LooseLock]()
    for i in range(run.angle_rad.shape[1] if run.angle_rad.ndim == 2 else 0):
        good = np.isfinite(run.angle_rad[:, i]) & (run.angle_time_s < until_s)
        time, angle = _medians(run.angle_time_s[good], np.degrees(run.angle_rad[good, i]))
        if len(time) < _FEWEST or np.ptp(angle) <= tolerance:
            continue
        left = np.flatnonzero(np.abs(angle - angle[0]) > 0.5 * np.ptp(angle))
        found.append(LooseLock("AB"[i], float(np.ptp(angle)), float(time[left[0]] if len(left) else time[0])))
    return found


def _medians(time_s: Array, value: Array) -> tuple[Array, Array]:
    """Return the first time and the median value of each block."""
    if not len(time_s):
        return time_s, value
    starts = np.flatnonzero(np.r_[True, np.diff(np.floor(time_s / _BLOCK_S)) > 0])
    return time_s[starts], np.array([float(np.median(part)) for part in np.split(value, starts[1:])])
