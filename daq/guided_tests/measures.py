"""Measured values for the looks of a guided test, from the newest samples of each signal."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.recent_speed import recent_agreement
from daq.acquisition.session import Session
from daq.signals.settling import DISPLACEMENTS_S, RotorSignals, Settling, SettlingLimits, locked_settled, settled
from daq.signals.window_means import whole_revolutions
from rig_basics.arrays import Array

_COMPARED_S = 3.0  # of reports and index marks, s; five turns at 100 rpm
ANGLE_FIELDS = ("theta3_rad", "theta4_rad")
"""Fields of the pendulum angles A and B in their channel."""


class Measures:
    """Measured values of an open session."""

    def __init__(self, session: Session) -> None:
        self._s = session

    def since(self, seconds: float) -> int:
        """Return the time that lies a number of seconds in the past, ns since 1970."""
        return self._s.clock.now_ns() - int(seconds * 1e9)

    def angles_described(self) -> bool:
        """Return whether the device of the pendulum angles has described itself; True if the rig has none."""
        role = self._s.rig.roles.angles
        return role is None or self._s.devices.identification_of(role.device)[0]

    def rest_m(self, topic: str, seconds: float) -> float:
        """Return the median of a laser's newest samples, m; NaN without valid samples."""
        _, (x,) = self._s.channels.newest(topic, ("displacement_m",), seconds)
        valid: Array = x[np.isfinite(x)]
        return float(np.median(valid)) if len(valid) else math.nan

    def extremes(self, topic: str, seconds: float) -> tuple[float, float]:
        """Return minimum and maximum of a laser's newest samples, m; NaN if over a fifth are missing or invalid."""
        if self.valid(topic, seconds) < 0.8 * seconds:
            return math.nan, math.nan
        _, (x,) = self._s.channels.newest(topic, ("displacement_m",), seconds)
        return float(np.nanmin(x)), float(np.nanmax(x))

    def peak_to_peak(self, topic: str, seconds: float) -> float:
        """Return the peak-to-peak value of a laser's newest samples, m; NaN as in `extremes`."""
        low, high = self.extremes(topic, seconds)
        return high - low

    def valid(self, topic: str, seconds: float) -> float:
        """Return the number of valid samples in a laser's newest stretch, expressed in seconds."""
        _, (x,) = self._s.channels.newest(topic, ("displacement_m",), seconds)
        rates = {sensor.topic: sensor.rate_Hz for sensor in self._s.rig.roles.displacements}
        return float(np.count_nonzero(np.isfinite(x))) / rates[topic]

    def largest_since(self, topic: str, since_ns: int, rest_m: float) -> float:
        """Return the largest distance of a laser's samples since an instant from its reading at rest, m."""
        _, (x,) = self._s.channels.recent.last(topic, ("displacement_m",), since_ns)
        return float(np.nanmax(np.abs(x - rest_m), initial=0.0))

    def revolutions_since(self, since_ns: int) -> float:
        """Return the number of whole revolutions of the rotor since an instant, from its index marks."""
        _, (turns,) = self._s.channels.recent.last("tacho", ("revolutions",), since_ns)
        return float(int(turns[-1]) - int(turns[0])) if len(turns) else 0.0

    def host_doubt(self) -> str:
        """Return a sentence about the host if it was late recently; empty if not."""
        return self._s.host_words()

    def speed_doubt(self, seconds: float = _COMPARED_S) -> str:
        """Return in words how drive and index marks disagree over the newest stretch; empty if they do not."""
        found = recent_agreement(self._s.channels.recent, self._s.rig.roles, self.since(seconds))
        return "" if found is None else found.words

    def turned_since(self, since_ns: int) -> tuple[Array, Array]:
        """Return the ranges of the pendulum angles since an instant, rad, and the top speeds, rad/s; shapes (2,)."""
        time_ns, columns = self._s.channels.recent.last("pendulums", ANGLE_FIELDS, since_ns)
        step = 50
        if len(time_ns) <= step:
            return np.zeros(2), np.full(2, 1e-3)
        angles = np.column_stack(columns)
        rates = (angles[step:] - angles[:-step]) / ((time_ns[step:] - time_ns[:-step]) * 1e-9)[:, None]
        return np.ptp(angles, axis=0), np.max(np.abs(rates), axis=0)

    def rates(self) -> Array:
        """Return the mean pendulum speeds over the newest 0.2 s, rad/s, shape (2,); NaN without samples."""
        time_ns, (a, b) = self._s.channels.newest("pendulums", ANGLE_FIELDS, 0.2)
        if len(time_ns) < 10:
            return np.full(2, np.nan)
        turned: Array = np.array([a[-1] - a[0], b[-1] - b[0]], np.float64)
        return turned / float((time_ns[-1] - time_ns[0]) * 1e-9)

    def signals(self, since_ns: int, lasers_since_ns: int | None = None) -> RotorSignals:
        """Return the signals since an instant.

        Args:
            since_ns: start of angles and index marks, and zero of all times.
            lasers_since_ns: start of the displacements, `since_ns` if None.

        Returns:
            Angles, marks and displacements; every fourth sample of the displacements is taken.
        """
        recent = self._s.channels.recent
        t, (a, b) = recent.last("pendulums", ANGLE_FIELDS, since_ns)
        m, (turns,) = recent.last("tacho", ("revolutions",), since_ns)
        tx, (x,) = recent.last("laser/x", ("displacement_m",), lasers_since_ns or since_ns)
        ty, (y,) = recent.last("laser/y", ("displacement_m",), lasers_since_ns or since_ns)

        def seconds(ns: NDArray[np.int64]) -> Array:
            return np.asarray((ns - since_ns) * 1e-9, np.float64)

        return RotorSignals(
            seconds(t),
            np.column_stack([a, b]),
            seconds(m),
            2 * np.pi * turns.astype(float),
            seconds(tx)[::4],
            x[::4],
            seconds(ty)[::4],
            y[::4],
        )

    def locked_steady(self) -> Settling:
        """Return whether the orbit of the turning rotor with locked pendulums is steady."""
        return locked_settled(self.signals(self.since(15.0)))

    def steady(self, released_ns: int, step_rad: float, limits: SettlingLimits, free: bool = False) -> Settling:
        """Return whether pendulums and orbit are steady after a release.

        Args:
            released_ns: time of the release, ns since 1970; with `free` the time at which the speed was reached.
            step_rad: resolution of the encoders, rad.
            limits: tolerances and windows of the decision.
            free: whether the pendulums were free before, so that there are no angles of release.
        """
        since = released_ns - (0 if free else 1_500_000_000)  # with the angles before the release
        signals = self.signals(since, max(since, self.since(DISPLACEMENTS_S)))
        release = None if free else (released_ns - since) * 1e-9
        return settled(signals, limits, release_time_s=release, angle_step_rad=step_rad)

    def mean_angles_rad(self, seconds: float = 2.0) -> tuple[float, float]:
        """Return the mean pendulum angles over the newest stretch, rad."""
        _, (a, b) = self._s.channels.newest("pendulums", ANGLE_FIELDS, seconds)
        means: Array = np.column_stack([a, b]).mean(axis=0)
        return float(means[0]), float(means[1])

    def amplitudes_m(self, seconds: float = 2.0) -> tuple[float, float]:
        """Return the order-1 amplitudes of x and y over whole revolutions of the newest stretch, m.

        They are NaN without index marks.
        """
        signals = self.signals(self.since(seconds + 3.0))
        edges = whole_revolutions(signals.mark_time_s, signals.mark_phase_rad, seconds, 1)
        found = signals.amplitude_means(edges, 1) if len(edges) == 2 else None
        return (math.nan, math.nan) if found is None else (float(found.means[-1, 0]), float(found.means[-1, 1]))
