"""The messages of a log within a time window: as columns, or chunk by chunk in file order."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.channels import RAW_PREFIX, Channel
from daq.log.columns import Columns, find_messages, read_columns
from daq.log.source import IndexWrongError, LogSource
from daq.mcap.chunks import ChunkTable
from daq.mcap.scan import Messages

_log = logging.getLogger(__name__)

_Part = TypeVar("_Part")


class LogWindow:
    """Contents of a file between two times; only the necessary chunks are read.

    If the file's index turns out to be wrong, the file is walked and reading continues with the result.

    Args:
        source: the open file.
        window_ns: first time and end, ns since 1970; None for the whole file.
    """

    def __init__(self, source: LogSource, window_ns: tuple[int, int] | None) -> None:
        self._source, self._window_ns = source, window_ns
        self._chosen: tuple[ChunkTable, NDArray[np.intp]] | None = None

    def ids(self) -> dict[str, list[int]]:
        """Channel ids by topic."""
        ids: dict[str, list[int]] = {}
        for channel_id, channel in sorted(self._source.contents.definitions.channels.items()):
            ids.setdefault(channel.topic, []).append(channel_id)
        return ids

    def columns(self, topic: str, layout: Channel, rows: int) -> Iterator[Columns]:
        """Yield the samples of a topic whose own time is in the window, in file order; at least one part.

        Args:
            rows: approximate number of samples in a part, which consists of whole chunks.

        Raises:
            ValueError: a message is not a protobuf message of this schema.
            LogError: the log was closed.
        """
        return self._in_order(lambda position: self._columns_from(position, topic, layout, rows))

    def _columns_from(self, position: int, topic: str, layout: Channel, rows: int) -> Iterator[tuple[int, Columns]]:
        """As `columns`, for chunks that begin at byte `position` or later, each part with its last chunk's position."""
        table, chunks, ids = self._source.contents.table, self._chunks(), self.ids()[topic]
        chunks = chunks[table.start[chunks] >= position]
        counts = table.messages(chunks, ids)
        for part in np.split(chunks, np.flatnonzero(np.diff(np.cumsum(counts) // rows)) + 1):
            columns = read_columns(self._source, part, ids, layout)
            yield int(table.start[part].max(initial=0)), self._inside(columns)

    def _inside(self, columns: Columns) -> Columns:
        """Return the samples whose own time is in the window."""
        if self._window_ns is None:
            return columns
        start, end = self._window_ns
        rows = np.flatnonzero((columns.publish_ns >= start) & (columns.publish_ns < end))
        if len(rows) and rows[-1] - rows[0] + 1 == len(rows):  # the usual case: a slice needs no copy
            return columns.part(slice(rows[0], rows[-1] + 1))
        return columns.part(rows)

    def messages(self, topics: list[str]) -> Iterator[Messages]:
        """Yield the messages of some topics in file order, chunk by chunk: raw bytes by log time, others by their own.

        Raises:
            LogError: the log was closed.
        """
        return self._in_order(lambda position: self._from(position, topics))

    def _in_order(self, read: Callable[[int], Iterator[tuple[int, _Part]]]) -> Iterator[_Part]:
        """Yield the parts that `read` returns from a position on, each with the position of its last chunk."""
        position = 0
        while position >= 0:
            try:
                for start, part in read(position):
                    position = start + 1
                    yield part
                position = -1
            except IndexWrongError as error:
                _log.info("the whole file is read, since its index is wrong: %s", error)
                self._source.walk()

    def _chunks(self) -> NDArray[np.intp]:
        """Return the chunks that may contain messages in the window."""
        table = self._source.contents.table
        if self._chosen is None or self._chosen[0] is not table:
            self._chosen = table, table.numbers(self._window_ns)
        return self._chosen[1]

    def _from(self, position: int, topics: list[str]) -> Iterator[tuple[int, Messages]]:
        """As `messages`, for chunks that begin at byte `position` or later, each with its position."""
        by_topic = self.ids()
        ids = [channel_id for topic in topics for channel_id in by_topic.get(topic, ())]
        table, chunks = self._source.contents.table, self._chunks()
        chunks = chunks[table.start[chunks] >= position]
        counts = table.messages(chunks, ids)
        expected = dict(zip(chunks[counts > 0].tolist(), counts[counts > 0].tolist(), strict=True))
        by_host_time = all(topic.startswith(RAW_PREFIX) for topic in topics)
        for chunk, data, _ in self._source.each(chunks[counts > 0]):
            found = find_messages(self._source, chunk, data, np.array(ids, np.int64), expected[chunk])
            if self._window_ns is not None:
                times = (found.log_ns if by_host_time else found.publish_ns).view(np.int64)
                found = found.part((times >= self._window_ns[0]) & (times < self._window_ns[1]))
            yield int(table.start[chunk]), found
