"""Requests to a polled displacement sensor, each of which is distinguished from those before it.

An answer has no number. After an answer that is missing, damaged or surplus, the next one could belong to an earlier
request, and its value to an earlier time. The host then sends a probe: a request that only reads and whose answer is no
value. The sensor answers in order, so that no late value follows the probe's answer; values before it are dropped
(`unasked`). The first request of a session is a probe too. Probes: LK-G ``M2``, or ``M1`` for its other output,
LK-G5000 ``M1`` (refused), IL ``SR,00,037``, HL-G1 ``%01#ROA**``. A sensor that answers neither of the first two is
polled without: the request after a missing answer follows after 1 s, and a still later answer is taken for the next.
"""

from __future__ import annotations

from collections.abc import Callable

from typing_extensions import override

from daq.drivers.polling import LATEST_S, Request, RequestLoop
from daq.transports.host_clock import HostClock
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.settings import PolledLaser

_TRIES = 2
"""Probes after which a sensor that has answered none is polled without them."""


class NextRequest:
    """What to send next to a sensor, by what it has answered. It does no I/O.

    Args:
        dialect: of the sensor.
        output: number of its output, see PolledLaser.
    """

    def __init__(self, dialect: wire.Dialect, output: int) -> None:
        self._dialect, self._output = dialect, output
        self._value, self._probe = dialect.request(output), dialect.probe(output)
        self.begin()

    def begin(self) -> None:
        """Begin with a probe: answers to an earlier program, or to the dialogue, may still come."""
        self._awaited = b""  # the request whose answer is awaited
        self._is_in_doubt = True  # whether an answer may belong to an earlier request
        self._has_probed = False
        self._unanswered = 0  # probes before the first answer to one
        self._line = b""

    def request(self, number: int) -> bytes:
        """Return the next request. One whose answer is still awaited is given up."""
        if self._awaited:
            self._is_in_doubt = True
            self._unanswered += self._awaited == self._probe
        probes = self._is_in_doubt and (self._has_probed or self._unanswered < _TRIES)
        self._awaited = self._probe if probes else self._value
        return self._awaited

    def heard(self, data: bytes) -> bool:
        """Take bytes of the sensor and return whether the next request may be sent."""
        *lines, tail = (self._line + data.replace(b"\n", b"")).split(b"\r")
        self._line = tail[-wire.LONGEST_LINE_BYTES :]
        ends = [self._ends_wait(line) for line in lines]
        return any(ends)

    def _ends_wait(self, line: bytes) -> bool:
        if not line or line + b"\r" in (self._value, self._probe) or self._dialect.is_foreign(line, self._output):
            return False  # an echo, or not meant for this host: the answer is still to come
        found = self._dialect.parse(line, self._output)
        is_probed = self._awaited == self._probe
        if self._dialect.answers_probe(line, self._output) or (is_probed and isinstance(found, wire.Refusal)):
            return self._is_in_order() if is_probed else False
        if found is None:  # damaged: whose answer it was is not known
            self._is_in_doubt, self._awaited = True, b""
            return True
        if self._awaited != self._value:
            self._is_in_doubt = True
            return False
        self._awaited, self._is_in_doubt = b"", False
        return True

    def _is_in_order(self) -> bool:
        self._awaited, self._is_in_doubt, self._has_probed = b"", False, True
        return True


class SensorPoller(RequestLoop):
    """See Poller.

    Args:
        settings: table of the sensor in the rig file.
        send: writes bytes to the sensor's link, and to the log.
        clock: clock for the periods and the time-out.
    """

    def __init__(self, settings: PolledLaser, send: Callable[[bytes], None], clock: HostClock) -> None:
        self._next = NextRequest(wire.DIALECTS[settings.dialect], settings.output)
        super().__init__(Request(self._next.request, b"", 1.0 / settings.rate_Hz, 2 * LATEST_S), send, clock)

    @override
    def start(self) -> None:
        self.stop()
        with self._lock:
            self._next.begin()
        super().start()

    @override
    def heard(self, data: bytes) -> None:
        with self._lock:
            may_go_on = self._next.heard(data)
        if may_go_on:
            super().heard(data)
