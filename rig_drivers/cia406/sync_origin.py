"""Origin of the SYNCs that the adapter passes on: echoes of this host's, or another node's.

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

from rig_drivers.cia406.settings import LATEST_S

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
