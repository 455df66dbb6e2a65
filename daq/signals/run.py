"""Signals of one run on one clock: the input of identification and analysis.

Every device stamps its samples with its own clock. `load_run` fits one straight line per device over the whole log
(device time → host time, see daq.clock). It returns every signal in seconds since the run's start on the common clock,
with the uncertainty of each device's clock rate. Channels without a device clock (of imported recordings) are already
on the common clock. Gaps are kept: nothing is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import DEVICE_TICK_S, LOCK_A_CLOSED, LOCK_B_CLOSED, suspects
from daq.clock import ClockLine, fit_line
from daq.errors import LogError
from daq.guided_tests.kinds import KINDS, kind_of
from daq.log import Log, open_log
from daq.log.losses import losses_of
from daq.log.outcome import not_reached_of
from daq.log.samples import Samples
from daq.log.snapshot import identities_of, rig_of
from daq.signals.witnesses import Agreement, Witness, agreement
from rig_configs.roles import Displacement, PendulumAngles, Roles, RotorPhase

Array = NDArray[np.float64]

ASSUMED_TOLERANCE_PPM = 50.0
"""Standard uncertainty of the rate of a clock without stated tolerance: ordinary quartz, one year in a laboratory."""


@dataclass(frozen=True)
class Release:
    """Release of a pendulum during the run.

    Attributes:
        pendulum: 0 is A, 1 is B.
        time_s: time since the run's start, s.
        time_std_s: standard uncertainty of the time, s; large if the node's own message was lost and the time was taken
            from the encoder blocks' lock flags.
    """

    pendulum: int
    time_s: float
    time_std_s: float = 1e-4


@dataclass(frozen=True)
class Run:
    """One recorded test. A channel that is not in the log is empty.

    Attributes:
        test: name in the table of test kinds (`daq.guided_tests.kinds`); "point-NAME" for a test at a point.
        source: path of the log, for messages.
        start_s: start of the run, s since 1970; all other times count from it.
        x_time_s, x_m: laser x, shape (n,), disk-centre displacement, m; NaN if the sensor marked the sample as invalid,
            or the line's damage affects it (`daq.channels.suspects`).
        y_time_s, y_m: laser y with its own sample times, shape (m,).
        angle_time_s, angle_rad: pendulum angles θ3, θ4 relative to the rotor, shapes (k,), (k, 2), unwrapped; all
            NaN for a pendulum that was not recorded.
        mark_time_s, mark_phase_rad: tachometer marks and ψ at each (unwrapped, ψ = 0: imbalance along +x).
        releases: releases of pendulums during the run.
        angle_step_rad: quantisation of the angles, rad.
        clock_rate_std: relative standard uncertainty of the rate of each signal's clock: "x", "y", "angles", "phase".
        clock_shared_std: part of that uncertainty that all runs with the same clock share; all of it if not given.
        clocks: clock that stamped each signal, by the same names: that of its device, or the recorder's for an imported
            recording. Signals with the same clock have the same clock error.
        losses: counted losses by "device.kind"; "log.missing_messages" are messages missing in the file itself.
        metadata: facts of the log (rig, point, software version, digest …); "missing" lists the missing parts of the
            file, as sentences.
        phase_time_s, phase_rad: ψ between the marks as well, shape (l,), for recordings that contain it.
        phase_absolute: True if the imbalance points along +x at ψ = 0; False if a speed was integrated, which leaves
            one unknown angle between ψ and the laboratory.
        witnesses: additional sensors along an axis; x and y are from the sensors that the rig file assigns to them.
        turn_deg: angle from the x axis to the sensor of x, and from the y axis to that of y, from the rig file, °. The
            sensors are at right angles, and x and y are their readings.
        motor_start_s: time of the motor's first change of target speed, since the run's start, s; NaN if the target did
            not change or was not recorded.
    """

    test: str
    source: str
    start_s: float
    x_time_s: Array
    x_m: Array
    y_time_s: Array
    y_m: Array
    angle_time_s: Array
    angle_rad: Array
    mark_time_s: Array
    mark_phase_rad: Array
    releases: tuple[Release, ...] = ()
    angle_step_rad: float = 2 * np.pi / 4096
    clock_rate_std: Mapping[str, float] = field(default_factory=dict[str, float])
    clocks: Mapping[str, str] = field(default_factory=dict[str, str])
    losses: Mapping[str, int] = field(default_factory=dict[str, int])
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])
    phase_time_s: Array = field(default_factory=lambda: np.empty(0))
    phase_rad: Array = field(default_factory=lambda: np.empty(0))
    phase_absolute: bool = True
    witnesses: tuple[Witness, ...] = ()
    turn_deg: float = 0.0
    clock_shared_std: Mapping[str, float] = field(default_factory=dict[str, float])
    motor_start_s: float = math.nan

    def agreements(self) -> list[Agreement]:
        """Compare every witness with the sensor that measures along its axis for the rig."""
        measured = {"x": (self.x_time_s, self.x_m), "y": (self.y_time_s, self.y_m)}
        return [agreement(witness, *measured[witness.axis]) for witness in self.witnesses if witness.reference]


def disagreements(run: Run) -> list[str]:
    """Return one sentence for each witness that disagrees with its reference sensor."""
    return [found.text for found in run.agreements() if found.verdict == "disagree"]


def point_of(test: str) -> str:
    """Return the name of the validation point of a test; empty for any other test."""
    kind, _, name = test.partition("-")
    return name if kind in KINDS and kind_of(test) is KINDS[kind] else ""


def load_run(path: str | Path) -> Run:
    """Read one log into signals on the common clock.

    Raises:
        LogError: the file is not a readable log, has no samples or no rig file, or a device restarted in it.
    """
    with open_log(path) as log:
        roles = rig_of(log).roles
        _refuse_restarts(log)
        start_s = _start(log)
        run = log.metadata.get("run", {})
        shared = _shared_clock(log, run) if _is_stamped_elsewhere(log) else _NO_DEVICE
        x, x_line = _laser(log, "laser/x", roles.along("x"), start_s, shared)
        y, y_line = _laser(log, "laser/y", roles.along("y"), start_s, shared)
        angle_line, phase_line = _rotor_lines(log, roles, start_s, shared)
        lines = {"x": x_line, "y": y_line, "angles": angle_line, "phase": phase_line}
        index_rad = math.radians(roles.phase.index_angle_deg) if roles.phase else 0.0
        angle_time_s, angle_rad = _angles(log, angle_line, start_s)
        mark_time_s, mark_phase_rad = _marks(log, phase_line, index_rad, start_s)
        phase_time_s, phase_rad = _phase(log, phase_line, start_s)
        return Run(
            test=run.get("test", "unknown"),
            source=str(path),
            start_s=start_s,
            x_time_s=x[0],
            x_m=x[1],
            y_time_s=y[0],
            y_m=y[1],
            angle_time_s=angle_time_s,
            angle_rad=angle_rad,
            mark_time_s=mark_time_s,
            mark_phase_rad=mark_phase_rad,
            phase_time_s=phase_time_s,
            phase_rad=phase_rad,
            phase_absolute=run.get("phase_reference") != "none",
            witnesses=_witnesses(log, roles, start_s),
            turn_deg=roles.turn_deg,
            releases=_releases(log, angle_line, start_s),
            angle_step_rad=roles.angles.step_rad if roles.angles else Run.angle_step_rad,
            clock_rate_std={name: line.rate_std for name, line in lines.items()},
            clock_shared_std={name: line.shared_std for name, line in lines.items()},
            clocks={
                name: _recorder(run) if line is shared is not _NO_DEVICE else _device(roles, name) or name
                for name, line in lines.items()
            },
            losses=losses_of(log).flat,
            motor_start_s=_motor_start(log, start_s),
            metadata={
                **run,
                "identities": identities_of(log),
                "complete": log.complete,
                "missing": [str(place) for place in log.missing],
                "not_reached": not_reached_of(log),
            },
        )


_CHANNELS = ("laser/x", "laser/y", "pendulums", "tacho")
_LOCK_FLAGS = (LOCK_A_CLOSED, LOCK_B_CLOSED)
_NO_DEVICE = ClockLine(0.0, 0.0, 0.0, 0.0, 0.0)


def _refuse_restarts(log: Log) -> None:
    restarted = sorted({e["device"] for e in log.events if e["kind"] == "restart"})
    if restarted:
        raise LogError(
            f"{log.path}: {', '.join(restarted)} restarted during this log, so its clock is not continuous. "
            "Repeat the test; the samples themselves can be read with open_log"
        )


def _samples(log: Log, topic: str) -> Samples | None:
    """Return the samples of a channel; None if the log has none."""
    if topic not in log:
        return None
    samples = log[topic]
    return samples if len(samples) else None


def _start(log: Log) -> float:
    """Return the time of the earliest sample, whole seconds since 1970."""
    found = [samples.log_time_ns[0] for samples in (_samples(log, topic) for topic in _CHANNELS) if samples is not None]
    if not found:
        raise LogError(f"{log.path}: expected samples in {', '.join(_CHANNELS)}, the log has {list(log) or 'none'}")
    return math.floor(min(found) * 1e-9)


def _is_stamped_elsewhere(log: Log) -> bool:
    """Return True if any channel is on the common clock already: it has samples without a device clock."""
    present = [samples for samples in (_samples(log, topic) for topic in _CHANNELS) if samples is not None]
    return any(not {"device_ticks", "node_time_us"} & set(samples.columns) for samples in present)


def _shared_clock(log: Log, run: Mapping[str, str]) -> ClockLine:
    """Return the line of channels that are on the common clock already, with the rate tolerance stated in the log.

    A log without a tolerance, or with 0 that is not marked as stated (from an older import), gets the default
    tolerance.
    """
    text = run.get("clock_tolerance_ppm", "0")
    try:
        tolerance = float(text)
    except ValueError as fault:
        raise LogError(f"{log.path}: expected a number as clock_tolerance_ppm, got {text!r}") from fault
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise LogError(f"{log.path}: expected a number of at least 0 as clock_tolerance_ppm, got {text!r}")
    if tolerance == 0 and run.get("clock_tolerance_from") != "stated":
        tolerance = ASSUMED_TOLERANCE_PPM
    return ClockLine(0.0, 0.0, 1e-6 * tolerance, 0.0, 1e-6 * tolerance)


def _recorder(run: Mapping[str, str]) -> str:
    """Return the clock name of an imported recording; all recordings without a recorder's name share one clock."""
    name = run.get("recorder", "")
    return f"recorder {name}" if name else "recorder"


