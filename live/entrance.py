"""Entrance of the page: accepts all connections, judges each request, and carries out STOP itself.

    connection ─▶ request head ─▶ live.guard ──no──▶ 400, 403
      │ none in time: closed        ├─▶ POST /stop ─▶ the order to stop ─▶ answer
      │ too many: oldest closed     └─▶ all else is handed over, with the bytes read so far

One thread does this and nothing else: no drawing, no file, no wait for a viewer. A connection costs others nothing
until its request has passed the guard. Connections are limited in number and time and counted by address: of
`MOST_ASKING` without a whole request, the oldest of the address with most of them is closed. A file is kept in reserve.

A response ends its connection. A browser would otherwise send STOP on one that belongs to the page's process.
"""

from __future__ import annotations

import enum
import errno
import json
import logging
import selectors
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from http import HTTPStatus

import h11

from live.errors import CommandRefused
from live.guard import HEADERS, Access
from live.messages import Facts
from rig_basics.ignoring import ignoring
from rig_basics.texts import number_of

STOP_PATH = "/stop"
MOST_ASKING, MOST_ANSWERED = 256, 64
"""Connections without a whole request, and those that wait for the answer of STOP or read it. Together with
those that wait to be handed over they remain far below the 1 024 files of a process."""
_ASKING_S, _ANSWER_S, _READING_S = 5.0, 2.0, 1.0  # for a request, the answer of STOP, and reading it
_MAX_HEAD_BYTES, _READ_BYTES = 16 * 1024, 16 * 1024
_ACCEPTED_AT_ONCE = 64  # then those that have sent something get their turn
_MOST_ADDRESSES, _OTHERS = 32, "other addresses"
_REPORT_S = 1.0
_NO_FILES_S = 0.01
_NO_FILES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_log = logging.getLogger(__name__)

Connections = Mapping[str, Mapping[str, int]]
"""By address: connections closed without a request in time, closed for newer ones, refused by the guard, and turned
away because the page was busy."""


class _Stage(enum.Enum):
    ASKING = "has not sent a whole request"
    ORDERED = "waits for the answer of STOP"
    ANSWERED = "reads its answer"


@dataclass(eq=False)
class _Guest:
    """One connection."""

    socket: socket.socket
    address: str
    until_s: float
    received: bytearray = field(default_factory=bytearray)
    head: h11.Connection | None = None  # from the first byte on: most of a flood send none
    stage: _Stage = _Stage.ASKING


