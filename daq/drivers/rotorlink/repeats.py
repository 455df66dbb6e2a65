"""Order of encoder blocks by their samples, for nodes that send some blocks again (flag b4), and radios that do so.

A block after a gap waits for the block that fills the gap. After the duration of four blocks, at least `_MIN_WAIT_US`,
the gap counts as a loss. For a node that has not repeated a block yet, blocks wait only after short gaps, and not any
more after `_MAX_OPEN_GAPS` gaps that were not filled. If a block then arrives that would have filled its gap in that
time, blocks wait from then on.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from daq.drivers.rotorlink.wire import FLAG_REPEATS, EncoderBlock

_MIN_WAIT_US, _MAX_WAIT_US, _WAIT_BLOCKS = 50_000, 1_000_000, 4
_MAX_WAITING = 64  # blocks
_MAX_OPEN_GAPS = 3
_KEPT_GAPS = 64  # newest ones that counted as losses


class Arrived(NamedTuple):
    """A received block.

    Attributes:
        first: index of its first sample, unwrapped.
        block: the block.
        host_ns: host time of its arrival, ns since 1970.
    """

    first: int
    block: EncoderBlock
    host_ns: int

    @property
    def behind(self) -> int:
        """Index of the sample after its last one."""
        return self.first + len(self.block.counts)


class Repeats:
    """See the module."""

    def __init__(self) -> None:
        self._chances = _MAX_OPEN_GAPS
        self._known = False
        self._waiting: list[Arrived] = []
        self._lost = deque[range](maxlen=_KEPT_GAPS)

    def feed(self, arrived: Arrived, expected: int | None, *, late: bool = False) -> list[Arrived]:
        """Take the next block; return the blocks that are in order now.

        Args:
            arrived: the block.
            expected: index of the sample after the last one returned; None before the first.
            late: whether the block arrives after frames that were sent later, and is not marked as repeated.
        """
        repeats = bool(arrived.block.flags & FLAG_REPEATS)
        self._known = self._known or repeats or (late and self._was_waited_for(arrived, expected))
        waiting = [*self._waiting, arrived]
        if len(waiting) > 1:
            waiting.sort(key=lambda each: each.first)
        out: list[Arrived] = []
        while waiting:
            hole = 0 if expected is None else waiting[0].first - expected
            if hole > 0 and not self._is_lost(hole, waiting):
                break
            if hole > 0:
                self._lost.append(range(waiting[0].first - hole, waiting[0].first))
            out.append(waiting.pop(0))
            expected = max(expected or 0, out[-1].behind)
        self._waiting = waiting
        return out

    def end(self) -> list[Arrived]:
        """Return the waiting blocks in order: the gaps before them will not be filled."""
        out, self._waiting = self._waiting, []
        return out

    def _is_lost(self, hole: int, waiting: list[Arrived]) -> bool:
        """Whether the gap of `hole` samples before the waiting blocks counts as a loss."""
        first, limit_us = waiting[0].block, _limit_us(waiting[0].block)
        if not self._known and (not self._chances or hole * first.period_us > limit_us):
            return True
        waited_us = (max(each.behind for each in waiting) - waiting[0].first) * first.period_us
        if waited_us <= limit_us and len(waiting) <= _MAX_WAITING:
            return False
        self._chances = max(0, self._chances - 1)
        return True

    def _was_waited_for(self, late: Arrived, expected: int | None) -> bool:
        """Whether a late block is part of a gap that counts as a loss, but not later than blocks wait."""
        age_us = ((expected or 0) - late.first) * late.block.period_us
        return age_us <= _limit_us(late.block) and any(late.first in gap for gap in self._lost)


def _limit_us(block: EncoderBlock) -> int:
    """Return for how long blocks like this one wait, µs."""
    return min(max(_MIN_WAIT_US, _WAIT_BLOCKS * len(block.counts) * block.period_us), _MAX_WAIT_US)