def _line(device_s: Array, log_ns: NDArray[np.int64], start_s: float, tolerance_ppm: float) -> ClockLine:
    """Fit the clock line through the last sample of every read."""
    last = np.flatnonzero(np.diff(log_ns, append=log_ns[-1] + 1))
    step_s = float(np.median(np.diff(device_s))) if len(device_s) > 1 else 0.0
    return fit_line(device_s[last], _since(log_ns[last], start_s), tolerance_ppm, step_s)


def _since(time_ns: NDArray[np.int64], start_s: float) -> Array:
    """Convert times on the common clock to s since the run's start."""
    return np.asarray((time_ns - int(start_s) * 1_000_000_000) * 1e-9, np.float64)


def _device(roles: Roles, signal: str) -> str:
    """Return the device whose clock stamps a signal; empty if the rig has none."""
    role = roles.along(signal) if signal in ("x", "y") else roles.angles if signal == "angles" else roles.phase
    return "" if role is None else role.device


def _laser(
    log: Log, usual: str, role: Displacement | None, start_s: float, shared: ClockLine
) -> tuple[tuple[Array, Array], ClockLine]:
    """Return times and displacements along an axis, and the clock line of the times.

    Args:
        usual: channel of imported displacements, used if the rig has no sensor along the axis.
    """
    samples = _samples(log, role.topic if role else usual)
    if samples is None:
        return (np.empty(0), np.empty(0)), shared
    displacement = samples.displacement_m
    if "flags" in samples:  # logs of earlier versions have no flags
        displacement = np.where(suspects(samples.flags), np.nan, displacement)
    if "device_ticks" not in samples.columns:
        return (_since(samples.time_ns, start_s), displacement), shared
    device_s = samples.device_ticks * DEVICE_TICK_S
    line = _line(device_s, samples.log_time_ns, start_s, _tolerance_ppm(role))
    return (np.asarray(line.host_s(device_s), np.float64), displacement), line


