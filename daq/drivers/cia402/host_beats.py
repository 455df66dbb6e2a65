# pyright: strict
"""Heartbeats that bear the host's number and are not the host's: with them the drive's watch guards nothing.

A node that sends them keeps the drive running after the host has died. An adapter does not hand back what it sends; one
that is set to echo does, and what comes back is ours. So a heartbeat that came is taken for an echo when it follows one
of ours within `ECHO_S` and nothing else has been taken for that one's, unless the adapter has shown on other frames of
ours that it echoes nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from daq.drivers.cia402 import wire as cia402
from daq.transports.slcan import CanFrame

ECHO_S = 0.03
"""Host time within which an adapter hands back a frame; a host that is late at reading may need all of it."""
IN_A_ROW = 3
"""So many are no late echo."""
APART_S = 1.6
"""Twice the longest time a drive may be told to wait: what comes less often keeps no watch alive."""
_GIVEN_UP_S = 0.2  # after which a frame of ours counts as not handed back
_UNECHOED = 3  # so many of them, and never one that was: the adapter echoes nothing


class HostBeats:
    """See the module. Fed in the order of the log, with host times.

    Args:
        node_id: the drive's; what is sent to it is the host's alone.
        host_node_id: whose heartbeat the drive watches.

    Attributes:
        foreign: how many heartbeats came that are not ours.
    """

    def __init__(self, node_id: int, host_node_id: int) -> None:
        self.foreign = 0
        self._beat = cia402.cob_heartbeat(host_node_id)
        self._orders = (cia402.cob_sdo_request(node_id), cia402.cob_rpdo(1, node_id))
        self._sending = False  # whoever only listens to a bus sees its host's
        self._beats: deque[int] = deque(maxlen=64)  # when ours went out, ns
        self._others: deque[tuple[CanFrame, int]] = deque(maxlen=64)
        self._echoes, self._unechoed = False, 0
        self._in_a_row, self._last_ns = 0, 0

    def sent(self, frames: Iterable[CanFrame], host_ns: int) -> None:
        """The host wrote these."""
        for frame in frames:
            if frame.arbitration_id == self._beat:
                self._sending = True
                self._beats.append(host_ns)
            elif frame.arbitration_id in self._orders:
                self._others.append((frame, host_ns))

    def came(self, frames: Iterable[CanFrame], host_ns: int) -> bool:
        """These came from the bus; whether heartbeats that are not ours keep coming."""
        while self._others and host_ns - self._others[0][1] > _GIVEN_UP_S * 1e9:
            self._others.popleft()
            self._unechoed += 1
        keep_coming = False
        for frame in frames:
            if frame.arbitration_id == self._beat:
                keep_coming |= self._sending and not self._is_echo(host_ns) and self._counts(host_ns)
            elif frame.arbitration_id in self._orders:
                self._echoes |= any(frame == mine for mine, _ in self._others)
        return keep_coming

    def _is_echo(self, host_ns: int) -> bool:
        while self._beats and host_ns - self._beats[0] > ECHO_S * 1e9:
            self._beats.popleft()
        if not self._beats or (not self._echoes and self._unechoed >= _UNECHOED):
            return False
        self._beats.popleft()
        return True

    def _counts(self, host_ns: int) -> bool:
        self.foreign += 1
        self._in_a_row = self._in_a_row + 1 if host_ns - self._last_ns < APART_S * 1e9 else 1
        self._last_ns = host_ns
        return self._in_a_row >= IN_A_ROW
