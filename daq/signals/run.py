"""One run's signals on one clock: what identification and analysis work on.

Every device stamps its samples with its own clock. `load_run` fits one straight line per device over the whole log
(device time → host time, see daq.clock) and gives every signal in seconds since the run's start on the common
clock, with the uncertainty of each device's clock rate. Channels without a device's clock (of recordings made
elsewhere) are on the common clock already. Gaps stay gaps: nothing is filled in.
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

ASSUMED_TOLERANCE_PPM = 50.0
"""Standard uncertainty of the rate of a clock of which nothing is said: an ordinary quartz over a laboratory's year."""


@dataclass(frozen=True)
class Release:
    """A pendulum let go during the run.

    Attributes:
        pendulum: 0 is A, 1 is B.
        time_s: since the run's start.
        time_std_s: its standard uncertainty; large when the node's own message was lost and the encoder blocks'
            lock flags had to tell.
    """

    pendulum: int
    time_s: float
    time_std_s: float = 1e-4


@dataclass(frozen=True)
class Run:
    """One recorded test. A channel the log does not have is empty.

    Attributes:
        test: its name in the table of test kinds (`daq.guided_tests.kinds`); at a point "point-NAME".
        source: the log's path, for messages.
        start_s: the run's start in seconds since 1970; every other time counts from it.
        x_time_s, x_m: laser x, shape (n,), disk-centre displacement; NaN where the sensor said "invalid"
            and where the line's damage shows (`daq.channels.suspects`).
        y_time_s, y_m: laser y, its own samples, shape (m,).
        angle_time_s, angle_rad: pendulum angles θ3, θ4 relative to the rotor, shapes (k,), (k, 2), unwrapped; all
            NaN for a pendulum that was not recorded.
        mark_time_s, mark_phase_rad: tachometer marks and ψ at each (unwrapped, ψ = 0: imbalance along +x).
        releases: pendulums let go during the run.
        angle_step_rad: quantisation of the angles, rad.
        clock_rate_std: relative standard uncertainty of the rate of each signal's clock: "x", "y", "angles", "phase".
        clock_shared_std: what of that every run of the same clock has alike; all of it where none is given.
        clocks: which clock stamped each signal, by the same names: its device's, or the recorder's of a recording made
            elsewhere. What shares a clock shares its error.
        losses: counted losses by "device.kind"; "log.missing_messages" are those the file itself lacks.
        metadata: the log's own facts (rig, point, software version, digest …); "missing" lists what the file lacks,
            sentences.
        phase_time_s, phase_rad: ψ between the marks too, shape (l,), where a recording has it.
        phase_absolute: whether ψ = 0 is where the imbalance points along +x; False where a speed was integrated, which
            leaves one unknown angle between ψ and the laboratory.
        witnesses: further sensors along an axis; x and y are those of the sensors that measure for the rig.
        turn_deg: by the rig file, from the x axis to the sensor of x, and from y to that of y: these stand at right
            angles, and x and y are what they see.
        motor_start_s: when the motor was first told to turn faster or slower, since the run's start; nan where it was
            not, or nothing recorded it.
    """

    test: str
    source: str
    start_s: float
    x_time_s: np.ndarray
    x_m: np.ndarray
    y_time_s: np.ndarray
    y_m: np.ndarray
    angle_time_s: np.ndarray
    angle_rad: np.ndarray
    mark_time_s: np.ndarray
    mark_phase_rad: np.ndarray
    releases: tuple[Release, ...] = ()
    angle_step_rad: float = 2 * np.pi / 4096
    clock_rate_std: Mapping[str, float] = field(default_factory=dict)
    clocks: Mapping[str, str] = field(default_factory=dict)
    losses: Mapping[str, int] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)
    phase_time_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    phase_rad: np.ndarray = field(default_factory=lambda: np.empty(0))
    phase_absolute: bool = True
    witnesses: tuple[Witness, ...] = ()
    turn_deg: float = 0.0
    clock_shared_std: Mapping[str, float] = field(default_factory=dict)
    motor_start_s: float = math.nan

    def agreements(self) -> list[Agreement]:
        """Every witness held against the sensor that measures along its axis for the rig."""
        beside = {"x": (self.x_time_s, self.x_m), "y": (self.y_time_s, self.y_m)}
        return [agreement(witness, *beside[witness.axis]) for witness in self.witnesses if witness.beside]


def disagreements(run: Run) -> list[str]:
    """A sentence for each witness that does not show what the sensor beside it shows."""
    return [found.text for found in run.agreements() if found.verdict == "disagree"]


def point_of(test: str) -> str:
    """Name of the validation point that a test is run at; empty for any other test."""
    kind, _, name = test.partition("-")
    return name if kind in KINDS and kind_of(test) is KINDS[kind] else ""