class Entrance:
    """Accepts connections until it is ended; `run` is called in a thread of its own.

    Args:
        listening: listening socket; it stays open.
        access: rules for every request.
        order: orders the stop and returns its answer once it exists; raises CommandRefused if it is impossible.
        hand_over: takes a connection with the bytes read so far; False if it cannot take one now.
        report: receives the counts at most once per second when they have changed.
    """

    def __init__(
        self,
        listening: socket.socket,
        access: Access,
        order: Callable[[], Future[Facts]],
        hand_over: Callable[[socket.socket, bytes], bool],
        report: Callable[[Connections], None],
    ) -> None:
        self._listening, self._access = listening, access
        self._order, self._hand_over, self._report = order, hand_over, report
        self._asking: dict[str, dict[_Guest, None]] = {}
        self._number_asking = 0
        self._answered: dict[_Guest, None] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._reported_s, self._changed = 0.0, False
        self._answers: deque[tuple[_Guest, Future[Facts]]] = deque()
        self._ending = threading.Event()
        self._woken, self._waking = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._reserve: socket.socket | None = None  # a file for a connection when the process has used up all others

    def run(self) -> None:
        """Accept and answer until the end."""
        self._listening.setblocking(False)
        self._woken.setblocking(False)
        self._waking.setblocking(False)
        self._reserve = self._listening.dup()
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        while not self._ending.is_set():
            ready = [key for key, _ in self._selector.select(self._patience_s())]
            for key in ready:
                if isinstance(key.data, _Guest) and key.data.socket.fileno() >= 0:  # not closed in this turn
                    self._read(key.data)
            if any(key.fileobj is self._woken for key in ready):
                self._send_answers()
            if any(key.fileobj is self._listening for key in ready):
                self._accept()
            self._close_late()
            self._report_changes()
        for guest in [*(each for group in self._asking.values() for each in group), *self._answered]:
            self._close(guest)
        self._use_reserve()
        self._selector.close()
        self._woken.close()
        self._waking.close()

    def end(self) -> None:
        """End `run`. Any thread."""
        self._ending.set()
        self._wake()

    def _wake(self) -> None:
        with ignoring(_log, "waking the entrance", OSError):  # it has ended, or is awake
            self._waking.send(b"\0")

    # --- connections without a request ----------------------------------------------------------------------------

    def _accept(self) -> None:
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                made, address = self._listening.accept()
            except BlockingIOError:  # usual: none waits any more
                return
            except OSError as fault:
                if fault.errno in _NO_FILES and not (self._displace() or self._use_reserve()):
                    _log.debug("no connection can be accepted: %s", fault)
                    self._ending.wait(_NO_FILES_S)
                continue
            made.setblocking(False)
            guest = _Guest(made, str(address[0]), time.monotonic() + _ASKING_S)
            self._asking.setdefault(guest.address, {})[guest] = None
            self._selector.register(made, selectors.EVENT_READ, guest)
            self._number_asking += 1
            if self._number_asking > MOST_ASKING:
                self._displace()
            if guest.address in self._asking and guest in self._asking[guest.address]:
                self._read(guest)

    def _displace(self) -> bool:
        """Close the oldest connection without a request of the address that has the most; False if there is none."""
        if not self._asking:
            return False
        address, group = max(self._asking.items(), key=lambda pair: len(pair[1]))
        self._count(address, "displaced")
        self._close(next(iter(group)))
        return True

    def _use_reserve(self) -> bool:
        """Free the reserved file for one connection; False if it is in use."""
        if self._reserve is None:
            return False
        self._reserve.close()
        self._reserve = None
        return True

    def _read(self, guest: _Guest) -> None:
        try:
            data = guest.socket.recv(_READ_BYTES)
        except BlockingIOError:  # usual: nothing yet
            return
        except OSError:  # usual: the client is gone
            data = b""
        if not data:
            self._close(guest)
        elif guest.stage is _Stage.ASKING:  # the rest of a request that is answered here has no meaning
            guest.received += data
            self._parse(guest, data)

    def _parse(self, guest: _Guest, data: bytes) -> None:
        guest.head = guest.head or h11.Connection(h11.SERVER, _MAX_HEAD_BYTES)
        try:
            guest.head.receive_data(data)
            event = guest.head.next_event()
        except h11.RemoteProtocolError as fault:
            self._refuse(guest, 400, f"expected an HTTP request: {fault}")
            return
        if isinstance(event, h11.Request):
            self._decide(guest, event)

    def _decide(self, guest: _Guest, request: h11.Request) -> None:
        path, _, query = request.target.partition(b"?")
        headers = list(request.headers)
        is_line = any(name == b"upgrade" and value.lower() == b"websocket" for name, value in headers)
        method = request.method.decode("latin-1")
        status, why = self._access.judge(
            {
                "type": "websocket" if is_line else "http",
                "method": method,
                "headers": headers,
                "query_string": query,
            }
        )
        if status != 200:
            self._refuse(guest, status, why)
        elif method == "POST" and path.decode("latin-1") == STOP_PATH:
            self._stop(guest)
        else:
            self._pass_on(guest)

    def _pass_on(self, guest: _Guest) -> None:
        self._detach(guest)
        if self._hand_over(guest.socket, bytes(guest.received)):
            return
        self._count(guest.address, "busy")
        self._answered[guest] = None
        self._selector.register(guest.socket, selectors.EVENT_READ, guest)
        self._answer(guest, 503, {"error": "the page is busy"})

    # --- STOP and its answers -------------------------------------------------------------------------------------

    def _stop(self, guest: _Guest) -> None:
        """Order the stop before anything else, then arrange its answer."""
        waiting = sum(each.stage is _Stage.ORDERED for each in self._answered)
        self._settle(guest, _Stage.ORDERED, _ANSWER_S)
        if waiting >= MOST_ANSWERED:  # the pipe to the recorder must not fill up
            unanswered = number_of(waiting, "earlier order to stop has", "earlier orders to stop have")
            self._answer(guest, 503, {"error": f"stop: {unanswered} no answer yet"})
            return
        try:
            answer = self._order()
        except CommandRefused as why:
            self._answer(guest, 409, {"error": str(why)})
            return

        def arrived(done: Future[Facts]) -> None:
            self._answers.append((guest, done))
            self._wake()

        answer.add_done_callback(arrived)

    def _send_answers(self) -> None:
        with ignoring(_log, "emptying the wake-up", OSError):
            self._woken.recv(4096)
        while self._answers:
            guest, done = self._answers.popleft()
            if guest not in self._answered or guest.stage is not _Stage.ORDERED:
                continue  # it was answered that none came, or has left
            try:
                self._answer(guest, 200, done.result())
            except CommandRefused as why:
                self._answer(guest, 409, {"error": str(why)})

    def _refuse(self, guest: _Guest, status: int, why: str) -> None:
        self._count(guest.address, "refused")
        self._settle(guest, _Stage.ANSWERED, _READING_S)
        self._answer(guest, status, f"{why}\n")

    def _settle(self, guest: _Guest, stage: _Stage, within_s: float) -> None:
        """Move a connection to those whose request has been read; the oldest leaves if there are too many."""
        self._remove(guest)
        guest.stage, guest.until_s = stage, time.monotonic() + within_s
        self._answered[guest] = None
        read = [each for each in self._answered if each.stage is _Stage.ANSWERED]
        if len(read) > MOST_ANSWERED:
            self._close(read[0])

    def _answer(self, guest: _Guest, status: int, answer: Facts | str) -> None:
        """Send a response; the client then has a moment to read it and to close the connection."""
        kind = "text/plain; charset=utf-8" if isinstance(answer, str) else "application/json"
        body = (answer if isinstance(answer, str) else json.dumps(answer)).encode("utf-8", "replace")
        headers = {**HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}
        lines = [
            f"HTTP/1.1 {status} {HTTPStatus(status).phrase}",
            *(f"{name}: {text}" for name, text in headers.items()),
        ]
        guest.stage, guest.until_s = _Stage.ANSWERED, time.monotonic() + _READING_S
        try:  # the buffer of a new connection takes it at once
            guest.socket.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + body)
            guest.socket.shutdown(socket.SHUT_WR)
        except OSError:  # usual: the client is gone
            self._close(guest)

    # --- ends and counts ------------------------------------------------------------------------------------------

    def _patience_s(self) -> float:
        """Return the time until the next connection is late or the counts are reported, s."""
        first = [next(iter(group)).until_s for group in self._asking.values()]
        earliest = min([*first, *(guest.until_s for guest in self._answered)], default=float("inf"))
        report = self._reported_s + _REPORT_S if self._changed else float("inf")
        return max(0.0, min(min(earliest, report) - time.monotonic(), _REPORT_S))

    def _close_late(self) -> None:
        now_s = time.monotonic()
        for address, group in list(self._asking.items()):
            while group and (oldest := next(iter(group))).until_s <= now_s:  # in the order of their times
                self._count(address, "timed_out")
                self._close(oldest)
        for guest in [each for each in self._answered if each.until_s <= now_s]:
            if guest.stage is _Stage.ORDERED:
                _log.info("stop: no answer from the recorder within %g s", _ANSWER_S)
                self._answer(guest, 409, {"error": f"stop: no answer from the recorder within {_ANSWER_S:g} s"})
            else:
                self._close(guest)

    def _close(self, guest: _Guest) -> None:
        self._detach(guest)
        guest.socket.close()
        if self._reserve is None:
            with ignoring(_log, "reserving a file", OSError):
                self._reserve = self._listening.dup()

    def _detach(self, guest: _Guest) -> None:
        self._remove(guest)
        self._selector.unregister(guest.socket)

    def _remove(self, guest: _Guest) -> None:
        self._answered.pop(guest, None)
        group = self._asking.get(guest.address, {})
        if guest in group:
            del group[guest]
            self._number_asking -= 1
            if not group:
                del self._asking[guest.address]

    def _count(self, address: str, kind: str) -> None:
        known = address in self._counts or len(self._counts) < _MOST_ADDRESSES
        self._counts.setdefault(address if known else _OTHERS, Counter())[kind] += 1
        self._changed = True

    def _report_changes(self) -> None:
        now_s = time.monotonic()
        if self._changed and now_s - self._reported_s >= _REPORT_S:
            self._reported_s, self._changed = now_s, False
            self._report({address: dict(counts) for address, counts in self._counts.items()})
