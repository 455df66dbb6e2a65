"""Detection of heartbeats under the host's number that another node sends. They make the drive's watch ineffective.

A node that sends them keeps the drive running after the end of the host. Most adapters do not return sent frames; an
adapter that is set to echo does, and the echo is a heartbeat of this host. A received heartbeat therefore counts as an
echo if it follows a sent one within `ECHO_S` and no other received heartbeat has been assigned to that one. It does not
count as an echo if other sent frames have shown that the adapter does not echo. If they have shown that it does, a busy
host may receive the echoes of heartbeats as late as those of the other frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from daq.drivers.canopen import cia301
from daq.transports.can_frames import CanFrame

ECHO_S = 0.03
"""Host time within which an adapter echoes a frame, s, as long as it is not known whether it echoes."""
IN_A_ROW = 3
"""Number of consecutive foreign heartbeats that late echoes do not explain."""
APART_S = 1.6
"""Longest interval of foreign heartbeats, s: twice the longest timeout of a drive. Rarer ones are harmless."""
_ECHO_TIMEOUT_S = 0.2  # time after which a sent frame counts as not echoed
_MIN_UNECHOED = 3  # number of sent frames without any echo after which the adapter counts as not echoing


class HostBeats:
    """See the module. Frames are fed in the order of the log, with host times.

    Args:
        node_id: node number of the drive; only the host sends frames to it.
        host_node_id: node number whose heartbeat the drive watches.

    Attributes:
        foreign: number of received heartbeats that this host did not send.
    """

    def __init__(self, node_id: int, host_node_id: int) -> None:
        self.foreign: int = 0
        self._beat = cia301.cob_heartbeat(host_node_id)
        self._commands = (cia301.cob_sdo_request(node_id), cia301.cob_rpdo(1, node_id))
        self._sending = False  # a session that only receives gets the heartbeats of the bus's host
        self._beats: deque[int] = deque(maxlen=64)  # host times of the sent heartbeats, ns
        self._others: deque[tuple[CanFrame, int]] = deque(maxlen=64)
        self._echoed, self._unechoed = 0, 0  # numbers of sent frames
        self._in_a_row, self._last_ns = 0, 0

    def sent(self, frames: Iterable[CanFrame], host_ns: int) -> None:
        """Take frames that the host has sent."""
        for frame in frames:
            if frame.arbitration_id == self._beat:
                self._sending = True
                self._beats.append(host_ns)
            elif frame.arbitration_id in self._commands:
                self._others.append((frame, host_ns))

    def received(self, frames: Iterable[CanFrame], host_ns: int) -> bool:
        """Take frames from the bus; return whether foreign heartbeats arrive continuously."""
        while self._others and host_ns - self._others[0][1] > _ECHO_TIMEOUT_S * 1e9:
            self._others.popleft()
            self._unechoed += 1
        keep_coming = False
        for frame in frames:
            if frame.arbitration_id == self._beat:
                keep_coming |= self._sending and not self._is_echo(host_ns) and self._counts(host_ns)
            elif frame.arbitration_id in self._commands:
                self._take_echo(frame)
        return keep_coming

    def _take_echo(self, frame: CanFrame) -> None:
        sent = next((each for each in self._others if each[0] == frame), None)
        if sent is not None:
            self._echoed += 1
            self._others.remove(sent)

    @property
    def _longest_echo_s(self) -> float:
        """Host time within which a heartbeat may be an echo, s."""
        return _ECHO_TIMEOUT_S if self._echoed > self._unechoed else ECHO_S

    def _is_echo(self, host_ns: int) -> bool:
        while self._beats and host_ns - self._beats[0] > self._longest_echo_s * 1e9:
            self._beats.popleft()
        echoes = self._echoed > self._unechoed
        if not self._beats or (not echoes and self._unechoed >= _MIN_UNECHOED):
            return False
        self._beats.popleft()
        return True

    def _counts(self, host_ns: int) -> bool:
        self.foreign += 1
        self._in_a_row = self._in_a_row + 1 if host_ns - self._last_ns < APART_S * 1e9 else 1
        self._last_ns = host_ns
        return self._in_a_row >= IN_A_ROW
