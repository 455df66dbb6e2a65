"""The chunk that is being written: its records, and the message index of each channel.

Successive messages of one channel and one size are rows of one array, which become records together.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel id, sequence, log time and publish time in front of a message."""
_HEAD, SEQUENCE, LOG_NS, PUBLISH_NS = "record heads", "sequence numbers", "log times", "publish times"
"""Columns of message records; fields of the messages are columns too, and have names of one word."""
INDEX_HEAD, INDEX_ENTRY_BYTES = struct.Struct("<BQHI"), 16
"""Opcode, length, channel id and size of the entries of a message index; size of one entry: log time and offset."""


class MessageIndex:
    """Log time and offset of each message of the chunk by channel; counts and times of all messages so far.

    Attributes:
        counts: number of messages by channel id.
        first_ns, last_ns: first and last log time; the first is 2**64 without messages.
        late_ns, early_ns: largest log time − publish time, and publish time − log time.
    """

    def __init__(self) -> None:
        self._entries: dict[int, array[int]] = {}
        self.counts: dict[int, int] = {}
        self.first_ns: int = 2**64
        self.last_ns: int = 0
        self.late_ns: int = 0
        self.early_ns: int = 0

    def add(self, channel_id: int, log_ns: int, publish_ns: int, offset: int) -> None:
        """Add the message whose record is at byte `offset` of the chunk."""
        self._of(channel_id).extend((log_ns, offset))
        self._compare(log_ns - publish_ns, log_ns - publish_ns)

    def add_rows(self, channel_id: int, log_ns: NDArray[Any], publish_ns: NDArray[Any], offsets: NDArray[Any]) -> None:
        """Add n messages of a channel; integers of 64 bits, (n,) each."""
        entries = np.empty((len(offsets), 2), np.uint64)
        entries[:, 0], entries[:, 1] = log_ns, offsets
        self._of(channel_id).frombytes(entries.tobytes())
        delays = (log_ns - publish_ns).view(np.int64)
        self._compare(int(np.minimum.reduce(delays)), int(np.maximum.reduce(delays)))

    def _of(self, channel_id: int) -> array[int]:
        entries = self._entries.get(channel_id)
        if entries is None:
            entries = self._entries[channel_id] = array("Q")
        return entries

    def _compare(self, least_ns: int, most_ns: int) -> None:
        self.late_ns, self.early_ns = max(self.late_ns, most_ns), max(self.early_ns, -least_ns)

    def take(self) -> tuple[bytes, dict[int, int], tuple[int, int]]:
        """Return the records of the chunk's message indexes, entries in order of log time, and begin the next chunk.

        Returns:
            The concatenated records; the offset of each channel's record; first and last log time, zeros for none.
        """
        parts, starts, at = list[bytes](), dict[int, int](), 0
        first, last = 2**64, 0
        for channel_id, entries in sorted(self._entries.items()):
            data = entries.tobytes()
            log_ns = np.frombuffer(data, "<u8")[::2]
            if len(log_ns) > 1 and (log_ns[1:] < log_ns[:-1]).any():
                data = np.frombuffer(data, "V16")[np.argsort(log_ns, kind="stable")].tobytes()
            parts += [INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel_id, len(data)), data]
            starts[channel_id], at = at, at + INDEX_HEAD.size + len(data)
            first = min(first, int.from_bytes(data[:8], "little"))
            last = max(last, int.from_bytes(data[-INDEX_ENTRY_BYTES:-8], "little"))
            self.counts[channel_id] = self.counts.get(channel_id, 0) + len(log_ns)
        if not starts:
            return b"", {}, (0, 0)
        self.first_ns, self.last_ns = min(self.first_ns, first), max(self.last_ns, last)
        self._entries = {}
        return b"".join(parts), starts, (first, last)


