"""A channel's messages as columns: the records of many chunks are gathered in one array, and then checked together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from daq.channels import Channel
from daq.log.source import IndexWrongError, LogSource
from daq.mcap.blocks import fields
from daq.mcap.chunks import ChunkTable
from daq.mcap.open_chunk import INDEX_ENTRY_BYTES, INDEX_HEAD, MESSAGE_HEAD
from daq.mcap.records import DamageError
from daq.mcap.scan import Messages, split_chunk
from rig_basics.texts import number_of

_ROWS = 2**14  # gathered at a time: they stay in the processor's cache until they are columns


def find_messages(
    source: LogSource, chunk: int, data: bytes, channel_ids: NDArray[np.int64] | None, count: int
) -> Messages:
    """Find the messages of some channels in a chunk; None selects all channels.

    Raises:
        IndexWrongError: the number of messages is not `count`, or the chunk has other times than the index lists.
    """
    try:
        messages, _ = split_chunk(data)
    except DamageError as damage:
        raise IndexWrongError(str(damage)) from damage
    table = source.contents.table
    if table.crc is None and len(messages) and messages.span() != (table.start_ns[chunk], table.end_ns[chunk]):
        raise IndexWrongError("a chunk with messages at other times than the index lists")
    if channel_ids is not None:
        messages = messages.part(np.isin(messages.channel_ids, channel_ids))
    if len(messages) != count:
        raise IndexWrongError(f"a chunk without the {number_of(count, 'message')} that the index lists")
    return messages


@dataclass(frozen=True)
class Columns:
    """Samples of a channel: log and publish times (n,), ns; sequence numbers (n,); arrays (n,) by field."""

    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    fields: dict[str, NDArray[Any]]

    def part(self, rows: Any) -> Columns:
        """Return the selected rows."""
        fields = {name: column[rows] for name, column in self.fields.items()}
        return Columns(self.log_ns[rows], self.publish_ns[rows], self.sequence[rows], fields)


def read_columns(source: LogSource, chunks: NDArray[np.intp], channel_ids: list[int], layout: Channel) -> Columns:
    """Read every sample of a channel in some chunks.

    Raises:
        IndexWrongError: a chunk does not match the index.
        ValueError: a message is not a protobuf message of this schema.
    """
    counts = source.contents.table.messages(chunks, channel_ids)
    chunks, counts = chunks[counts > 0], counts[counts > 0]
    ids = np.array(channel_ids, np.int64)
    expected = dict(zip(chunks.tolist(), counts.tolist(), strict=True))
    index_at = dict(zip(chunks.tolist(), _index_places(source.contents.table, chunks, channel_ids), strict=True))
    reading = _Reading(source, ids, layout, int(counts.sum()))
    try:
        for chunk, data, behind in source.each(chunks):
            reading.take(chunk, data, behind, expected[chunk], index_at[chunk])
        return reading.columns()
    except _OtherLayoutError:  # usual: a file of another writer
        found = [find_messages(source, chunk, data, ids, expected[chunk]) for chunk, data, _ in source.each(chunks)]
    log_ns = np.concatenate([np.empty(0, np.uint64), *(part.log_ns for part in found)])
    publish_ns = np.concatenate([np.empty(0, np.uint64), *(part.publish_ns for part in found)])
    sequence = np.concatenate([np.empty(0, np.uint32), *(part.sequences for part in found)])
    values = layout.unpack_any(part.payload(row) for part in found for row in range(len(part)))
    return Columns(log_ns.view(np.int64), publish_ns.view(np.int64), sequence, values)


def _index_places(table: ChunkTable, chunks: NDArray[np.intp], channel_ids: list[int]) -> list[int]:
    """Return the offset of the channel's index entries from the end of each chunk; negative if there is no index."""
    entries = np.flatnonzero(table.channel == channel_ids[0])
    if len(channel_ids) > 1 or not len(chunks):
        return [-1] * len(chunks)
    at = table.index_at[entries[np.searchsorted(entries, table.first_entry[chunks])]]
    return np.where(at < 0, -1, at - table.start[chunks] - table.length[chunks] + INDEX_HEAD.size).tolist()


class _OtherLayoutError(Exception):
    """A message is not encoded as this package encodes it, but may be a valid one of its schema."""


