"""Replay of a log through the interlocks: the same `Interlocks` receive what arrived, in the same way as in a session.

Period, tolerances and order of calls are those of a session; the time is that of the log. The phase of a session's
period is not in a log, except where the session stopped the rotor: there it is evaluated additionally. A log contains
only the result of the checks of link, disk and operator, so these rows of the table are not evaluated again.

Without `target_rpm` (the log begins while the rotor turns, unless it is of a point or a run-down; or it only received,
on a line without commands) the drive's reported speed is used until the next command, and a runaway is not evaluated.
The part after a hole has unknown commands. A silence may be found one period earlier or later than in the session. In
the last seconds of an aborted session at rest the devices are being closed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from daq.acquisition.interlock_table import LOOK_S, TOGETHER_S
from daq.acquisition.interlocks import Interlocks, Stop
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.trips import finding_of
from daq.items import Batch, DeviceEvent
from daq.log import Log
from daq.log.snapshot import identities_of, rig_of
from daq.replay.arrivals import Arrival, Arrivals, with_all_fields
from daq.replay.checking import Holes, Progress, share_of
from daq.replay.commanded_speeds import (
    LoggedSpeeds,
    closing_ns,
    needed_at_rest,
    report_hand_speeds,
    roles_in,
    standing_speed,
    stops_of,
)
from daq.replay.stream import pipelines_with
from rig_configs.roles import Roles
from rig_configs.schema import Limits, Rig

_AGAIN_S = 1.0  # the same finding after a longer pause is another trip
_DISORDER_S = 0.2  # largest displacement of two devices' reads in the wrong order, s
_IGNORED_EVENTS = ("reply", "acknowledge")  # answers to the host


@dataclass(frozen=True)
class WouldTrip:
    """A trip that would have occurred.

    Attributes:
        interlock: name of its row in the table.
        text: reason with the values.
        cause: as `Stop.cause`.
        time_ns: host time of the finding, ns since 1970.
        last_ns, found: time of the last repetition and number of findings; not counted if the replay ended at the trip.
        speed_rpm: estimated speed of the rotor; None if unknown.
        told_rpm: last commanded speed; None if it is not in the log.
        newest: newest values of every channel that guards the rotor, by topic and field.
    """

    interlock: str
    text: str
    cause: str
    time_ns: int
    last_ns: int
    speed_rpm: float | None
    told_rpm: float | None
    newest: Mapping[str, Mapping[str, float]] = field(default_factory=dict[str, Mapping[str, float]])
    found: int = 1


@dataclass(frozen=True)
class InterlockReplay:
    """Result of a replay through the interlocks.

    Attributes:
        trips: trips in order of time; the first and those that belong to it, unless all were requested.
        start_ns, until_ns: host times between which the log was evaluated, ns since 1970.
        limits, roles: limits used, and roles of the rig that are in the log.
        stops: see `stops_of`.
        notes: limitations of the result, as sentences.
    """

    trips: tuple[WouldTrip, ...]
    start_ns: int
    until_ns: int
    limits: Limits
    roles: Roles
    stops: tuple[Mapping[str, Any], ...]
    notes: tuple[str, ...]


def replay_interlocks(
    log: Log, settings: Sequence[str] = (), *, all_trips: bool = False, progress: Progress | None = None
) -> InterlockReplay:
    """Evaluate the interlocks for a log.

    Args:
        log: the open log; finished, cut or damaged.
        settings: "key=value" texts that replace values of the log's rig file, such as limits.amplitude_m=0.004.
        all_trips: continue after the first trip, which would have ended the run.
        progress: called with the completed share, 0 … 1.

    Raises:
        LogError: the log does not contain its rig file.
        RigFileError: a setting is not valid in the rig file.
    """
    log.verify()  # damage determines the holes of the log
    rig = rig_of(log, settings)
    roles, notes = roles_in(log, rig)
    run = _Run(log, rig, roles, all_trips)
    share = share_of(log, progress)
    for arrival in run.arrivals:
        share(arrival.host_ns)
        if run.receive(arrival):
            break
    else:
        run.finish(log.end_ns)
    found, notes = tuple(run.trips), (*notes, *run.notes())
    return InterlockReplay(found, log.start_ns, run.now_ns, rig.limits, roles, stops_of(log), notes)


class _Run:
    """One pass through a log."""

    def __init__(self, log: Log, rig: Rig, roles: Roles, all_trips: bool) -> None:
        self._rig, self._roles, self._all = rig, roles, all_trips
        self._facts = log.metadata.get("run", {})
        self._period_ns, self._together_ns = _ns(LOOK_S), _ns(TOGETHER_S)
        self._holes = Holes.of(log.missing)
        self._left = list(self._holes.between)  # those after the present time
        pipelines = pipelines_with(rig, identities_of(log), str(log.path), log)
        self.arrivals = Arrivals(log, pipelines, roles.device_of, _DISORDER_S)
        self._closing_ns = closing_ns(log)
        self._looked_ns = sorted(note["time_ns"] for note in stops_of(log))  # a session certainly evaluated then
        self._at_closing = 0
        self.trips: list[WouldTrip] = []
        self._newest: dict[str, dict[str, float]] = {}
        self._start_ns = self.now_ns = log.start_ns
        self._begin(log.start_ns, whole=True)

    def _begin(self, now_ns: int, *, whole: bool) -> None:
        """Start as a session does with each log: all data are due from now on."""
        self._locks = Interlocks(self._rig.limits, self._roles, LeastMotion.of(self._rig), driving=True)
        self._locks.begin(now_ns)
        self._locks.need(needed_at_rest(self._facts.get("test", ""), self._roles))
        standing = standing_speed(self._facts)
        if self._roles.speed is None:
            report_hand_speeds(self._locks.commanded, self._facts, self._rig.limits.speed_rpm)
        self._commanded = LoggedSpeeds(
            self._locks.commanded, whole=whole, standing=standing if whole else None, rest_rpm=self._roles.rest_rpm
        )
        self._tick_ns, self._stood = now_ns + self._period_ns, False
        self.now_ns = max(self.now_ns, now_ns)

    def receive(self, arrival: Arrival) -> bool:
        """Process the next arrival; return True if a session would have ended before it."""
        if self._left and arrival.host_ns > self._left[0][0]:
            self._pass_holes(arrival.host_ns)
        if self._tick_until(arrival.host_ns):
            return True
        self.now_ns = max(self.now_ns, arrival.host_ns)
        speed = self._roles.speed
        if arrival.wrote and speed is not None and arrival.device == speed.device:
            self._commanded.sent()
        self._stood = not self._locks.turning(arrival.host_ns)  # the arrival may end the knowledge of the speed
        for item in arrival.items:
            if isinstance(item, Batch):
                self._note_newest(item)
                if speed is not None and item.channel.topic == speed.topic:
                    self._commanded.follow(item)
                self._collect(self._locks.feed(with_all_fields(item), arrival.host_ns), arrival.host_ns)
            elif item.kind not in _IGNORED_EVENTS:
                self._collect(self._locks.happened(item), arrival.host_ns)
        return self._ended(arrival.host_ns)

    def finish(self, end_ns: int) -> None:
        """Evaluate until the end, without further arrivals."""
        self._tick_until(end_ns)
        self.now_ns = max(self.now_ns, end_ns)

    def notes(self) -> list[str]:
        """Return the limitations of the result, as sentences."""
        out = [
            f"messages are missing from {self._after_s(start_ns)} to {self._after_s(end_ns)} s: nothing was "
            "judged there, and the part after it was judged as a separate log"
            for start_ns, end_ns in self._holes.between
        ]
        out += [f"missing, at an unknown time: {place}" for place in self._holes.unplaced]
        if self._holes.cut_ns is not None:
            out.append(
                f"the log is cut: everything after {self._after_s(self._holes.cut_ns)} s is missing and was not judged"
            )
        if self.arrivals.stored:
            out.append(f"judged by stored samples, without raw bytes to decode: {', '.join(self.arrivals.stored)}")
        if self._roles.speed is not None and self._commanded.rpm is None:
            out.append(
                "the log contains no command to the drive: its reported speed was used, a runaway was not judged"
            )
        if self._at_closing:
            out.append("the state of the devices while the session closed them, with the rotor at rest, was not judged")
        return out

    # --- parts -------------------------------------------------------------------------------------------------

    def _pass_holes(self, now_ns: int) -> None:
        self._tick_until(self._left[0][0])
        end_ns = now_ns
        while self._left and now_ns > self._left[0][0]:
            end_ns = self._left.pop(0)[1]
        self._begin(max(now_ns, end_ns), whole=False)

    def _tick_until(self, now_ns: int) -> bool:
        """Advance the log's time, with one evaluation per period; return True if the run would have ended."""
        while (tick_ns := min([self._tick_ns, *self._looked_ns[:1]])) <= now_ns:
            if tick_ns == self._tick_ns:
                self._tick_ns += self._period_ns
            else:
                self._looked_ns.pop(0)
            self.now_ns = max(self.now_ns, tick_ns)
            self._collect(self._locks.tick(tick_ns), tick_ns)
            if self._ended(tick_ns):
                return True
        return False

    def _ended(self, now_ns: int) -> bool:
        return bool(self.trips) and not self._all and now_ns > self.trips[0].time_ns + self._together_ns

    def _collect(self, found: Sequence[DeviceEvent | Stop], now_ns: int) -> None:
        for item in found:
            if isinstance(item, Stop):
                self._tripped(item, now_ns)

    def _tripped(self, stop: Stop, now_ns: int) -> None:
        if now_ns >= self._closing_ns and self._stood and not self._commanded.rpm:
            self._at_closing += 1
            return
        finding = finding_of(stop.interlock, stop.text)
        same = [i for i, trip in enumerate(self.trips) if finding_of(trip.interlock, trip.text) == finding]
        if same and (not self._all or now_ns - self.trips[same[-1]].last_ns <= _ns(_AGAIN_S)):
            last = self.trips[same[-1]]
            self.trips[same[-1]] = replace(last, last_ns=now_ns, found=last.found + 1)
            return
        if self._ended(now_ns):
            return
        speed = self._locks.speed_rpm(now_ns)
        newest = {topic: dict(values) for topic, values in self._newest.items()}
        self.trips.append(
            WouldTrip(
                stop.interlock,
                stop.text,
                stop.cause,
                now_ns,
                now_ns,
                None if math.isnan(speed) else speed,
                self._commanded.rpm,
                newest,
            )
        )

    def _note_newest(self, batch: Batch) -> None:
        self._newest[batch.channel.topic] = {
            name: values[-1].item() for name, values in batch.columns.items() if values.dtype.kind == "f"
        }

    def _after_s(self, time_ns: int) -> str:
        return f"{(time_ns - self._start_ns) * 1e-9:.3f}"


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
