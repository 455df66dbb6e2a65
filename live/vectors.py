"""1× vectors between index marks, computed as the signals arrive."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from analysis.quantities.order_tracking import order_track
from analysis.quantities.stamp_lag import StampLag, fitted_lag, unknown_lag
from live.signals import Signals
from rig_basics.arrays import Array
from rig_basics.units import RPM
from rig_configs.roles import Roles

_REVOLUTIONS, _MIN_WINDOW_S = 2, 0.1  # of one vector's window
_STEP_RPM, _MAX_INTERVAL_S = 0.4, 5.0  # a vector is kept after this change of speed or this time since the last one
_MAX_RAMP_RPM_S = 60.0  # above, no meaningful 1× exists, as during braking
_MAX_VECTORS = 6000


class LiveVectors:
    """1× amplitudes of x and y between index marks.

    Args:
        signals: signals of the rig.
    """

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        phase = signals.rig.roles.phase
        self._index_rad = math.radians(phase.index_angle_deg if phase else 0.0)
        self._done_s = -math.inf
        self._rows: deque[tuple[float, float, complex, complex]] = deque(maxlen=_MAX_VECTORS)

    def follow(self, until_s: float) -> None:
        """Process all windows that are complete at an instant."""
        with self._signals.lock:
            times, turns = self._signals.by_name["turns"].between(self._done_s, until_s)
        first = 0
        for last in range(1, len(times)):
            if turns[last] <= turns[first] or turns[last] - turns[first] > 50 or times[last] - times[first] > 6.0:
                first = last  # the counter was reset, or the rotor nearly stands still
            elif turns[last] - turns[first] >= _REVOLUTIONS and times[last] - times[first] >= _MIN_WINDOW_S:
                self._window(times[first : last + 1], turns[first : last + 1])
                first = last
            self._done_s = float(times[first]) - 1e-9

    def _window(self, times: Array, turns: Array) -> None:
        rpm = 60 * float(turns[-1] - turns[0]) / float(times[-1] - times[0])
        at_s = float(times[-1])
        begins, ends = (60 * (turns[i] - turns[i - 1]) / (times[i] - times[i - 1]) for i in (1, len(times) - 1))
        if abs(ends - begins) > _MAX_RAMP_RPM_S * (times[-1] - times[0]):
            return
        if self._rows and abs(rpm - self._rows[-1][1]) < _STEP_RPM and at_s - self._rows[-1][0] < _MAX_INTERVAL_S:
            return
        found = [self._vector(axis, times, turns) for axis in ("x", "y")]
        self._rows.append((at_s, rpm, found[0], found[1]))

    def _vector(self, axis: str, times: Array, turns: Array) -> complex:
        with self._signals.lock:
            time_s, values = self._signals.by_name[axis].between(float(times[0]), float(times[-1]))
        turned: Array = np.asarray(np.interp(time_s, times, turns - turns[0]), dtype=np.float64)
        phase: Array = 2 * math.pi * turned + self._index_rad
        try:
            track = order_track(time_s, values, phase, revolutions=1, harmonics=2)
        except ValueError:  # usual: too few valid samples
            return complex(math.nan, math.nan)
        return complex(np.mean(track.amplitude_m[:, 0]))

    def between(self, since_s: float, at_s: float) -> Array:
        """Return rows (rpm, Re X, Im X, Re Y, Im Y) of an interval, mm, shape (n, 5)."""
        rows = [row for row in list(self._rows) if since_s <= row[0] <= at_s]
        return np.array([(rpm, x.real, x.imag, y.real, y.imag) for _, rpm, x, y in rows]).reshape(-1, 5)


def clocks_of(roles: Roles) -> dict[str, str]:
    """Return the clocks of "x", "y" and "phase", as in daq.signals.run.Run."""
    phase = {} if roles.phase is None else {"phase": roles.phase.device}
    return {each.axis: each.clock or each.device for each in roles.displacements} | phase


def without_lags(rows: Array, planned: Array | None, clocks: Mapping[str, str]) -> tuple[Array, dict[str, StampLag]]:
    """Return vectors without the lags of the stamps behind the rotor's phase, and these lags.

    Args:
        rows: measured vectors as from LiveVectors.between, shape (n, 5).
        planned: vectors of the planned ramp, shape (m, 5); None without one: the lags remain unknown.
        clocks: clocks of the signals.
    """
    out, lags = rows.copy(), dict[str, StampLag]()
    speed = RPM * rows[:, 0]
    for axis, real in (("x", 1), ("y", 3)):
        vectors = rows[:, real] + 1j * rows[:, real + 1]
        found = None
        if planned is not None and len(planned):
            known = planned[np.argsort(planned[:, 0])]
            at = [np.interp(rows[:, 0], known[:, 0], known[:, real + part]) for part in (0, 1)]
            found = fitted_lag(speed, vectors, at[0] + 1j * at[1])
        lags[axis] = found if found is not None and found.is_line else unknown_lag(clocks, axis)
        shown = lags[axis].without(speed, vectors)
        out[:, real], out[:, real + 1] = shown.real, shown.imag
    return out, lags
