# pyright: strict
"""The page beside a session: a process of its own, fed with copies of what is newest.

The session's threads do nothing for it. One thread here looks at the newest samples 30 times a second, as the terminal
does, and writes them into a pipe; while the page does not take them, this thread waits, and what it then missed is
counted. Another carries out what the page asks for.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

from daq.acquisition.session import Session
from daq.drivers.items import Event
from daq.errors import DeviceError, RigError
from daq.guided_tests.controls import Controls
from live.newest import Newest
from live.signals import Signals
from live.watched import run_page
from rig_configs import IdentifiedParameters
from rig_configs.schema import Rig

_TURN_S, _FACTS_S = 1 / 30, 0.2
_START_S, _END_S, _FEED_ENDS_S = 60.0, 10.0, 1.0
_MOST_EVENTS = 500
_QUIET = ("status", "reply", "acknowledge")
_TOO_LONG = ("excerpt",)  # facts of events that the page does not show


class Asking:
    """What the page may ask a running test for, and what it shows of it.

    Args:
        controls: of the tests; None where none runs.
        confirmed: called when somebody says that what was asked for is done; None where nobody waits for it.
    """

    def __init__(self, controls: Controls | None = None, confirmed: Callable[[], None] | None = None) -> None:
        self.controls, self.confirmed = controls, confirmed
        self._prompt, self._at = "", ("", "")

    def prompt(self, text: str) -> None:
        """The operator is asked for something."""
        self._prompt, self._at = text, self._state()

    def _state(self) -> tuple[str, str]:
        status = self.controls.status if self.controls is not None else None
        return (status.test, status.state) if status is not None else ("", "")

    def facts(self) -> dict[str, Any]:
        """For the page."""
        if self.controls is None:
            return {}
        status = self.controls.status
        prompt = self._prompt if self._at == self._state() else ""
        return {"test": status.test, "step": status.state, "words": status.words, "share": status.share,
                "answer": status.answer, "prompt": prompt}  # fmt: skip

    def can(self) -> list[str]:
        """Verbs that make sense."""
        tests = [] if self.controls is None or not self.controls.status.test else ["pause", "resume", "abort"]
        return [*tests, *(["confirm"] if tests and self.confirmed is not None and self._prompt else [])]


class LivePage:
    """A page for one session; a context, entered before the session and left after it.

    Args:
        rig: the session's, with identified parameters laid over it where there are any.
        identified: these.
        source: where the model's numbers are from, for a person.
        rate: seconds of the rig per second of the wall.
        title: of the page.
        host, port: as live.port.bound takes them.

    Attributes:
        url, token: once it is entered.
    Raises:
        RigError: the page cannot be served.
    """

    def __init__(
        self, rig: Rig, identified: IdentifiedParameters | None, source: str, rate: float, title: str,
        host: str = "", port: int = 0,
    ) -> None:  # fmt: skip
        self.url = self.token = ""
        self._ours, theirs = multiprocessing.get_context("spawn").Pipe()
        self._process = multiprocessing.get_context("spawn").Process(
            target=run_page, args=(theirs, rig, identified, source, rate, title, host, port), name="live page",
            daemon=True,
        )  # fmt: skip
        self._theirs: Connection = theirs
        self._sending = threading.Lock()
        self._ending = threading.Event()
        self._session: Session | None = None
        self._asking, self._facts = Asking(), dict[str, Any]()
        self._stop: Callable[[str], None] | None = None
        self._events: deque[dict[str, Any]] = deque(maxlen=_MOST_EVENTS)
        self._newest = Newest(Signals(rig, 0).topics)
        self._threads = [
            threading.Thread(target=run, name=name, daemon=True)
            for name, run in (("live feed", self._feed), ("live requests", self._serve))
        ]

    def __enter__(self) -> LivePage:
        self._process.start()
        self._theirs.close()
        try:
            came: dict[str, Any] = self._ours.recv() if self._ours.poll(_START_S) else {"failed": "it did not start"}
        except EOFError:
            came = {"failed": "its process ended"}
        if "failed" in came:
            self.__exit__()
            raise RigError(f"the live page: {came['failed']}")
        self.url, self.token = came["url"], came["token"]
        self._threads[1].start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._session is not None:
            with contextlib.suppress(ValueError):
                self._session.observers.remove(self._happened)
                self._session.noted.remove(self._noted)
        if self._threads[0].is_alive():
            self._threads[0].join(_FEED_ENDS_S)
        if self._threads[0].is_alive():  # it waits for a page that takes nothing any more
            self._process.kill()
        else:
            with contextlib.suppress(OSError, ValueError):
                self._send({"end": True})
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._threads[1].is_alive():
            self._threads[1].join(_END_S)  # the other end of the pipe is closed by now
        self._ours.close()

    def follow(
        self, session: Session, asking: Asking, stop: Callable[[str], None] | None, facts: Mapping[str, Any]
    ) -> None:
        """Show a session from now on.

        Args:
            session: open.
            asking: what its test asks and may be asked for.
            stop: stops the rotor at once and ends the run, with a reason; None where the rig is not ours to stop.
            facts: what else the page shows: "note", "log" …
        """
        self._session, self._asking, self._stop, self._facts = session, asking, stop, dict(facts)
        session.observers.append(self._happened)
        session.noted.append(self._noted)
        self._threads[0].start()

    # --- what happens, told by the session's threads: kept, no more ----------------------------------------------

    def _happened(self, event: Event) -> None:
        if event.kind not in _QUIET and self._session is not None:
            self._noted(event, self._session.clock.now_ns())

    def _noted(self, event: Event, host_ns: int) -> None:
        facts = {name: value for name, value in event.facts.items() if name not in _TOO_LONG}
        self._events.append(
            {"time_ns": host_ns, **facts, "kind": event.kind, "device": event.device, "text": event.text}
        )

    # --- handing over --------------------------------------------------------------------------------------------

    def _feed(self) -> None:
        facts_s = 0.0
        with contextlib.suppress(OSError, ValueError):  # the page is gone; the session goes on
            while not self._ending.wait(_TURN_S):
                now = time.monotonic()
                facts = self._said() if now - facts_s >= _FACTS_S else None
                facts_s = now if facts is not None else facts_s
                self._send(self._copied(facts))
            self._send(self._copied(self._said()))

    def _copied(self, facts: dict[str, Any] | None) -> dict[str, Any]:
        session = self._session
        assert session is not None
        heard_ns = session.clock.now_ns()
        rows = self._newest.take(session.recent, heard_ns)
        events: list[dict[str, Any]] = []
        with contextlib.suppress(IndexError):
            while True:
                events.append(self._events.popleft())
        return {"heard_ns": heard_ns, "rows": rows, "events": events, "facts": facts}

    def _said(self) -> dict[str, Any]:
        session = self._session
        assert session is not None
        disk = session.disk()
        stopping, ended = session.trouble is not None, session.closed
        tests = [] if stopping else self._asking.can()
        can = [] if ended else [*tests, *(["stop"] if self._stop is not None else []), "note"]
        log = {} if session.log is None else {"log": str(session.log)}
        return {
            **log, **self._facts, **self._asking.facts(), "stopping": stopping, "ended": ended,
            "losses": session.losses(), "rates": session.rates.now(),
            "disk": None if disk is None else disk.facts(), "feed_dropped": self._newest.left_out,
            "trouble": str(session.trouble or session.left or ""), "can": can,
            "stop": "" if self._stop is not None else "whoever runs the rig stops it: this session only listens",
        }  # fmt: skip

    def _send(self, what: Mapping[str, Any]) -> None:
        with self._sending:
            self._ours.send(what)

    # --- what the page asks for ----------------------------------------------------------------------------------

    def _serve(self) -> None:
        with contextlib.suppress(EOFError, OSError, ValueError):
            while not self._ending.is_set():
                asked = self._ours.recv()
                try:
                    answer = self._act(asked["act"], asked["given"])
                except Exception as why:  # whatever became of this one, the next stop is heard
                    answer = {"error": f"{why}" if isinstance(why, RigError) else f"{type(why).__name__}: {why}"}
                self._send({"answer": answer, "to": asked["number"]})

    def _act(self, verb: str, given: Mapping[str, Any]) -> dict[str, Any]:
        session, controls = self._session, self._asking.controls
        if session is None:
            raise DeviceError(f"{verb}: the rig is not open yet")
        text = str(given.get("text", "")).strip()
        match verb:
            case "stop" if self._stop is not None:
                self._stop("stopped by the button of the live page")
                return {"done": True, "time_ns": session.clock.now_ns()}
            case "note" if text and controls is not None and controls.status.test:
                controls.note(text)
            case "note" if text:
                session.note(Event("note", "host", text, {"time_ns": session.clock.now_ns()}))
            case "pause" if controls is not None:
                controls.pause()
            case "resume" if controls is not None:
                controls.resume()
            case "abort" if controls is not None:
                controls.abort("by the live page")
            case "confirm" if self._asking.confirmed is not None:
                self._asking.confirmed()
            case _:
                raise DeviceError(f"{verb}: nothing here does that")
        return {"done": True, "answer": f"{verb}: asked for"}
