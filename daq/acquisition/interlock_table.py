# pyright: strict
"""The table of all interlocks as data: what each guards, its threshold, how soon it acts, what then happens.

Numbers that more than one reader needs stand here or in the watch that uses them, once. `daq.acquisition.interlocks`
and the watches it asks judge the rows of `CHANNELS`; the session, which owns links, disk and operator, those of
`SESSION`. `docs/interlocks.md` shows the same table; a test keeps both equal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from daq.acquisition.exceedance import TOGETHER
from daq.acquisition.rotor_watch import DISAGREE, OVERSPEED, RADIO_S, ROWS_BEYOND, RUNAWAY, TURNS_UNSEEN
from daq.acquisition.stuck_watch import STILL_S, SWING_M
from rig_configs.roles import Displacement, PendulumAngles, PendulumLocks, Roles, RotorPhase, SpeedSource
from rig_configs.schema import Limits

LOOK_S = 0.1
"""Wall seconds between two looks at every channel: the period of `Interlocks.tick`, live and in a replay."""
TOGETHER_S = 0.3
"""Wall seconds after the first reason of a trip within which others belong to the same one."""
DISPLACEMENT_S, ANGLES_S, SPEED_S = 0.3, 1.0, 0.3
"""Rig time without a sample while the rotor turns …"""
AT_REST_S = 2.0
"""… and at rest, for a channel that a test needs."""
HOST_S = 0.3
"""Wall time that the host's threads may add."""
BLIND_S = 0.25
"""Of samples, more than half of them invalid; a flash is shorter."""
GONE_SAMPLES = 5
"""Invalid ones in a row after a large displacement."""
LARGE = 0.7
"""Of the amplitude limit."""
FAULTY_S = 0.1
"""Of samples, more than half of them with a fault flag."""
LINE_S = 2.0
"""Wall time without a byte of a device."""

Judge = Literal["channels", "session"]
_STOP = "rotor stopped, test ended"
_GOES_ON = "said and kept, exit 3; the run goes on, the device is opened again"


