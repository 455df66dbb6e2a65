"""Order of a node's sweeps: repeated packets, missing sweeps, and restarts, from tick and time of each packet."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

_TICKS = 65_536
_RECENT = 8  # packets whose repetition is recognised
_LATE_NS = 1_000_000_000  # an older packet shows that the beacon was set to another time
_MAX_LATE_PACKETS = 8  # consecutive ones; as many older packets show that the beacon was set to another time
_MAX_HOST_LATE_NS = 120_000_000_000  # largest lateness of a host
_OFF_GRID = 0.25  # sample periods


@dataclass(frozen=True)
class Place:
    """Place of a packet in the order.

    Attributes:
        state: "next": its sweeps follow; "repeated": its sweeps have come before or are counted as lost; "node": the
            node has started to sample again; "beacon": the beacon's time was set.
        missing: number of sweeps missing before it.
        known: number of its sweeps, from the first, that have come before.
        late_ns: time by which later packets came before it, ns, if it is a packet that was counted as lost; else 0.
    """

    state: Literal["next", "repeated", "node", "beacon"]
    missing: int = 0
    known: int = 0
    late_ns: int = 0


class SweepOrder:
    """See the module. Times of the beacon are those of synchronized sampling: all sweeps are on one grid.

    The tick decides about packets of earlier times: one that fits is late, unless only such packets come, and one that
    does not fit shows that the beacon's time was set.

    Args:
        rate_Hz: sample rate, Hz.
    """

    def __init__(self, rate_Hz: int) -> None:
        self._rate_Hz = rate_Hz
        self._next: tuple[int, int] | None = None  # tick and time, ns, of the sweep after the newest one
        self._host_ns = 0
        self._old = 0  # consecutive packets that are more than 1 s late
        self._recent: deque[tuple[int, int]] = deque(maxlen=_RECENT)

    def feed(self, tick: int, time_ns: int, count: int, host_ns: int) -> Place:
        """Take a packet.

        Args:
            tick: number of its first sweep, modulo 65536.
            time_ns: time of its first sweep on the beacon's clock, ns.
            count: number of its sweeps.
            host_ns: host time of its arrival, ns.
        """
        place = self.place(tick, time_ns, count, host_ns)
        self._old = self._old + 1 if place.late_ns > _LATE_NS else 0
        if place.state != "repeated":
            self._recent.append((tick, time_ns))
            self._next = (tick + count) % _TICKS, time_ns + round(count * 1e9 / self._rate_Hz)
            self._host_ns = host_ns
        return place

    def place(self, tick: int, time_ns: int, count: int, host_ns: int) -> Place:
        """Return the place that a packet would have now; for the arguments see `feed`."""
        if self._next is None:
            return Place("next")
        if (tick, time_ns) in self._recent:
            return Place("repeated")
        ahead_ns = time_ns - self._next[1]
        steps = round(ahead_ns * self._rate_Hz / 1e9)
        on_grid = abs(ahead_ns * self._rate_Hz / 1e9 - steps) < _OFF_GRID
        continues = on_grid and (tick - self._next[0] - steps) % _TICKS == 0
        is_old = ahead_ns < -_LATE_NS
        if steps < 0:
            is_old = not continues or (is_old and self._old >= _MAX_LATE_PACKETS)
        if is_old or ahead_ns > host_ns - self._host_ns + _MAX_HOST_LATE_NS:
            return Place("beacon")
        if steps < 0:
            if continues and -steps < count:
                return Place("next", known=-steps)
            return Place("repeated", late_ns=-ahead_ns)
        return Place("next", missing=steps) if continues else Place("node")
