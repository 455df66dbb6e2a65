"""Packets that a node sent again because the base station did not confirm them: they come late, also out of order.

The maker's nodes are first-in first-out, so that after late packets nothing is missing.

The first late packet shows that the node sends packets again. From then on, packets after a gap wait for the one that
fills it: for the duration of four packets, or for 1.5 times the longest delay so far, at most 2 s. Then the gap counts
as a loss. Packets of a node that has not sent a late packet yet do not wait. Eight consecutive packets more than a
second older than the newest show that the beacon was set to an earlier time.
"""

from __future__ import annotations

from typing import NamedTuple

from daq.drivers.microstrain.order import Place, SweepOrder
from daq.drivers.microstrain.wire import Sweeps

_WAIT_PACKETS, _MORE = 4, 1.5
_MAX_WAIT_NS = 2_000_000_000
_MAX_WAITING = 1024  # packets


class Arrived(NamedTuple):
    """A received packet.

    Attributes:
        sweeps: its content.
        host_ns: host time of its arrival, ns since 1970.
    """

    sweeps: Sweeps
    host_ns: int


class LatePackets:
    """See the module.

    Args:
        order: order of the sweeps; packets that are returned must be fed to it before the next call.
        rate_Hz: sample rate, Hz.
    """

    def __init__(self, order: SweepOrder, rate_Hz: int) -> None:
        self._order, self._rate_Hz = order, rate_Hz
        self._patience_ns = 0.0
        self._waiting: list[Arrived] = []

    def take(self, arrived: Arrived) -> Arrived | None:
        """Take a packet; return it if it need not wait.

        A packet that contradicts tick and time so far does not wait: call `end` before it is fed to the order.
        """
        sweeps = arrived.sweeps
        place = self._place(arrived)
        if place.late_ns:
            least_ns = _WAIT_PACKETS * len(sweeps.values) * 1e9 / self._rate_Hz
            self._patience_ns = min(_MAX_WAIT_NS, max(self._patience_ns, least_ns, _MORE * place.late_ns))
        if not self._patience_ns or place.state != "next" or not place.missing:
            return arrived
        if all(each.sweeps[1:3] != sweeps[1:3] for each in self._waiting):  # else it came again
            self._waiting.append(arrived)
            self._waiting.sort(key=lambda each: each.sweeps.time_ns)
        return None

    def contradicts(self, arrived: Arrived) -> bool:
        """Return whether a packet shows a new start of the node or of the beacon while others wait."""
        return bool(self._waiting) and self._place(arrived).state in ("node", "beacon")

    def next(self, host_ns: int) -> Arrived | None:
        """Return the next packet that need not wait any more at a host time, ns; None without one."""
        if not self._waiting:
            return None
        first = self._waiting[0]
        gap = self._place(first).missing > 0
        waited_ns = host_ns - min(each.host_ns for each in self._waiting)
        if gap and waited_ns <= self._patience_ns and len(self._waiting) <= _MAX_WAITING:
            return None
        return self._waiting.pop(0)

    def end(self) -> list[Arrived]:
        """Return the waiting packets in order: the gaps before them will not be filled."""
        out, self._waiting = self._waiting, []
        return out

    def _place(self, arrived: Arrived) -> Place:
        sweeps = arrived.sweeps
        return self._order.place(sweeps.tick, sweeps.time_ns, len(sweeps.values), arrived.host_ns)