@dataclass(frozen=True)
class Interlock:
    """One row.

    Attributes:
        name: as a trip names it.
        guards: what it looks at.
        threshold: beyond which it trips, with units; `limits.NAME` stands for the rig file's number.
        source: where that number comes from: keys of the rig file's limits, or "constant".
        deadline: how soon it acts.
        reaction: what then happens.
        role: the role that some device must play for it; empty where it needs none.
        judge: who judges it: the watches over channels, which a log can be put through again, or the session.
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
        """The threshold with a rig's own numbers in it."""
        amplitude, speed = f"{limits.amplitude_m * 1e3:g} mm", f"{limits.speed_rpm:g} rpm"
        return self.threshold.replace("limits.amplitude_m", amplitude).replace("limits.speed_rpm", speed)

    def has_role(self, roles: Roles) -> bool:
        """Whether a rig has what it looks at."""
        played: dict[str, object] = {
            "": True,
            Displacement.role: roles.displacements,
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


def _within(rig_s: float, wall_s: float = HOST_S) -> str:
    return f"{rig_s:g} s + {wall_s:g} s wall" if rig_s else f"{wall_s:g} s wall"


def _silence(turning_s: float) -> str:
    return f"{_within(turning_s)}; at rest, where the test needs it, {_within(AT_REST_S)}"


def _beyond(share_and_rpm: tuple[float, float]) -> str:
    share, rpm = share_and_rpm
    return f"{share:.0%} and {rpm:g} rpm".replace("%", " %")


def _rows() -> Iterator[Interlock]:
    yield Interlock(
        "amplitude",
        "displacement",
        f"limits.amplitude_m, by two of {TOGETHER} samples",
        "limits.amplitude_m",
        "at once",
        role=Displacement.role,
    )
    yield Interlock(
        "out of sight",
        "displacement",
        f"{GONE_SAMPLES} invalid samples after one beyond {LARGE:g} × limits.amplitude_m",
        "limits.amplitude_m, constant",
        "at once",
        role=Displacement.role,
    )
    yield Interlock(
        "blind sensor",
        "displacement",
        f"half of the samples invalid over {BLIND_S:g} s",
        "constant",
        f"{BLIND_S:g} s of samples",
        role=Displacement.role,
    )
    yield Interlock(
        "stuck sensor",
        "displacement",
        f"one reading for {STILL_S:g} s while the other direction moves {SWING_M * 1e6:g} µm",
        "constant",
        f"{STILL_S:g} s of samples",
        role=Displacement.role,
    )
    for what, name, seconds, role in (
        ("displacement", "silent displacement", DISPLACEMENT_S, Displacement.role),
        ("pendulum angles, and with them the radio", "silent angles", ANGLES_S, PendulumAngles.role),
        ("actual speed: a word that is too old", "silent speed", SPEED_S, SpeedSource.role),
    ):
        yield Interlock(
            name, what, f"no sample for {seconds:g} s, whatever bytes come", "constant", _silence(seconds), role=role
        )
    yield Interlock(
        "no index mark",
        "rotor phase",
        f"{TURNS_UNSEEN:g} turns without an index mark",
        "constant",
        f"{TURNS_UNSEEN:g} turns + {RADIO_S:g} s wall",
        role=RotorPhase.role,
    )
    yield Interlock(
        "encoder fault",
        "pendulum angles",
        f"half of the samples flagged over {FAULTY_S:g} s",
        "constant",
        f"{FAULTY_S:g} s of samples",
        role=PendulumAngles.role,
    )
    yield Interlock(
        "lock fault",
        "pendulum locks",
        "a lock reports a fault",
        "the device's word",
        "at once",
        "test ended",
        PendulumLocks.role,
    )
    yield from _speed_rows()
    yield Interlock(
        "restart",
        "the drive; others while the rotor turns or the test needs them",
        "a boot-up message, or counters that begin anew",
        "the device's word",
        "at once",
    )
    yield Interlock("fault", "every device", "the device reports a fault", "the device's word", "at once")
    yield Interlock(
        "left operation",
        "speed source",
        "a network state other than operational",
        "the device's word",
        "at once",
        role=SpeedSource.role,
    )
    yield from _session_rows()


def _speed_rows() -> Iterator[Interlock]:
    yield Interlock(
        "overspeed",
        "actual speed, index marks",
        f"{_beyond(OVERSPEED)} beyond limits.speed_rpm, in {ROWS_BEYOND} reports in a row or over 3 turns",
        "limits.speed_rpm, constant",
        "at once",
    )
    yield Interlock(
        "runaway",
        "actual speed",
        f"{_beyond(RUNAWAY)} beyond what the drive was told",
        "constant",
        "at once",
        role=SpeedSource.role,
    )
    yield Interlock(
        "speed disagreement",
        "index marks against actual speed",
        f"{_beyond(DISAGREE)} apart",
        "constant",
        f"1 s or 5 marks, then {_within(0.5)}",
        role=RotorPhase.role,
    )


def _session_rows() -> Iterator[Interlock]:
    yield Interlock(
        "drop-out",
        "speed source",
        "it leaves operation by itself",
        "the device's word",
        f"{LOOK_S:g} s wall",
        role=SpeedSource.role,
        judge="session",
    )
    yield Interlock(
        "emergency",
        "speed source",
        "an emergency message that ends no operation",
        "the device's word",
        "at once",
        "said and kept, exit 3; the run goes on",
        SpeedSource.role,
        "session",
    )
    yield Interlock(
        "silent line",
        "every device",
        f"no byte for {LINE_S:g} s wall, seen twice",
        "constant",
        _within(0, LINE_S + 0.5),
        _GOES_ON,
        judge="session",
    )
    yield Interlock(
        "lost device",
        "every device",
        "its port fails, or its bytes make its decoder fail",
        "the device",
        "at once",
        f"{_STOP}; {_GOES_ON} where nothing turns",
        judge="session",
    )
    yield Interlock(
        "disk",
        "the log",
        "the disk full, gone, or 64 MB behind",
        "constant",
        _within(0, 0.25),
        f"{_STOP}; the log is whole",
        judge="session",
    )
    yield Interlock(
        "operator",
        "Ctrl-C, SIGTERM, SIGHUP, the live page's stop",
        "any",
        "the operator",
        "at once",
        f"{_STOP}, exit 130",
        judge="session",
    )


INTERLOCKS: tuple[Interlock, ...] = tuple(_rows())
"""All rows, in the order in which they are shown."""
CHANNELS = tuple(row for row in INTERLOCKS if row.judge == "channels")
SESSION = tuple(row for row in INTERLOCKS if row.judge == "session")


def interlock(name: str) -> Interlock:
    """The row of a name.

    Raises:
        KeyError: there is none.
    """
    return {row.name: row for row in INTERLOCKS}[name]
