"""A log as the page's source, with play, pause, seek and speed."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from daq.errors import LogError
from daq.log import Log
from daq.log.losses import losses_of
from live.errors import CommandRefused
from live.signals import Signals
from live.source import Facts
from live.transport import Transport
from rig_configs.schema import Rig

_QUIET = ("status", "reply", "acknowledge")


class Replayed:
    """A log as live.source.PageSource. It stays at its start until the first viewer has displayed a picture.

    Args:
        log: open log; it is read here and not needed afterwards.
        rig: rig of the log, with settings and parameters applied.
        speed: initial speed, seconds of the log per second.
        clock: as for Transport.
    Raises:
        LogError: the log has no samples of this rig.
    """

    def __init__(self, log: Log, rig: Rig, speed: float = 1.0, clock: Callable[[], float] | None = None) -> None:
        topics = Signals(rig, 0).topics
        found = {topic: log[topic] for topic in topics if topic in log and len(log[topic])}
        if not found:
            others = ", ".join(topic for topic in log if len(log[topic])) or "no channel"
            raise LogError(f"{log.path}: expected samples in one of {', '.join(topics)}, found samples in {others}")
        start_ns = min(int(samples.time_ns[0]) for samples in found.values())
        end_ns = max(int(samples.time_ns[-1]) for samples in found.values())
        self.signals: Signals = Signals(rig, start_ns, max(len(samples) for samples in found.values()))
        for topic, samples in found.items():
            columns = {name: samples.columns[name] for name in topics[topic] if name in samples.columns}
            self.signals.feed(topic, samples.time_ns, columns)
        span_s = float(self.signals.seconds(end_ns))
        self.transport: Transport = Transport(0.0, span_s, speed, *([clock] if clock else []))
        self.transport.await_viewer()
        self._path, self._run = log.path, log.metadata.get("run", {})
        self._numbers = {name: float(self._run[name]) for name in ("top_rpm", "duration_s") if name in self._run}
        self._losses = losses_of(log)
        events = [{**event, "at_s": float(self.signals.seconds(int(event["time_ns"])))} for event in log.events]
        self._events = sorted((e for e in events if e["kind"] not in _QUIET), key=lambda e: e["at_s"])
        self._events = [{**event, "number": number} for number, event in enumerate(self._events)]
        self._event_s = [event["at_s"] for event in self._events]
        self._disks = [(float(self.signals.seconds(int(r["time_ns"]))), r.get("disk")) for r in log.health]
        self._health = [(float(self.signals.seconds(int(r["time_ns"]))), r.get("losses")) for r in log.health]

    def now_s(self) -> float:
        """See Source."""
        return self.transport.at()

    def heard_s(self) -> float:
        """See Source."""
        return self.transport.at()

    def looked_at(self) -> None:
        """See Source."""
        self.transport.looked_at()

    def facts(self) -> Facts:
        """See Source."""
        at_s, transport = self.transport.at(), self.transport
        return {
            "mode": "replay",
            "title": self._path.name,
            "test": self._run.get("test", ""),
            "numbers": self._numbers,
            "point": self._run.get("point", ""),
            "started": self._run.get("started", ""),
            "note": self._run.get("note", ""),
            "step": "",
            "words": "",
            "prompt": "",
            "share": None,
            "playing": transport.playing,
            "speed": transport.speed,
            "start_s": transport.start_s,
            "end_s": transport.end_s,
            "losses": _newest(self._health, at_s) or {},
            "disk": _newest(self._disks, at_s),
            "losses_in_all": self._losses.words(),
            "can": ["play", "pause", "seek", "speed"],
            "stop": "",
            "rates": "",
            "feed_dropped": 0,
            "trouble": "",
            "stopping": False,
            "ended": False,
        }

    def events(self) -> list[Mapping[str, Any]]:
        """See Source."""
        return list(self._events[: bisect.bisect_right(self._event_s, self.transport.at())])

    def act(self, verb: str, given: Mapping[str, Any]) -> Future[Facts]:
        """See Source."""
        answer = Future[Facts]()
        try:
            match verb:
                case "play":
                    self.transport.play()
                case "pause":
                    self.transport.pause()
                case "seek":
                    self.transport.seek(float(given["to_s"]))
                case "speed":
                    self.transport.set_speed(float(given["speed"]))
                case _:
                    raise CommandRefused(f"{verb}: not possible for a log")
        except (KeyError, TypeError, ValueError) as fault:
            raise CommandRefused(f"{verb}: {fault}") from fault
        answer.set_result({"done": True, "at_s": self.transport.at()})
        return answer


def _newest(reports: list[tuple[float, Any]], at_s: float) -> Any:
    place = bisect.bisect_right([when for when, _ in reports], at_s)
    return reports[place - 1][1] if place else None
