"""Order of the packets of an RF60x sensor: which are lost, come twice or late, and where the sensor started again.

A packet has its number modulo 256 and the host's time, which is late by the delay of network and host, and never
early. The least late of the newest packets therefore give the number that is due at a time. A packet whose number is
not the next one shows a loss if its number is due. If it is not, either the host read it late, or the sensor started
again: the packets after it decide. Packets that the host read late are followed by others at once, until one is in
time; a sensor that started again continues at its usual pace and stays late.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from daq.drivers.riftek_ethernet.wire import NUMBERS, RESULTS, Packet

_WINDOW = 128  # newest packets whose host times give the number that is due; more than wait during a short stall
_RATE_WINDOW = 32  # least number of packets that show whether the sensor has another rate than the rig file
_LEAST_WINDOW = 9  # fewer packets may all have been late
_NEAR = 0.05  # of the median period, relative to that of the rig file
_MISMATCH_PACKETS = 0.32  # in all of them: error of the rate of the rig file that is taken for real
_TOLERANCE_S, _TOLERANCE_PACKETS, _TOLERANCE_SHARE = 0.02, 0.5, 1e-3  # of a number from the one that is due
_EARLY_PACKETS = 1.0  # more for a number that is too high: the newest packets may have waited for each other
_FIRST_TOLERANCE_S = 0.25  # more for it while there are few packets
_BEHIND = 8  # packets that come twice or late are at most so many numbers behind
_PACE = 0.5  # packets between two reads, from which the second one was not waiting behind the first
_SETTLED, _SETTLED_S = 2, 0.25  # packets at the usual pace, and time, after which a contradiction is a restart
_MOST_HELD = NUMBERS


@dataclass(frozen=True)
class Placed:
    """A packet in its place.

    Attributes:
        packet: the packet.
        host_ns: host time of its read, ns.
        lost: number of packets missing before it; 0 after a restart.
        is_restart: whether the sensor started again before it.
    """

    packet: Packet
    host_ns: int
    lost: int
    is_restart: bool


class PacketOrder:
    """Places packets; see the module.

    Args:
        rate_Hz: sampling rate by the rig file, Hz.

    Attributes:
        repeated: number of packets that came twice or too late.
    """

    def __init__(self, rate_Hz: float) -> None:
        self.repeated: int = 0
        self._nominal_ns = RESULTS / rate_Hz * 1e9
        self._seen: deque[tuple[int, int]] = deque(maxlen=_WINDOW)  # count and host time of the newest packets
        self._count = 0  # of the newest packet
        self._number = 0  # of the newest packet
        self._held: list[tuple[Packet, int, int]] = []  # packets without a place, host times, counts
        self._settled = 0  # held packets that came at the usual pace

    def take(self, packet: Packet, host_ns: int) -> list[Placed]:
        """Return the packets whose place is known with this one; the others are held."""
        if not self._seen:
            return [self._place(packet, host_ns, self._count, is_restart=True, is_first=True)]
        ahead = (packet.number - self._number) % NUMBERS
        if self._held and (ahead != 1 or (self._settled and packet.number == (self._held[-1][0].number + 1) % NUMBERS)):
            return self._after_held(packet, host_ns)
        if ahead == 1:
            self.repeated += len(self._held)  # the packets before them go on
            self._held, self._settled = [], 0
            return [self._place(packet, host_ns, self._count + 1)]
        packet_ns = self._packet_ns()
        passed = (host_ns - self._seen[-1][1]) / packet_ns
        if ahead == 0 or ahead >= NUMBERS - _BEHIND:
            if passed < _PACE:
                self.repeated += 1
                return []
            if passed < NUMBERS // 2:
                self._held = [(packet, host_ns, self._count + (ahead - NUMBERS if ahead else 0))]
                return []
        return self._after_break(packet, host_ns, ahead or NUMBERS, packet_ns)

    def _after_break(self, packet: Packet, host_ns: int, ahead: int, packet_ns: float) -> list[Placed]:
        """Take a packet whose number is so many after the newest one, modulo NUMBERS."""
        late, tolerance = self._lateness(host_ns, self._count + ahead, packet_ns)
        if late < -self._early(tolerance, packet_ns):  # a number cannot be early
            return [self._place(packet, host_ns, 0, is_restart=True)]
        wraps = max(0, int((late + tolerance) // NUMBERS))
        count = self._count + ahead + NUMBERS * wraps
        if late - NUMBERS * wraps <= tolerance:  # it is due
            return [self._place(packet, host_ns, count)]
        self._held = [(packet, host_ns, count)]
        return []

    def end(self) -> list[Placed]:
        """Return the packets that are held; the log ends."""
        return self._undecided()

    def _after_held(self, packet: Packet, host_ns: int) -> list[Placed]:
        """Take a packet that is not the next one while there are held ones."""
        before, before_ns, count = self._held[-1]
        ahead = (packet.number - before.number) % NUMBERS
        packet_ns = self._packet_ns()
        if (ahead == 0 or ahead >= NUMBERS - _BEHIND) and host_ns - before_ns < _PACE * packet_ns:
            self.repeated += 1
            return []
        late, tolerance = self._lateness(host_ns, count + ahead, packet_ns)
        if ahead == 0 or late < -self._early(tolerance, packet_ns):
            return [*self._undecided(), *self.take(packet, host_ns)]
        self._held.append((packet, host_ns, count + ahead))
        if self._held[0][2] > self._count and late <= tolerance:
            return self._continue()
        self._settled += host_ns - before_ns >= _PACE * packet_ns
        is_settled = self._settled >= _SETTLED and host_ns - self._held[0][1] >= _SETTLED_S * 1e9
        return self._restart() if is_settled or len(self._held) >= _MOST_HELD else []

    def _undecided(self) -> list[Placed]:
        """Place the held packets without others after them. If they came quickly, they had waited for the host."""
        if not self._held:
            return []
        (_, first_ns, first), (_, last_ns, last) = self._held[0], self._held[-1]
        is_late = last_ns - first_ns < _PACE * (last - first) * self._packet_ns()
        return self._continue() if is_late and first > self._count else self._restart()

    def _continue(self) -> list[Placed]:
        held, self._held, self._settled = self._held, [], 0
        return [self._place(*each) for each in held]

    def _restart(self) -> list[Placed]:
        held, self._held, self._settled = self._held, [], 0
        return [self._place(*each, is_restart=not index) for index, each in enumerate(held)]

    def _place(
        self, packet: Packet, host_ns: int, count: int, *, is_restart: bool = False, is_first: bool = False
    ) -> Placed:
        if is_restart:
            self._seen.clear()
        lost = 0 if is_restart else count - self._count - 1
        self._seen.append((count, host_ns))
        self._count, self._number = count, packet.number
        return Placed(packet, host_ns, lost, is_restart and not is_first)

    def _lateness(self, host_ns: int, count: int, packet_ns: float) -> tuple[float, float]:
        """Return how late a packet would be with this count, and what is tolerated, in packets."""
        due = max(seen + (host_ns - seen_ns) / packet_ns for seen, seen_ns in self._seen)
        passed = max(0.0, due - self._count)
        tolerance = max(_TOLERANCE_PACKETS, _TOLERANCE_S * 1e9 / packet_ns) + _TOLERANCE_SHARE * passed
        return due - count, tolerance

    def _early(self, tolerance: float, packet_ns: float) -> float:
        """Return the tolerance for a number that is too high, in packets."""
        first = _FIRST_TOLERANCE_S * 1e9 / packet_ns if len(self._seen) < _LEAST_WINDOW else 0.0
        return tolerance + _EARLY_PACKETS + first

    def _packet_ns(self) -> float:
        """Return the time between two packets, ns: by the rig file, unless the sensor is set to another rate."""
        nominal = self._nominal_ns
        if len(self._seen) < _RATE_WINDOW:
            return nominal
        counts, times = np.array(self._seen, np.float64).T
        steps = np.diff(times) / np.diff(counts)
        middle = float(np.median(steps))
        regular = np.count_nonzero(np.abs(steps - middle) <= 0.25 * middle)
        if middle < 0.1 * nominal or regular < 0.75 * len(steps) or np.max(steps) > 2 * middle:  # reads in bursts
            return nominal
        about = nominal if abs(middle / nominal - 1) < _NEAR else middle  # the median contains the delays' scatter
        lag, quarter = times - counts * about, len(counts) // 4
        first, last = int(np.argmin(lag[:quarter])), len(lag) - quarter + int(np.argmin(lag[-quarter:]))
        own = float((times[last] - times[first]) / (counts[last] - counts[first]))
        return own if abs(own / nominal - 1) * len(counts) > _MISMATCH_PACKETS else nominal
