"""Polling of a device that answers one message to one request."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from typing_extensions import override

from daq.drivers.contract import Poller
from daq.errors import LinkLost
from daq.transports.host_clock import HostClock, Repeated
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

LATEST_S = 0.5
"""Latest answer after its request, s: an older reading has no known time, and is not the present state."""
_LEAST_BEAT_S = 0.001  # s, shortest period of the thread
_BEATS = 4  # beats in a period: a request is late by at most a quarter of it


@dataclass(frozen=True)
class Request:
    """A request that is repeated.

    Attributes:
        data: returns the bytes of a request from its number, 0, 1, …
        end: byte that ends an answer; b"" if any bytes are one. With it an echo of the request, as on a line with two
            wires, is no answer.
        period_s: time from one request to the next, s.
        answer_s: time after which a request counts as unanswered and the next one is sent, s.
    """

    data: Callable[[int], bytes]
    end: bytes
    period_s: float
    answer_s: float


class RequestLoop(Poller):
    """Sends numbered requests periodically, and never before the last one is answered or given up; see Poller.

    Args:
        request: the request.
        send: writes bytes to the device's link, and to the log.
        clock: clock for the periods and the time-out.
    """

    def __init__(self, request: Request, send: Callable[[bytes], None], clock: HostClock) -> None:
        self._request, self._send, self._clock = request, send, clock
        self._lock = threading.Lock()
        self._asked_s: float | None = None  # time of the request that is not answered yet
        self._due_s = 0.0
        self._number = 0  # of the next request
        self._echo = b""  # part of the newest request whose echo may still come
        self._repeated: Repeated | None = None

    @override
    def start(self) -> None:
        self.stop()
        self._asked_s, self._echo = None, b""  # a request before a pause is not answered any more
        self._due_s = self._clock.now_s()
        beat_s = max(_LEAST_BEAT_S, self._request.period_s / _BEATS)
        self._repeated = self._clock.every(beat_s, self._beat, "polls", self._failed)

    @override
    def heard(self, data: bytes) -> None:
        with self._lock:
            answered = self._request.end in self._without_echo(data)
            if answered:
                self._asked_s = None
        if answered:
            self._beat()

    def _without_echo(self, data: bytes) -> bytes:
        """Return the bytes that follow an echo of the request, which may come in parts; the caller holds the lock."""
        data = data.lstrip(b"\n") if self._request.end == b"\r" else data  # of the answer before
        length = min(len(data), len(self._echo))
        if not self._request.end or data[:length] != self._echo[:length]:
            self._echo = b""
            return data
        self._echo = self._echo[length:]
        return data[length:]

    def hurry(self) -> None:
        """Send the next request without waiting for its period, as soon as the present one is answered."""
        with self._lock:
            self._due_s = min(self._due_s, self._clock.now_s())

    @override
    def stop(self) -> None:
        repeated, self._repeated = self._repeated, None
        if repeated is not None:
            repeated.stop()

    def _beat(self) -> None:
        now, period = self._clock.now_s(), self._request.period_s
        with self._lock:
            waits = self._asked_s is not None and now - self._asked_s < self._request.answer_s
            if self._repeated is None or waits or now < self._due_s:
                return
            self._asked_s = now
            self._due_s = max(self._due_s + period, now)  # requests that are overdue are not made up for
            self._echo = data = self._request.data(self._number)
            self._number += 1
        with ignoring(_log, "polling a device without a link", LinkLost):
            self._send(data)

    def _failed(self, error: Exception) -> None:
        _log.error("polling ended: %s", error)