def _motor_start(log: Log, start_s: float) -> float:
    """Return the time at which the motor's target speed first differs from that at the log's start."""
    samples = _samples(log, "motor")
    if samples is None or "target_rpm" not in samples.columns:
        return math.nan
    changed = np.flatnonzero(samples.target_rpm != samples.target_rpm[0])
    return float(_since(samples.time_ns[changed[0]], start_s)) if len(changed) else math.nan


def _witnesses(log: Log, roles: Roles, start_s: float) -> tuple[Witness, ...]:
    """Return the witnesses that have samples in the log; imported recordings have none."""
    found: list[Witness] = []
    for role in roles.witnesses:
        (time_s, value_m), _ = _laser(log, role.topic, role, start_s, _NO_DEVICE)
        main = roles.beside(role)
        if len(time_s):
            gain_std = math.hypot(role.gain_std, main.gain_std if main else 0.0)
            times, values = np.asarray(time_s, np.float64), np.asarray(value_m, np.float64)
            reference = main.device if main else ""
            found.append(Witness(role.device, role.axis, reference, times, values, gain_std))
    return tuple(found)


def _rotor_lines(log: Log, roles: Roles, start_s: float, shared: ClockLine) -> tuple[ClockLine, ClockLine]:
    """Return the clocks of the pendulum angles and of the rotor's phase: one line if one device stamps both."""
    angles = _node_line(log, "pendulums", roles.angles, start_s)
    phase = _node_line(log, "tacho", roles.phase, start_s)
    if _device(roles, "angles") == _device(roles, "phase"):
        angles = phase = angles or phase  # angles are sampled continuously, marks once per turn
    return angles or shared, phase or shared


