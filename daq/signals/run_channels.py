"""Channels of a log as signals of a run: displacements, angles, marks and phase with their times."""

from __future__ import annotations

import math

import numpy as np

from daq.channels import DEVICE_TICK_S, suspects
from daq.clock import ClockLine
from daq.log import Log
from daq.signals.rotor_doubts import RotorDoubt, sound_marks
from daq.signals.run_clocks import clock_line, node_times, samples_of, since_start
from rig_basics.arrays import Array
from rig_configs.roles import DisplacementSensor, Roles


def laser_signal(
    log: Log, usual: str, role: DisplacementSensor | None, start_s: float, shared: ClockLine
) -> tuple[tuple[Array, Array], ClockLine]:
    """Return times and displacements along an axis, and the clock line of the times.

    Args:
        usual: channel of imported displacements, used if the rig has no sensor along the axis.
    """
    samples = samples_of(log, role.topic if role else usual)
    if samples is None:
        return (np.empty(0), np.empty(0)), shared
    displacement = samples.displacement_m
    if "flags" in samples:  # imported displacements have none
        displacement = np.where(suspects(samples.flags), np.nan, displacement)
    if "device_ticks" not in samples.columns:
        return (since_start(samples.time_ns, start_s), displacement), shared
    device_s = samples.device_ticks * DEVICE_TICK_S
    line = clock_line(device_s, samples.log_time_ns, start_s, role)
    return (np.asarray(line.host_s(device_s), np.float64), displacement), line


def motor_start(log: Log, start_s: float) -> float:
    """Return the time at which the motor's target speed first differs from that at the log's start."""
    samples = samples_of(log, "motor")
    if samples is None or "target_rpm" not in samples.columns:
        return math.nan
    changed = np.flatnonzero(samples.target_rpm != samples.target_rpm[0])
    return float(since_start(samples.time_ns[changed[0]], start_s)) if len(changed) else math.nan


def driven_speed(log: Log, roles: Roles, start_s: float) -> tuple[Array, Array]:
    """Return times and speeds, rpm, of the longest stretch of the drive's reports in which a speed is commanded.

    Before and after it the drive may be off, and its report of a rotor that coasts is no measurement.
    """
    samples = None if roles.speed is None else samples_of(log, roles.speed.topic)
    if samples is None or not {"speed_rpm", "target_rpm"} <= set(samples.columns):
        return np.empty(0), np.empty(0)
    driven = np.isfinite(samples.speed_rpm) & (samples.target_rpm != 0)
    edges = np.flatnonzero(np.diff(np.r_[False, driven, False]))
    if not len(edges):
        return np.empty(0), np.empty(0)
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    stretch = slice(int(edges[2 * longest]), int(edges[2 * longest + 1]))
    times = since_start(samples.time_ns[stretch], start_s)
    return np.asarray(times, np.float64), np.asarray(samples.speed_rpm[stretch], np.float64)


def angle_signal(log: Log, line: ClockLine, start_s: float) -> tuple[Array, Array]:
    """Return times and both angles, without the instants at which one of two recorded pendulums has no reading."""
    samples = samples_of(log, "pendulums")
    if samples is None:
        return np.empty(0), np.empty((0, 2))
    angles = np.column_stack([samples.theta3_rad, samples.theta4_rad])
    present = np.isfinite(angles)
    whole = present[:, present.any(axis=0)].all(axis=1)
    return node_times(samples, line, start_s)[whole], angles[whole]


def mark_signal(
    log: Log, line: ClockLine, index_rad: float, start_s: float
) -> tuple[Array, Array, tuple[RotorDoubt, ...]]:
    """Return times and phases of the index marks, and what contradicts them.

    They are those of the whole turns if the log contains the phase itself.
    """
    samples = samples_of(log, "tacho")
    if samples is None:
        return np.empty(0), np.empty(0), ()
    times = node_times(samples, line, start_s)
    if "phase_rad" in samples.columns:
        return *_whole_turns(times, samples.phase_rad), ()
    return sound_marks(times, 2 * np.pi * samples.revolutions.astype(float) + index_rad)


def phase_signal(log: Log, line: ClockLine, start_s: float) -> tuple[Array, Array]:
    """Return times and values of the rotor's phase, if the log contains it in every row."""
    samples = samples_of(log, "tacho")
    if samples is None or "phase_rad" not in samples.columns:
        return np.empty(0), np.empty(0)
    good = np.isfinite(samples.phase_rad)
    return node_times(samples, line, start_s)[good], samples.phase_rad[good]


def _whole_turns(time_s: Array, phase_rad: Array) -> tuple[Array, Array]:
    """Return where a phase first passes each whole turn, by linear interpolation between two samples."""
    good = np.isfinite(phase_rad)
    turns = phase_rad[good] / (2 * np.pi)
    highest = np.maximum.accumulate(turns)
    rising = np.flatnonzero(np.diff(highest, prepend=-np.inf) > 0)
    time_s, turns = time_s[good][rising], turns[rising]
    if len(turns) < 2:
        return np.empty(0), np.empty(0)
    first, last = math.ceil(float(turns[0])), math.floor(float(turns[-1]))
    whole: Array = np.array(range(first, last + 1), np.float64)
    return np.asarray(np.interp(whole, turns, time_s), np.float64), 2 * np.pi * whole
