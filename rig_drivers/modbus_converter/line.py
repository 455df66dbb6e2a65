"""The host's requests to a converter: one at a time, commands before reads, answers matched to their request.

A request follows 3.5 characters (at least 1.75 ms) after an answer, or `answer_s` after a request without one (late
answers: `RequestLine`); reads pause for at most 3 `answer_s`. Commands are repeated up to three times, also after
exceptions 5 and 6 (busy; INVT's 6 is a damaged request).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

from daq.drivers.questions import TRIES
from daq.transports.host_clock import HostClock
from rig_drivers.modbus_converter import wire
from rig_drivers.modbus_converter.settings import ModbusConverter

_BUSY = (5, 6)  # exceptions after which a command is repeated; some makers use 6 for a request with a wrong CRC
_SILENCE = 3  # requests in turn without an answer after which the converter may have been switched off and on
_LATEST_ANSWERS = 3  # answer times after which an answer does not come any more
_SHORTEST_PAUSE_S = 0.00175  # between two frames, s: the standard's value above 19200 baud
_PAUSE_BITS = 3.5 * 11


class QueuedRequest:
    """A request that waits for its answer.

    Attributes:
        request: the request.
        tries: how often it may still be sent.
        answer: its answer, once it came.
    """

    def __init__(self, request: wire.Request, tries: int = TRIES) -> None:
        self.request: wire.Request = request
        self.tries: int = tries
        self.answer: wire.Answer | None = None


class RequestLine:
    """Sends requests one at a time.

    The next request is sent when the last one is answered, or `answer_s` later. In the second case its answer may still
    come, and it could be taken for that of the next read of the same number of registers. Therefore a read of another
    number is sent first: its answer shows that no earlier one can follow, because a converter answers in order. Writes
    need no such precaution: their answers repeat register and value, or are not relied on. `_deciding` protects the
    state, `_sending` keeps the order of what is sent; no lock is held during a wait.

    A command that the converter refuses because it is busy is repeated `answer_s` later. During a silence the
    communication timeout is read until it is answered: a converter that was switched off and on has lost it, and the
    pipeline must know before the next report.

    Args:
        settings: table of the converter in the rig file.
        send: writes bytes to the converter's link (and to the log).
        clock: clock for periods and timeouts.

    Attributes:
        polling: whether state and speed are read periodically.
        sent_ns: time at which the newest request was sent, ns since 1970.
    """

    def __init__(self, settings: ModbusConverter, send: Callable[[bytes], None], clock: HostClock) -> None:
        function = settings.registers.read_function
        self._polls = [wire.Request(settings.address, function, *block) for block in settings.blocks]
        self._period_s, self._answer_s = 1 / settings.report_Hz, settings.answer_s
        self._pause_s = max(_SHORTEST_PAUSE_S, _PAUSE_BITS / settings.baud)
        self._send, self._clock = send, clock
        self._deciding, self._sending = threading.Lock(), threading.Lock()
        self._queue: deque[QueuedRequest] = deque()
        self._asked: QueuedRequest | None = None
        self._asked_s = self._free_s = self._due_s = 0.0
        self._resume_s = 0.0  # time until which commands wait because the converter is busy; reads go on
        self._next_poll = 0
        self._probes = [wire.Request(settings.address, function, settings.registers.status, 1), *self._polls]
        self._missed: dict[wire.Request, float] = {}  # unanswered reads, and when their answers are overdue
        watchdog = settings.registers.watchdog
        self._evidence = None if watchdog is None else wire.Request(settings.address, function, watchdog, 1)
        self._unanswered = 0  # requests in turn without an answer
        self.polling: bool = False
        self.sent_ns: int = 0

    def put(self, requests: Sequence[wire.Request], *, urgent: bool = False) -> list[QueuedRequest]:
        """Queue requests, and return them with their future answers; urgent ones replace all that wait."""
        queued = [QueuedRequest(request) for request in requests]
        with self._deciding:
            if urgent:
                self._resume_s = 0.0
                self._queue.clear()
                if self._asked is not None:
                    self._asked.tries = 0
            self._queue.extend(queued)
        return queued

    @property
    def idle(self) -> bool:
        """Whether no request waits, and the last one is answered."""
        with self._deciding:
            return not self._queue and self._asked is None

    def drop(self, queued: Sequence[QueuedRequest]) -> None:
        """Remove requests that are not needed any more."""
        with self._deciding:
            for one in queued:
                one.tries = 0
            self._queue = deque(one for one in self._queue if one not in queued)

    def heard(self, answer: wire.Answer) -> None:
        """Take an answer that the pipeline has found for a request."""
        with self._deciding:
            self._unanswered = 0
            if answer.request != self._evidence:  # several such reads may be outstanding
                self._missed.clear()
            asked = self._asked
            if asked is not None and asked.request == answer.request:
                self._asked = None
                self._free_s = self._clock.now_s() + self._pause_s
                if answer.exception in _BUSY and asked.tries > 0:
                    self._queue.appendleft(asked)
                    self._resume_s = self._free_s + self._answer_s
                else:
                    asked.answer = answer

    def beat(self) -> None:
        """Send the next request if it is due.

        Raises:
            LinkLost: the connection to the device is lost.
        """
        with self._sending:
            with self._deciding:
                one = self._next(self._clock.now_s())
            if one is not None:
                self.sent_ns = self._clock.now_ns()
                self._send(wire.encode(one.request))

    def _next(self, now: float) -> QueuedRequest | None:
        """Return what to send now; the caller holds both locks."""
        if self._asked is not None:
            if now - self._asked_s < self._answer_s:
                return None
            asked, self._asked = self._asked, None
            self._unanswered += 1
            if asked.request.function in wire.READS:
                self._missed[asked.request] = self._asked_s + _LATEST_ANSWERS * self._answer_s
            if asked.tries > 0:
                self._queue.appendleft(asked)
        if now < self._free_s:
            return None
        one = self._due(now)
        if one is None:
            return None
        one.tries -= 1
        self._asked, self._asked_s = one, now
        return one

    def _due(self, now: float) -> QueuedRequest | None:
        ordered = bool(self._queue) and now >= self._resume_s
        if not ordered and (not self.polling or now < self._due_s):
            return None
        wanted = self._queue[0].request if ordered else self._polls[self._next_poll]
        if not ordered and self._evidence is not None and self._unanswered >= _SILENCE:
            return None if self._confusable(self._evidence, now) else QueuedRequest(self._evidence, tries=1)
        if self._confusable(wanted, now):
            clear = [probe for probe in self._probes if not self._confusable(probe, now)]
            return QueuedRequest(clear[0], tries=1) if clear else None
        if ordered:
            return self._queue.popleft()
        self._next_poll = (self._next_poll + 1) % len(self._polls)
        if self._next_poll == 0:  # rounds that are overdue are not made up for
            self._due_s = max(self._due_s + self._period_s, now)
        return QueuedRequest(wanted, tries=1)

    def _confusable(self, request: wire.Request, now: float) -> bool:
        """Whether the late answer to another read could be taken for that of a request.

        All answers to reads of the communication timeout are alike.
        """
        missed = [each for each, overdue_s in self._missed.items() if now < overdue_s and each.shape == request.shape]
        return any(each != request or each != self._evidence for each in missed)
