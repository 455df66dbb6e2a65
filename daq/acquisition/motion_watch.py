"""Detection of a displacement sensor that does not measure the motion of a turning rotor, such as one that hangs.

A sensor that hangs repeats its last value, or adds its own noise to it. Two comparisons find it:

- with the other sensor. A constant reading alone is not a fault: a balanced rotor and a simulation without noise give
  one too. A turning rotor, however, does not move in one direction only. A reading that is constant to the last bit
  while the other direction swings is a fault.
- with the unbalance of the rig file (`daq.acquisition.least_motion`), which implies a least motion. The motion is half
  the distance between the lowest and the highest tenth of the newest samples, over 0.95 as of a sine. Noise, drift and
  free vibration only increase it, and single false readings leave it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.rotor_watch import Stop
from rig_basics.units import RPM
from rig_configs.roles import DisplacementSensor

WINDOW_S, TURNS, BEATS = 0.5, 1.0, 1.5
"""Least length of the evaluated stretch: time, turns, and beats of a free vibration with the rotation, s of samples."""
SWING_M = 50e-6
"""Peak-to-peak displacement of another sensor in `WINDOW_S` that shows a motion, m: a hundred steps of a sensor."""
STUCK_M = 25e-6
"""Implied amplitude from which a reading that is constant to the last bit is a fault: ten steps of 5 µm, peak to
peak, and common sensors have steps below 2 µm."""
_KEPT = 64  # samples of one read that are kept at most
_MIN_SAMPLES = 40
_TENTH = 0.1
_OF_SINE = math.cos(math.pi * _TENTH)  # that quantile of a sine of amplitude 1
_MAX_GAP = 0.1  # share of the stretch that may lack at its beginning


class MotionWatch:
    """Compares the motion of displacement sensors with the least that a rig file implies.

    Args:
        sensors: the measuring sensors.
        least: the bound.
    """

    def __init__(self, sensors: Iterable[DisplacementSensor], least: LeastMotion) -> None:
        self._axis_of = {sensor.topic: sensor.axis for sensor in sensors}
        self._least = least
        self._speeds: deque[tuple[int, float]] = (
            deque()
        )  # host ns, rad/s; NaN: unknown, or pendulums not at their locks
        self._reads: dict[str, deque[tuple[int, NDArray[np.float64]]]] = {topic: deque() for topic in self._axis_of}
        self._theta_rad: tuple[float, float] | None = None

    def clear(self) -> None:
        """Remove all samples, since the rotor is at rest."""
        self._speeds.clear()
        for reads in self._reads.values():
            reads.clear()

    def feed(self, topic: str, host_ns: int, displacement_m: NDArray[np.floating]) -> None:
        """Add the samples of one read of a sensor, m; NaN for invalid ones."""
        every = -(-len(displacement_m) // _KEPT)
        values = np.asarray(displacement_m[::every], np.float64)
        self._reads[topic].append((host_ns, values[np.isfinite(values)]))

    def angles(self, theta3_rad: float, theta4_rad: float) -> None:
        """Register the newest pendulum angles."""
        self._theta_rad = (theta3_rad, theta4_rad)

    def tick(self, now_ns: int, rpm: float) -> Stop | None:
        """Evaluate the newest stretch of a turning rotor. Return a fault, or None.

        Args:
            now_ns: host time, ns.
            rpm: measured speed; NaN if unknown.
        """
        held = not self._least.has_angles or (
            self._theta_rad is not None and self._least.stand_at_locks(self._theta_rad)
        )
        self._speeds.append((now_ns, abs(rpm) * RPM if held else math.nan))
        speed = self._speeds[-1][1]
        window_s = self._window_s(speed) if speed > 0 else WINDOW_S
        self._drop(now_ns - round(window_s * 1e9))
        if (stuck := self._stuck(now_ns)) is not None:
            return stuck
        speeds = [each for _, each in self._speeds]
        full = (now_ns - self._speeds[0][0]) * 1e-9 >= (1 - _MAX_GAP) * window_s
        if not full or any(math.isnan(each) for each in speeds):
            return None
        return next(filter(None, (self._missing(topic, min(speeds), max(speeds)) for topic in self._axis_of)), None)

    def _window_s(self, speed: float) -> float:
        """Return the length of the stretch at a speed, s."""
        naturals = (math.sqrt(k / self._least.mass_kg) for k in self._least.stiffness_N_per_m)
        beats = [2 * math.pi / (speed - natural) for natural in naturals if speed > 1.01 * natural]
        return max(WINDOW_S, TURNS * 2 * math.pi / speed, BEATS * max(beats, default=0.0))

    def _drop(self, before_ns: int) -> None:
        for kept in (self._speeds, *self._reads.values()):
            while kept and kept[0][0] < before_ns:
                kept.popleft()

    def _values(self, topic: str, since_ns: int = 0) -> NDArray[np.float64]:
        return np.concatenate([np.empty(0), *(values for at_ns, values in self._reads[topic] if at_ns >= since_ns)])

    def _stuck(self, now_ns: int) -> Stop | None:
        """Return the fault of a reading that is constant while another sensor moves."""
        since_ns = now_ns - round(WINDOW_S * 1e9)
        newest = {topic: self._values(topic, since_ns) for topic in self._axis_of}
        swings_m = {topic: float(np.ptp(values)) for topic, values in newest.items() if len(values) > 2}
        swing_m = max(swings_m.values(), default=0.0)
        for topic in (topic for topic, own_m in swings_m.items() if own_m == 0.0 and swing_m >= SWING_M):
            if _fill([at_ns for at_ns, _ in self._reads[topic] if at_ns >= since_ns], since_ns):
                return Stop(
                    "device",
                    f"{topic}: reads {newest[topic][0] * 1e3:.4f} mm without any change for {WINDOW_S:.1f} s, while "
                    f"the column moves by {swing_m * 1e3:.2f} mm across it: the sensor hangs. Switch it off and on",
                    "stuck sensor",
                )
        return None

    def _missing(self, topic: str, slowest: float, fastest: float) -> Stop | None:
        values = self._values(topic)
        if len(values) < _MIN_SAMPLES:
            return None
        axis, constant = self._axis_of[topic], bool(np.all(values == values[0]))
        least_m = self._least.amplitude_m(axis, slowest, fastest)
        if constant and (by_unbalance := self._least.unbalance_m(axis, slowest, fastest)) >= STUCK_M:
            least_m = by_unbalance
        if not least_m > 0:
            return None
        low, high = np.quantile(values, (_TENTH, 1 - _TENTH)).tolist()
        seen_m = 0.5 * (high - low) / _OF_SINE
        if seen_m >= least_m:
            return None
        return Stop(
            "device",
            f"{topic}: moves by ± {seen_m * 1e6:.1f} µm at {fastest / RPM:.0f} rpm; the rig file's unbalance implies "
            f"± {least_m * 1e6:.0f} µm or more. The sensor hangs, or it does not look at the disk, or the rotor is "
            "balanced better than the file states. Switch the sensor off and on, and compare [imbalance] and "
            "[suspension] with the rig",
            "no motion",
        )


def _fill(times_ns: list[int], since_ns: int) -> bool:
    """Return whether reads fill a stretch of `WINDOW_S`: its begin may lack their distance, or `_MAX_GAP` of it."""
    if len(times_ns) < 3:
        return False
    distance_ns = (times_ns[-1] - times_ns[0]) / (len(times_ns) - 1)
    return times_ns[0] - since_ns <= max(_MAX_GAP * WINDOW_S * 1e9, distance_ns)
