"""The newest samples of every channel in memory, for guided tests, trips and displays."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.items import Batch

_FIRST_ROWS = 4096


class Recent:
    """The newest samples of every channel; thread-safe.

    The rows of a channel are stored in one table, whose content is moved to its front when it is full. Separate arrays
    for every read would fragment the memory in recordings of hours.

    Args:
        keep_s: maximum age of the samples in their own time, s.
        known: the channels; those of `daq.channels.CHANNELS` if None.
    """

    def __init__(self, keep_s: float, known: Iterable[channels.Channel] | None = None) -> None:
        self._keep_ns = int(keep_s * 1e9)
        self._tables = {channel.topic: _Table(channel) for channel in known or channels.CHANNELS.values()}
        self._lock = threading.Lock()

    def add(self, batch: Batch) -> None:
        """Append one batch. Samples that are too old are removed when the table is full."""
        with self._lock:
            self._tables[batch.channel.topic].add(batch, self._keep_ns)

    def last(self, topic: str, fields: tuple[str, ...], since_ns: int = 0) -> tuple[NDArray[np.int64], list[Any]]:
        """Return times (ns) and columns of a channel since an instant; empty arrays if there are no samples."""
        with self._lock:
            rows = self._tables[topic].since(since_ns)
            return rows["time_ns"].copy(), [rows[name].copy() for name in fields]

    def clear(self) -> None:
        """Remove all samples, since every log has new clock maps."""
        with self._lock:
            for table in self._tables.values():
                table.end = 0


class _Table:
    """Rows of one channel. The rows before `end` are valid."""

    def __init__(self, channel: channels.Channel) -> None:
        layout = [(name, channel.dtype[name]) for name in channel.names]
        self._rows = np.empty(_FIRST_ROWS, [("time_ns", np.int64), *layout])
        self._names = channel.names
        self.end = 0

    def add(self, batch: Batch, keep_ns: int) -> None:
        count = len(batch.time_ns)
        if self.end + count > len(self._rows):
            self._make_room(count, int(batch.time_ns[-1]) - keep_ns)
        new = self._rows[self.end : self.end + count]
        new["time_ns"] = batch.time_ns
        for name in self._names:
            new[name] = batch.columns.get(name, 0)
        self.end += count

    def since(self, since_ns: int) -> NDArray[Any]:
        """Return the rows since an instant. The times of a channel ascend."""
        rows = self._rows[: self.end]
        return rows[np.searchsorted(rows["time_ns"], since_ns) :]

    def _make_room(self, count: int, oldest_ns: int) -> None:
        """Move the rows since `oldest_ns` to the front, of a larger table if they fill most of the present one."""
        kept = self.since(oldest_ns)
        needed = len(kept) + count
        rows = self._rows if 4 * needed <= 3 * len(self._rows) else np.empty(2 * needed, self._rows.dtype)
        rows[: len(kept)] = kept.copy()
        self._rows, self.end = rows, len(kept)