def load_run(path: str | Path) -> Run:
    """Read one log into signals on the common clock.

    Raises:
        LogError: not a readable log, one without samples or without its rig file, or one in which a device restarted.
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
            f"{log.path}: {', '.join(restarted)} restarted during this log, so its clock does not run through. "
            "Repeat the test; the samples themselves can be read with open_log"
        )


def _samples(log: Log, topic: str) -> Samples | None:
    """Samples of a channel; None when the log has none."""
    if topic not in log:
        return None
    samples = log[topic]
    return samples if len(samples) else None


def _start(log: Log) -> float:
    """The earliest sample, whole seconds since 1970."""
    found = [samples.log_time_ns[0] for samples in (_samples(log, topic) for topic in _CHANNELS) if samples is not None]
    if not found:
        raise LogError(f"{log.path}: expected samples in {', '.join(_CHANNELS)}, the log has {list(log) or 'none'}")
    return math.floor(min(found) * 1e-9)


def _is_stamped_elsewhere(log: Log) -> bool:
    """Whether any channel is on the common clock already: it has samples, but no device's clock in them."""
    there = [samples for samples in (_samples(log, topic) for topic in _CHANNELS) if samples is not None]
    return any(not {"device_ticks", "node_time_us"} & set(samples.columns) for samples in there)


def _shared_clock(log: Log, run: Mapping[str, str]) -> ClockLine:
    """The line of channels that are on the common clock already: its rate is as good as the log says.

    A log that does not say, or says 0 without saying that this was stated (imported before that was asked for), has
    no exact clock: it has one that nothing is known of.
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
    """The clock of a recording made elsewhere: recordings that do not name their recorder count as one recorder's."""
    name = run.get("recorder", "")
    return f"recorder {name}" if name else "recorder"


def _line(device_s: NDArray[np.floating], log_ns: NDArray[np.int64], start_s: float, tolerance_ppm: float) -> ClockLine:
    """Clock line through the last sample of every read."""
    last = np.flatnonzero(np.diff(log_ns, append=log_ns[-1] + 1))
    step_s = float(np.median(np.diff(device_s))) if len(device_s) > 1 else 0.0
    return fit_line(device_s[last], _since(log_ns[last], start_s), tolerance_ppm, step_s)


def _since(time_ns: NDArray[np.int64], start_s: float) -> NDArray[np.floating]:
    """Times on the common clock in s since the run's start."""
    return (time_ns - int(start_s) * 1_000_000_000) * 1e-9


def _device(roles: Roles, signal: str) -> str:
    """Which device's clock stamps a signal; empty where the rig has none."""
    role = roles.along(signal) if signal in ("x", "y") else roles.angles if signal == "angles" else roles.phase
    return "" if role is None else role.device


def _laser(
    log: Log, usual: str, role: Displacement | None, start_s: float, shared: ClockLine
) -> tuple[tuple[NDArray[np.floating], NDArray[np.floating]], ClockLine]:
    """Times and displacements along an axis, and the line that made the times.

    Args:
        usual: the channel where the rig has no such sensor and the log has its displacements: made elsewhere.
    """
    samples = _samples(log, role.topic if role else usual)
    if samples is None:
        return (np.empty(0), np.empty(0)), shared
    displacement = samples.displacement_m
    if "flags" in samples:  # not in an earlier version's logs
        displacement = np.where(suspects(samples.flags), np.nan, displacement)
    if "device_ticks" not in samples.columns:
        return (_since(samples.time_ns, start_s), displacement), shared
    device_s = samples.device_ticks * DEVICE_TICK_S
    line = _line(device_s, samples.log_time_ns, start_s, _tolerance_ppm(role))
    return (line.host_s(device_s), displacement), line


def _motor_start(log: Log, start_s: float) -> float:
    """When the motor's target first became another than at the log's begin."""
    samples = _samples(log, "motor")
    if samples is None or "target_rpm" not in samples.columns:
        return math.nan
    changed = np.flatnonzero(samples.target_rpm != samples.target_rpm[0])
    return float(_since(samples.time_ns[changed[0]], start_s)) if len(changed) else math.nan


def _witnesses(log: Log, roles: Roles, start_s: float) -> tuple[Witness, ...]:
    """Those with samples in the log; a recording made elsewhere has none."""
    found: list[Witness] = []
    for role in roles.witnesses:
        (time_s, value_m), _ = _laser(log, role.topic, role, start_s, _NO_DEVICE)
        main = roles.beside(role)
        if len(time_s):
            gain_std = math.hypot(role.gain_std, main.gain_std if main else 0.0)
            times, values = np.asarray(time_s, np.float64), np.asarray(value_m, np.float64)
            found.append(Witness(role.device, role.axis, main.device if main else "", times, values, gain_std))
    return tuple(found)


def _rotor_lines(log: Log, roles: Roles, start_s: float, shared: ClockLine) -> tuple[ClockLine, ClockLine]:
    """The clocks of the pendulums' angles and of the rotor's phase: one line where one device stamps both."""
    angles = _node_line(log, "pendulums", roles.angles, start_s)
    phase = _node_line(log, "tacho", roles.phase, start_s)
    if _device(roles, "angles") == _device(roles, "phase"):
        angles = phase = angles or phase  # the angles come all the time, the marks once a turn
    return angles or shared, phase or shared


