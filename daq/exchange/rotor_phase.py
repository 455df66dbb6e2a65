"""Phase of the rotor in an imported recording: from an angle in every row, from index marks, or from the speed."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import integrate

from daq.exchange.errors import ExchangeError
from daq.exchange.readings import SensorReadings, unwrapped
from rig_basics.texts import number_of

_MAX_STEP_TURNS = 0.4  # turns between two rows: with larger steps whole turns may be missed
_TWO_MARKS = 1.5  # ratio to the neighbouring intervals above which an interval contains several revolutions


def phase_of_angle(angle: SensorReadings) -> tuple[NDArray[np.int64], NDArray[np.float64], list[str]]:
    """Return times and unwrapped phase of an angle, and warnings.

    Raises:
        ExchangeError: the angle decreases over the recording.
    """
    good = np.isfinite(angle.value)
    time, phase = angle.time_ns[good], unwrapped(angle.value[good])
    if phase[-1] < phase[0] - 2 * math.pi:
        raise ExchangeError(
            f"phase: expected an angle that rises with time, it falls from {phase[0]:.4g} to {phase[-1]:.4g} rad; "
            "if the rotor turns the other way give the unit a minus sign: NAME:-rad"
        )
    step = float(np.max(np.abs(np.diff(phase)))) / (2 * math.pi)
    warnings: list[str] = []
    if step > _MAX_STEP_TURNS:
        warnings.append(
            f"phase: the rotor turns up to {step:.2f} revolutions between two rows, so whole turns may be missed; "
            "is the unit right, and is it sampled fast enough?"
        )
    return time, phase, warnings


def phase_of_speed(speed: SensorReadings) -> tuple[NDArray[np.int64], NDArray[np.float64], list[str]]:
    """Return times and phase from a speed in rad/s; the phase starts at 0 for any initial position of the rotor."""
    good = np.isfinite(speed.value)
    time, value = speed.time_ns[good], speed.value[good]
    integral = cast("Any", integrate).cumulative_trapezoid  # scipy has no types
    phase = np.asarray(integral(value, (time - time[0]) * 1e-9, initial=0.0), np.float64)
    warning = (
        "speed: the phase is the integral of the speed and starts at 0 for any initial position: it has no absolute "
        "reference, so the imbalance's direction and the sense of the pendulums' angles against it are not known"
    )
    return time, phase, [warning]


def revolutions_of_marks(time_ns: NDArray[np.int64]) -> tuple[NDArray[np.uint32], list[str]]:
    """Return the number of complete revolutions at each mark, shape (n,); missed marks are counted.

    An interval that is a multiple of the shortest of the two before it, and of the two after it, contains missed marks.
    Missed marks among the first three from standstill cannot be detected.
    """
    if len(time_ns) < 2:
        raise ExchangeError(f"marks: expected at least two marks, got {len(time_ns)}")
    interval = np.diff(time_ns).astype(np.float64)
    turns = np.ones(len(interval), np.int64)
    for i in range(1, len(interval) - 1):
        around = max(interval[max(0, i - 2) : i].min(), interval[i + 1 : i + 3].min())
        if interval[i] > _TWO_MARKS * around:
            turns[i] = round(interval[i] / around)
    missed = int(turns.sum()) - len(turns)
    warnings = [f"marks: {missed} of {number_of(missed + len(time_ns), 'mark')} missing and counted"] if missed else []
    return np.r_[0, np.cumsum(turns)].astype(np.uint32), warnings
