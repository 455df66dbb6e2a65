"""Where in its sender's count each message is: next, repeated, after lost ones, or after a new start of the sender.

A message has a number that begins again after `size`, and may have a time of its sender's clock. Its place is the
number plus an unknown count of whole cycles. The sender's clock decides between them as far as it reaches. Beyond that
the host's time does: a message cannot be received before it was sent, and only a delayed one later than the others.

    the next number                              ─▶ placed
    a later number that is due                   ─▶ placed after lost messages
    a number that is not due yet                 ─▶ started again, damaged, or sent earlier
    late, by a whole cycle or between two cycles ─▶ lost messages, started again, or only the host was late

What a message does not decide waits for those after it. After a delay they come faster than they were sent, until one
is in time. After a loss or a new start they come at their usual pace, and remain late.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Generic, Literal

import numpy as np
from numpy.typing import NDArray

from daq.numbered.due_line import RATE_ERROR, DueLine, Lateness, came_at_once, first_late, settled_lateness
from daq.numbered.look_ahead import LookAhead, Run
from daq.numbered.messages import Count, Message, R, Stretch

_HOST_NS = 10e6
"""Delay of a host under usual load, which shows nothing."""
_EDGE = 0.1
"""Share of a cycle by which the least delayed messages may lie above the line that none can come before."""
_CHANCE = 0.01
"""Largest share of a cycle within the tolerance: so often a delay of the host looks like whole lost cycles."""
_SILENT = 0.8
"""Share of missing messages for whose duration the line must have been silent; a delay may cover the rest."""
_STARTS_NS = 100e6
"""Time that a sender needs at least to start again."""
_RARE = 1e-4
"""Share of its cycle by which a number of a radio, which delays its messages, may be late without doubt."""
_MOST_WAITING = 4096


_Why = Literal["jumped", "too early", "sent earlier", "late"]


class NumberedStream(Generic[R]):
    """Places the messages of one sender; see the module.

    Args:
        count: their numbers.
        joined: joins the contents of several messages.

    Attributes:
        repeated: number of messages that came again or too late, and were dropped.
        damaged: number of messages that were dropped because of their number.
    """

    def __init__(self, count: Count, joined: Callable[[Sequence[R]], R]) -> None:
        self.repeated: int = 0
        self.damaged: int = 0
        self._count, self._joined = count, joined
        self._number_ns = count.period_ns / count.step
        self._tolerance_ns = min(0.5 * count.size * self._number_ns, max(_HOST_NS, 0.5 * count.period_ns))
        self._due = DueLine(self._tolerance_ns)
        self._ahead = LookAhead[R](count.period_ns, count.look_ahead_ns) if count.look_ahead_ns else None
        self._place = self._time = 0  # of the newest message with a place
        self._waiting: list[Message[R]] = []
        self._why: _Why = "late"
        self._ends_read = True  # whether the newest message is the last one of its read
        self._stands_still = False  # whether the newest message had the number of that before it

    @property
    def pace(self) -> float:
        """Time between two messages by the host's clock, relative to the stated one; 1 as long as no other is found."""
        return self._due.pace

    def feed(
        self, numbers: NDArray[np.int64], rows: R, host_ns: int, times: NDArray[np.int64] | None = None
    ) -> list[Stretch[R]]:
        """Take the messages of one read.

        Args:
            numbers: their numbers, int64, shape (n,), n ≥ 1.
            rows: their contents.
            host_ns: host time of the read, ns.
            times: times of their sender's clock, int64, shape (n,); None without one.

        Returns:
            Messages that have a place now, in order.
        """
        read = Run(numbers, np.zeros(len(numbers), np.int64) if times is None else times, rows, host_ns)
        if self._ahead is None:
            return self._fed(read)
        out: list[Stretch[R]] = []
        for run in _runs(read, self._count.size):
            out += self._in_order(self._ahead, run)
        return out

    def at(self, host_ns: int) -> list[Stretch[R]]:
        """Return the messages that need not wait any more for others that fill a gap, at a host time, ns."""
        if self._ahead is None:
            return []
        return [each for run in self._ahead.due(host_ns, self._place + 1) for each in self._fed(run)]

    def end(self) -> list[Stretch[R]]:
        """Return the messages that wait; no others come."""
        ahead = [] if self._ahead is None else [each for run in self._ahead.end() for each in self._fed(run)]
        return [*ahead, *self._merged(self._settled())]

    def _in_order(self, ahead: LookAhead[R], run: Run[R]) -> list[Stretch[R]]:
        """Return the messages that have a place with those of a run, unless they wait for others that fill a gap."""
        place = self._place_near(run) if self._due.begun else None
        if place is None or (self._waiting and self._why != "sent earlier"):
            ready = [*ahead.end(), run]
        else:
            newest = place + len(run.numbers) - 1
            if place > self._place and self._is_in_time(self._late_ns(newest, run.host_ns), run.host_ns):
                self._drop()  # the sender goes on counting
            ready = ahead.feed(place, run, self._place + 1)
        return [each for one in ready for each in self._fed(one)]

    def _place_near(self, run: Run[R]) -> int | None:
        """Return the place of a run before or after the newest message; None if number and clock contradict it."""
        count = self._count
        step = _centred(int(run.numbers[0]) - self._place, count.size)
        if count.clock_size:
            passed = _centred(int(run.times[0]) - self._time, count.clock_size) / count.clock_step
            step += count.size * round((passed - step) / count.size)
            if abs(passed - step) > 0.5 + RATE_ERROR * abs(passed):
                return None
        return self._place + step

    def _fed(self, read: Run[R]) -> list[Stretch[R]]:
        """Return the messages that have a place with those of a read."""
        numbers, times, rows, host_ns = read.numbers, read.times, read.rows, read.host_ns
        if not self._due.begun:
            self._begin(int(numbers[0]), int(times[0]))
        before = np.concatenate([[self._place], numbers[:-1]]), np.concatenate([[self._time], times[:-1]])
        steps, cycles_ns = self._steps(*before, numbers, times)
        is_next = np.abs(steps - self._count.step) < 0.5 * self._count.step
        ends = np.append(np.flatnonzero(~is_next), len(numbers)).tolist()  # of runs of next ones
        out: list[Stretch[R]] = []
        i = 0
        while i < len(numbers):
            end = ends[bisect_left(ends, i)]
            goes_on = i == 0 or self._is_newest(int(numbers[i - 1]), int(times[i - 1]))
            if end > i and goes_on and not self._waiting:
                places = self._place + np.cumsum(steps[i:end]).astype(np.int64)
                at_ns = self._arrived_ns(read, end - 1)
                late_ns = self._late_ns(int(places[-1]), at_ns)
                if self._cycles(late_ns, float(np.min(cycles_ns[i:end])), at_ns) < 1:
                    self._time = int(times[end - 1])
                    taken = 1 if end - i == len(numbers) else end - i  # the first reads of a log may all be late
                    out.append(self._placed(places, rows[i:end], host_ns, taken))
                    i = end
                    continue
            self._ends_read = i == len(numbers) - 1
            out += self._take((int(numbers[i]), int(times[i]), self._arrived_ns(read, i), host_ns, rows[i : i + 1]))
            i += 1
        return out if len(out) == 1 else self._merged(out)

    def _arrived_ns(self, read: Run[R], i: int) -> int:
        """Return the time at which a message of a read arrived, estimated from the number of those after it, ns."""
        return read.host_ns - round((len(read.numbers) - 1 - i) * self._count.period_ns * self._due.pace)

    def _is_newest(self, number: int, time: int) -> bool:
        """Whether number and time are those of the newest message with a place."""
        return (self._place - number) % self._count.size == 0 and self._time == time

    def _begin(self, number: int, time: int) -> None:
        """Let the next message have no other before it."""
        self._place = number - round(self._count.step)
        self._time = time - round(self._count.clock_step)
        self._due = DueLine(self._tolerance_ns)

    # --- steps ----------------------------------------------------------------------------------------------------

    def _steps(self, place: Any, time: Any, number: Any, own_time: Any) -> tuple[Any, Any]:
        """Return the least steps from one message to the next, and the times after which they are the same again, ns.

        Args:
            place, time: of the messages before them.
            number, own_time: their own; all are arrays of shape (n,), or ints.
        """
        count = self._count
        steps, cycle_ns = (number - place - 1) % count.size + 1, count.size * self._number_ns
        passed = (own_time - time) % max(1, count.clock_size) / count.clock_step * count.step
        cycles = ((passed - steps) / count.size + 0.5) // 1
        unlike = abs(passed - steps - cycles * count.size)
        is_like = (unlike < 0.5 * count.step + RATE_ERROR * passed) & (unlike < 0.25 * count.size)
        agree = is_like & (cycles >= 0) & (count.clock_size > 0)
        clock_ns = max(count.clock_size / count.clock_step * count.period_ns, cycle_ns)
        return steps + agree * cycles * count.size, cycle_ns + agree * (clock_ns - cycle_ns)

    def _late_ns(self, place: int, at_ns: int) -> float:
        return self._due.late_ns(place * self._number_ns, at_ns)

    def _is_in_time(self, late_ns: float, at_ns: int) -> bool:
        return -self._due.early_ns(at_ns) <= late_ns <= self._due.tolerance_ns(at_ns)

    def _cycles(self, late_ns: float, cycle_ns: float, at_ns: int) -> int:
        """Return the whole cycles in a lateness. A delay makes it longer, and only an error of the line shorter."""
        error_ns = min(_HOST_NS, _EDGE * cycle_ns) + self._due.tolerance_ns(at_ns) - self._tolerance_ns
        return max(0, int((late_ns + min(error_ns, 0.5 * cycle_ns)) / cycle_ns))

    def _missing(self, step: int) -> int:
        return round(step / self._count.step) - 1

    def _message(self, place: int, time: int, received: tuple[int, int, int, int, R]) -> Message[R]:
        """Return a message with its place after another one, whose place and time are given."""
        number, own_time, at_ns, host_ns, row = received
        steps, cycle_ns = self._steps(place, time, number, own_time)
        step = int(steps)
        if step > self._count.size and self._late_ns(place + step, at_ns) < -self._due.early_ns(at_ns):
            step = (step - 1) % self._count.size + 1  # the clock's time is damaged
            cycle_ns = self._count.size * self._number_ns
        here = place + step
        return Message(
            number,
            own_time,
            here,
            self._missing(step),
            cycle_ns,
            self._late_ns(here, at_ns),
            at_ns,
            host_ns,
            row,
        )

    # --- one message ----------------------------------------------------------------------------------------------

    def _take(self, received: tuple[int, int, int, int, R]) -> list[Stretch[R]]:
        """Take number, time, arrival, read and content of a message."""
        here = self._message(self._place, self._time, received)
        if not self._waiting:
            return self._alone(here)
        newest = self._waiting[-1]
        after = self._message(newest.place, newest.time, received)
        if self._goes_on(here, after):
            self._drop()
            return self._put([here], here.missing)
        more_ns = after.late_ns - newest.late_ns
        if after.missing and (after.late_ns if self._why == "late" else more_ns) < -self._due.early_ns(after.at_ns):
            return self._apart(here, after, received)
        if self._why == "late" and self._tolerance_ns < more_ns < (after.at_ns - newest.host_ns) / _SILENT:
            return [*self._put(self._waiting, self._waiting[0].missing), *self._take(received)]
        self._waiting.append(after)
        return self._decided()

    def _apart(self, here: Message[R], after: Message[R], received: tuple[int, int, int, int, R]) -> list[Stretch[R]]:
        """Take a message that does not go on from those that wait."""
        if not self._is_of_before(after, self._waiting[-1].time):
            return [*self._settled(), *self._take(received)]
        if self._why == "sent earlier":
            self._drop()
            return self._alone(here)
        self.repeated += 1
        return []

    def _goes_on(self, here: Message[R], after: Message[R]) -> bool:
        """Whether a message goes on from the newest one with a place, and not from those that wait."""
        if self._why == "late":
            return False
        if here.missing == 0:
            return self._why != "jumped" or after.missing > 0
        if self._why == "sent earlier":
            return after.missing > 0 and self._is_in_time(here.late_ns, here.at_ns)
        return after.missing > 0 and here.missing == len(self._waiting)  # they stand where others are missing

    def _alone(self, here: Message[R]) -> list[Stretch[R]]:
        """Take a message while no other one waits."""
        silent_ns = here.at_ns - self._due.heard_ns
        missing_ns = here.late_ns + here.missing * self._count.period_ns
        tolerance_ns = self._due.tolerance_ns(here.at_ns)
        was_silent = silent_ns >= _SILENT * missing_ns
        if here.missing == 0 and (self._cycles(here.late_ns, here.cycle_ns, here.at_ns) < 1 or not was_silent):
            return self._put([here], 0)
        is_same = self._behind(here) == 0 and (here.late_ns < -tolerance_ns or self._stands_still)
        if is_same or here.late_ns < -self._due.early_ns(here.at_ns):
            return self._too_early(here)
        if here.late_ns <= (max(tolerance_ns, _RARE * here.cycle_ns) if self._ahead else tolerance_ns):
            return self._put([here], here.missing) if self._count.is_checked else self._wait(here, "jumped")
        cycles = self._cycles(here.late_ns, here.cycle_ns, here.at_ns)
        is_due = abs(here.late_ns - cycles * here.cycle_ns) <= tolerance_ns
        if self._count.is_checked and is_due and 2 * tolerance_ns < _CHANCE * here.cycle_ns:
            return self._put([here], here.missing, cycles)
        if not was_silent:
            return self._put([here], here.missing)
        return self._wait(here, "late")

    def _too_early(self, here: Message[R]) -> list[Stretch[R]]:
        """Take a message that cannot have been sent yet if it comes after the newest one."""
        if self._is_of_before(here, self._time):
            if not self._count.late_messages:  # the same number again
                self.damaged += 1
                self._stands_still = True
                return []
            return self._wait(here, "sent earlier")
        return self._restarted([here]) if self._count.is_checked else self._wait(here, "too early")

    def _behind(self, here: Message[R]) -> int:
        """Return the number of messages by which a message comes before the one that it was compared with."""
        return self._missing(self._count.size) - here.missing

    def _is_of_before(self, here: Message[R], time: int) -> bool:
        """Whether a message may be an earlier one than that with which it was compared, which has the given time."""
        behind = self._behind(here)
        if not (self._count.clock_size and self._count.late_messages):
            return behind <= self._count.late_messages
        passed = _centred(time - here.time, self._count.clock_size) / self._count.clock_step
        return behind <= self._count.late_messages and abs(passed - behind) <= 0.5 + RATE_ERROR * behind

    def _wait(self, here: Message[R], why: _Why) -> list[Stretch[R]]:
        self._waiting, self._why = [here], why
        return []

    def _drop(self) -> None:
        """Drop the messages that wait."""
        if self._why == "sent earlier":
            self.repeated += len(self._waiting)
        else:
            self.damaged += len(self._waiting)
        self._waiting = []

    # --- messages that wait ---------------------------------------------------------------------------------------

    def _decided(self) -> list[Stretch[R]]:
        """Decide about the messages that wait, with a newer one."""
        first, newest = self._waiting[0], self._waiting[-1]
        is_in_time = self._why == "late" and newest.late_ns <= self._due.tolerance_ns(newest.at_ns)
        if self._why == "jumped" or is_in_time:
            return self._put(self._waiting, first.missing)
        if self._why == "too early":
            return self._restarted(self._waiting)
        if len(self._waiting) >= _MOST_WAITING:
            return self._settled()
        is_due = self._ends_read  # the lateness of all that wait is judged once a read
        lateness = settled_lateness(self._waiting, self._tolerance_ns, self._count.period_ns) if is_due else None
        if lateness is None:
            return []
        if self._why == "sent earlier":
            return self._restarted(self._waiting)
        return self._late(lateness)

    def _late(self, lateness: Lateness) -> list[Stretch[R]]:
        """Place messages that remain late: after whole cycles, after a new start, or with a delay of the host."""
        waiting, late_ns = self._waiting, lateness.least_ns
        first = waiting[0]
        cycles = self._cycles(late_ns, first.cycle_ns, first.at_ns)
        off_ns = abs(late_ns - cycles * first.cycle_ns)
        if np.isfinite(lateness.change_ns):
            if off_ns <= self._due.tolerance_ns(first.at_ns) + self._tolerance_ns + lateness.change_ns:
                at = first_late(waiting, late_ns, self._tolerance_ns)
                before = self._put(waiting[:at], first.missing) if at else []
                return [*before, *self._put(waiting[at:], waiting[at].missing, cycles)]
            if first.missing and late_ns > _STARTS_NS:
                return self._restarted(waiting)
        return self._put(waiting, first.missing)

    def _settled(self) -> list[Stretch[R]]:
        """Place or drop the messages that wait, without others after them."""
        if not self._waiting:
            return []
        first, is_burst = self._waiting[0], came_at_once(self._waiting, self._number_ns)
        if self._why == "jumped" or (self._why == "late" and is_burst):
            return self._put(self._waiting, first.missing)
        if self._why == "late":
            return self._late(Lateness(min(each.late_ns for each in self._waiting), 0.0))
        if is_burst or self._why == "too early":
            self._drop()
            return []
        return self._restarted(self._waiting)

    # --- results --------------------------------------------------------------------------------------------------

    def _put(self, messages: list[Message[R]], missing: int, cycles: int = 0) -> list[Stretch[R]]:
        """Place messages after `missing` ones and whole cycles, of which none is certain."""
        first = messages[0]
        lost = missing + round(cycles * first.cycle_ns / self._count.period_ns)
        shift = round(cycles * first.cycle_ns / self._number_ns)
        is_about = cycles > 0 and 2 * self._due.tolerance_ns(first.at_ns) > _CHANCE * first.cycle_ns
        return self._stretches(messages, shift, lost, is_about=is_about)

    def _restarted(self, messages: list[Message[R]]) -> list[Stretch[R]]:
        """Place messages after a new start of the sender."""
        first = messages[0]
        silent_ns = first.at_ns - self._due.heard_ns
        lost = max(0, round(silent_ns / self._count.period_ns) - 1)
        self._begin(first.number, first.time)
        return self._stretches(messages, first.number - first.place, lost, is_about=True, is_restart=True)

    def _stretches(
        self, messages: list[Message[R]], shift: int, lost: int, *, is_about: bool = False, is_restart: bool = False
    ) -> list[Stretch[R]]:
        self._waiting = []
        out: list[Stretch[R]] = []
        for i, each in enumerate(messages):
            self._time = each.time
            one = self._placed(np.array([each.place + shift]), each.row, each.host_ns)
            out.append(
                replace(one, lost=each.missing)
                if i
                else replace(one, lost=lost, is_about=is_about, is_restart=is_restart)
            )
        return out

    def _placed(self, places: NDArray[np.int64], rows: R, host_ns: int, taken: int = 1) -> Stretch[R]:
        self._place, self._stands_still = int(places[-1]), False
        self._due.take(self._place * self._number_ns, host_ns, taken)
        return Stretch(places, rows, host_ns)

    def _merged(self, parts: Sequence[Stretch[R]]) -> list[Stretch[R]]:
        """Return the stretches with those of one read joined that follow one another."""
        out: list[list[Stretch[R]]] = []
        for part in parts:
            if out and part.host_ns == out[-1][0].host_ns and not (part.lost or part.is_restart):
                out[-1].append(part)
            else:
                out.append([part])
        return [
            replace(
                group[0],
                numbers=np.concatenate([each.numbers for each in group]),
                rows=self._joined([each.rows for each in group]),
            )
            for group in out
        ]


def _runs(read: Run[R], size: int) -> list[Run[R]]:
    """Return the parts of a read with consecutive numbers."""
    ends = [0, *(np.flatnonzero((np.diff(read.numbers) - 1) % size) + 1).tolist(), len(read.numbers)]
    return [Run(read.numbers[a:b], read.times[a:b], read.rows[a:b], read.host_ns) for a, b in pairwise(ends)]


def _centred(difference: int, size: int) -> int:
    """Return a difference of numbers that begin again after `size`, as the one nearest to 0."""
    return (difference + size // 2) % size - size // 2
