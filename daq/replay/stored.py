"""Stored samples of a log, read in order in blocks of a requested size."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.log import Log

_ROWS = 60_000  # approximate number of samples in memory
_WINDOW_NS = 2_000_000_000  # shortest window
_NEVER_NS = 2**63 - 1


class StoredRows:
    """One channel of a log from its beginning on; one time window is in memory at a time.

    Attributes:
        names: its fields; empty if the log does not have the channel.
    """

    def __init__(self, log: Log, topic: str) -> None:
        self._log, self._topic = log, topic
        self._exists = topic in log and log.count(topic) > 0
        self.names: tuple[str, ...] = log.channel(topic).names if self._exists else ()
        self._blocks = self._in_order() if self._exists else iter(())
        self._block: dict[str, NDArray[Any]] = {}
        self._at = self._size = 0

    def read_next(self, count: int, until_ns: int | None = None) -> dict[str, NDArray[Any]]:
        """Return the next samples: time_ns, log_time_ns, sequence and every field, each of shape (n ≤ count,).

        The number is smaller only at the channel's end, or if the next log time is not before `until_ns`.
        """
        parts: list[dict[str, NDArray[Any]]] = []
        while count:
            if self._at == self._size and not self._next_block():
                break
            part = {name: values[self._at : self._at + count] for name, values in self._block.items()}
            size = len(part["log_time_ns"])
            fit = size if until_ns is None else int(np.searchsorted(part["log_time_ns"], until_ns))
            parts.append({name: values[:fit] for name, values in part.items()})
            self._at += fit
            count -= fit
            if fit < size:
                break
        names = ("time_ns", "log_time_ns", "sequence", *self.names)
        return {
            name: np.concatenate(
                [np.empty(0, np.int64) if not parts else parts[0][name][:0], *(part[name] for part in parts)]
            )
            for name in names
        }

    def _next_block(self) -> bool:
        block = next(self._blocks, None)
        if block is None:
            return False
        self._block, self._at, self._size = block, 0, len(block["log_time_ns"])
        return True

    def _in_order(self) -> Iterator[dict[str, NDArray[Any]]]:
        """Yield blocks in the order of the file.

        Windows are of sample times, which may step back if a device's clock was mapped again. Log times of a channel
        ascend, so they restore the order within two neighbouring windows.
        """
        held: dict[str, NDArray[Any]] | None = None
        for block in self._windows():
            if not len(block["log_time_ns"]):
                continue
            if held is not None:
                overlap = held["log_time_ns"][-1] > block["log_time_ns"].min()
                first, held = _merged(held, block) if overlap else (held, block)
                yield first
            else:
                held = block
        if held is not None:
            yield held

    def _windows(self) -> Iterator[dict[str, NDArray[Any]]]:
        start, end = self._log.start_ns, self._log.end_ns
        count = -(-self._log.count(self._topic) // _ROWS)
        width = max(_WINDOW_NS, (end - start) // count + 1)
        edges = [0, *range(start + width, end, width), _NEVER_NS]
        for first, last in itertools.pairwise(edges):
            samples = self._log.between(first, last)[self._topic]
            heads = {"time_ns": samples.time_ns, "log_time_ns": samples.log_time_ns, "sequence": samples.sequence}
            yield heads | samples.columns


def _merged(
    before: dict[str, NDArray[Any]], after: dict[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Return both blocks sorted by log time; the first keeps its length."""
    both = {name: np.concatenate([before[name], after[name]]) for name in before}
    order = np.argsort(both["log_time_ns"], kind="stable")
    size = len(before["log_time_ns"])
    return (
        {name: values[order[:size]] for name, values in both.items()},
        {name: values[order[size:]] for name, values in both.items()},
    )
