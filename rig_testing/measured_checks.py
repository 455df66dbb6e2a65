"""Comparison of a driver's samples with the motion of the simulated rig."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.lockstep.clock import START_NS
from rig_basics.texts import number_of
from rig_basics.units import TO_RPM
from rig_configs.roles import DisplacementSensor, PendulumAngles, RotorPhase, SpeedSource
from rig_testing.bench import NOISE_M, Tape
from rig_testing.report import Failed, NotTried, need
from rig_testing.subject import Subject, together

Array = NDArray[np.floating[Any]]

_LATE_S = 0.02  # tolerance of a sample's time: a host cannot measure the line's delay
_SETTLED_S = 0.5  # time after which the clock map has settled


def check_displacement(subject: Subject) -> str:
    """Displacement is the disk centre's along its axis, m, within noise and gain, and increases with the coordinate."""
    sensors = [role for role in subject.roles if isinstance(role, DisplacementSensor)]
    if not sensors:
        raise NotTried("it measures no displacement")
    words = [_check_sensor(subject, role) for role in sensors]
    return words[0] if len(words) == 1 else "; ".join(f"{r.axis}: {w}" for r, w in zip(sensors, words, strict=True))


def _check_sensor(subject: Subject, role: DisplacementSensor) -> str:
    value, rate = (0, 4) if role.axis == "x" else (1, 5)
    time_s, measured = _samples(subject, role.topic, "displacement_m")
    true, speed = _at(subject.tape, time_s, value), _at(subject.tape, time_s, rate)
    gain, late_s, residual = _fit(measured, true, speed)
    allowed = 3 * role.gain_std + 0.003
    need(
        abs(gain - 1) < allowed,
        f"{role.topic}: {gain:.4f} times the disk centre's motion along {role.axis}, expected 1 within {allowed:.4f}: "
        "sign, scale and lever_ratio",
    )
    need(abs(late_s) < _LATE_S, f"{role.topic}: its times are {late_s * 1e3:.1f} ms off")
    spread = float(np.std(residual))
    limit = 3 * NOISE_M / role.lever_ratio + 2 * role.range_m / 2**14 / role.lever_ratio
    need(spread < limit, f"{role.topic}: {spread * 1e6:.1f} µm apart from the motion, expected {limit * 1e6:.1f} µm")
    return f"gain {gain:.4f}, {late_s * 1e3:+.2f} ms, {spread * 1e6:.1f} µm"


def check_angles(subject: Subject) -> str:
    """Both pendulums' angles in the rotor's frame, rad, within a few counts."""
    role = next((role for role in subject.roles if isinstance(role, PendulumAngles)), None)
    if role is None:
        raise NotTried("it measures no pendulum angles")
    measured_words: list[str] = []
    for field, value, rate in (("theta3_rad", 2, 6), ("theta4_rad", 3, 7)):
        time_s, measured = _samples(subject, role.topic, field)
        true, speed = _at(subject.tape, time_s, value), _at(subject.tape, time_s, rate)
        need(float(np.ptp(true)) > 0.2, f"{field}: the simulated pendulum did not move")
        gain, late_s, residual = _fit(measured, true, speed)
        need(abs(gain - 1) < 0.02, f"{field}: {gain:.4f} times the pendulum's angle, expected 1: sign and counts")
        need(abs(late_s) < _LATE_S, f"{field}: its times are {late_s * 1e3:.1f} ms off")
        spread = float(np.std(residual))
        need(spread < 3 * role.step_rad, f"{field}: {spread / role.step_rad:.1f} counts apart from the pendulum")
        zero = abs(math.remainder(float(np.median(measured - true)), 2 * math.pi))
        need(zero < 0.05, f"{field}: zero is off by {math.degrees(zero):.2f}°")
        measured_words.append(f"{field} {spread / role.step_rad:.1f} counts")
    return ", ".join(measured_words)


def check_phase(subject: Subject) -> str:
    """An index mark occurs once a turn, at the direction of the imbalance that the settings state."""
    role = next((role for role in subject.roles if isinstance(role, RotorPhase)), None)
    if role is None:
        raise NotTried("it measures no rotor phase")
    whole = together(subject.tape.items, role.topic)
    turned = float(subject.tape.motion[-1, 8] - subject.tape.motion[0, 8]) / (2 * math.pi)
    if whole is None:
        raise Failed(f"{role.topic}: no marks in {turned:.1f} turns")
    need(
        abs(len(whole.time_ns) - turned) <= 1.5,
        f"{role.topic}: {number_of(len(whole.time_ns), 'mark')} in {turned:.1f} turns",
    )
    steps = np.diff(np.asarray(whole.columns["revolutions"], np.int64))
    need(bool(np.all(steps == 1)), f"{role.topic}: revolutions step by {steps.tolist()}, expected 1")
    time_s = (whole.time_ns - START_NS) * 1e-9
    phase, speed = _at(subject.tape, time_s, 8), _at(subject.tape, time_s, 9)
    late_s = np.array([math.remainder(p - math.radians(role.index_angle_deg), 2 * math.pi) for p in phase]) / speed
    worst = float(np.max(np.abs(late_s[len(late_s) // 3 :])))
    need(worst < _LATE_S, f"{role.topic}: marks up to {worst * 1e3:.1f} ms from index_angle_deg")
    return f"{number_of(len(whole.time_ns), 'mark')}, {worst * 1e3:.1f} ms at most"


def check_speed(subject: Subject) -> str:
    """The reported speed is the rotor's, rpm."""
    role = next((role for role in subject.roles if isinstance(role, SpeedSource)), None)
    if role is None:
        raise NotTried("it turns no rotor")
    time_s, measured = _samples(subject, role.topic, "speed_rpm")
    off = measured - _at(subject.tape, time_s, 9) * TO_RPM
    need(float(np.max(measured)) > 50, "the rotor was commanded to turn, but the reported speed stays low")
    worst = float(np.max(np.abs(off)))
    need(worst < 20.0, f"{role.topic}: the speed reported is up to {worst:.1f} rpm off")
    return f"{worst:.1f} rpm at most"


def _samples(subject: Subject, topic: str, field: str) -> tuple[Array, Array]:
    """Return times in s since the start, and values, of valid readings after the clock map has settled."""
    whole = together(subject.tape.items, topic)
    if whole is None:
        raise Failed(f"{topic}: no samples")
    time_s = (whole.time_ns - START_NS) * 1e-9
    values = np.asarray(whole.columns[field], np.float64)
    readings = np.isfinite(values)
    need(
        bool(readings.mean() > 0.95),
        f"{topic}: {number_of(int(np.sum(~readings)), 'sample is', 'samples are')} not readings, of {len(readings)}",
    )
    kept = readings & (time_s > time_s[0] + _SETTLED_S)
    return time_s[kept], values[kept]


def _at(tape: Tape, time_s: Array, column: int) -> Array:
    return np.interp(time_s, tape.motion_s, tape.motion[:, column])


def _fit(measured: Array, true: Array, rate: Array) -> tuple[float, float, Array]:
    """Fit measured = zero + gain · true(t − lateness); return gain, lateness (s) and residuals."""
    columns = np.column_stack([np.ones_like(true), true, rate])
    solution, *_ = np.linalg.lstsq(columns, measured, rcond=None)
    return float(solution[1]), -float(solution[2] / solution[1]), measured - columns @ solution
