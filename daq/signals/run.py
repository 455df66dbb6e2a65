"""Signals of one run on one clock: the input of identification and analysis.

Every device stamps its samples with its own clock. `load_run` fits one straight line per device over the whole log
(device time → host time, see daq.clock). It returns every signal in seconds since the run's start on the common clock,
with the uncertainty of each device's clock rate. Channels without a device clock (of imported recordings) are already
on the common clock. Gaps are kept: nothing is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from daq.errors import LogError
from daq.log import Log, open_log
from daq.log.losses import losses_of
from daq.log.outcome import not_reached_of
from daq.log.snapshot import identities_of, rig_of
from daq.log.time_span import TimeSpan
from daq.signals.possible_displacement import refuse_impossible
from daq.signals.releases import Release, releases_of
from daq.signals.rotor_doubts import RotorDoubt, doubts_of_events
from daq.signals.run_channels import angle_signal, driven_speed, laser_signal, mark_signal, motor_start, phase_signal
from daq.signals.run_clocks import (
    NO_DEVICE,
    device_of,
    is_stamped_elsewhere,
    recorder_name,
    rotor_lines,
    shared_clock,
    start_of,
)
from daq.signals.speed_agreement import SpeedAgreement, speed_agreement
from daq.signals.witnesses import Witness, WitnessAgreement, agreement
from rig_basics.arrays import Array
from rig_basics.times import checked_times
from rig_configs.roles import Roles

__all__ = ["Release", "Run", "disagreements", "load_run"]

_WHOLE = TimeSpan()


@dataclass(frozen=True)
class Run:
    """One recorded test. A channel that is not in the log is empty.

    Attributes:
        test: name in the table of test kinds (`daq.guided_test_kinds`); "point-NAME" for a test at a point.
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
            file, as sentences; "part" is the part of the log, if it is not the whole.
        phase_time_s, phase_rad: ψ between the marks as well, shape (l,), for recordings that contain it.
        phase_absolute: True if the imbalance points along +x at ψ = 0; False if a speed was integrated, which leaves
            one unknown angle between ψ and the laboratory.
        witnesses: additional sensors along an axis; x and y are from the sensors that the rig file assigns to them.
        turn_deg: angle from the x axis to the sensor of x, and from the y axis to that of y, from the rig file, °. The
            sensors are at right angles, and x and y are their readings.
        motor_start_s: time of the motor's first change of target speed, since the run's start, s; NaN if the target did
            not change or was not recorded.
        speed: agreement of the drive's reports with the index marks while a speed is commanded; None if they cannot be
            compared.
        rotor_doubts: contradictions of marks and times, by the log's events and by the marks themselves. Bounces and
            turns that were not counted are corrected in `mark_time_s` and `mark_phase_rad`.
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
    speed: SpeedAgreement | None = None
    rotor_doubts: tuple[RotorDoubt, ...] = ()

    @classmethod
    def of_arrays(
        cls,
        test: str,
        *,
        x: tuple[ArrayLike, ArrayLike] | None = None,
        y: tuple[ArrayLike, ArrayLike] | None = None,
        angles: tuple[ArrayLike, ArrayLike] | None = None,
        marks: tuple[ArrayLike, ArrayLike] | None = None,
        released_s: Sequence[float] = (),
        angle_step_rad: float = 2 * np.pi / 4096,
    ) -> Run:
        """Create a run from arrays on one clock, for the fits of identification and the functions of analysis.

        Args:
            test: name in the table of test kinds; "point-NAME" for a release at a point.
            x, y: times, s, and displacements of the disk's centre, m, shape (n,) each; None without.
            angles: times, s, shape (k,), and angles of A and B relative to the rotor, rad, shape (k, 2).
            marks: times, s, and the rotor's phase ψ, rad, unwrapped (ψ = 0: imbalance along +x), shape (m,) each.
            released_s: instants at which A and B were released, s; empty without.
            angle_step_rad: quantisation of the angles, rad.
        Raises:
            ValueError: times are dates or run backwards, or a signal has another shape.
        """
        x, y, marks = (_checked(name, pair, ()) for name, pair in (("x", x), ("y", y), ("marks", marks)))
        releases = tuple(Release(pendulum, instant) for pendulum, instant in enumerate(released_s))
        signals = (*x, *y, *_checked("angles", angles, (2,)), *marks)
        clocks: dict[str, str] = dict.fromkeys(("x", "y", "angles", "phase"), "arrays")
        return cls(test, test, 0.0, *signals, releases=releases, angle_step_rad=angle_step_rad, clocks=clocks)

    def agreements(self) -> list[WitnessAgreement]:
        """Compare every witness with the sensor that measures along its axis for the rig."""
        measured = {"x": (self.x_time_s, self.x_m), "y": (self.y_time_s, self.y_m)}
        return [agreement(witness, *measured[witness.axis]) for witness in self.witnesses if witness.reference]


