"""The live page of a session in processes of its own, and its commands; omitted samples are counted."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any, Self

from daq.acquisition.session import Session
from daq.errors import DeviceError
from daq.guided_tests.controls import Controls
from daq.items import DeviceEvent
from live.entrance_process import EntranceProcess
from live.errors import LiveError
from live.fed_process import FedProcess, drained
from live.guard import hosts_of, new_token
from live.newest import Newest
from live.port import bound, page_address
from live.signals import Signals
from live.watched import run_page
from rig_basics.errors import RigError
from rig_basics.worker_processes import WORKERS
from rig_configs import IdentifiedParameters
from rig_configs.schema import Rig

_FACTS_S = 0.2
_MAX_EVENTS = 500
_QUIET = ("status", "reply", "acknowledge")
_HIDDEN_FACTS = ("excerpt",)  # long facts of events, which the page does not display


class Asking:
    """Commands of the page to a running test, and the facts of that test on the page.

    Args:
        controls: controls of the tests; None if no test can run.
        confirmed: called when a viewer confirms that a prompt has been carried out; None if prompts need no answer.
    """

    def __init__(self, controls: Controls | None = None, confirmed: Callable[[], None] | None = None) -> None:
        self.controls: Controls | None = controls
        self.confirmed: Callable[[], None] | None = confirmed
        self._prompt, self._at = "", ("", "")

    def prompt(self, text: str) -> None:
        """Display a prompt to the operator."""
        self._prompt, self._at = text, self._state()

    def _state(self) -> tuple[str, str]:
        status = self.controls.status if self.controls is not None else None
        return (status.test, status.state) if status is not None else ("", "")

    def facts(self) -> dict[str, Any]:
        """Return the facts of the test for the page."""
        if self.controls is None:
            return {}
        status = self.controls.status
        prompt = self._prompt if self._at == self._state() else ""
        return {
            "test": status.test,
            "numbers": dict(status.numbers),
            "step": status.state,
            "words": status.words,
            "share": status.share,
            "answer": status.answer,
            "prompt": prompt,
        }

    def can(self) -> list[str]:
        """Return the commands that are possible now."""
        tests = [] if self.controls is None or not self.controls.status.test else ["pause", "resume", "abort"]
        return [*tests, *(["confirm"] if tests and self.confirmed is not None and self._prompt else [])]


class LivePage(FedProcess):
    """The live page of one session; see FedProcess.

    Args:
        rig: rig of the session, with identified parameters applied if they exist.
        identified: these parameters.
        source: origin of the model's numbers, for a reader.
        title: title of the page.
        host, port: as for live.port.bound.

    Raises:
        LiveError: on entering, if the page cannot be served.
    """

    def __init__(
        self,
        rig: Rig,
        identified: IdentifiedParameters | None,
        source: str,
        title: str,
        host: str = "",
        port: int = 0,
    ) -> None:
        self._token, self._place, self._url = new_token(), (host, port), ""
        self._accepted, given = WORKERS.Pipe()
        self._hosts: list[str] = []  # known to the page's process too, by reference, once the port is bound
        page = (rig, identified, source, title, self._token, self._hosts, given)
        super().__init__("live page", "the live page", run_page, page)
        self._given, self._entrance = given, ExitStack()
        self._stop_path: EntranceProcess | None = None
        self._asking, self._facts, self._facts_s = Asking(), dict[str, Any](), -math.inf
        self._stop: Callable[[str], None] | None = None
        self._events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        self._newest = Newest(Signals(rig, 0).topics)

    def __enter__(self) -> Self:
        host, port = self._place
        try:
            listening = bound(host, port)
        except LiveError as fault:
            self._end_pipes()
            raise LiveError(f"{self._label}: {fault}") from fault
        with listening:
            self._url = page_address(host, listening, self._token)
            self._hosts += hosts_of(host, int(listening.getsockname()[1]))
            super().__enter__()
            pid = self._process.pid
            assert pid is not None
            path = EntranceProcess(
                listening, self._token, self._hosts, self._accepted, pid, lambda: self._act("stop", {})
            )
            try:
                self._stop_path = self._entrance.enter_context(path)
            except LiveError:
                self.__exit__()
                raise
        self._end_pipes()  # the processes have them: each notices the end of the other
        return self

    def __exit__(self, *exit_: object) -> None:
        super().__exit__(*exit_)
        self._entrance.close()

    def _end_pipes(self) -> None:
        self._accepted.close()
        self._given.close()

    @property
    def url(self) -> str:
        """Address of the page with its token."""
        return self._url

    @property
    def token(self) -> str:
        """Token of the page."""
        return self._token

    def follow(
        self, session: Session, asking: Asking, stop: Callable[[str], None] | None, facts: Mapping[str, Any]
    ) -> None:
        """Display a session from now on.

        Args:
            session: open session.
            asking: commands to its test.
            stop: stops the rotor at once and ends the run, with a reason; None if this program does not run the rig.
            facts: further facts on the page: "note", "log" …
        """
        self._asking, self._stop, self._facts = asking, stop, dict(facts)
        self._feed_from(session)

    def _on_event(self, session: Session, event: DeviceEvent) -> None:
        if event.kind not in _QUIET:
            super()._on_event(session, event)

    def _on_note(self, event: DeviceEvent, host_ns: int) -> None:
        facts = {name: value for name, value in event.facts.items() if name not in _HIDDEN_FACTS}
        self._events.append(
            {"time_ns": host_ns, **facts, "kind": event.kind, "device": event.device, "text": event.text}
        )

    def _update(self, session: Session, last: bool) -> Mapping[str, Any]:
        now_s = time.monotonic()
        facts = self._session_facts(session) if last or now_s - self._facts_s >= _FACTS_S else None
        self._facts_s = now_s if facts is not None else self._facts_s
        heard_ns = session.clock.now_ns()
        rows = self._newest.take(session.channels.recent, heard_ns)
        return {"heard_ns": heard_ns, "rows": rows, "events": drained(self._events), "facts": facts}

    def _session_facts(self, session: Session) -> dict[str, Any]:
        disk = session.recording.disk()
        stopping, ended = session.trouble is not None, session.closed
        tests = [] if stopping else self._asking.can()
        can = [] if ended else [*tests, *(["stop"] if self._stop is not None else []), "note"]
        log = {} if session.recording.path is None else {"log": str(session.recording.path)}
        return {
            **log,
            **self._facts,
            **self._asking.facts(),
            "stopping": stopping,
            "ended": ended,
            "losses": session.recording.losses(),
            "rates": session.channels.rates.now(),
            "disk": None if disk is None else disk.facts(),
            "feed_dropped": self._newest.left_out,
            "trouble": str(session.trouble or session.rotor_warning or (self._no_stop() if self._stop else "")),
            "can": can,
            "stop": self._no_stop(),
            "connections": {} if self._stop_path is None else self._stop_path.connections,
        }

    def _no_stop(self) -> str:
        """Return the reason why STOP is impossible; "" if it is possible."""
        if self._stop is None:
            return "this session only receives; stop the rig in the program that runs it"
        if self._stop_path is not None and not self._stop_path.works:
            return "STOP of this page has failed: its process ended; use the emergency stop at the rig"
        return ""

    def _on_message(self, message: Mapping[str, Any]) -> None:
        """Carry out a command of the page and send the answer."""
        try:
            answer = self._act(message["act"], message["given"])
        except Exception as fault:  # a failed command must not prevent a later stop
            answer = {"error": f"{fault}" if isinstance(fault, RigError) else f"{type(fault).__name__}: {fault}"}
        self._send({"answer": answer, "to": message["number"]})

    def _act(self, verb: str, given: Mapping[str, Any]) -> dict[str, Any]:
        session, controls = self._session, self._asking.controls
        if session is None:
            raise DeviceError(f"{verb}: the rig is not open yet")
        if session.closed:
            raise DeviceError(f"{verb}: the run has ended")
        text = str(given.get("text", "")).strip()
        match verb:
            case "stop" if self._stop is not None:
                self._stop("stopped by the button of the live page")
                return {"done": True, "time_ns": session.clock.now_ns()}
            case "note" if text and controls is not None and controls.status.test:
                controls.note(text)
            case "note" if text:
                session.note(DeviceEvent("note", "host", text, {"time_ns": session.clock.now_ns()}))
            case "pause" if controls is not None:
                controls.pause()
            case "resume" if controls is not None:
                controls.resume()
            case "abort" if controls is not None:
                controls.abort("by the live page")
            case "confirm" if self._asking.confirmed is not None:
                self._asking.confirmed()
            case _:
                raise DeviceError(f"{verb}: not available in this session")
        return {"done": True, "answer": f"{verb}: requested"}
