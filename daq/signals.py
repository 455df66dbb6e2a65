"""One run's signals on one clock: what identification and analysis work on.

Every device stamps its samples with its own clock. `load_run` fits one straight line per device over the whole log
(device time → host time, see daq.clock) and gives every signal in seconds since the run's start on the common
clock, with the uncertainty of each device's clock rate. Gaps stay gaps: nothing is filled in.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.clock import ClockLine, fit_line
from daq.errors import LogError
from daq.log import Log, open_log
from daq.protocols import optoncdt
from rig_configs.schema import Rig


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
    """One recorded test.

    Attributes:
        test: "ring-down-x", "ring-down-y", "spin-down", "run-up" or "point-NAME".
        source: the log's path, for messages.
        start_s: the run's start in seconds since 1970; every other time counts from it.
        x_time_s, x_m: laser x, shape (n,), disk-centre displacement; NaN where the sensor said "invalid".
        y_time_s, y_m: laser y, its own samples, shape (m,).
        angle_time_s, angle_rad: pendulum angles θ3, θ4 relative to the rotor, shapes (k,), (k, 2), unwrapped.
        mark_time_s, mark_phase_rad: tachometer marks and ψ at each (unwrapped, ψ = 0: imbalance along +x).
        releases: pendulums let go during the run.
        angle_step_rad: quantisation of the angles, rad.
        clock_rate_std: relative standard uncertainty of each device's rate ("laser_x", "laser_y", "encoder").
        losses: counted losses by stream, as in the log's summary.
        metadata: the log's own facts (rig, point, software version, digest …).
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
    losses: Mapping[str, int] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)


def load_run(path: str | Path) -> Run:
    """Read one log into signals on the common clock.

    Raises:
        LogError: not a readable log, or one without the channels a run needs.
    """
    with open_log(path) as log:
        rig = Rig.model_validate_json(log.attachments["rig.json"])
        restarted = sorted({e["device"] for e in log.events if e["kind"] == "restart"})
        if restarted:
            raise LogError(
                f"{path}: {', '.join(restarted)} restarted during this log, so its clock does not run through. "
                "Repeat the test; the samples themselves can be read with open_log"
            )
        start_s = _start(log)
        lasers = {
            axis: _laser(log, axis, config.clock_tolerance_ppm, start_s)
            for axis, config in (("x", rig.devices.laser_x), ("y", rig.devices.laser_y))
        }
        angles = log["pendulums"]
        node_s = angles.node_time_us * 1e-6
        line = _line(node_s, angles.log_time_ns, start_s, rig.devices.encoder.clock_tolerance_ppm)
        marks = log["tacho"] if "tacho" in log.topics else None
        releases = _releases(log, line)
        index = math.radians(rig.devices.encoder.index_angle_deg)
        run = log.metadata.get("run", {})
        return Run(
            test=run.get("test", "unknown"),
            source=str(path),
            start_s=start_s,
            x_time_s=lasers["x"][0],
            x_m=lasers["x"][1],
            y_time_s=lasers["y"][0],
            y_m=lasers["y"][1],
            angle_time_s=line.host_s(node_s),
            angle_rad=np.column_stack([angles.theta3_rad, angles.theta4_rad]),
            mark_time_s=np.empty(0) if marks is None else line.host_s(marks.node_time_us * 1e-6),
            mark_phase_rad=np.empty(0) if marks is None else 2 * np.pi * marks.revolutions.astype(float) + index,
            releases=releases,
            angle_step_rad=2 * np.pi / rig.devices.encoder.counts_per_revolution,
            clock_rate_std={
                "laser_x": lasers["x"][2].rate_std,
                "laser_y": lasers["y"][2].rate_std,
                "encoder": line.rate_std,
            },
            losses=_losses(log),
            metadata={**run, "identities": json.loads(log.attachments["identities.json"]), "complete": log.complete},
        )


def _start(log: Log) -> float:
    """The earliest sample, whole seconds since 1970."""
    return math.floor(min(log[t].log_time_ns[0] for t in ("laser/x", "laser/y", "pendulums")) * 1e-9)


def _line(device_s: NDArray[np.floating], log_ns: NDArray[np.int64], start_s: float, tolerance_ppm: float) -> ClockLine:
    """Clock line through the last sample of every read."""
    last = np.flatnonzero(np.diff(log_ns, append=log_ns[-1] + 1))
    host = (log_ns[last] - int(start_s) * 1_000_000_000) * 1e-9
    return fit_line(device_s[last], host, tolerance_ppm)


_LOCK_FLAGS = (0x20, 0x40)


def _releases(log: Log, line: ClockLine) -> tuple[Release, ...]:
    """Releases by the node's own message; where the radio lost it, by the lock flags of the encoder blocks.

    One command lets both go at once: when the flags change in the same block, a message about one tells both.
    """
    told = {
        int(e["pendulum"]): float(line.host_s(np.array([e["node_time_us"] * 1e-6]))[0])
        for e in log.events
        if e["kind"] == "lock" and e["state"] == "released"
    }
    samples = log["pendulums"]
    seen: dict[int, tuple[float, float]] = {}
    for pendulum, flag in enumerate(_LOCK_FLAGS):
        closed = (samples.flags & flag) != 0
        opened = np.flatnonzero(closed[:-1] & ~closed[1:])
        if len(opened):
            i = int(opened[-1])
            before, after = line.host_s(samples.node_time_us[i : i + 2] * 1e-6)
            # flags are a block's state when it is sent: the lock opened within the block before `after`, or in a gap
            end = after + (samples.node_time_us[min(i + 20, len(samples) - 1)] - samples.node_time_us[i + 1]) * 1e-6
            seen[pendulum] = (0.5 * (before + end), (end - before) / math.sqrt(12))
    releases: list[Release] = []
    for pendulum in sorted(set(told) | set(seen)):
        other = 1 - pendulum
        if pendulum in told:
            releases.append(Release(pendulum, told[pendulum]))
        elif other in told and seen.get(other) == seen[pendulum]:
            releases.append(Release(pendulum, told[other]))
        else:
            releases.append(Release(pendulum, *seen[pendulum]))
    return tuple(releases)


def _laser(
    log: Log, axis: str, tolerance_ppm: float, start_s: float
) -> tuple[NDArray[np.floating], NDArray[np.floating], ClockLine]:
    samples = log[f"laser/{axis}"]
    device_s = samples.device_ticks * optoncdt.TICK_S
    line = _line(device_s, samples.log_time_ns, start_s, tolerance_ppm)
    return line.host_s(device_s), samples.displacement_m, line


def _losses(log: Log) -> dict[str, int]:
    """Losses by "device.what", from the summary or, in a cut log, from the last health message."""
    summary = log.metadata.get("summary", {})
    by_device = json.loads(summary["losses"]) if "losses" in summary else {}
    if not by_device and log.health:
        by_device = log.health[-1].get("losses", {})
    return {f"{device}.{what}": int(n) for device, losses in by_device.items() for what, n in losses.items()}