def _checked(name: str, pair: tuple[ArrayLike, ArrayLike] | None, each: tuple[int, ...]) -> tuple[Array, Array]:
    """Return times (n,) and values (n, *each) of a signal; empty ones for None."""
    if pair is None:
        return np.empty(0), np.empty((0, *each))
    time, values = checked_times(pair[0], ValueError), np.asarray(pair[1], np.float64)
    if values.shape != (len(time), *each):
        raise ValueError(f"{name}: expected values of shape {(len(time), *each)} for the times, got {values.shape}")
    return time, values


def disagreements(run: Run) -> list[str]:
    """Return one sentence for each witness that disagrees with its reference, and for a drive with the index marks."""
    doubts = [run.speed.words] if run.speed is not None and not run.speed.agrees else []
    return [*doubts, *(found.text for found in run.agreements() if found.verdict == "disagree")]


def load_run(path: str | Path, span: TimeSpan = _WHOLE) -> Run:
    """Read one log, or a part of it, into signals on the common clock.

    Args:
        path: the log.
        span: the part, s since the log's start.
    Raises:
        LogError: the file is not a readable log, has no samples or no rig file, a device restarted in it, or its
            displacements are larger than the sensors can measure.
    """
    with open_log(path) as whole:
        log = whole if span.is_whole else whole.between(*span.ns(whole.start_ns))
        rig = rig_of(log)
        roles = rig.roles
        _refuse_restarts(log)
        start_s = start_of(log)
        run = log.metadata.get("run", {})
        shared = shared_clock(log, run) if is_stamped_elsewhere(log) else NO_DEVICE
        x, x_line = laser_signal(log, "laser/x", roles.along("x"), start_s, shared)
        y, y_line = laser_signal(log, "laser/y", roles.along("y"), start_s, shared)
        refuse_impossible(str(path), "x", x[1], roles.along("x"), rig)
        refuse_impossible(str(path), "y", y[1], roles.along("y"), rig)
        own = [(axis, line) for axis, line in (("x", x_line), ("y", y_line)) if line is not shared]
        lasers = {device_of(roles, axis): line for axis, line in own}
        angle_line, phase_line = rotor_lines(log, roles, start_s, shared, lasers)
        lines = {"x": x_line, "y": y_line, "angles": angle_line, "phase": phase_line}
        index_rad = math.radians(roles.phase.index_angle_deg) if roles.phase else 0.0
        angle_time_s, angle_rad = angle_signal(log, angle_line, start_s)
        mark_time_s, mark_phase_rad, doubts = mark_signal(log, phase_line, index_rad, start_s)
        reported = doubts_of_events(log, roles.phase.device, start_s) if roles.phase else ()
        phase_time_s, phase_rad = phase_signal(log, phase_line, start_s)
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
            releases=releases_of(log, angle_line, start_s),
            angle_step_rad=roles.angles.step_rad if roles.angles else Run.angle_step_rad,
            clock_rate_std={name: line.rate_std for name, line in lines.items()},
            clock_shared_std={name: line.shared_std for name, line in lines.items()},
            clocks={
                name: recorder_name(run) if line is shared is not NO_DEVICE else device_of(roles, name) or name
                for name, line in lines.items()
            },
            losses=losses_of(log).flat,
            rotor_doubts=(*reported, *doubts),
            motor_start_s=motor_start(log, start_s),
            speed=speed_agreement(mark_time_s, mark_phase_rad / (2 * np.pi), *driven_speed(log, roles, start_s)),
            metadata={
                **run,
                "identities": identities_of(log),
                "complete": log.complete,
                "missing": [str(place) for place in log.missing],
                "not_reached": not_reached_of(log),
                **({} if span.is_whole else {"part": str(span)}),
            },
        )


def _refuse_restarts(log: Log) -> None:
    restarted = sorted({e["device"] for e in log.events if e["kind"] == "restart"})
    if restarted:
        raise LogError(
            f"{log.path}: {', '.join(restarted)} restarted during this log, so its clock is not continuous. "
            "Repeat the test; the samples themselves can be read with open_log"
        )


def _witnesses(log: Log, roles: Roles, start_s: float) -> tuple[Witness, ...]:
    """Return the witnesses that have samples in the log; imported recordings have none."""
    found: list[Witness] = []
    for role in roles.witnesses:
        (time_s, value_m), _ = laser_signal(log, role.topic, role, start_s, NO_DEVICE)
        main = roles.measuring_sensor(role)
        if len(time_s):
            gain_std = math.hypot(role.gain_std, main.gain_std if main else 0.0)
            times, values = np.asarray(time_s, np.float64), np.asarray(value_m, np.float64)
            reference = main.device if main else ""
            found.append(Witness(role.device, role.axis, reference, times, values, gain_std))
    return tuple(found)
