"""A rig as the page's source in the page's own process, fed by the recorder's process through a pipe."""

from __future__ import annotations

import itertools
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from multiprocessing.connection import Connection
from typing import Any

from live.errors import CommandRefused
from live.followers import compile_followers
from live.handover import received_sockets
from live.model import LiveModel
from live.serving import PageServer
from live.signals import Signals
from live.source import Facts
from rig_configs import IdentifiedParameters
from rig_configs.schema import Rig

_LAST_STATE_S = 1.0
_MAX_EVENTS = 2000
_log = logging.getLogger(__name__)
_INITIAL: Facts = {
    "mode": "live",
    "test": "",
    "numbers": {},
    "point": "",
    "started": "",
    "note": "",
    "step": "",
    "words": "opening the rig",
    "prompt": "",
    "share": None,
    "losses": {},
    "disk": None,
    "can": [],
    "stop": "",
    "rates": "",
    "feed_dropped": 0,
    "trouble": "",
    "answer": "",
    "log": "",
    "connections": {},
    "stopping": False,
    "ended": False,
}


class Watched:
    """A rig as live.source.PageSource.

    Args:
        rig: rig of the session.
        pipe: pipe to the session's process.
        title: title of the page.
    """

    def __init__(self, rig: Rig, pipe: Connection, title: str) -> None:
        self._rig, self._pipe = rig, pipe
        self.signals: Signals = Signals(rig, 0)
        self._facts: Facts = {**_INITIAL, "title": title}
        self._events: deque[Mapping[str, Any]] = deque(maxlen=_MAX_EVENTS)
        self._heard: tuple[float, float] | None = None
        self._end_s: float | None = None
        self._numbers, self._event_numbers = itertools.count(1), itertools.count()
        self._waiting: dict[int, Future[Facts]] = {}
        self._sending = threading.Lock()

    def follow(self) -> bool:
        """Receive updates until the other side announces the end (True) or the pipe breaks (False)."""
        try:
            while "end" not in (update := self._pipe.recv()):
                self._take(update)
        except (EOFError, OSError) as error:
            _log.info("the session's process ended without an announcement: %s", error)
            return False
        self._end({**self._facts, "ended": True, "can": []})
        return True

    def _end(self, facts: Facts) -> None:
        """End the run: the display stays at the last sample, and no panel becomes stale."""
        if self._end_s is None:
            newest_s = self.signals.newest_s
            self._end_s = newest_s if math.isfinite(newest_s) else self.heard_s()
        self._facts = facts

    def _take(self, update: Mapping[str, Any]) -> None:
        if "answer" in update:
            self._answered(update["to"], update["answer"])
            return
        if self._heard is None:
            self.signals.origin_ns = int(update["heard_ns"]) // 10**9 * 10**9
        for topic, time_ns, columns in update["rows"]:
            self.signals.feed(topic, time_ns, columns)
        for event in update["events"]:
            at_s = float(self.signals.seconds(event["time_ns"]))
            self._events.append({**event, "at_s": at_s, "number": next(self._event_numbers)})
        heard_s = float(self.signals.seconds(update["heard_ns"]))
        if update["facts"] is not None:
            facts = {**self._facts, **update["facts"]}
            if facts["test"] != self._facts["test"]:
                facts["since_s"] = heard_s  # figures of the last test do not belong to this one
            if facts["ended"]:
                self._end(facts)
            self._facts = facts
        self._heard = heard_s, time.monotonic()

    def _answered(self, number: int, answer: Facts) -> None:
        waiting = self._waiting.get(number)
        if waiting is None or not waiting.set_running_or_notify_cancel():
            return  # the request was cancelled
        if "error" in answer:
            waiting.set_exception(CommandRefused(str(answer["error"])))
        else:
            waiting.set_result(answer)

    def now_s(self) -> float:
        """See Source."""
        return self.heard_s()

    def heard_s(self) -> float:
        """See Source; it advances without updates, so that old samples are displayed as old."""
        if self._end_s is not None:
            return self._end_s
        if self._heard is None:
            return 0.0
        heard_s, since = self._heard
        return heard_s + time.monotonic() - since

    def looked_at(self) -> None:
        """See Source; a rig does not wait for viewers."""

    def facts(self) -> Facts:
        """See Source."""
        return self._facts

    def events(self) -> list[Mapping[str, Any]]:
        """See Source."""
        return list(self._events)

    def act(self, verb: str, given: Mapping[str, Any]) -> Future[Facts]:
        """See Source; the session's process carries it out."""
        if self._facts["ended"]:
            raise CommandRefused(f"{verb}: the run has ended")
        number, answer = next(self._numbers), Future[Facts]()
        self._waiting[number] = answer
        answer.add_done_callback(lambda _: self._waiting.pop(number, None))  # cancelled requests too
        try:
            with self._sending:
                self._pipe.send({"act": verb, "given": dict(given), "number": number})
        except (OSError, ValueError) as fault:
            answer.cancel()
            raise CommandRefused(f"{verb}: the recorder has ended") from fault
        return answer


def run_page(
    pipe: Connection,
    rig: Rig,
    identified: IdentifiedParameters | None,
    source: str,
    title: str,
    token: str,
    hosts: Sequence[str],
    connections: Connection,
) -> None:
    """Run the page's process: serve the connections of a SocketSender until the other side closes the pipe."""
    watched = Watched(rig, pipe, title)
    model = LiveModel(rig, identified, source)
    if rig.roles.angles is not None:
        compile_followers(rig, model)  # before a rotor turns, because a compiler takes time from the recorder

    def adopt() -> None:
        for accepted, head in received_sockets(connections):
            server.adopt(accepted, head)

    with PageServer(watched, model, token, hosts) as server:
        threading.Thread(target=adopt, name="connections", daemon=True).start()
        pipe.send({"ready": True})
        if watched.follow():
            server.page.flush_state(_LAST_STATE_S)
