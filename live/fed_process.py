# pyright: strict
"""A process of its own beside a session, fed with copies of what is newest.

The session's threads do nothing for it. One thread here looks at the newest samples 30 times a second and writes them
into a pipe; while that process does not take them, this thread waits. Another takes what comes back.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any, Self, TypeVar

from daq.acquisition.session import Session
from daq.drivers.items import Event
from daq.errors import RigError

_Item = TypeVar("_Item")
_TURN_S = 1 / 30
_START_S, _END_S, _FEED_ENDS_S = 180.0, 10.0, 1.0  # a slow machine compiles for a minute, once


class FedProcess(ABC):
    """For one session; a context, entered before the session and left after it.

    Args:
        name: of the process.
        whose: what an error begins with.
        run: the process: called with its end of the pipe and `args`. It says one thing first: what is offered, or
            {"failed": why}; it ends when it is sent {"end": True}, or the pipe is gone.
        args: whatever can be pickled.

    Attributes:
        offered: what the process said first, once this is entered.
    Raises:
        RigError: it did not start, or failed.
    """

    def __init__(self, name: str, whose: str, run: Callable[..., None], args: tuple[Any, ...]) -> None:
        self.offered: dict[str, Any] = {}
        self._whose = whose
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._theirs: Connection = theirs
        self._process = context.Process(target=run, args=(theirs, *args), name=name, daemon=True)
        self._sending = threading.Lock()
        self._ending = threading.Event()
        self._session: Session | None = None
        self._feeding = threading.Thread(target=self._feed, name=f"{name}: feed", daemon=True)
        self._hearing = threading.Thread(target=self._hear, name=f"{name}: answers", daemon=True)

    @abstractmethod
    def _copied(self, session: Session, last: bool) -> Mapping[str, Any]:
        """What is handed over now: all that is new; `last` at the session's end."""

    @abstractmethod
    def _heard(self, said: Mapping[str, Any]) -> None:
        """The process said something."""

    def _happened(self, session: Session, event: Event) -> None:
        """An event of a device, told by the session's threads: to be kept, no more."""
        self._noted(event, session.clock.now_ns())

    @abstractmethod
    def _noted(self, event: Event, host_ns: int) -> None:
        """An event of the host, as `_happened`."""

    def _reported(self, facts: Mapping[str, Any], host_ns: int) -> None:
        """A health report, as `_happened`."""
        del facts, host_ns

    def __enter__(self) -> Self:
        self._process.start()
        self._theirs.close()
        try:
            came: dict[str, Any] = self._ours.recv() if self._ours.poll(_START_S) else {"failed": "it did not start"}
        except EOFError:
            came = {"failed": "its process ended"}
        if "failed" in came:
            self.__exit__()
            raise RigError(f"{self._whose}: {came['failed']}")
        self.offered = came
        self._hearing.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._session is not None:
            with contextlib.suppress(ValueError):
                self._session.observers.remove(self._observed)
                self._session.noted.remove(self._noted)
                self._session.reported.remove(self._reported)
        if self._feeding.is_alive():
            self._feeding.join(_FEED_ENDS_S)
        if self._feeding.is_alive():  # it waits for a process that takes nothing any more
            self._process.kill()
        else:
            with contextlib.suppress(OSError, ValueError):
                self._send({"end": True})
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._hearing.is_alive():
            self._hearing.join(_END_S)  # the other end of the pipe is closed by now
        self._ours.close()

    def _feed_from(self, session: Session) -> None:
        """Hand an open session over from now on."""
        self._session = session
        session.observers.append(self._observed)
        session.noted.append(self._noted)
        session.reported.append(self._reported)
        self._feeding.start()

    def _observed(self, event: Event) -> None:
        if self._session is not None:
            self._happened(self._session, event)

    def _feed(self) -> None:
        session = self._session
        assert session is not None
        with contextlib.suppress(OSError, ValueError):  # its process is gone; the session goes on
            while not self._ending.wait(_TURN_S):
                self._send(self._copied(session, last=False))
            self._send(self._copied(session, last=True))

    def _hear(self) -> None:
        with contextlib.suppress(EOFError, OSError, ValueError):
            while True:
                self._heard(self._ours.recv())

    def _send(self, what: Mapping[str, Any]) -> None:
        with self._sending:
            self._ours.send(what)


def emptied(kept: deque[_Item]) -> list[_Item]:
    """All that a deque holds, taken out of it while others append."""
    found: list[_Item] = []
    with contextlib.suppress(IndexError):
        while True:
            found.append(kept.popleft())
    return found
