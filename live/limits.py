"""Usage of every limit at an instant, and the lamp of every interlock.

The numbers are those of the interlocks' own table. The acquisition stops the rotor, not this page.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.acquisition.interlock_table import (
    ANGLES_S,
    AT_REST_S,
    BLIND_S,
    DISPLACEMENT_S,
    FAULTY_S,
    HOST_S,
    INTERLOCKS,
    SPEED_S,
)
from daq.acquisition.rotor_watch import DISAGREE, OVERSPEED, RADIO_S, RUNAWAY, TURNS_UNSEEN
from live.signals import Signals

NEAR = 0.8
"""Share of a limit above which the lamp is "near"."""
_SPAN_S = 1.0  # interval of the largest displacement
_TURNING_RPM = 5.0
_DISK_BYTES = 64e6
_MAX_MARK_AGE_S, _DRIVE_DELAY_S = 2.0, 0.15  # age of the newest index mark; delay of a drive's speed report
_KINDS = {  # events that report a fault: interlock, and whether it has recovered
    "gone": ("lost device", False),
    "back": ("lost device", True),
    "silent": ("silent line", False),
    "heard": ("silent line", True),
    "emergency": ("emergency", False),
    "fault": ("fault", False),
    "restart": ("restart", False),
}


@dataclass(frozen=True)
class Distance:
    """Distance to one limit.

    Attributes:
        interlock: name of its row in the table.
        what: monitored quantity, for a reader.
        value, limit: current value and limit, in `unit`; NaN if unknown.
        used: value over limit.
    """

    interlock: str
    what: str
    value: float
    limit: float
    unit: str

    @property
    def used(self) -> float:
        """Used share of the limit, 0 …; NaN if unknown."""
        return self.value / self.limit if self.limit else math.nan


def distances(signals: Signals, at_s: float, heard_s: float, disk: Mapping[str, Any] | None = None) -> list[Distance]:
    """Return the distance to every limit that can be calculated from the signals.

    Args:
        signals: signals of the rig.
        at_s: instant.
        heard_s: instant up to which samples can have arrived: host time of the newest update.
        disk: state of the recorder, if one records.
    """
    with signals.lock:
        found = [*_motion(signals, at_s), *_speed(signals, at_s), *_channels(signals, at_s, heard_s)]
    if disk is not None:
        found.append(Distance("disk", "log behind", float(disk["backlog_bytes"]) * 1e-6, _DISK_BYTES * 1e-6, "MB"))
    return found


def _motion(signals: Signals, at_s: float) -> Iterator[Distance]:
    limit_mm = signals.rig.limits.amplitude_m * 1e3
    for sensor in signals.rig.roles.displacements:
        _, values = signals.by_name[sensor.axis].between(at_s - _SPAN_S, at_s)
        known = values[np.isfinite(values)]
        largest = float(np.max(np.abs(known))) if len(known) else math.nan
        yield Distance("amplitude", f"|{sensor.axis}|, last {_SPAN_S:g} s", largest, limit_mm, "mm")


def _speed(signals: Signals, at_s: float) -> Iterator[Distance]:
    roles, limits = signals.rig.roles, signals.rig.limits
    if roles.speed is None and roles.phase is None:
        return
    rpm = signals.rpm(at_s)
    share, least = OVERSPEED
    yield Distance("overspeed", "speed", abs(rpm), limits.speed_rpm * (1 + share) + least, "rpm")
    if roles.speed is not None:
        drive = signals.by_name["drive"]
        actual, before = drive.last(at_s), drive.last(at_s - _SPAN_S)
        allowed = float(np.nanmax([0.0, abs(signals.by_name["target"].last(at_s)), abs(before)]))  # it may slow down
        share, least = RUNAWAY
        yield Distance("runaway", "beyond its command", max(0.0, abs(actual) - allowed), share * allowed + least, "rpm")
    if roles.speed is not None and roles.phase is not None:
        apart, around = _disagreement(signals, at_s)
        share, least = DISAGREE
        yield Distance("speed disagreement", "drive against index marks", apart, share * around + least, "rpm")


def _disagreement(signals: Signals, at_s: float) -> tuple[float, float]:
    """Return the newest turn's difference to the drive's speed, and the nearest drive speed; NaN: unknown."""
    marks = signals.by_name["marks"]
    until_s, turned = marks.until(at_s), marks.last(at_s)
    if not turned > _TURNING_RPM or at_s - until_s > _MAX_MARK_AGE_S:
        return math.nan, 0.0
    _, reported = signals.by_name["drive"].between(until_s - 60 / turned - _DRIVE_DELAY_S, until_s)
    if not len(reported):
        return math.nan, 0.0
    nearest = min(max(turned, float(np.min(np.abs(reported)))), float(np.max(np.abs(reported))))
    return abs(turned - nearest), nearest


def _channels(signals: Signals, at_s: float, heard_s: float) -> Iterator[Distance]:
    roles, rpm = signals.rig.roles, signals.rpm(at_s)
    turning = abs(rpm) > _TURNING_RPM
    for sensor in roles.displacements:
        age = heard_s - signals.topic_newest_s(sensor.topic, at_s)
        limit = HOST_S + (DISPLACEMENT_S if turning else AT_REST_S)
        yield Distance("silent displacement", f"{sensor.axis}: no sample for", _known(age), limit, "s")
        _, values = signals.by_name[sensor.axis].between(at_s - BLIND_S, at_s)
        share = float(np.mean(np.isnan(values))) if len(values) else math.nan
        yield Distance("blind sensor", f"{sensor.axis}: invalid samples", 100 * share, 50.0, "%")
    if roles.angles is not None:
        age = heard_s - signals.topic_newest_s(roles.angles.topic, at_s)
        limit = HOST_S + (ANGLES_S if turning else AT_REST_S)
        yield Distance("silent angles", "angles: no sample for", _known(age), limit, "s")
        share = signals.faulty_share(at_s - FAULTY_S, at_s)
        yield Distance("encoder fault", "angles: samples with a fault", 100 * share, 50.0, "%")
    if roles.speed is not None:
        age = heard_s - signals.topic_newest_s(roles.speed.topic, at_s)
        limit = HOST_S + (SPEED_S if turning else AT_REST_S)
        yield Distance("silent speed", "drive: no report for", _known(age), limit, "s")
    if roles.phase is not None:
        age = heard_s - signals.topic_newest_s(roles.phase.topic, at_s)
        limit = TURNS_UNSEEN * 60 / max(abs(rpm), _TURNING_RPM) + RADIO_S
        yield Distance("no index mark", "no index mark for", _known(age) if turning else 0.0, limit, "s")


def _known(seconds: float) -> float:
    return max(0.0, seconds) if math.isfinite(seconds) else math.nan


@dataclass
class Lamp:
    """Lamp of one interlock.

    Attributes:
        name, guards, threshold, reaction: columns of its row in the table, with the rig's numbers.
        state: "quiet", "near", "beyond" (above its limit now), "tripped" (it stopped the rotor), "recovered" (was
            above its limit or was reported, and is not any more; it stays listed).
        text: newest event; empty before the first one.
        since_s: start of the state.
    """

    name: str
    guards: str
    threshold: str
    reaction: str
    state: str = "quiet"
    text: str = ""
    since_s: float = 0.0


class Lamps:
    """Lamps of all interlocks of a rig, with their history.

    Args:
        signals: signals of the rig.
    """

    def __init__(self, signals: Signals) -> None:
        self._limits, self._roles = signals.rig.limits, signals.rig.roles
        self._at_s = -math.inf
        self.all: dict[str, Lamp] = {}
        self._reset()

    def _reset(self) -> None:
        self._newest = -1
        self.all = {
            row.name: Lamp(row.name, row.guards, row.threshold_of(self._limits), row.reaction)
            for row in INTERLOCKS
            if row.has_role(self._roles)
        }

    def look(self, at_s: float, found: Iterable[Distance], events: list[Mapping[str, Any]]) -> list[Lamp]:
        """Update the lamps at an instant; an instant before the last one resets them.

        Args:
            at_s: instant.
            found: distances at the instant.
            events: all events up to it in order, each with `at_s` and a rising `number`.
        """
        if at_s < self._at_s - 1.0:
            self._reset()
        self._at_s = at_s
        for event in events:
            if event["number"] > self._newest:
                self._newest = event["number"]
                self._event(event)
        worst: dict[str, Distance] = {}
        for distance in found:
            known = worst.get(distance.interlock)
            if math.isfinite(distance.used) and (known is None or distance.used > known.used):
                worst[distance.interlock] = distance
        for name, distance in worst.items():
            if name in self.all:
                self._distance(self.all[name], distance, at_s)
        return list(self.all.values())

    def _distance(self, lamp: Lamp, distance: Distance, at_s: float) -> None:
        if lamp.state == "tripped":
            return
        words = f"{distance.what} {distance.value:.3g} of {distance.limit:.3g} {distance.unit}"
        if distance.used >= 1:
            if lamp.state != "beyond":
                lamp.since_s = at_s
            lamp.state, lamp.text = "beyond", words
        elif lamp.state == "beyond":
            lamp.state, lamp.since_s = "recovered", at_s
        elif lamp.state in ("quiet", "near"):
            lamp.state = "near" if distance.used >= NEAR else "quiet"

    def _event(self, event: Mapping[str, Any]) -> None:
        at_s, text = float(event["at_s"]), str(event.get("text", ""))
        if event["kind"] == "trip":
            for reason in event.get("reasons", ()):
                self._set(str(reason.get("interlock")), "tripped", str(reason.get("text", text)), at_s)
        elif event["kind"] == "disk":
            self._set("disk", "beyond" if event.get("slow") else "recovered", text, at_s)
        elif event["kind"] in _KINDS:
            name, recovered = _KINDS[event["kind"]]
            self._set(name, "recovered" if recovered else "beyond", text, at_s)

    def _set(self, name: str, state: str, text: str, at_s: float) -> None:
        lamp = self.all.get(name)
        if lamp is not None and lamp.state != "tripped":
            lamp.state, lamp.text, lamp.since_s = state, text, at_s
