"""Entrance of a session's page in a process of its own: STOP shares no interpreter with drawing or recording.

    browser ─▶ entrance process ══orders, answers══▶ session's process, thread "stop": Session.stop
                     └════════ accepted connections ════════▶ page's process

It imports no numerical code, opens no file and waits for no other process.
"""

from __future__ import annotations

import itertools
import logging
import socket
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from multiprocessing.connection import Connection
from typing import Any

from live.entrance import Connections, Entrance
from live.errors import CommandRefused, LiveError
from live.guard import Access
from live.handover import SocketSender
from live.messages import Facts
from rig_basics.errors import RigError
from rig_basics.ignoring import ignoring
from rig_basics.worker_processes import WORKERS

_START_S, _END_S = 60.0, 5.0
_log = logging.getLogger(__name__)


class _Orders:
    """Orders to the session's process and their answers."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self._sending = pipe, threading.Lock()
        self._numbers = itertools.count()
        self._waiting: dict[int, Future[Facts]] = {}

    def place(self) -> Future[Facts]:
        number, answer = next(self._numbers), Future[Facts]()
        self._waiting[number] = answer
        self.send({"stop": number})
        return answer

    def send(self, message: dict[str, Any]) -> None:
        try:
            with self._sending:
                self._pipe.send(message)
        except (OSError, ValueError) as fault:
            raise CommandRefused("stop: the recorder has ended") from fault

    def report(self, connections: Connections) -> None:
        with ignoring(_log, "reporting connections", CommandRefused):
            self.send({"connections": connections})

    def receive(self, end: Callable[[], None]) -> None:
        """Receive answers until the session's process announces the end or breaks off."""
        with ignoring(_log, "receiving the session's answers", EOFError, OSError):
            while "end" not in (message := self._pipe.recv()):
                answer, waiting = message["answer"], self._waiting.pop(message["to"])
                if "error" in answer:
                    waiting.set_exception(CommandRefused(answer["error"]))
                else:
                    waiting.set_result(answer)
        end()


def run_entrance(
    pipe: Connection, listening: socket.socket, token: str, hosts: Sequence[str], connections: Connection, page_pid: int
) -> None:
    """Run the entrance's process until the session's process ends it."""
    orders = _Orders(pipe)
    page = SocketSender(connections, page_pid)
    entrance = Entrance(listening, Access(token, hosts), orders.place, page.offer, orders.report)
    threading.Thread(target=orders.receive, args=(entrance.end,), name="answers", daemon=True).start()
    pipe.send({"ready": True})
    entrance.run()


class EntranceProcess:
    """The process, started on entering; a context.

    Args:
        listening: listening socket; a copy of it is closed with the process.
        token, hosts: as for live.guard.Access.
        connections: pipe to the page's process, which receives the accepted connections.
        page_pid: that process.
        stop: stops the rotor and returns the answer; called by a thread that does nothing else.

    Attributes:
        connections: newest counts.
    Raises:
        LiveError: on entering, if the process does not start.
    """

    def __init__(
        self,
        listening: socket.socket,
        token: str,
        hosts: Sequence[str],
        connections: Connection,
        page_pid: int,
        stop: Callable[[], Facts],
    ) -> None:
        self.connections: Connections = {}
        self._stop, self._sending = stop, threading.Lock()
        self._ours, self._theirs = WORKERS.Pipe()
        arguments = (self._theirs, listening, token, tuple(hosts), connections, page_pid)
        self._process = WORKERS.Process(target=run_entrance, args=arguments, name="live page: entrance", daemon=True)
        self._thread = threading.Thread(target=self._receive, name="stop", daemon=True)

    @property
    def works(self) -> bool:
        """Whether the process runs, so that STOP is received."""
        return self._process.is_alive()

    def __enter__(self) -> EntranceProcess:
        self._process.start()
        self._theirs.close()
        try:
            if not self._ours.poll(_START_S):
                raise LiveError(f"the live page: its entrance did not start within {_START_S:g} s")
            self._ours.recv()
        except (EOFError, OSError, LiveError) as fault:
            self._process.kill()
            raise LiveError(f"the live page: its entrance did not start: {fault}") from fault
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with ignoring(_log, "announcing the end", OSError, ValueError):
            self._send({"end": True})
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._thread.join(_END_S)
        self._ours.close()

    def _send(self, message: dict[str, Any]) -> None:
        with self._sending:
            self._ours.send(message)

    def _receive(self) -> None:
        with ignoring(_log, "receiving the orders of the page", EOFError, OSError, ValueError):
            while True:
                message = self._ours.recv()
                if "connections" in message:
                    self.connections = message["connections"]
                else:
                    self._send({"answer": self._carry_out(), "to": message["stop"]})

    def _carry_out(self) -> Facts:
        try:
            return self._stop()
        except Exception as fault:  # a failed order must not prevent a later one
            _log.warning("stop: %s: %s", type(fault).__name__, fault)
            return {"error": f"{fault}" if isinstance(fault, RigError) else f"{type(fault).__name__}: {fault}"}
