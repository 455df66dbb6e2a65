"""Index marks that contradict one another: a mark that bounces, and turns that were not counted.

A contact or a reflex sensor may give its edge twice. The second mark follows within milliseconds, and the counter of
revolutions counts it as a turn. It is dropped, and later marks get the numbers that they would have without it. A mark
that is missing although the counter goes on by one makes a turn twice as long as those before and after it. Such a turn
is counted and reported; its marks keep their times and numbers.
"""

from __future__ import annotations

import math
from collections import deque

from daq.drivers.sparing import EachSecond
from daq.items import DeviceEvent
from rig_basics.texts import number_of

SHORTEST_NS = 50_000_000
"""A mark that follows sooner is a bounce if the turn before was `SHORTER` times as long. To turn the rotor within this
time after a turn so much longer, it had to be accelerated by π/t² > 1000 rad/s²: with a moment of inertia of 0.01 kg m²
by more than 10 N m, beyond a hand and beyond the drive of such a rig."""
SHORTER = 4.0
NEIGHBOURS_RATIO = 1.25
"""Largest ratio of the turns before and after a turn that is examined. The rotor starts from rest with turns in the
ratio √2 + 1, √3 − √2, …; from the third turn on, neighbours of a constant acceleration are nearer than this."""
LOST_DEVIATION = 0.15
"""Deviation from a whole number of turns: that of the mean of two neighbours under `NEIGHBOURS_RATIO` is 0.12."""


def lost_turns(before: float, between: float, after: float) -> int:
    """Return how many turns are missing in the time between two marks, given the turns before and after it.

    Args:
        before, between, after: durations per counted turn, in any unit.
    """
    longer, shorter = max(before, after), min(before, after)
    if not 0 < longer <= NEIGHBOURS_RATIO * shorter:
        return 0
    turns = between / math.sqrt(before * after)
    whole = round(turns)
    return whole - 1 if whole >= 2 and abs(turns - whole) < LOST_DEVIATION * whole else 0


class MarkSequence:
    """Examines the marks of one sensor in the order of their arrival.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline, which get `doubled_marks` and `turns` as soon as there are some.
    """

    def __init__(self, device: str, losses: dict[str, int]) -> None:
        self._device, self._losses = device, losses
        self._dropped = 0  # marks dropped since the counter started
        self._last: tuple[int, int] | None = None  # time, ns, and number of the newest mark
        self._turns: deque[tuple[int, float, int]] = deque(maxlen=3)  # time at the end, duration per turn, turns
        self._bounces = self._bounce_ns = 0
        self._each_second = EachSecond()

    def restart(self) -> None:
        """Begin again: the sensor's counter or clock has started again."""
        self._dropped, self._last = 0, None
        self._turns.clear()

    def due_ns(self, revolution: int) -> float | None:
        """Return the expected time of a mark on the sensor's clock; None before the first turn."""
        if self._last is None or not self._turns:
            return None
        return self._last[0] + (revolution - self._dropped - self._last[1]) * self._turns[-1][1]

    def feed(self, own_ns: int, revolution: int, time_ns: int) -> tuple[int | None, list[DeviceEvent]]:
        """Take the next mark.

        Args:
            own_ns: its time on the sensor's clock.
            revolution: its number, as the sensor counts.
            time_ns: its time on the common clock.
        Returns:
            Its number without the bounces before it, None if it is a bounce itself; and events.
        """
        number = revolution - self._dropped
        if self._last is None or number <= self._last[1] or own_ns <= self._last[0]:
            self._turns.clear()
            self._last = own_ns, number
            return number, []
        passed, counted = own_ns - self._last[0], number - self._last[1]
        if counted == 1 and self._is_bounce(passed):
            self._dropped += 1
            return None, self._bounced(passed, time_ns)
        self._last = own_ns, number
        self._turns.append((time_ns, passed / counted, counted))
        return number, self._missed()

    def _is_bounce(self, passed: int) -> bool:
        return passed < SHORTEST_NS and bool(self._turns) and self._turns[-1][1] > SHORTER * passed

    def _bounced(self, passed: int, time_ns: int) -> list[DeviceEvent]:
        """Count a bounce; return the event about those since the last one, at most one each second."""
        self._losses["doubled_marks"] = self._losses.get("doubled_marks", 0) + 1
        self._bounces, self._bounce_ns = self._bounces + 1, max(self._bounce_ns, passed)
        if not self._each_second.passes(time_ns):
            return []
        facts = {"doubled_marks": self._bounces, "span_s": self._bounce_ns * 1e-9, "time_ns": time_ns}
        self._bounces = self._bounce_ns = 0
        text = (
            f"{number_of(int(facts['doubled_marks']), 'index mark')} came twice, the second one within "
            f"{facts['span_s'] * 1e3:.1f} ms: "
            "dropped, and not counted as turns. Look at the index sensor: its contact or its distance"
        )
        return [DeviceEvent("marks", self._device, text, facts)]

    def _missed(self) -> list[DeviceEvent]:
        """Return the event about turns that are missing before the last mark but one."""
        if len(self._turns) < 3:
            return []
        (_, before, _), (at_ns, between, counted), (_, after, _) = self._turns
        lost = lost_turns(before, between, after) if counted == 1 else 0
        if not lost:
            return []
        self._losses["turns"] = self._losses.get("turns", 0) + lost
        span_s = between * 1e-9
        text = (
            f"{number_of(lost, 'turn')} not counted: {span_s * 1e3:.0f} ms from mark to mark, between turns of "
            f"{before * 1e-6:.0f} and {after * 1e-6:.0f} ms. Look at the index sensor: its distance and its supply"
        )
        return [DeviceEvent("marks", self._device, text, {"turns": lost, "span_s": span_s, "time_ns": at_ns})]
