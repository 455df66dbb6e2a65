"""Rotor phase from index marks, for online use."""

from __future__ import annotations

import numpy as np

_MAX_MARKS = 64  # number of stored marks
_STALE_TURNS = 5.0  # without a mark for so many turns and 1 s the rotor counts as stopped
_MAX_SPEED_RAD_S = 2000.0  # upper bound of the speed of any rotor
_MAX_REFUSED = 4  # refused marks in a row, after which the stored marks are dropped


class PhaseClock:
    """Phase, speed and acceleration of the rotor between marks and shortly after the last one.

    Between two marks the phase is the parabola through both and the mark before them. After the last mark it continues
    at the last speed. Marks that are out of order or exceed the largest speed are refused and counted. After several
    refused marks in a row the stored marks are dropped.
    """

    def __init__(self) -> None:
        self._time_s: list[float] = []
        self._phase_rad: list[float] = []
        self.refused: int = 0
        self._in_a_row: int = 0

    def feed(self, time_s: np.ndarray, phase_rad: np.ndarray) -> None:
        """Add marks.

        Args:
            time_s: instants of the marks on the readings' clock, shape (n,).
            phase_rad: unwrapped phase at the marks, shape (n,).
        """
        for t, phase in zip(np.atleast_1d(time_s).tolist(), np.atleast_1d(phase_rad).tolist(), strict=True):
            if not (np.isfinite(t) and np.isfinite(phase)) or not self._follows(t, phase):
                self.refused += 1
                self._in_a_row += 1
                if self._in_a_row > _MAX_REFUSED:  # the earlier marks are the wrong ones
                    self._time_s.clear()
                    self._phase_rad.clear()
                    self._in_a_row = 0
                continue
            self._in_a_row = 0
            self._time_s.append(t)
            self._phase_rad.append(phase)
        del self._time_s[:-_MAX_MARKS], self._phase_rad[:-_MAX_MARKS]

    @property
    def known(self) -> bool:
        """Whether there are enough marks for a phase."""
        return len(self._time_s) >= 2

    def _follows(self, t: float, phase: float) -> bool:
        if not self._time_s:
            return True
        span = t - self._time_s[-1]
        return span > 0 and abs(phase - self._phase_rad[-1]) < _MAX_SPEED_RAD_S * span

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return ψ in rad, ω in rad/s and α in rad/s² at the times, shape (n, 3); zeros without marks."""
        out = np.zeros((len(time_s), 3))
        if not self.known:
            return out
        t, phase = np.array(self._time_s), np.array(self._phase_rad)
        speed = np.diff(phase) / np.diff(t)
        middle = 0.5 * (t[1:] + t[:-1])
        change = np.diff(speed) / np.diff(middle) if len(speed) > 1 else np.zeros(1)
        i = np.clip(np.searchsorted(t, time_s) - 1, 0, len(t) - 2)
        change = change[np.clip(i - 1, 0, len(change) - 1)]
        beyond = time_s > t[-1]
        since = time_s - t[i]
        curve = np.where(beyond, 0.0, change)
        # through both marks: ψ = ψi + ω̄ s + ½ α s (s − width)
        width = t[i + 1] - t[i]
        out[:, 0] = phase[i] + speed[i] * since + 0.5 * curve * since * (since - width)
        out[:, 1] = speed[i] + curve * (since - 0.5 * width)
        out[:, 2] = curve
        end_speed = speed[-1] + 0.5 * change[-1] * (t[-1] - t[-2])
        ahead = time_s[beyond] - t[-1]
        out[beyond, 0], out[beyond, 1] = phase[-1] + end_speed * ahead, end_speed
        stopped = beyond & (time_s - t[-1] > _STALE_TURNS * (t[-1] - t[-2]) + 1.0)
        out[stopped, 1] = 0.0
        return out
