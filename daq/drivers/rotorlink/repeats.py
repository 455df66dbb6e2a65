# pyright: strict
"""Encoder blocks in the order of their samples, where a node sends some of them again (flag b4).

A block behind a hole waits for the one that fills it: as long as four blocks last, `_LEAST_US` at least, then the hole
is a loss. A node that has not repeated anything yet is waited for at short holes only, and no more after `_GIVEN_UP`
that stayed open.
"""

from __future__ import annotations

from typing import NamedTuple

from daq.drivers.rotorlink.wire import FLAG_REPEATS, EncoderBlock

_LEAST_US, _MOST_US, _BLOCKS = 50_000, 1_000_000, 4
_MOST = 64  # blocks that wait
_GIVEN_UP = 3


class Arrived(NamedTuple):
    """A block.

    Attributes:
        first: index of its first sample, unwrapped.
        host_ns: when it came.
    """

    first: int
    block: EncoderBlock
    host_ns: int

    @property
    def behind(self) -> int:
        """Index of the sample behind its last one."""
        return self.first + len(self.block.counts)


class Repeats:
    """See the module.

    Args:
        waits: whether a node is waited for that has not repeated anything yet.
    """

    def __init__(self, *, waits: bool) -> None:
        self._chances = _GIVEN_UP if waits else 0
        self._known = False
        self._waiting: list[Arrived] = []

    def feed(self, arrived: Arrived, expected: int | None) -> list[Arrived]:
        """Take the next block; returns those whose turn it is.

        Args:
            expected: index of the sample behind the last one that was handed out; None before the first.
        """
        self._known = self._known or bool(arrived.block.flags & FLAG_REPEATS)
        waiting = [*self._waiting, arrived]
        if len(waiting) > 1:
            waiting.sort(key=lambda each: each.first)
        out: list[Arrived] = []
        while waiting:
            hole = 0 if expected is None else waiting[0].first - expected
            if hole > 0 and not self._is_lost(hole, waiting):
                break
            out.append(waiting.pop(0))
            expected = max(expected or 0, out[-1].behind)
        self._waiting = waiting
        return out

    def end(self) -> list[Arrived]:
        """What waits, in order: nothing will fill the holes."""
        out, self._waiting = self._waiting, []
        return out

    def _is_lost(self, hole: int, waiting: list[Arrived]) -> bool:
        """Whether so many samples before what waits will not come."""
        first = waiting[0].block
        limit_us = min(max(_LEAST_US, _BLOCKS * len(first.counts) * first.period_us), _MOST_US)
        if not self._known and (not self._chances or hole * first.period_us > limit_us):
            return True
        waited_us = (max(each.behind for each in waiting) - waiting[0].first) * first.period_us
        if waited_us <= limit_us and len(waiting) <= _MOST:
            return False
        self._chances = max(0, self._chances - 1)
        return True
