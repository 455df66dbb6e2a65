"""Clock lines of a run's channels: device time to seconds since the run's start on the common clock."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daq.clock import ClockLine, fit_line
from daq.errors import LogError
from daq.log import Log
from daq.log.samples import Samples
from rig_basics.arrays import Array
from rig_configs.roles import DisplacementSensor, PendulumAngles, Roles, RotorPhase

ASSUMED_TOLERANCE_PPM = 50.0
"""Standard uncertainty of the rate of a clock without stated tolerance: ordinary quartz, one year in a laboratory."""
CHANNELS = ("laser/x", "laser/y", "pendulums", "tacho")
Timed = DisplacementSensor | PendulumAngles | RotorPhase

NO_DEVICE = ClockLine(0.0, 0.0, 0.0, 0.0, 0.0)
"""Line of channels that are on the common clock already."""


def samples_of(log: Log, topic: str) -> Samples | None:
    """Return the samples of a channel; None if the log has none."""
    if topic not in log:
        return None
    samples = log[topic]
    return samples if len(samples) else None


def start_of(log: Log) -> float:
    """Return the time of the earliest sample, whole seconds since 1970."""
    found = [
        samples.log_time_ns[0] for samples in (samples_of(log, topic) for topic in CHANNELS) if samples is not None
    ]
    if not found:
        others = ", ".join(topic for topic in log if len(log[topic])) or "no channel"
        raise LogError(f"{log.path}: expected samples in one of {', '.join(CHANNELS)}, found samples in {others}")
    return math.floor(min(found) * 1e-9)


def is_stamped_elsewhere(log: Log) -> bool:
    """Return True if any channel is on the common clock already: it has samples without device time."""
    present = [samples for samples in (samples_of(log, topic) for topic in CHANNELS) if samples is not None]
    return any(not {"device_ticks", "node_time_us"} & set(samples.columns) for samples in present)


def shared_clock(log: Log, run: Mapping[str, str]) -> ClockLine:
    """Return the line of channels that are on the common clock already, with the rate tolerance stated in the log.

    A log without a tolerance gets the default one.
    """
    text = run.get("clock_tolerance_ppm", repr(ASSUMED_TOLERANCE_PPM))
    try:
        tolerance = float(text)
    except ValueError as fault:
        raise LogError(f"{log.path}: expected a number as clock_tolerance_ppm, got {text!r}") from fault
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise LogError(f"{log.path}: expected a number of at least 0 as clock_tolerance_ppm, got {text!r}")
    return ClockLine(0.0, 0.0, 1e-6 * tolerance, 0.0, 1e-6 * tolerance)


def recorder_name(run: Mapping[str, str]) -> str:
    """Return the clock name of an imported recording; recordings without a recorder name share one clock."""
    name = run.get("recorder", "")
    return f"recorder {name}" if name else "recorder"


def clock_line(device_s: Array, log_ns: NDArray[np.int64], start_s: float, role: Timed | None) -> ClockLine:
    """Fit the clock line through the last sample of every read, earlier by the least delay of the device's bytes."""
    last = np.flatnonzero(np.diff(log_ns, append=log_ns[-1] + 1))
    step_s = float(np.median(np.diff(device_s))) if len(device_s) > 1 else 0.0
    arrived_s = since_start(log_ns[last], start_s) - (0.0 if role is None else role.least_delay_s)
    return fit_line(device_s[last], arrived_s, tolerance_ppm(role), step_s)


def since_start(time_ns: NDArray[np.int64], start_s: float) -> Array:
    """Convert times on the common clock to s since the run's start."""
    return np.asarray((time_ns - int(start_s) * 1_000_000_000) * 1e-9, np.float64)


def device_of(roles: Roles, signal: str) -> str:
    """Return the device whose clock stamps a signal, with the clock's name if the device has several; empty without
    a device.
    """
    role = roles.along(signal) if signal in ("x", "y") else roles.angles if signal == "angles" else roles.phase
    if isinstance(role, DisplacementSensor) and role.clock:
        return f"{role.device} {role.clock}"
    return "" if role is None else role.device


def rotor_lines(
    log: Log, roles: Roles, start_s: float, shared: ClockLine, lasers: Mapping[str, ClockLine]
) -> tuple[ClockLine, ClockLine]:
    """Return the clocks of the pendulum angles and of the rotor's phase: one line if one device stamps both.

    Args:
        lasers: lines of the displacement sensors by device. A device that also marks the rotor's phase has one clock
            for both, and samples its displacements continuously.
    """
    angles = _node_line(log, "pendulums", roles.angles, start_s)
    phase = lasers.get(device_of(roles, "phase")) or _node_line(log, "tacho", roles.phase, start_s)
    if device_of(roles, "angles") == device_of(roles, "phase"):
        angles = phase = angles or phase  # angles are sampled continuously, marks once per turn
    return angles or shared, phase or shared


def _node_line(log: Log, usual: str, role: PendulumAngles | RotorPhase | None, start_s: float) -> ClockLine | None:
    """Return the clock of a channel that contains its device's time; None if it does not."""
    samples = samples_of(log, role.topic if role else usual)
    if samples is None or "node_time_us" not in samples.columns:
        return None
    return clock_line(samples.node_time_us * 1e-6, samples.log_time_ns, start_s, role)


def tolerance_ppm(role: Timed | None) -> float:
    """Return the tolerance of the rate of a role's clock, ppm; the default without a role."""
    return ASSUMED_TOLERANCE_PPM if role is None else role.clock_tolerance_ppm


def node_times(samples: Samples, line: ClockLine, start_s: float) -> Array:
    """Return the times of the node's samples: by its own clock, or by the common one if they have no device time."""
    if "node_time_us" in samples.columns:
        return np.asarray(line.host_s(samples.node_time_us * 1e-6), np.float64)
    return since_start(samples.time_ns, start_s)