class _Reading:
    """Samples of a channel whose messages all have its constant layout.

    Args:
        rows: largest number of samples.
    """

    def __init__(self, source: LogSource, channel_ids: NDArray[np.int64], layout: Channel, rows: int) -> None:
        self._source, self._ids, self._layout = source, channel_ids, layout
        heads = [("opcode", "u1"), ("length", "<u8"), ("channel_id", "<u2"), ("sequence", "<u4")]
        times = [("log_ns", "<i8"), ("publish_ns", "<i8")]
        self._dtype = np.dtype([*heads, *times, ("message", layout.dtype)])
        self._size = self._dtype.itemsize
        self._make_room(min(rows, _ROWS))
        self._used = self._done = 0
        self._log_ns, self._publish_ns = np.empty((2, rows), np.int64)
        self._sequence = np.empty(rows, np.uint32)
        self._fields = {name: np.empty(rows, layout.dtype[name]) for name in layout.names}

    def take(self, chunk: int, data: bytes, behind: memoryview, count: int, index_at: int) -> None:
        """Add the samples of a chunk; arguments as `LogSource.each` and `_index_places`, and their number.

        Raises:
            IndexWrongError, _OtherLayoutError: they are not as expected.
        """
        if self._used + count > len(self._records):
            self._flush()
        if count > len(self._records):
            self._make_room(count)
        rows, size = slice(self._used, self._used + count), self._size
        offsets, channel_ids, log_ns = self._places(chunk, data, behind, count, index_at)
        if offsets[0] < 0 or offsets[-1] + MESSAGE_HEAD.size > len(data):
            raise IndexWrongError("a message index that points beyond its chunk")
        if (offsets == offsets[0] + self._steps[:count]).all() and offsets[-1] + size <= len(data):
            self._records[rows] = np.ndarray(count, self._records.dtype, data, int(offsets[0]))
        elif (offsets[1:] <= offsets[:-1]).any():
            raise IndexWrongError("a message index that lists a message twice")
        elif (fields(data, offsets + 1, "<u8") != size - 9).any() or offsets[-1] + size > len(data):
            raise _OtherLayoutError
        else:
            self._records[rows] = fields(data, offsets, self._records.dtype.str)
        self._listed[0, rows], self._listed[1, rows] = channel_ids, log_ns
        self._used += count

    def _make_room(self, rows: int) -> None:
        self._records = np.empty(rows, f"V{self._size}")
        self._listed = np.empty((2, rows), np.int64)  # channel id and log time according to the index
        self._steps = self._size * np.arange(rows)

    def _places(
        self, chunk: int, data: bytes, behind: memoryview, count: int, index_at: int
    ) -> tuple[NDArray[np.int64], Any, NDArray[np.int64]]:
        """Return offsets of the records (ascending), channel ids (one or n) and log times of the samples of a chunk."""
        if index_at < 0 or index_at + INDEX_ENTRY_BYTES * count > len(behind):
            found = find_messages(self._source, chunk, data, self._ids, count)
            return found.offsets, found.channel_ids, found.log_ns.view(np.int64)
        entries = np.frombuffer(behind, "<i8", 2 * count, index_at)
        log_ns, offsets = entries[::2], entries[1::2]
        if (offsets[1:] < offsets[:-1]).any():
            by_offset = np.argsort(offsets)
            log_ns, offsets = log_ns[by_offset], offsets[by_offset]
        return offsets, self._ids[0], log_ns

    def _flush(self) -> None:
        """Check the gathered samples and add them to the columns."""
        block, listed = self._records[: self._used].view(self._dtype), self._listed[:, : self._used]
        if (block["length"] != self._size - 9).any():
            raise _OtherLayoutError
        same = (block["opcode"] == Opcode.MESSAGE) & (block["channel_id"] == listed[0]) & (block["log_ns"] == listed[1])
        if not same.all():
            raise IndexWrongError("a chunk without the messages that the index lists")
        rows = slice(self._done, self._done + self._used)
        try:
            self._layout.check(block["message"])
        except ValueError as fault:
            raise _OtherLayoutError from fault
        for name, column in self._fields.items():
            column[rows] = block["message"][name]
        self._log_ns[rows], self._publish_ns[rows] = block["log_ns"], block["publish_ns"]
        self._sequence[rows] = block["sequence"]
        self._done, self._used = self._done + self._used, 0

    def columns(self) -> Columns:
        """Return the samples of all chunks."""
        self._flush()
        whole = Columns(self._log_ns, self._publish_ns, self._sequence, self._fields)
        return whole if self._done == len(self._sequence) else whole.part(slice(self._done))