def _node_line(log: Log, usual: str, role: PendulumAngles | RotorPhase | None, start_s: float) -> ClockLine | None:
    """Return the clock of a channel that contains its device's time; None if it does not."""
    samples = _samples(log, role.topic if role else usual)
    if samples is None or "node_time_us" not in samples.columns:
        return None
    return _line(samples.node_time_us * 1e-6, samples.log_time_ns, start_s, _tolerance_ppm(role))


def _tolerance_ppm(role: Displacement | PendulumAngles | RotorPhase | None) -> float:
    return ASSUMED_TOLERANCE_PPM if role is None else role.clock_tolerance_ppm


def _node_s(samples: Samples, line: ClockLine, start_s: float) -> Array:
    """Return the times of the node's samples: by its own clock, or by the common one if they have no device time."""
    if "node_time_us" in samples.columns:
        return np.asarray(line.host_s(samples.node_time_us * 1e-6), np.float64)
    return _since(samples.time_ns, start_s)


def _angles(log: Log, line: ClockLine, start_s: float) -> tuple[Array, Array]:
    """Return times and both angles, without the instants at which one of two recorded pendulums has no reading."""
    samples = _samples(log, "pendulums")
    if samples is None:
        return np.empty(0), np.empty((0, 2))
    angles = np.column_stack([samples.theta3_rad, samples.theta4_rad])
    present = np.isfinite(angles)
    whole = present[:, present.any(axis=0)].all(axis=1)
    return _node_s(samples, line, start_s)[whole], angles[whole]