def _node_line(log: Log, usual: str, role: PendulumAngles | RotorPhase | None, start_s: float) -> ClockLine | None:
    """The clock of a channel that bears its device's time; None where it bears none."""
    samples = _samples(log, role.topic if role else usual)
    if samples is None or "node_time_us" not in samples.columns:
        return None
    return _line(samples.node_time_us * 1e-6, samples.log_time_ns, start_s, _tolerance_ppm(role))


def _tolerance_ppm(role: Displacement | PendulumAngles | RotorPhase | None) -> float:
    return ASSUMED_TOLERANCE_PPM if role is None else role.clock_tolerance_ppm


def _node_s(samples: Samples, line: ClockLine, start_s: float) -> NDArray[np.floating]:
    """Times of the node's samples: by its own clock, or by the common one where they have none."""
    if "node_time_us" in samples.columns:
        return line.host_s(samples.node_time_us * 1e-6)
    return _since(samples.time_ns, start_s)


def _angles(log: Log, line: ClockLine, start_s: float) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Times and both angles; without the instants at which one of two recorded pendulums has no reading."""
    samples = _samples(log, "pendulums")
    if samples is None:
        return np.empty(0), np.empty((0, 2))
    angles = np.column_stack([samples.theta3_rad, samples.theta4_rad])
    there = np.isfinite(angles)
    whole = there[:, there.any(axis=0)].all(axis=1)
    return _node_s(samples, line, start_s)[whole], angles[whole]


def _marks(
    log: Log, line: ClockLine, index_rad: float, start_s: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Times and phases of the index marks; where the log has the phase itself, of its whole turns."""
    samples = _samples(log, "tacho")
    if samples is None:
        return np.empty(0), np.empty(0)
    times = _node_s(samples, line, start_s)
    if "phase_rad" in samples.columns:
        return _whole_turns(times, samples.phase_rad)
    return times, 2 * np.pi * samples.revolutions.astype(float) + index_rad


def _phase(log: Log, line: ClockLine, start_s: float) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Times and values of the rotor's phase, where the log has it in every row."""
    samples = _samples(log, "tacho")
    if samples is None or "phase_rad" not in samples.columns:
        return np.empty(0), np.empty(0)
    good = np.isfinite(samples.phase_rad)
    return _node_s(samples, line, start_s)[good], samples.phase_rad[good]


def _whole_turns(
    time_s: NDArray[np.floating], phase_rad: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Where a phase first passes each whole turn, on the straight line between two samples."""
    good = np.isfinite(phase_rad)
    turns = phase_rad[good] / (2 * np.pi)
    highest = np.maximum.accumulate(turns)
    rising = np.flatnonzero(np.diff(highest, prepend=-np.inf) > 0)
    time_s, turns = time_s[good][rising], turns[rising]
    if len(turns) < 2:
        return np.empty(0), np.empty(0)
    whole = np.arange(math.ceil(turns[0]), math.floor(turns[-1]) + 1)
    return np.interp(whole, turns, time_s), 2 * np.pi * whole


def _releases(log: Log, line: ClockLine, start_s: float) -> tuple[Release, ...]:
    """Releases by the node's own message; where the radio lost it, by the lock flags of the encoder blocks.

    One command lets both go at once: when the flags change in the same block, a message about one tells both.
    """
    told = {
        int(e["pendulum"]): _told_release(e, line, start_s)
        for e in log.events
        if e["kind"] == "lock" and e["state"] == "released"
    }
    seen = _seen_releases(log, line)
    releases: list[Release] = []
    for pendulum in sorted(set(told) | set(seen)):
        other = 1 - pendulum
        if pendulum in told:
            releases.append(told[pendulum])
        elif other in told and seen.get(other) == seen[pendulum]:
            releases.append(Release(pendulum, told[other].time_s))
        else:
            releases.append(Release(pendulum, *seen[pendulum]))
    return tuple(releases)


def _told_release(event: Mapping[str, Any], line: ClockLine, start_s: float) -> Release:
    """A release as the node, or whoever imported the recording, told it."""
    if "node_time_us" in event:
        return Release(int(event["pendulum"]), float(line.host_s(np.array([event["node_time_us"] * 1e-6]))[0]))
    time_s = float(_since(np.array([event["time_ns"]], np.int64), start_s)[0])
    return Release(int(event["pendulum"]), time_s, float(event.get("time_std_s", Release.time_std_s)))


def _seen_releases(log: Log, line: ClockLine) -> dict[int, tuple[float, float]]:
    """Time and its standard uncertainty by pendulum, as the encoder blocks' lock flags show it."""
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
            block = int(
                np.percentile(np.unique(samples.log_time_ns, return_counts=True)[1], 5)
            )  # a read has one or more
            last = min(i + max(1, block), len(samples) - 1)
            end = after + (samples.node_time_us[last] - samples.node_time_us[i + 1]) * 1e-6
            seen[pendulum] = (0.5 * (before + end), (end - before) / math.sqrt(12))
    return seen
