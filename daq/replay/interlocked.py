# pyright: strict
"""When the interlocks would have tripped in a log: the same `Interlocks`, fed with what arrived, as a session feeds it.

Period, patience and order of calls are the session's own; the time is the log's. When in each period a session looked
is not in a log, except where it stopped the rotor: there is a look of its own. A log says nothing of link, disk and
operator beyond what ended it, so those rows of the table are not judged again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from daq.acquisition.interlock_table import LOOK_S, TOGETHER_S
from daq.acquisition.interlocks import Interlocks, Stop
from daq.acquisition.trips import finding_of
from daq.drivers.items import Batch, Event
from daq.log import Log
from daq.log.snapshot import identities_of, rig_of
from daq.replay.arrivals import Arrival, Arrivals, Hole, holes_of, with_all_fields
from daq.replay.checking import Progress, share_of
from daq.replay.orders import Orders, standing_order, tell_hand
from daq.replay.session_facts import clock_rate, closing_ns, needed_at_rest, roles_in, stops_of
from daq.replay.stream import pipelines_with
from daq.transports.host_clock import HostClock
from rig_configs.roles import Roles
from rig_configs.schema import Limits, Rig

_AGAIN_S = 1.0  # the same thing found later than this after the last time is another trip
_DISORDER_S = 0.2  # wall seconds by which reads of two devices may stand the wrong way round
_NOT_HEEDED = ("reply", "acknowledge")  # answers to the host, not something that happened


@dataclass(frozen=True)
class WouldTrip:
    """A trip that would have been.

    Attributes:
        interlock: name of its row in the table.
        text: the reason, with the values.
        cause: as `Stop.cause`.
        time_ns: when it was found, host time.
        last_ns, found: until when and how often it was found again; the same where the replay ended with it.
        speed_rpm: how fast the rotor turned by all that is known, None where nobody can tell.
        told_rpm: what the rotor was last told; None where the log does not hold it.
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
    """What was found.

    Attributes:
        trips: in the order of their times; the first, and those that belong to it, unless all were asked for.
        start_ns, until_ns: host times between which the log was judged.
        limits, roles: what was judged by, and what of the rig the log holds.
        stops: see `stops_of`.
        notes: what a reader of the result must know, sentences.
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
    """Put a log through the interlocks.

    Args:
        log: open; finished, cut or damaged.
        settings: "key=value" laid over the log's rig file, such as limits.amplitude_m=0.004.
        all_trips: go on after the first trip, which would have ended the run.
        progress: told the share done, 0 … 1.

    Raises:
        LogError: the log does not say what rig it was recorded on.
        RigFileError: a setting that the rig file cannot have.
    """
    log.verify()  # what is damaged decides where the log has holes
    rig = rig_of(log, settings)
    roles, notes = roles_in(log, rig)
    run = _Run(log, rig, roles, all_trips)
    share = share_of(log, progress)
    for arrival in run.arrivals:
        share(arrival.host_ns)
        if run.take(arrival):
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
        patience = HostClock(clock_rate(self._facts)).patience
        self._patience = patience
        self._period_ns, self._together_ns = _ns(LOOK_S * clock_rate(self._facts)), _ns(patience(TOGETHER_S))
        self._holes = list(holes_of(log.missing))
        lost = [place for place in log.missing if place.messages != 0]
        self._unplaced = [place for place in lost if place.start_ns is None]
        self._cut_ns = min((p.start_ns for p in lost if p.start_ns is not None and p.end_ns is None), default=None)
        self._whole_holes = tuple(self._holes)
        pipelines = pipelines_with(rig, identities_of(log), str(log.path), log)
        self.arrivals = Arrivals(log, pipelines, roles.device_of, patience(_DISORDER_S))
        self._closing_ns = closing_ns(log, patience)
        self._looked_ns = sorted(note["time_ns"] for note in stops_of(log))  # a session looked then, that is known
        self._let_go = 0
        self.trips: list[WouldTrip] = []
        self._newest: dict[str, dict[str, float]] = {}
        self._start_ns = self.now_ns = log.start_ns
        self._begin(log.start_ns, whole=True)

    def _begin(self, now_ns: int, *, whole: bool) -> None:
        """As a session does with each log: everything is due from now on."""
        self._locks = Interlocks(self._rig.limits, self._roles, self._patience, driving=True)
        self._locks.begin(now_ns)
        self._locks.need(needed_at_rest(self._facts.get("test", ""), self._roles))
        standing = standing_order(self._facts)
        if self._roles.speed is None:
            tell_hand(self._locks.told, self._facts, self._rig.limits.speed_rpm)
        self._orders = Orders(
            self._locks.told, whole=whole, standing=standing if whole else None, rest_rpm=self._roles.rest_rpm
        )
        self._tick_ns, self._stood = now_ns + self._period_ns, False
        self.now_ns = max(self.now_ns, now_ns)

    def take(self, arrival: Arrival) -> bool:
        """What arrived next; returns whether a session would have ended before it."""
        if self._holes and arrival.host_ns > self._holes[0].start_ns:
            self._pass_hole(self._holes[0], arrival.host_ns)
        if self._tick_until(arrival.host_ns):
            return True
        self.now_ns = max(self.now_ns, arrival.host_ns)
        speed = self._roles.speed
        if arrival.wrote and speed is not None and arrival.device == speed.device:
            self._orders.sent()
        self._stood = not self._locks.turning(arrival.host_ns)  # what comes may take away all that tells so
        for item in arrival.items:
            if isinstance(item, Batch):
                self._note_newest(item)
                if speed is not None and item.channel.topic == speed.topic:
                    self._orders.follow(item)
                self._heed(self._locks.feed(with_all_fields(item), arrival.host_ns), arrival.host_ns)
            elif item.kind not in _NOT_HEEDED:
                self._heed(self._locks.happened(item), arrival.host_ns)
        return self._ended(arrival.host_ns)

    def finish(self, end_ns: int) -> None:
        """Nothing comes any more."""
        self._tick_until(end_ns)
        self.now_ns = max(self.now_ns, end_ns)

    def notes(self) -> list[str]:
        """What must be known of the result."""
        out = [
            f"messages are missing from {self._after_s(hole.start_ns)} to {self._after_s(hole.end_ns)} s: nothing was "
            "judged there, and what follows was judged as a log of its own"
            for hole in self._whole_holes
        ]
        out += [f"missing, nobody knows when: {place}" for place in self._unplaced]
        if self._cut_ns is not None:
            out.append(f"the log is cut: what came after {self._after_s(self._cut_ns)} s is missing and was not judged")
        if self.arrivals.stored:
            out.append(f"judged by stored samples, there are no bytes to decode: {', '.join(self.arrivals.stored)}")
        if self._roles.speed is not None and self._orders.rpm is None:
            out.append("the log holds no order to the drive: its own word was taken for it, a runaway was not judged")
        if self._let_go:
            out.append("what its devices did as the session let go of them, the rotor at rest, is left out")
        return out

    # --- parts -------------------------------------------------------------------------------------------------

    def _pass_hole(self, hole: Hole, now_ns: int) -> None:
        self._tick_until(hole.start_ns)
        while self._holes and now_ns > self._holes[0].start_ns:
            hole = self._holes.pop(0)
        self._begin(max(now_ns, hole.end_ns), whole=False)

    def _tick_until(self, now_ns: int) -> bool:
        """Let the log's time pass, a look each period; returns whether the run would have ended."""
        while (tick_ns := min([self._tick_ns, *self._looked_ns[:1]])) <= now_ns:
            if tick_ns == self._tick_ns:
                self._tick_ns += self._period_ns
            else:
                self._looked_ns.pop(0)
            self.now_ns = max(self.now_ns, tick_ns)
            self._heed(self._locks.tick(tick_ns), tick_ns)
            if self._ended(tick_ns):
                return True
        return False

    def _ended(self, now_ns: int) -> bool:
        return bool(self.trips) and not self._all and now_ns > self.trips[0].time_ns + self._together_ns

    def _heed(self, found: Sequence[Event | Stop], now_ns: int) -> None:
        for item in found:
            if isinstance(item, Stop):
                self._tripped(item, now_ns)

    def _tripped(self, stop: Stop, now_ns: int) -> None:
        if now_ns >= self._closing_ns and self._stood and not self._orders.rpm:
            self._let_go += 1
            return
        finding = finding_of(stop.interlock, stop.text)
        for number in range(len(self.trips) - 1, -1, -1):
            known = self.trips[number]
            if finding_of(known.interlock, known.text) == finding:
                if now_ns - known.last_ns <= _ns(_AGAIN_S) or not self._all:
                    self.trips[number] = replace(known, last_ns=now_ns, found=known.found + 1)
                    return
                break
        if self.trips and not self._all and now_ns > self.trips[0].time_ns + self._together_ns:
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
                self._orders.rpm,
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