def _marks(log: Log, line: ClockLine, index_rad: float, start_s: float) -> tuple[Array, Array]:
    """Return times and phases of the index marks, or of the whole turns if the log contains the phase itself."""
    samples = _samples(log, "tacho")
    if samples is None:
        return np.empty(0), np.empty(0)
    times = _node_s(samples, line, start_s)
    if "phase_rad" in samples.columns:
        return _whole_turns(times, samples.phase_rad)
    return times, 2 * np.pi * samples.revolutions.astype(float) + index_rad


def _phase(log: Log, line: ClockLine, start_s: float) -> tuple[Array, Array]:
    """Return times and values of the rotor's phase, if the log contains it in every row."""
    samples = _samples(log, "tacho")
    if samples is None or "phase_rad" not in samples.columns:
        return np.empty(0), np.empty(0)
    good = np.isfinite(samples.phase_rad)
    return _node_s(samples, line, start_s)[good], samples.phase_rad[good]


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


def _releases(log: Log, line: ClockLine, start_s: float) -> tuple[Release, ...]:
    """Return the releases from the node's messages, or from the encoder blocks' lock flags if a message was lost.

    One command releases both pendulums at once. If the flags change in the same block, a message about one pendulum
    gives the time of both.
    """
    reported = {
        int(e["pendulum"]): _reported_release(e, line, start_s)
        for e in log.events
        if e["kind"] == "lock" and e["state"] == "released"
    }
    seen = _seen_releases(log, line)
    releases: list[Release] = []
    for pendulum in sorted(set(reported) | set(seen)):
        other = 1 - pendulum
        if pendulum in reported:
            releases.append(reported[pendulum])
        elif other in reported and seen.get(other) == seen[pendulum]:
            releases.append(Release(pendulum, reported[other].time_s))
        else:
            releases.append(Release(pendulum, *seen[pendulum]))
    return tuple(releases)


def _reported_release(event: Mapping[str, Any], line: ClockLine, start_s: float) -> Release:
    """Return a release from the node's message, or from the import of the recording."""
    if "node_time_us" in event:
        return Release(int(event["pendulum"]), float(line.host_s(np.array([event["node_time_us"] * 1e-6]))[0]))
    time_s = float(_since(np.array([event["time_ns"]], np.int64), start_s)[0])
    return Release(int(event["pendulum"]), time_s, float(event.get("time_std_s", Release.time_std_s)))


def _seen_releases(log: Log, line: ClockLine) -> dict[int, tuple[float, float]]:
    """Return time and its standard uncertainty by pendulum, from the encoder blocks' lock flags."""
    samples = _samples(log, "pendulums")
    if samples is None or "flags" not in samples.columns:
        return {}
    seen: dict[int, tuple[float, float]] = {}
    for pendulum, flag in enumerate(_LOCK_FLAGS):
        closed = (samples.flags & flag) != 0
        opened = np.flatnonzero(closed[:-1] & ~closed[1:])
        if len(opened):
            i = int(opened[-1])
            before, after = line.host_s(samples.node_time_us[i : i + 2] * 1e-6)
            # flags are a block's state when it is sent: the lock opened within the block before `after`, or in a gap
            blocks = np.unique(samples.log_time_ns, return_counts=True)[1]
            block = int(np.percentile(blocks, 5))  # a read has one or more
            last = min(i + max(1, block), len(samples) - 1)
            end = after + (samples.node_time_us[last] - samples.node_time_us[i + 1]) * 1e-6
            seen[pendulum] = (0.5 * (before + end), (end - before) / math.sqrt(12))
    return seen
