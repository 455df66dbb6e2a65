"""The host's requests to a converter: one at a time, commands before reads, answers matched to their request."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

from daq.drivers.modbus_converter import wire
from daq.drivers.modbus_converter.settings import ModbusConverter
from daq.transports.host_clock import HostClock

_TRIES = 3
_SHORTEST_PAUSE_S = 0.00175  # between two frames, s: the standard's value above 19200 baud
_PAUSE_BITS = 3.5 * 11


class Order:
    """A request that waits for its answer.

    Attributes:
        request: the request.
        tries: how often it may still be sent.
        answer: its answer, once it came.
    """

    def __init__(self, request: wire.Request, tries: int = _TRIES) -> None:
        self.request: wire.Request = request
        self.tries: int = tries
        self.answer: wire.Answer | None = None


class RequestLine:
    """Sends requests one at a time.

    The next request is sent when the last one is answered, or `answer_s` later. In the second case a read of the same
    number of registers waits for another `answer_s`, because it could be confused with a late answer; a write does not
    wait. `_deciding` protects the state, `_sending` keeps the order of what is sent; no lock is held during a wait.

    Args:
        settings: table of the converter in the rig file.
        send: writes bytes to the converter's link (and to the log).
        clock: clock for periods and timeouts.

    Attributes:
        polling: whether state and speed are read periodically.
    """

    def __init__(self, settings: ModbusConverter, send: Callable[[bytes], None], clock: HostClock) -> None:
        function = settings.registers.read_function
        self._polls = [wire.Request(settings.address, function, *block) for block in settings.blocks]
        self._period_s, self._answer_s = clock.wall(1 / settings.report_Hz), settings.answer_s
        self._pause_s = max(_SHORTEST_PAUSE_S, _PAUSE_BITS / settings.baud)
        self._send, self._clock = send, clock
        self._deciding, self._sending = threading.Lock(), threading.Lock()
        self._orders: deque[Order] = deque()
        self._asked: Order | None = None
        self._asked_s = self._free_s = self._due_s = 0.0
        self._next_poll = 0
        self._missed: tuple[tuple[int, ...], float] = ((), 0.0)  # shape of a request without answer; end of the wait
        self.polling: bool = False

    def put(self, requests: Sequence[wire.Request], *, urgent: bool = False) -> list[Order]:
        """Queue requests, and return them with their future answers; urgent ones replace all that wait."""
        orders = [Order(request) for request in requests]
        with self._deciding:
            if urgent:
                self._orders.clear()
                if self._asked is not None:
                    self._asked.tries = 0
            self._orders.extend(orders)
        return orders

    def drop(self, orders: Sequence[Order]) -> None:
        """Remove requests that are not needed any more."""
        with self._deciding:
            for order in orders:
                order.tries = 0
            self._orders = deque(order for order in self._orders if order not in orders)

    def heard(self, answer: wire.Answer) -> None:
        """Take an answer that the pipeline has found for a request."""
        with self._deciding:
            asked = self._asked
            if asked is not None and asked.request == answer.request:
                asked.answer, self._asked = answer, None
                self._free_s = self._clock.wall_s() + self._pause_s

    def beat(self) -> None:
        """Send the next request if it is due.

        Raises:
            LinkLost: the connection to the device is lost.
        """
        with self._sending:
            with self._deciding:
                order = self._next(self._clock.wall_s())
            if order is not None:
                self._send(wire.encode(order.request))

    def _next(self, now: float) -> Order | None:
        """Return what to send now; the caller holds both locks."""
        if self._asked is not None:
            if now - self._asked_s < self._answer_s:
                return None
            asked, self._asked = self._asked, None
            self._missed = asked.request.shape, self._asked_s + 2 * self._answer_s
            if asked.tries > 0:
                self._orders.appendleft(asked)
        if now < self._free_s:
            return None
        if self._orders:
            if self._confusable(self._orders[0].request, now):
                return None
            order = self._orders.popleft()
        else:
            if not self.polling or now < self._due_s or self._confusable(self._polls[self._next_poll], now):
                return None
            order = Order(self._polls[self._next_poll], tries=1)
            self._next_poll = (self._next_poll + 1) % len(self._polls)
            if self._next_poll == 0:  # rounds that are overdue are not made up for
                self._due_s = max(self._due_s + self._period_s, now)
        order.tries -= 1
        self._asked, self._asked_s = order, now
        return order

    def _confusable(self, request: wire.Request, now: float) -> bool:
        shape, until_s = self._missed
        return request.function in wire.READS and request.shape == shape and now < until_s