class OpenChunk:
    """Records of the chunk, and their message index.

    Args:
        chunk_bytes: largest size of the chunk, unless a single message is larger.

    Attributes:
        size: of its records so far, bytes.
        is_filled: True if it contains more than repeated definitions.
        index: of its messages.
    """

    def __init__(self, chunk_bytes: int) -> None:
        self.chunk_bytes: int = chunk_bytes
        self.size: int = 0
        self.is_filled: bool = False
        self.index: MessageIndex = MessageIndex()
        self._parts: list[bytes] = []
        self._rows: dict[int, _Rows] = {}  # by channel
        self._growing: _Rows | None = None  # its records are the last ones of the chunk

    def fitting(self, record_bytes: int) -> int:
        """Return how many records of this size fit: one or more into a chunk that is not filled."""
        return max(not self.is_filled, (self.chunk_bytes - self.size) // record_bytes)

    def add(self, record: bytes, is_repeated: bool = False) -> None:
        """Add a record; a message is known to the index already."""
        self._end_rows()
        self._parts.append(record)
        self.size += len(record)
        self.is_filled = self.is_filled or not is_repeated

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add one message."""
        self.index.add(channel_id, log_ns, publish_ns, self.size)
        head = MESSAGE_HEAD.pack(
            Opcode.MESSAGE, MESSAGE_HEAD.size - 9 + len(data), channel_id, sequence, log_ns, publish_ns
        )
        self.add(head + data)

    def add_rows(self, channel_id: int, item: NDArray[Any], columns: Mapping[str, NDArray[Any]], count: int) -> None:
        """Add messages of one size that fit.

        Args:
            item: structured array (1,), a message; the caller gives the same array each time.
            columns: values (count,), or one for all: `SEQUENCE`, `LOG_NS`, `PUBLISH_NS`, and by name those fields in
                which messages differ from `item`.
        """
        rows = self._growing
        if rows is None or rows.channel_id != channel_id or rows.item is not item:
            self._end_rows()
            rows = self._rows.get(channel_id)
            if rows is None or rows.item is not item:
                rows = self._rows[channel_id] = _Rows(channel_id, item, self.chunk_bytes)
            rows.start, self._growing = self.size, rows
        self.size += rows.add(columns, count)
        self.is_filled = True

    def _end_rows(self) -> None:
        if self._growing is not None:
            self._parts.append(self._growing.take(self.index))
            self._growing = None

    def take(self) -> bytes:
        """Return all records, and begin the next chunk."""
        self._end_rows()
        data = b"".join(self._parts)
        self._parts, self.size, self.is_filled = [], 0, False
        return data


class _Rows:
    """Records of one channel and one size, filled again and again; what is equal in all is written once."""

    def __init__(self, channel_id: int, item: NDArray[Any], chunk_bytes: int) -> None:
        self.channel_id, self.item, self.start, self._used = channel_id, item, 0, 0
        self._size = MESSAGE_HEAD.size + item.itemsize
        fields = [(name, item.dtype[name]) for name in item.dtype.names or ()]
        heads = [(_HEAD, "V11"), (SEQUENCE, "<u4"), (LOG_NS, "<i8"), (PUBLISH_NS, "<i8")]
        self._records = np.empty(max(1, chunk_bytes // self._size), [*heads, *fields])
        self._columns = {name: self._records[name] for name, _ in (*heads, *fields)}
        head = MESSAGE_HEAD.pack(Opcode.MESSAGE, self._size - 9, channel_id, 0, 0, 0)[:11]
        for name, value in ((_HEAD, np.void(head)), *((name, item[name]) for name, _ in fields)):
            self._columns[name][:] = value
        self._offsets = self._size * np.arange(len(self._records))

    def add(self, columns: Mapping[str, NDArray[Any]], count: int) -> int:
        """Add messages as `OpenChunk.add_rows`; return the size of their records, bytes."""
        rows = slice(self._used, self._used + count)
        for name, values in columns.items():
            self._columns[name][rows] = values
        self._used = rows.stop
        return count * self._size

    def take(self, index: MessageIndex) -> bytes:
        """Return the records and add them to `index`."""
        rows, self._used = slice(self._used), 0
        log_ns, publish_ns = (self._columns[name][rows] for name in (LOG_NS, PUBLISH_NS))
        index.add_rows(self.channel_id, log_ns, publish_ns, self._offsets[rows] + self.start)
        return self._records[rows].tobytes()
