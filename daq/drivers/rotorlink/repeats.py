# pyright: strict
"""Encoder blocks in the order of their samples, where a node sends some of them again (flag b4).

A block that stands behind a hole waits for the block that fills it, if its node has been seen to repeat: for as long
as `WAIT_US` of the node's samples, then the hole is a loss. Blocks of a node that repeats nothing never wait.
"""

from __future__ import annotations

from daq.channels import REPEATED
from daq.drivers.rotorlink.wire import EncoderBlock

WAIT_US = 50_000
_MOST = 32  # blocks that wait

Arrived = tuple[EncoderBlock, int]
"""A block and the host's time of its arrival, ns."""


class Repeats:
    """See the module."""

    def __init__(self) -> None:
        self._known = False
        self._waiting: list[Arrived] = []

    def feed(self, block: EncoderBlock, host_ns: int, expected: int | None) -> list[Arrived]:
        """Take the next block; returns those whose turn it is.

        Args:
            expected: index of the sample behind the last one that was handed out; None before the first.
        """
        self._known = self._known or bool(block.flags & REPEATED)
        if not self._known or expected is None:
            return [*self.end(), (block, host_ns)]
        waiting = sorted([*self._waiting, (block, host_ns)], key=lambda arrived: arrived[0].first_index)
        out: list[Arrived] = []
        while waiting and (waiting[0][0].first_index <= expected or _too_long(waiting)):
            out.append(waiting.pop(0))
            expected = max(expected, _behind(out[-1][0]))
        self._waiting = waiting
        return out

    def end(self) -> list[Arrived]:
        """What waits, in order: nothing will fill the holes."""
        out, self._waiting = self._waiting, []
        return out


def _too_long(waiting: list[Arrived]) -> bool:
    first = waiting[0][0]
    newest = max(_behind(block) for block, _ in waiting)
    return (newest - first.first_index) * first.period_us > WAIT_US or len(waiting) > _MOST


def _behind(block: EncoderBlock) -> int:
    return block.first_index + len(block.counts)
