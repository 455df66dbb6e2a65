"""Facts of the recording session that its interlocks depended on: roles, channels needed by the test, stops, and the
time at which it closed its devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from daq.acquisition.channel_watch import HOST
from daq.acquisition.interlock_table import TOGETHER_S
from daq.guided_test_kinds import kind_of
from daq.log import Log
from daq.log.outcome import summary_of
from rig_configs.roles import Roles
from rig_configs.schema import Rig

_CLOSING_S = 5.0  # time in which a session closes its devices while the log is still open, s
# Reasons for the end of a log that ended before its session.
_ENDS = ("the test's end", "done", "duration", "silence", "not reached")


def stops_of(log: Log) -> tuple[Mapping[str, Any], ...]:
    """Return the session's stops: events of the host, each with `time_ns` and `text`."""
    return tuple(note for note in log.events if note.get("device") == HOST and note.get("kind") == "stop")


def roles_in(log: Log, rig: Rig) -> tuple[Roles, list[str]]:
    """Return the roles of a rig that have data in a log, and the reasons why others are omitted.

    A device that was recorded and sent nothing was silent; a device that was not recorded is omitted.
    """
    left_out: dict[str, str] = {}
    for topic, device in rig.roles.device_of.items():
        if device not in log.devices and not (topic in log and log.count(topic)):
            left_out[topic] = f"not judged, the log contains nothing of {device}: {topic}"
    phase = rig.roles.phase
    present = phase is not None and phase.topic not in left_out and phase.device not in log.devices
    if phase is not None and present and "revolutions" not in log.channel(phase.topic).names:
        left_out[phase.topic] = f"not judged, the log contains no index marks: {phase.topic}"
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
    """Return the channels that a guided test needs at rest, from its table row; empty if the test is not installed."""
    kind = kind_of(test)
    return [] if kind is None else list(kind.required_at_rest(roles))


def closing_ns(log: Log) -> int:
    """Return the host time from which a session may have been closing its devices; after the log's end if the log
    ended first, which is the usual case.

    A session that was aborted ends its log last: after the stop in the log, or within the log's last seconds.
    """
    ended = str(summary_of(log).get("ended") or "")
    if not ended or ended.startswith(_ENDS):
        return log.end_ns + 1
    stops = [note["time_ns"] for note in stops_of(log)]
    return min(stops) + _ns(TOGETHER_S) if stops else log.end_ns - _ns(_CLOSING_S)


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
