# pyright: strict
"""A rig as the page's source, in the page's own process: what the recorder's process hands over through a pipe."""

from __future__ import annotations

import contextlib
import itertools
import math
import signal
import threading
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future
from multiprocessing.connection import Connection
from typing import Any

from daq.errors import RigError
from live.followers import compile_followers
from live.model import Model
from live.serving import Serving
from live.signals import Signals
from live.source import Facts, Refused
from rig_configs import IdentifiedParameters
from rig_configs.schema import Rig

_LAST_WORDS_S = 1.0
_MOST_EVENTS = 2000
_NOTHING: Facts = {
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
    "stopping": False,
    "ended": False,
}


class Watched:
    """See live.source.Source.

    Args:
        rig: the session's.
        pipe: to the session's process.
        rate: seconds of the rig per second of the wall.
        title: of the page.
    """

    def __init__(self, rig: Rig, pipe: Connection, rate: float, title: str) -> None:
        self._rig, self._pipe, self._rate = rig, pipe, rate
        self.signals = Signals(rig, 0)
        self._facts: Facts = {**_NOTHING, "title": title}
        self._events: deque[Mapping[str, Any]] = deque(maxlen=_MOST_EVENTS)
        self._heard: tuple[float, float] | None = None
        self._end_s: float | None = None
        self._numbers, self._event_numbers = itertools.count(1), itertools.count()
        self._waiting: dict[int, Future[Facts]] = {}
        self._sending = threading.Lock()

    def follow(self) -> bool:
        """Take what is handed over until the other side says that it ends, or is gone without a word: False."""
        with contextlib.suppress(EOFError, OSError):
            while "end" not in (handed := self._pipe.recv()):
                self._take(handed)
            self._end({**self._facts, "ended": True, "can": []})
            return True
        return False

    def _end(self, facts: Facts) -> None:
        """The run is over: what is shown stands at its last sample, and nothing gets old."""
        if self._end_s is None:
            newest_s = self.signals.newest_s
            self._end_s = newest_s if math.isfinite(newest_s) else self.heard_s()
        self._facts = facts

    def _take(self, handed: Mapping[str, Any]) -> None:
        if "answer" in handed:
            self._answered(handed["to"], handed["answer"])
            return
        if self._heard is None:
            self.signals.origin_ns = int(handed["heard_ns"]) // 10**9 * 10**9
        for topic, time_ns, columns in handed["rows"]:
            self.signals.feed(topic, time_ns, columns)
        for event in handed["events"]:
            at_s = float(self.signals.seconds(event["time_ns"]))
            self._events.append({**event, "at_s": at_s, "number": next(self._event_numbers)})
        heard_s = float(self.signals.seconds(handed["heard_ns"]))
        if handed["facts"] is not None:
            facts = {**self._facts, **handed["facts"]}
            if facts["test"] != self._facts["test"]:
                facts["since_s"] = heard_s  # the last test's figures are not this one's
            if facts["ended"]:
                self._end(facts)
            self._facts = facts
        self._heard = heard_s, time.monotonic()

    def _answered(self, number: int, answer: Facts) -> None:
        waiting = self._waiting.get(number)
        if waiting is None or not waiting.set_running_or_notify_cancel():
            return  # nobody waits for it any more
        if "error" in answer:
            waiting.set_exception(Refused(str(answer["error"])))
        else:
            waiting.set_result(answer)

    def now_s(self) -> float:
        """See Source."""
        return self.heard_s()

    def heard_s(self) -> float:
        """See Source: it goes on while nothing is handed over, so that what is old looks old."""
        if self._end_s is not None:
            return self._end_s
        if self._heard is None:
            return 0.0
        heard_s, since = self._heard
        return heard_s + self._rate * (time.monotonic() - since)

    @property
    def rate(self) -> float:
        """See Source."""
        return self._rate

    def looked_at(self) -> None:
        """See Source: a rig waits for nobody."""

    def facts(self) -> Facts:
        """See Source."""
        return self._facts

    def events(self) -> list[Mapping[str, Any]]:
        """See Source."""
        return list(self._events)

    def act(self, verb: str, given: Mapping[str, Any]) -> Future[Facts]:
        """See Source: the session's process does it."""
        if self._facts["ended"]:
            raise Refused(f"{verb}: the run has ended")
        number, answer = next(self._numbers), Future[Facts]()
        self._waiting[number] = answer
        answer.add_done_callback(lambda _: self._waiting.pop(number, None))  # also of one nobody waits for
        try:
            with self._sending:
                self._pipe.send({"act": verb, "given": dict(given), "number": number})
        except (OSError, ValueError) as fault:
            answer.cancel()
            raise Refused(f"{verb}: the recorder is gone") from fault
        return answer


def run_page(
    pipe: Connection,
    rig: Rig,
    identified: IdentifiedParameters | None,
    source: str,
    rate: float,
    title: str,
    host: str,
    port: int,
) -> None:
    """The page's process: serve until the other side of the pipe is gone."""
    for name in ("SIGINT", "SIGHUP"):  # the terminal sends them to both; the session decides when it is over
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    watched = Watched(rig, pipe, rate if math.isfinite(rate) else 1.0, title)
    model = Model(rig, identified, source)
    if rig.roles.angles is not None:
        compile_followers(rig, model)  # before a rotor turns: the stop passes through here
    try:
        serving = Serving(watched, model, host, port)
    except RigError as fault:
        pipe.send({"failed": str(fault)})
        return
    with serving:
        pipe.send({"url": serving.url, "token": serving.token})
        if watched.follow():
            serving.page.tell_all(_LAST_WORDS_S)
