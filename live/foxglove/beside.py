# pyright: strict
"""The Foxglove connection beside a session: a process of its own, fed with copies, as the live page is.

One thread looks at the newest samples 30 times a second and writes them into a pipe. While that process does not take
them, this thread waits; what it then missed is counted. Nothing comes back but words for the operator.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import threading
from collections import deque
from collections.abc import Callable, Collection, Mapping
from multiprocessing.connection import Connection
from typing import Any

from daq import channels
from daq.acquisition.session import Session
from daq.drivers.devices import channels_of
from daq.drivers.items import Event
from daq.errors import RigError
from live.foxglove.served import NoteRow, run_foxglove
from live.newest import Newest
from rig_configs.schema import Rig

HOLD_S = 0.25
"""Seconds of the wall that samples are kept back, so that those of a slow radio are sent in order with the others."""
_TURN_S = 1 / 30
_START_S, _END_S, _FEED_ENDS_S = 60.0, 10.0, 1.0
_MOST_NOTES = 2000


class FoxgloveBeside:
    """A connection for one session; a context, entered before the session and left after it.

    Args:
        rig: the session's.
        rate: seconds of the rig per second of the wall.
        port, origins: as FoxgloveServer takes them.
        told: takes a sentence for the operator.

    Attributes:
        url: once it is entered.
        left_out: messages that slow clients were not sent; known once it is left.
    Raises:
        RigError: the connection cannot be offered.
    """

    def __init__(
        self, rig: Rig, rate: float, port: int, origins: Collection[str], told: Callable[[str], None]
    ) -> None:  # fmt: skip
        self.url, self.left_out = "", 0
        self._told, self._hold_ns = told, int(HOLD_S * 1e9 * (rate if math.isfinite(rate) else 1.0))
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._theirs: Connection = theirs
        self._process = context.Process(
            target=run_foxglove, args=(theirs, rig, port, tuple(origins)), name="foxglove", daemon=True
        )
        self._ending = threading.Event()
        self._session: Session | None = None
        self._notes: deque[NoteRow] = deque(maxlen=_MOST_NOTES)
        self._newest = Newest({topic: channel.names for topic, channel in channels_of(rig.devices).items()})
        self._feeding = threading.Thread(target=self._feed, name="foxglove feed", daemon=True)
        self._hearing = threading.Thread(target=self._hear, name="foxglove words", daemon=True)

    def __enter__(self) -> FoxgloveBeside:
        self._process.start()
        self._theirs.close()
        try:
            came: dict[str, Any] = self._ours.recv() if self._ours.poll(_START_S) else {"failed": "it did not start"}
        except EOFError:
            came = {"failed": "its process ended"}
        if "failed" in came:
            self.__exit__()
            raise RigError(f"--foxglove: {came['failed']}")
        self.url = came["url"]
        self._hearing.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._session is not None:
            with contextlib.suppress(ValueError):
                self._session.observers.remove(self._happened)
                self._session.noted.remove(self._noted)
                self._session.reported.remove(self._reported)
        if self._feeding.is_alive():
            self._feeding.join(_FEED_ENDS_S)
        if self._feeding.is_alive():  # it waits for a process that takes nothing any more
            self._process.kill()
        else:
            with contextlib.suppress(OSError, ValueError):
                self._ours.send({"end": True})
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._hearing.is_alive():
            self._hearing.join(_END_S)  # the other end of the pipe is closed by now
        self._ours.close()

    def follow(self, session: Session) -> None:
        """Show an open session from now on."""
        self._session = session
        session.observers.append(self._happened)
        session.noted.append(self._noted)
        session.reported.append(self._reported)
        self._feeding.start()

    # --- what happens, told by the session's threads: kept, no more ----------------------------------------------

    def _happened(self, event: Event) -> None:
        if self._session is not None:
            self._noted(event, self._session.clock.now_ns())

    def _noted(self, event: Event, host_ns: int) -> None:
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        self._notes.append((channels.EVENTS_TOPIC, int(event.facts.get("time_ns", host_ns)), note))

    def _reported(self, facts: Mapping[str, Any], host_ns: int) -> None:
        self._notes.append((channels.HEALTH_TOPIC, host_ns, dict(facts)))

    # --- handing over --------------------------------------------------------------------------------------------

    def _feed(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # its process is gone; the session goes on
            while not self._ending.wait(_TURN_S):
                self._ours.send(self._copied(self._hold_ns))
            self._ours.send(self._copied(0))

    def _copied(self, hold_ns: int) -> dict[str, Any]:
        session = self._session
        assert session is not None
        heard_ns = session.clock.now_ns()
        until_ns = heard_ns - hold_ns
        rows = self._newest.take(session.recent, heard_ns, until_ns if hold_ns else None)
        notes: list[NoteRow] = []
        with contextlib.suppress(IndexError):
            while True:
                notes.append(self._notes.popleft())
        return {"until_ns": until_ns, "rows": rows, "notes": notes}

    def _hear(self) -> None:
        with contextlib.suppress(EOFError, OSError, ValueError):
            while True:
                said = self._ours.recv()
                if "left_out" in said:
                    self.left_out = int(said["left_out"])
                else:
                    self._told(str(said["say"]))
