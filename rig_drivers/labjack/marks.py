"""Index marks from the sampled pulse of a tachometer: its edges, with the numbers of the revolutions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.drivers.index_marks import MarkSequence
from daq.items import Batch, DeviceEvent
from rig_drivers.labjack.settings import Tachometer


class EdgeFinder:
    """Finds the rising edges of a signal. The result does not depend on the split into blocks.

    An edge is where the signal reaches the threshold after it was below the threshold less the hysteresis. Its instant
    is interpolated between the sample below the threshold and the one above.

    Args:
        threshold, hysteresis: in the unit of the signal.
    """

    def __init__(self, threshold: float, hysteresis: float) -> None:
        self._high, self._low = threshold, threshold - hysteresis
        self.restart()

    def restart(self) -> None:
        """Begin with a signal of unknown state, as after a gap: the first edge needs a sample below."""
        self._armed = False  # whether the signal was below since the last edge
        self._before: float | None = None  # last sample of the block before

    def feed(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the places of the edges in a block, in samples from its first; the first may lie before it (> -1)."""
        if self._before is None:
            values, first = signal, 0
        else:
            values, first = np.insert(signal, 0, self._before), 1
        if not len(signal):
            return np.empty(0)
        above, below = values >= self._high, values < self._low
        # state at each sample: that of the newest sample that is above or below
        decided = np.flatnonzero(above | below)
        found: list[float] = []
        armed = self._armed
        for at in decided[np.flatnonzero(np.diff(above[decided], prepend=not above[decided][:1].any()))].tolist():
            if above[at] and armed and at >= first:
                low, high = float(values[at - 1]), float(values[at])
                found.append(at - 1 + (self._high - low) / (high - low) - first)
            armed = bool(below[at])
        self._armed, self._before = armed, float(values[-1])
        return np.array(found)


class IndexMarks:
    """Index marks of one tachometer.

    Args:
        tacho: its settings.
        period_ns: time between two scans on the device's clock, ns.
        sequence: examines the marks for bounces and missing turns.
    """

    def __init__(self, tacho: Tachometer, period_ns: float, sequence: MarkSequence) -> None:
        self._tacho, self._period_ns, self._sequence = tacho, period_ns, sequence
        self._sign = 1.0 if tacho.edge == "rising" else -1.0
        if tacho.is_digital:
            self._edges = EdgeFinder(self._sign * 0.5, 0.25)
        else:
            self._edges = EdgeFinder(self._sign * tacho.threshold_V, tacho.hysteresis_V)
        self._newest: tuple[int, int] | None = None  # number and time of the newest scan
        self._turn = -1  # number of the newest mark, with bounces
        self._scans_lost = False  # since the newest mark

    def scans_lost(self) -> None:
        """Note that scans are missing before the next ones: no edge is found between them."""
        self._edges.restart()
        self._newest, self._scans_lost = None, True

    def feed(
        self, signal: NDArray[np.float64] | NDArray[np.uint16], number: NDArray[np.int64], time_ns: NDArray[np.int64]
    ) -> list[Batch | DeviceEvent]:
        """Return the marks in consecutive scans, and the events about marks that contradict one another.

        Args:
            signal: volts of the input, or states of its port, shape (n,), n ≥ 1.
            number: numbers of the scans.
            time_ns: times of the scans on the common clock.
        """
        if self._tacho.is_digital:
            signal = (signal.astype(np.uint16) >> self._tacho.bit & 1).astype(np.float64)
        places = self._edges.feed(self._sign * signal.astype(np.float64))
        known, times = number.astype(np.float64), time_ns
        if self._newest is not None:
            known, times = np.insert(known, 0, self._newest[0]), np.insert(times, 0, self._newest[1])
        self._newest = int(number[-1]), int(time_ns[-1])
        if not len(places):
            return []
        at = places + float(number[0])
        first_ns = int(times[0])
        mark_ns = first_ns + np.rint(np.interp(at, known, (times - first_ns).astype(np.float64))).astype(np.int64)
        own_ns = at * self._period_ns
        found = [self._numbered(own, at_ns) for own, at_ns in zip(own_ns.tolist(), mark_ns.tolist(), strict=True)]
        out: list[Batch | DeviceEvent] = [event for _, events in found for event in events]
        whole = np.array([number is not None for number, _ in found])
        if not whole.any():
            return out
        turns = np.array([number for number, _ in found if number is not None], np.uint32)
        columns = {"revolutions": turns, "node_time_us": np.rint(own_ns[whole] / 1000).astype(np.uint64)}
        return [*out, Batch(channels.TACHO, mark_ns[whole], turns, columns)]

    def _numbered(self, own_ns: float, time_ns: int) -> tuple[int | None, list[DeviceEvent]]:
        """Return the number of a mark, None if it is a bounce, and the events about it.

        Marks that were lost with scans are counted by the time of the turn before.
        """
        self._turn += 1
        due_ns, next_ns = self._sequence.due_ns(self._turn), self._sequence.due_ns(self._turn + 1)
        if self._scans_lost and due_ns is not None and next_ns is not None:
            self._turn += max(0, round((own_ns - due_ns) / (next_ns - due_ns)))
        self._scans_lost = False
        return self._sequence.feed(round(own_ns), self._turn, time_ns)
