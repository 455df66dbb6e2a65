"""Messages after a gap, which wait for those that fill it: a radio repeats what was not confirmed, out of order.

A message after a gap waits for the duration of a few messages, or longer than those so far have come late. Then the gap
counts as a loss. Of a sender that has not filled a gap yet, messages wait only after short gaps, and not any more after
a few of them that were not filled. If a message then comes that would have filled its gap in time, they wait again.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from daq.numbered.messages import R

_LEAST_NS, _LEAST_MESSAGES = 50e6, 4
"""Least wait: a delay of a radio and its host under usual load, and the messages between one and its repetition."""
_LONGER = 1.5
"""Wait relative to the longest delay so far, which further delays may exceed."""
_UNFILLED_GAPS = 3
"""Unfilled gaps after which a sender is taken for one that sends nothing again."""
_MOST = 1024
"""Largest numbers of messages that wait, and of gaps that are kept: a bound of the memory."""


@dataclass(frozen=True)
class Run(Generic[R]):
    """Consecutive rows of one message.

    Attributes:
        numbers, times: as received, int64, shape (n,).
        rows: contents.
        host_ns: host time of their arrival, ns.
    """

    numbers: NDArray[np.int64]
    times: NDArray[np.int64]
    rows: R
    host_ns: int


class LookAhead(Generic[R]):
    """See the module.

    Args:
        period_ns: time from one row to the next, ns.
        longest_ns: longest wait, ns.

    Attributes:
        period_ns: see above.
        fills_gaps: whether the sender is known to fill gaps.
    """

    def __init__(self, period_ns: float, longest_ns: float) -> None:
        self.period_ns: float = period_ns
        self.fills_gaps: bool = False
        self._longest_ns = longest_ns
        self._patience_ns = 0.0
        self._chances = _UNFILLED_GAPS
        self._held: list[tuple[int, Run[R]]] = []
        self._lost = deque[range](maxlen=_MOST)

    def feed(self, place: int, run: Run[R], expected: int) -> list[Run[R]]:
        """Take a message; return those that need not wait, in order, also such that came before or come too late.

        Args:
            place: continuous number of its first row.
            run: the message.
            expected: continuous number of the row after the newest one that was returned.
        """
        late_ns = (expected - place) * self.period_ns
        if expected <= place and self._held and place < self._held[0][0]:
            self.fills_gaps = True
        elif 0 < late_ns <= self._longest_ns and any(place in gap for gap in self._lost):
            self.fills_gaps = True
            self._patience_ns = max(self._patience_ns, _LONGER * late_ns)
        self._held.append((place, run))
        self._held.sort(key=lambda each: each[0])
        return self.due(run.host_ns, expected)

    def due(self, host_ns: int, expected: int) -> list[Run[R]]:
        """Return the messages that need not wait any more at a host time, ns; for `expected` see `feed`."""
        out: list[Run[R]] = []
        while self._held:
            place, run = self._held[0]
            if place > expected:
                if not self._is_lost(place - expected, host_ns):
                    break
                self._lost.append(range(expected, place))
            out.append(run)
            del self._held[0]
            expected = max(expected, place + len(run.numbers))
        return out

    def end(self) -> list[Run[R]]:
        """Return the messages that wait: the gaps before them will not be filled."""
        out, self._held = [run for _, run in self._held], []
        return out

    def _is_lost(self, missing: int, host_ns: int) -> bool:
        """Whether the gap before the messages that wait counts as a loss."""
        place, first = self._held[0]
        message_ns = len(first.numbers) * self.period_ns
        wait_ns = min(self._longest_ns, max(_LEAST_NS, _LEAST_MESSAGES * message_ns, self._patience_ns))
        if not self.fills_gaps and (not self._chances or missing * self.period_ns > wait_ns):
            return True
        newest, last = self._held[-1]
        came_after_ns = (newest + len(last.numbers) - place) * self.period_ns
        waited_ns = host_ns - min(run.host_ns for _, run in self._held)
        if max(came_after_ns, waited_ns) <= wait_ns and len(self._held) <= _MOST:
            return False
        self._chances = max(0, self._chances - 1)
        return True
