"""The host's SYNC: sent periodically, and not before all encoders have answered the one before or are given up.

Origin of the SYNCs that the adapter passes on: echoes of this host's, or another node's.

Most adapters do not return sent frames. One that does returns each of this host's SYNCs once, and before any report,
because the encoders answer after it. A received SYNC therefore counts as an echo only if

1. this host has sent a SYNC that is not echoed yet, at most `ECHO_S` ago;
2. no encoder has answered it yet. The answer of an encoder that owes one to an earlier SYNC does not count here;
3. the adapter does not belong to those that do not echo. It does as soon as `UNECHOED` more of this host's SYNCs were
   answered without an echo before than with one, and remains so. SYNCs that no encoder has answered do not count: they
   may not have gone out. SYNCs that an encoder has answered twice, though only the presumed echo was received, count as
   not echoed: the echo was another node's SYNC.

All others are another node's. When an adapter is found not to echo, the presumed echoes so far are counted too.

| adapter | the other node's SYNC | found |
|---|---|---|
| echoes | any | exactly: each of this host's SYNCs explains one |
| does not echo | at other instants | from the third of this host's SYNCs on, the earlier ones afterwards |
| does not echo | in step, shortly after this host's | by encoders that answer twice |
| does not echo | in step, so close that encoders answer once | not found; the instants differ by less than one answer |
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from typing_extensions import override

from daq.drivers.canopen import cia301
from daq.drivers.contract import Poller
from daq.drivers.polling import Request, RequestLoop
from daq.transports.can_frames import FrameDecoder
from daq.transports.host_clock import HostClock
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import LATEST_S, EncoderBus

_ANSWERED = b"\r"
_MISSES = 3
_UNANSWERED_S = 2 * LATEST_S
_ROUNDS, _MIN_ROUNDS = 31, 8  # newest SYNCs from which the wait follows, and fewest that give one
_SHARE, _MARGIN = 0.9, 2.0  # the wait is twice that within which the last answer came to 90 % of these
_LEAST_S = 0.012  # shortest wait for the last answer, s: a busy host reads late by as much


class SyncSender(RequestLoop):
    """See Poller. A SYNC that not all encoders answer delays the next one.

    If no encoder answers, the adapter or the host may be late: the next SYNC waits for twice `LATEST_S`, after which no
    report counts as an answer. If one has answered in time, those of the others are on the same way and come soon:
    the wait for them begins at the first answer and follows from the newest SYNCs, see `_MARGIN`. If the first answer
    is late by more than `max_lateness_s`, all are waited for as if none had come: the shaft's shows whether the SYNC
    was late.

    An answer that comes still later makes the next waits longer. The decoding recognises it if the encoder's next
    answer comes before another SYNC (`SyncTimes`). The SYNC after a missing answer therefore waits for two answers, or
    as long as for a missing one. An encoder that has not answered `_MISSES` times is not waited for until it answers
    again, so that a dead encoder does not slow down the others.

    Args:
        settings: table of the encoders in the rig file.
        send: writes bytes to the adapter.
        clock: clock for the periods.
    """

    def __init__(self, settings: EncoderBus, send: Callable[[bytes], None], clock: HostClock) -> None:
        self._expected = frozenset(cia301.cob_tpdo(1, encoder.node) for encoder in settings.encoders)
        self._missing: set[int] = set()
        self._owing: set[int] = set()  # encoders from which two answers may come, the first one to the SYNC before
        self._given_up: dict[int, float] = {}  # times of the first answers to the SYNCs given up, by encoder, s
        self._misses = dict.fromkeys(self._expected, 0)
        self._lines = FrameDecoder()
        self._write = send
        self._first_s: float | None = None  # time of the first answer to the newest SYNC
        self._firsts: deque[float] = deque(maxlen=_ROUNDS)  # from the SYNC to the first answer, s
        self._waits: deque[float] = deque(maxlen=_ROUNDS)  # from the first answer to the last one, s
        self._max_lateness_s = settings.max_lateness_s
        self._unanswered = Request(lambda number: wire.SYNC, _ANSWERED, 1.0 / settings.rate_Hz, _UNANSWERED_S)
        super().__init__(self._unanswered, self._sync, clock)

    @override
    def heard(self, data: bytes) -> None:
        before, now_s = bool(self._missing or self._owing), self._clock.now_s()
        for frame in self._lines.feed(data).frames:
            if frame.arbitration_id in self._expected:
                self._answer(frame.arbitration_id, now_s)
        if before and not self._missing and not self._owing and self._first_s is not None:
            self._waits.append(now_s - self._first_s)
            super().heard(_ANSWERED)

    def _answer(self, identifier: int, now_s: float) -> None:
        self._misses[identifier] = 0
        if identifier in self._missing:
            self._missing.discard(identifier)
        else:
            self._owing.discard(identifier)
            given_up_s = self._given_up.pop(identifier, None)
            if given_up_s is not None:  # it has answered both SYNCs: the first one late
                self._waits.append(min(now_s - given_up_s, _UNANSWERED_S))
        if self._first_s is None:
            self._first_s = now_s
            first_s = now_s - (self._asked_s or now_s)
            self._firsts.append(first_s)
            self._request = replace(self._unanswered, answer_s=min(first_s + self._others_s(first_s), _UNANSWERED_S))

    def _others_s(self, first_s: float) -> float:
        """Return how long the other answers are waited for after the first one, s."""
        late_s = first_s - sorted(self._firsts)[len(self._firsts) // 2]
        if len(self._waits) < _MIN_ROUNDS or late_s > self._max_lateness_s:
            return _UNANSWERED_S
        return max(_MARGIN * sorted(self._waits)[int(_SHARE * len(self._waits))], _LEAST_S)

    def _sync(self, data: bytes) -> None:
        given_up = self._missing if self._first_s is not None else set[int]()
        self._given_up = dict.fromkeys(given_up, self._first_s or 0.0)
        for identifier in self._missing:
            self._misses[identifier] += 1
        self._owing = {identifier for identifier in self._missing if self._misses[identifier] < _MISSES}
        self._missing = {identifier for identifier in self._expected if self._misses[identifier] < _MISSES}
        self._first_s, self._request = None, self._unanswered
        self._write(data)


class NoRequests(Poller):
    """See Poller: encoders that send by their own timer get no request."""

    def start(self) -> None:
        """See Poller."""

    def heard(self, data: bytes) -> None:
        """See Poller."""

    def stop(self) -> None:
        """See Poller."""


ECHO_S = LATEST_S
"""Host time within which an echo comes, s: that of a report. Only hosts that read late need more than 1 ms."""
UNECHOED = 3
_MOST_TRUST = 8  # echoed SYNCs beyond this number add no trust in later ones


class SyncOrigin:
    """See the module.

    Attributes:
        foreign: number of SYNCs of other nodes.
        echoed: whether the newest of this host's SYNCs has been echoed.
    """

    def __init__(self) -> None:
        self.foreign: int = 0
        self.echoed: bool = False
        self._pending: deque[int] = deque(maxlen=64)  # host times of this host's SYNCs without echo, ns
        self._open = False  # whether the newest of this host's SYNCs waits for its first answer
        self._presumed = 0  # echoes so far
        self._trust = 0
        self._is_silent = False  # whether the adapter does not echo

    def sent(self, host_ns: int) -> None:
        """Take a SYNC of this host."""
        self._pending.append(host_ns)
        self._open, self.echoed = True, False

    def received(self, host_ns: int) -> bool:
        """Take a SYNC from the bus; return whether another node has sent it."""
        while self._pending and host_ns - self._pending[0] > ECHO_S * 1e9:
            self._pending.popleft()
        if self._pending and not self._is_silent:
            self._pending.popleft()
            self._presumed += 1
            self.echoed = not self._pending
            return False
        self.foreign += 1
        return True

    def answered(self) -> None:
        """Take the answer of an encoder that owes none to earlier SYNCs."""
        self._pending.clear()
        if self._open:
            self._open = False
            self._judge(1 if self.echoed else -1)

    def doubled(self) -> None:
        """Take the second answer of an encoder to a SYNC that no other received SYNC than its echo explains."""
        if self.echoed:
            self.echoed = False
            self._judge(-2)  # it was counted as an echo

    def _judge(self, echo: int) -> None:
        self._trust = min(self._trust + echo, _MOST_TRUST)
        if not self._is_silent and self._trust <= -UNECHOED:
            self._is_silent = True
            self.foreign += self._presumed
