"""Table of all interlocks: guarded quantity, threshold, deadline and reaction of each.

Constants that several modules use are defined once, here or in the watch that uses them. `daq.acquisition.interlocks`
and its watches evaluate the rows of `CHANNELS`. The session, which owns links, disk and operator, evaluates the rows of
`SESSION`. `docs/interlocks.md` contains the same table; a test compares them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from daq.acquisition.channel_watch import HOST_S
from daq.acquisition.exceedance import TOGETHER
from daq.acquisition.least_motion import MOMENT_SHARE, RUN_OUT_M
from daq.acquisition.locked_watch import MOVED_S, SETTLE_S
from daq.acquisition.motion_watch import BEATS, STUCK_M, SWING_M, TURNS, WINDOW_S
from daq.acquisition.recorder import BACKLOG_BYTES
from daq.acquisition.rotor_watch import DISAGREE, OVERSPEED, RADIO_S, ROWS_BEYOND, RUNAWAY, TURNS_UNSEEN
from rig_configs.roles import DisplacementSensor, PendulumAngles, PendulumLocks, Roles, RotorPhase, SpeedSource
from rig_configs.schema import Limits

LOOK_S = 0.1
"""Period of `Interlocks.tick`, live and in a replay, s."""
TOGETHER_S = 0.3
"""Time after the first reason of a trip within which further reasons belong to the same trip, s."""
DISPLACEMENT_S, ANGLES_S, SPEED_S = 0.3, 1.0, 0.3
"""Longest permitted time without a sample while the rotor turns, s."""
AT_REST_S = 2.0
"""Longest permitted time without a sample at rest, for a channel that the test needs, s."""
BLIND_S = 0.25
"""Time over which more than half of the samples must be invalid, s of samples; a flash of light is shorter."""
GONE_SAMPLES = 5
"""Number of consecutive invalid samples after a large displacement that means "out of sight"."""
LARGE = 0.7
"""Displacement that counts as large, as a share of the amplitude limit."""
FAULTY_S = 0.1
"""Time over which more than half of the samples must have a fault flag, s of samples."""
LINE_S = 2.0
"""Longest permitted time without a byte of a device, s."""

Judge = Literal["channels", "session"]
_STOP = "rotor stopped, test ended"
_CONTINUES = "reported and recorded, exit 3; the run continues"
_REOPENED = f"{_CONTINUES}, the device is reopened"
_REPORT = "report of the device"


@dataclass(frozen=True)
class Interlock:
    """One row of the table.

    Attributes:
        name: name of the interlock in a trip.
        guards: monitored quantity.
        threshold: condition of the trip, with units. `limits.NAME` stands for the value in the rig file.
        source: source of the threshold: keys of the rig file's limits, "constant", or a device.
        deadline: delay between the fault and the reaction.
        reaction: reaction to the trip.
        role: role that a device of the rig must have; empty if none is required.
        judge: "channels" for interlocks that a replay of a log can evaluate again, "session" for the others.
    """

    name: str
    guards: str
    threshold: str
    source: str
    deadline: str
    reaction: str = _STOP
    role: str = ""
    judge: Judge = "channels"

    def threshold_of(self, limits: Limits) -> str:
        """Return the threshold with the limits of a rig."""
        amplitude, speed = f"{limits.amplitude_m * 1e3:g} mm", f"{limits.speed_rpm:g} rpm"
        return self.threshold.replace("limits.amplitude_m", amplitude).replace("limits.speed_rpm", speed)

    def has_role(self, roles: Roles) -> bool:
        """Return whether a rig has the devices that the interlock needs."""
        played: dict[str, object] = {
            "": True,
            DisplacementSensor.role: roles.displacements,
            PendulumAngles.role: roles.angles,
            RotorPhase.role: roles.phase,
            SpeedSource.role: roles.speed,
            PendulumLocks.role: roles.locks,
        }
        if self.name == "stuck sensor":
            return len(roles.displacements) > 1
        if self.name == "overspeed":
            return bool(roles.speed or roles.phase)
        return bool(played[self.role])


def _within(seconds: float) -> str:
    return f"{seconds + HOST_S:g} s"


def _silence(name: str, guards: str, seconds: float, role: str) -> Interlock:
    threshold = f"no sample for {seconds:g} s; bytes without samples do not count"
    deadline = f"{_within(seconds)}; at rest, where the test needs it, {_within(AT_REST_S)}"
    return Interlock(name, guards, threshold, "constant", deadline, role=role)


def _beyond(share_and_rpm: tuple[float, float]) -> str:
    share, rpm = share_and_rpm
    return f"{share:.0%} and {rpm:g} rpm".replace("%", " %")


INTERLOCKS: tuple[Interlock, ...] = (
    Interlock(
        "amplitude",
        "displacement",
        f"limits.amplitude_m, by two samples at most {TOGETHER} apart",
        "limits.amplitude_m",
        "at once",
        role=DisplacementSensor.role,
    ),
    Interlock(
        "out of sight",
        "displacement",
        f"{GONE_SAMPLES} invalid samples after one beyond {LARGE:g} × limits.amplitude_m",
        "limits.amplitude_m, constant",
        "at once",
        role=DisplacementSensor.role,
    ),
    Interlock(
        "blind sensor",
        "displacement",
        f"half of the samples invalid over {BLIND_S:g} s",
        "constant",
        f"{BLIND_S:g} s of samples",
        role=DisplacementSensor.role,
    ),
    Interlock(
        "stuck sensor",
        "displacement",
        f"one reading for {WINDOW_S:g} s while the other direction moves {SWING_M * 1e6:g} µm",
        "constant",
        f"{WINDOW_S:g} s of samples",
        role=DisplacementSensor.role,
    ),
    Interlock(
        "no motion",
        "displacement",
        f"below {MOMENT_SHARE:g} × the unbalance's motion − {RUN_OUT_M * 1e6:g} µm; "
        f"constant at ± {STUCK_M * 1e6:g} µm of it",
        "rig file, constant",
        f"{WINDOW_S:g} s, {TURNS:g} turn, {BEATS:g} beats",
        role=DisplacementSensor.role,
    ),
    _silence("silent displacement", "displacement", DISPLACEMENT_S, DisplacementSensor.role),
    _silence("silent angles", "pendulum angles and their radio link", ANGLES_S, PendulumAngles.role),
    _silence("silent speed", "age of the actual speed", SPEED_S, SpeedSource.role),
    Interlock(
        "no index mark",
        "rotor phase",
        f"{TURNS_UNSEEN:g} turns without an index mark",
        "constant",
        f"{TURNS_UNSEEN:g} turns + {RADIO_S:g} s",
        role=RotorPhase.role,
    ),
    Interlock(
        "encoder fault",
        "pendulum angles",
        f"half of the samples flagged over {FAULTY_S:g} s",
        "constant",
        f"{FAULTY_S:g} s of samples",
        role=PendulumAngles.role,
    ),
    Interlock(
        "loose lock",
        "angles of pendulums in closed locks",
        "moves by more than 1° and 5 standard uncertainties of the encoder's zero",
        "constant",
        f"{MOVED_S:g} s of samples, from {SETTLE_S:g} s after the lock closed",
        role=PendulumLocks.role,
    ),
    Interlock(
        "lock fault",
        "pendulum locks",
        "a lock reports a fault",
        _REPORT,
        "at once",
        "test ended",
        PendulumLocks.role,
    ),
    Interlock(
        "overspeed",
        "actual speed, index marks",
        f"{_beyond(OVERSPEED)} beyond limits.speed_rpm, in {ROWS_BEYOND} reports in a row or over 3 turns",
        "limits.speed_rpm, constant",
        "at once",
    ),
    Interlock(
        "runaway",
        "actual speed",
        f"{_beyond(RUNAWAY)} beyond the commanded speed",
        "constant",
        "at once",
        role=SpeedSource.role,
    ),
    Interlock(
        "speed disagreement",
        "index marks against actual speed",
        f"{_beyond(DISAGREE)} apart",
        "constant",
        f"1 s or 5 marks, then {_within(0.5)}",
        role=RotorPhase.role,
    ),
    Interlock(
        "restart",
        "the drive; others while the rotor turns or the test needs them",
        "a boot-up message, or counters that restart",
        _REPORT,
        "at once",
    ),
    Interlock("fault", "every device", "the device reports a fault", _REPORT, "at once"),
    Interlock(
        "left operation",
        "speed source",
        "a network state other than operational",
        _REPORT,
        "at once",
        role=SpeedSource.role,
    ),
    Interlock(
        "drop-out",
        "speed source",
        "the drive leaves operation without a command",
        _REPORT,
        f"{LOOK_S:g} s",
        role=SpeedSource.role,
        judge="session",
    ),
    Interlock(
        "emergency",
        "speed source",
        "an emergency message after which the drive remains in operation",
        _REPORT,
        "at once",
        _CONTINUES,
        SpeedSource.role,
        "session",
    ),
    Interlock(
        "silent line",
        "every device",
        f"no byte for {LINE_S:g} s in two checks",
        "constant",
        f"{LINE_S + 0.5:g} s",
        _REOPENED,
        judge="session",
    ),
    Interlock(
        "lost device",
        "every device",
        "its port fails, or its bytes make its decoder fail",
        "the device",
        "at once",
        f"{_STOP}; at rest: {_REOPENED}",
        judge="session",
    ),
    Interlock(
        "disk",
        "the log",
        f"the disk is full, removed, or {BACKLOG_BYTES / 2**20:g} MB behind",
        "constant",
        "0.25 s",
        f"{_STOP}; the log is complete",
        judge="session",
    ),
    Interlock(
        "operator",
        "Ctrl-C, SIGTERM, SIGHUP, the live page's stop",
        "any",
        "the operator",
        "at once",
        f"{_STOP}, exit 130",
        judge="session",
    ),
)
"""All rows in the order of the documentation."""
CHANNELS = tuple(row for row in INTERLOCKS if row.judge == "channels")
SESSION = tuple(row for row in INTERLOCKS if row.judge == "session")


def interlock(name: str) -> Interlock:
    """Return the row of an interlock.

    Raises:
        KeyError: no interlock has this name.
    """
    return {row.name: row for row in INTERLOCKS}[name]
