"""Tap test: which way does each displacement sensor measure?

The operator taps the disk along +x and then along +y. The first movement after each tap goes the way of the tap. The
responses of a sensor to both taps are the components of its direction, so that exchanged sensors and a reversed sense
are found. `directions` is a pure function of the samples; `tap_test` waits for the taps of an open session.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from daq.acquisition.displacement_check import ObservedDisplacement
from daq.acquisition.session import Session
from daq.drivers.checks import Checks, DeviceCheck
from daq.errors import AcquisitionError
from rig_basics.arrays import Array
from rig_configs.roles import Axis, DisplacementSensor, Roles

_MAX_OFF_DEG = 30.0  # a tap by hand, with a sensor at right angles 90° off
_BEFORE_S = 0.5  # stretch before a movement that gives the position at rest
_RISE_S = 0.1  # longest time from the begin of a movement to its first extreme
_FALLEN = 0.8  # share of the extreme at which it has passed
_LEAST_M = 30e-6  # of a movement
_NOISES = 3.0  # peak-to-peak values at rest that a movement exceeds
_QUIET_S = 30.0  # longest wait for the column to come to rest between two taps, s
_PATIENCE_S = 60.0  # longest wait for a tap, s
_POLL_S = 0.05


@dataclass(frozen=True)
class Tap:
    """Responses to a tap: first extreme of the movement, by topic, m."""

    response_m: Mapping[str, float]

    @property
    def size_m(self) -> float:
        """Size of the movement, m."""
        return math.sqrt(sum(value**2 for value in self.response_m.values()))


class NoTap(AcquisitionError):
    """No movement was seen in time."""


def first_extreme(seen: Mapping[str, ObservedDisplacement]) -> Tap | None:
    """Return the responses to a tap; None if the samples contain no movement, or only its begin.

    Args:
        seen: samples by topic, which begin at rest, at least `_BEFORE_S` before the movement.
    """
    moved: dict[str, tuple[Array, Array]] = {}
    begins: list[tuple[float, str]] = []
    for topic, one in seen.items():
        good = np.isfinite(one.value_m)
        time, value = one.time_s[good], one.value_m[good]
        still = value[time < time[0] + _BEFORE_S] if len(time) else value
        if len(still) < 2:
            continue
        away = value - np.median(still)
        moved[topic] = time, away
        beyond = np.flatnonzero(np.abs(away) > max(_LEAST_M, _NOISES * float(np.ptp(still))))
        if len(beyond):
            begins.append((float(time[beyond[0]]), topic))
    if not begins:
        return None
    begin = min(begins)[0]
    if min(time[-1] for time, _ in moved.values()) < begin + _RISE_S:
        return None
    peaks = {topic: _peak(time, away, begin) for topic, (time, away) in moved.items()}
    _, at = max(peaks.values())
    return Tap({topic: float(np.interp(at, time, away)) for topic, (time, away) in moved.items()})


def _peak(time: Array, away: Array, begin: float) -> tuple[float, float]:
    """Return size and time of the first extreme of a movement that begins at a time."""
    rising = (time >= begin) & (time <= begin + _RISE_S)
    part, at = np.abs(away[rising]), time[rising]
    if not len(part):
        return 0.0, begin
    passed = np.flatnonzero(part < _FALLEN * np.maximum.accumulate(part))
    until = int(passed[0]) if len(passed) else len(part)
    top = int(np.argmax(part[: max(1, until)]))
    return float(part[top]), float(at[top])


def directions(roles: Roles, taps: Mapping[Axis, Tap]) -> dict[str, Checks]:
    """Return a check of the direction of each displacement sensor, by device.

    Args:
        roles: roles of the rig.
        taps: tap along + of each axis that was tapped.
    """
    sensors = (*roles.displacements, *roles.witnesses)
    found = {sensor.device: _found_deg(sensor, taps) for sensor in sensors}
    out: dict[str, Checks] = {}
    for sensor in sensors:
        expected = _own_deg(sensor)
        angle = found[sensor.device]
        if angle is None:
            out[sensor.device] = {"direction_deg": DeviceCheck(None, round(expected), False, "it did not move")}
            continue
        off = math.remainder(angle - expected, 360.0)
        ok = abs(off) <= _MAX_OFF_DEG
        note = "" if ok else _advice(sensor, off, [s for s in sensors if s is not sensor], found)
        value = round(math.remainder(angle, 360.0))
        out[sensor.device] = {
            "direction_deg": DeviceCheck(value, f"{expected:g} ± {_MAX_OFF_DEG:g}", ok, note),
        }
    return out


def _own_deg(sensor: DisplacementSensor) -> float:
    return (0.0 if sensor.axis == "x" else 90.0) + sensor.off_axis_deg


def _found_deg(sensor: DisplacementSensor, taps: Mapping[Axis, Tap]) -> float | None:
    """Return the direction of a sensor; None if it shows no movement. One tap alone gives only its sense."""
    parts = {axis: tap.response_m.get(sensor.topic, 0.0) / tap.size_m for axis, tap in taps.items() if tap.size_m > 0}
    if not any(parts.values()):
        return None
    if len(parts) == 1:
        ((axis, part),) = parts.items()
        along = _own_deg(sensor) if axis == sensor.axis else _own_deg(sensor) + 90.0
        return along if part > 0 else along + 180.0
    return math.degrees(math.atan2(parts["y"], parts["x"]))


def _advice(
    sensor: DisplacementSensor, off: float, others: list[DisplacementSensor], found: Mapping[str, float | None]
) -> str:
    angle = _own_deg(sensor) + off
    for other in others:
        angle_of_other = found[other.device]
        if (
            angle_of_other is not None
            and abs(math.remainder(angle - _own_deg(other), 360.0)) <= _MAX_OFF_DEG
            and abs(math.remainder(angle_of_other - _own_deg(sensor), 360.0)) <= _MAX_OFF_DEG
        ):
            return f"it measures what {other.device} should: exchange the ports of {sensor.device} and {other.device}"
    if abs(abs(off) - 180.0) <= _MAX_OFF_DEG:
        reversed_deg = (_own_deg(sensor) + 180.0) % 360.0
        return f"its sense is reversed: set devices.{sensor.device}.direction_deg = {reversed_deg:g}, or turn it"
    return f"look at its place, or correct devices.{sensor.device}.direction_deg"


def tap_test(session: Session, prompt: Callable[[str], None]) -> dict[str, Checks]:
    """Wait for a tap along each measured axis and return a check of each sensor's direction, by device.

    Args:
        session: the open session; the rotor stands.
        prompt: called with each request to the operator.

    Raises:
        NoTap: no movement was seen in time.
    """
    roles = session.rig.roles
    taps: dict[Axis, Tap] = {}
    for sensor in roles.displacements:
        _wait_for_rest(session)
        prompt(f"tap the disk once, by hand, along +{sensor.axis}")
        begun_ns = session.clock.now_ns() - int(_BEFORE_S * 1e9)
        end_s = session.clock.now_s() + _PATIENCE_S
        while (tap := first_extreme(_newest(session, begun_ns))) is None:
            if session.clock.now_s() > end_s:
                raise NoTap(f"no movement along +{sensor.axis} was seen within {_PATIENCE_S:g} s")
            session.clock.wait(_POLL_S)
        taps[sensor.axis] = tap
    return directions(roles, taps)


def _newest(session: Session, since_ns: int) -> dict[str, ObservedDisplacement]:
    roles, out = session.rig.roles, dict[str, ObservedDisplacement]()
    for sensor in (*roles.displacements, *roles.witnesses):
        time_ns, (value,) = session.channels.recent.last(sensor.topic, ("displacement_m",), since_ns)
        out[sensor.topic] = ObservedDisplacement.since(since_ns, time_ns, value)
    return out


def _wait_for_rest(session: Session) -> None:
    """Wait until the column stands, at most `_QUIET_S`."""
    end_s = session.clock.now_s() + _QUIET_S
    while session.clock.now_s() < end_s:
        session.clock.wait(_BEFORE_S)
        newest = _newest(session, session.clock.now_ns() - int(_BEFORE_S * 1e9))
        if all(_stands(one.value_m[np.isfinite(one.value_m)]) for one in newest.values()):
            break


def _stands(value: Array) -> bool:
    """Return whether values change by little more than the noise from one sample to the next."""
    return len(value) > 2 and float(np.std(value)) < _LEAST_M / 6 + float(np.std(np.diff(value)))
