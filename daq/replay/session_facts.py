# pyright: strict
"""What a log holds of the session that recorded it, as far as its interlocks were led by it: which roles were there,
what its test needed, how fast its clock ran, when it stopped the rotor and when it let go of its devices."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from daq.acquisition.channel_watch import HOST
from daq.acquisition.interlock_table import TOGETHER_S
from daq.guided_tests.kinds import kind_of
from daq.log import Log
from rig_configs.roles import Roles
from rig_configs.schema import Rig

_CLOSING_S = 5.0  # wall seconds that a session may take to let go of its devices, log still open
_ENDS = ("the test's end", "done", "duration", "silence", "not reached")  # logs that ended before their session did


def stops_of(log: Log) -> tuple[Mapping[str, Any], ...]:
    """What a log says of its session's stops: events of the host, each with `time_ns` and `text`."""
    return tuple(note for note in log.events if note.get("device") == HOST and note.get("kind") == "stop")


def roles_in(log: Log, rig: Rig) -> tuple[Roles, list[str]]:
    """Roles of a rig that a log holds something of, and why others are left out.

    A device that was recorded and never said anything is one that was silent; one that was not recorded is none.
    """
    left_out: dict[str, str] = {}
    for topic, device in rig.roles.device_of.items():
        if device not in log.devices and not (topic in log and log.count(topic)):
            left_out[topic] = f"not judged, the log holds nothing of {device}: {topic}"
    phase = rig.roles.phase
    there = phase is not None and phase.topic not in left_out and phase.device not in log.devices
    if phase is not None and there and "revolutions" not in log.channel(phase.topic).names:
        left_out[phase.topic] = f"not judged, the log holds no index marks: {phase.topic}"
    kept = rig.roles
    single = {
        name: role
        for name in ("angles", "phase", "speed")
        if (role := getattr(kept, name)) is not None and role.topic in left_out
    }
    lasers = tuple(sensor for sensor in kept.displacements if sensor.topic not in left_out)
    return replace(kept, displacements=lasers, **dict.fromkeys(single)), [
        why for topic, why in left_out.items() if not any(other.topic == topic for other in kept.others)
    ]


def needed_at_rest(test: str, roles: Roles) -> list[str]:
    """Channels that a guided test lives on at rest, by its row; of one that is not installed none is known."""
    kind = kind_of(test)
    return [] if kind is None else list(kind.lives_on(roles))


def closing_ns(log: Log, patience: Callable[[float], float]) -> int:
    """From when on a session may have been letting go of its devices, host time; behind the log's end where it ended
    first, as most do.

    A session that was broken off ends its log last: after the stop that the log holds, or within its last seconds.
    """
    said = log.metadata.get("summary", {}).get("ended", "")
    if not said or _text(said).startswith(_ENDS):
        return log.end_ns + 1
    stops = [note["time_ns"] for note in stops_of(log)]
    return min(stops) + _ns(patience(TOGETHER_S)) if stops else log.end_ns - _ns(patience(_CLOSING_S))


def _text(said: str) -> str:
    """A word of the summary: JSON, or in a log of an earlier version the word itself."""
    try:
        return str(json.loads(said))
    except (ValueError, RecursionError):
        return said


def clock_rate(run: Mapping[str, str]) -> float:
    """Seconds of rig time per wall second, as the log says; 1 where it says nothing that can be."""
    try:
        rate = float(run.get("clock_rate", 1.0))
    except ValueError:
        return 1.0
    return rate if 0.01 <= rate <= 100 else 1.0


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
