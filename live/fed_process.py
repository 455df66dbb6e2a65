"""A separate process for one session, fed with copies of the newest data.

The session's threads do no work for it. One thread here reads the newest samples 30 times per second and writes them
into a pipe. It waits while the process does not read the pipe. A second thread receives the messages of the process.
"""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any, Self, TypeVar

from daq.acquisition.session import Session
from daq.items import DeviceEvent
from live.errors import LiveError
from rig_basics.ignoring import ignoring
from rig_basics.worker_processes import WORKERS

_Item = TypeVar("_Item")
_INTERVAL_S = 1 / 30
_START_S, _END_S, _FEED_END_S = 180.0, 10.0, 1.0  # timeouts; a slow machine compiles for a minute, once
_log = logging.getLogger(__name__)


class FedProcess(ABC):
    """A separate process for one session; a context that is entered before the session and left after it.

    Args:
        name: name of the process.
        label: start of error messages.
        run: function of the process, called with its end of the pipe and `args`. Its first message contains what it
            offers, or {"failed": reason}. It ends when it receives {"end": True} or the pipe is closed.
        args: picklable arguments.

    Attributes:
        offered: first message of the process, once the context is entered.
    Raises:
        LiveError: the process did not start, or failed.
    """

    def __init__(self, name: str, label: str, run: Callable[..., None], args: tuple[Any, ...]) -> None:
        self.offered: dict[str, Any] = {}
        self._label = label
        self._ours, theirs = WORKERS.Pipe()
        self._theirs: Connection = theirs
        self._process = WORKERS.Process(target=run, args=(theirs, *args), name=name, daemon=True)
        self._sending = threading.Lock()
        self._ending = threading.Event()
        self._session: Session | None = None
        self._feeding = threading.Thread(target=self._feed, name=f"{name}: feed", daemon=True)
        self._receiving = threading.Thread(target=self._receive, name=f"{name}: answers", daemon=True)

    @abstractmethod
    def _update(self, session: Session, last: bool) -> Mapping[str, Any]:
        """Return all new data for the process; `last` at the end of the session."""

    @abstractmethod
    def _on_message(self, message: Mapping[str, Any]) -> None:
        """Handle a message of the process."""

    def _on_event(self, session: Session, event: DeviceEvent) -> None:
        """Store an event of a device; called by the session's threads, so it must return at once."""
        self._on_note(event, session.clock.now_ns())

    @abstractmethod
    def _on_note(self, event: DeviceEvent, host_ns: int) -> None:
        """Store an event of the host; as `_on_event`."""

    def _on_health(self, facts: Mapping[str, Any], host_ns: int) -> None:
        """Store a health report; as `_on_event`."""
        del facts, host_ns

    def __enter__(self) -> Self:
        self._process.start()
        self._theirs.close()
        try:
            first: dict[str, Any] = self._ours.recv() if self._ours.poll(_START_S) else {"failed": "it did not start"}
        except EOFError:  # usual: reported as LiveError
            first = {"failed": "its process ended"}
        if "failed" in first:
            self.__exit__()
            raise LiveError(f"{self._label}: {first['failed']}")
        self.offered = first
        self._receiving.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._session is not None:
            with ignoring(_log, "detaching from the session", ValueError):
                self._session.device_event_observers.remove(self._on_session_event)
                self._session.host_event_observers.remove(self._on_note)
                self._session.health_observers.remove(self._on_health)
        if self._feeding.is_alive():
            self._feeding.join(_FEED_END_S)
        if self._feeding.is_alive():  # it waits for a process that does not read any more
            self._process.kill()
        else:
            with ignoring(_log, "announcing the end", OSError, ValueError):
                self._send({"end": True})
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._receiving.is_alive():
            self._receiving.join(_END_S)  # the other end of the pipe is closed by now
        self._ours.close()

    def _feed_from(self, session: Session) -> None:
        """Feed the process from an open session from now on."""
        self._session = session
        session.device_event_observers.append(self._on_session_event)
        session.host_event_observers.append(self._on_note)
        session.health_observers.append(self._on_health)
        self._feeding.start()

    def _on_session_event(self, event: DeviceEvent) -> None:
        if self._session is not None:
            self._on_event(self._session, event)

    def _feed(self) -> None:
        session = self._session
        assert session is not None
        try:
            while not self._ending.wait(_INTERVAL_S):
                self._send(self._update(session, last=False))
            self._send(self._update(session, last=True))
        except (OSError, ValueError) as error:  # the process has ended
            _log.info("%s: receives no further data, the session continues: %s", self._label, error)

    def _receive(self) -> None:
        with ignoring(_log, f"receiving the messages of {self._label}", EOFError, OSError, ValueError):
            while True:
                self._on_message(self._ours.recv())

    def _send(self, message: Mapping[str, Any]) -> None:
        with self._sending:
            self._ours.send(message)


def drained(kept: deque[_Item]) -> list[_Item]:
    """Remove and return all items of a deque while other threads append."""
    found: list[_Item] = []
    while True:
        try:
            found.append(kept.popleft())
        except IndexError:  # usual: the deque is empty
            return found
