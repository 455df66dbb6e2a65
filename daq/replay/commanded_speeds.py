"""Facts of a recording session that its interlocks depended on: commanded speeds, roles, stops, and its end.

A session reports every speed to its interlocks before it sends it to the drive. In the log the same speeds are the
field `target_rpm` of the speed source's channel. Its pipeline decodes them from the bytes sent to the device, or from
those on the bus if the session only received. Four cases need additional rules:

- A log of a point or a run-down begins at a speed, and contains it among its facts. This is the valid command.
- Any other log that begins while the rotor turns, and the part of a log after a hole, do not contain the valid command.
  Until the next one the drive's reported speed is used instead. A runaway is not judged during this time, everything
  else is. A commanded 0 cannot be distinguished from a missing command before the first one of a log; a drive that
  slows down to rest is always allowed.
- A log of a session that only received on a line without commands is such a log from its beginning to its end.
- A rotor driven by hand follows spoken instructions. A speed counts as commanded from the log's beginning if the test
  turns the rotor, and a stop counts as commanded if the test is a run-down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST
from daq.acquisition.interlock_table import TOGETHER_S
from daq.guided_test_kinds import KINDS, kind_of
from daq.items import Batch
from daq.log import Log
from daq.log.outcome import summary_of
from rig_configs.roles import AT_REST_RPM, Roles
from rig_configs.schema import Rig

_FIELD = "target_rpm"


class LoggedSpeeds:
    """Follows the commands of a log.

    Args:
        notify: called with every speed, rpm, before the following samples are judged (`Interlocks.commanded`).
        whole: True if nothing is missing before: a device at rest that is sent bytes has no unseen command.
        standing: command that was valid before the log began, rpm; None if unknown.
        rest_rpm: largest reported speed of a rotor at rest, rpm.

    Attributes:
        rpm: last commanded speed, rpm; None while it is unknown.
    """

    def __init__(
        self,
        notify: Callable[[float], None],
        *,
        whole: bool,
        standing: float | None = None,
        rest_rpm: float = AT_REST_RPM,
    ) -> None:
        self._notify, self._whole, self._rest_rpm = notify, whole, rest_rpm
        self._sent = self._changed = False
        self._stood = True
        self._first: float | None = None
        self.rpm: float | None = None
        if standing is not None:
            self._report(standing)

    def sent(self) -> None:
        """Note that bytes were sent to the speed source, so its commands are in the log."""
        self._sent = True

    def follow(self, batch: Batch) -> None:
        """Report the commands in the speed source's samples; call it before the samples are judged."""
        speeds: NDArray[np.float64] = batch.columns["speed_rpm"]
        targets: NDArray[np.float64] = batch.columns.get(_FIELD, np.full(len(speeds), np.nan))
        for target in _changes(targets):
            if self._first is None:
                self._first = target
            self._changed = self._changed or target != self._first
            if self._changed:
                self._report(target)
        if self.rpm is not None:
            return
        self._stood = self._stood and bool(np.all(np.abs(speeds) <= self._rest_rpm))
        if self._whole and self._sent and self._stood and self._first is not None:
            self._report(self._first)
            return
        for rpm in (float(speeds.min()), float(speeds.max()), float(speeds[-1])):
            self._notify(rpm if abs(rpm) > self._rest_rpm else 0.0)

    def _report(self, rpm: float) -> None:
        if rpm != self.rpm:
            self.rpm = rpm
            self._notify(rpm)


def standing_speed(run: Mapping[str, str]) -> float | None:
    """Return the command that was valid before a log began, rpm: of a test that begins at a speed; None for any other.

    Args:
        run: facts of the log.
    """
    test = run.get("test", "")
    fact = {"point": "speed_rpm", "run-down": "top_rpm"}.get("point" if kind_of(test) is KINDS["point"] else test, "")
    return _number(run.get(fact))


def report_hand_speeds(notify: Callable[[float], None], run: Mapping[str, str], limit_rpm: float) -> None:
    """Report the commands in a log whose rotor is turned by hand.

    Args:
        notify: see LoggedSpeeds.
        run: facts of the log: its test, and the speed if it has one.
        limit_rpm: used for a speed that is not in the log; only its presence matters.
    """
    test = run.get("test", "")
    kind = kind_of(test)
    if kind is None or not kind.turns:
        return
    notify(_number(run.get("speed_rpm") or run.get("top_rpm")) or limit_rpm)
    if kind is KINDS["run-down"]:
        notify(0.0)


def _changes(values: NDArray[np.float64]) -> list[float]:
    """Return each value that differs from the one before it, without NaN."""
    present = values[~np.isnan(values)]
    new = np.flatnonzero(np.diff(present, prepend=np.nan) != 0)
    return present[new].tolist()


def _number(text: str | None) -> float | None:
    try:
        found = abs(float(text or 0.0))
    except ValueError:  # usual: a text without a number
        return None
    return found if 0 < found < float("inf") else None


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
    return min(stops) + int(TOGETHER_S * 1e9) if stops else log.end_ns - int(_CLOSING_S * 1e9)
