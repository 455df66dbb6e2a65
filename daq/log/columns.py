"""A channel's messages as columns: one compiled pass over each chunk writes directly into the returned arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import Channel
from daq.log.source import IndexWrongError, LogSource
from daq.mcap.scan import BROKEN, MESSAGE_HEAD_BYTES, OTHER_COUNT, OTHER_LAYOUT, collect, locate
from rig_basics.texts import number_of

_RECORD_HEAD_BYTES = 9


@dataclass(frozen=True)
class Messages:
    """Messages of one chunk: its bytes; offset, end and channel id of each (n, 3); log and publish times (n,), ns."""

    data: NDArray[np.uint8]
    places: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]

    def payload(self, row: int) -> bytes:
        """Return the payload of a row's message."""
        start, end, _ = self.places[row]
        return self.data[start + _RECORD_HEAD_BYTES + MESSAGE_HEAD_BYTES : end].tobytes()

    def part(self, rows: NDArray[np.bool_]) -> Messages:
        """Return the selected rows."""
        return Messages(self.data, self.places[rows], self.log_ns[rows], self.publish_ns[rows])

    @property
    def sequences(self) -> NDArray[np.uint32]:
        """Sequence numbers (n,)."""
        at = self.places[:, :1] + _RECORD_HEAD_BYTES + 2 + np.arange(4)
        return np.ascontiguousarray(self.data[at]).view("<u4")[:, 0]


def find_messages(data: NDArray[np.uint8], channel_ids: NDArray[np.int64], count: int) -> Messages:
    """Find the messages of some channels in a chunk; an empty `channel_ids` selects all channels.

    Raises:
        IndexWrongError: the number of messages is not `count`.
    """
    found = Messages(data, np.empty((count, 3), np.int64), np.empty(count, np.int64), np.empty(count, np.int64))
    if locate(data, channel_ids, found.places, found.log_ns, found.publish_ns) < 0:
        raise IndexWrongError(f"a chunk without the {number_of(count, 'message')} that the index lists")
    return found


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
    block = _Block(layout, int(counts.sum()))
    rows = dict(
        zip(chunks.tolist(), zip((np.cumsum(counts) - counts).tolist(), counts.tolist(), strict=True), strict=True)
    )

    def take(chunk: int, data: NDArray[np.uint8]) -> int:
        row, room = rows[chunk]
        return collect(
            data,
            ids,
            layout.dtype.itemsize,
            block.table,
            block.heads,
            block.sequence,
            block.wide,
            block.narrow,
            row,
            room,
        )

    results = source.for_each(chunks, take)
    if any(result in (BROKEN, OTHER_COUNT) for _, result in results):
        raise IndexWrongError("a chunk without the messages that the index lists")
    if any(result == OTHER_LAYOUT for _, result in results):
        return _read_any(source, chunks, counts, ids, layout)
    columns = block.columns()
    if len(results) == len(chunks):
        return columns
    good = {chunk for chunk, _ in results}
    return columns.part(np.repeat([chunk in good for chunk in chunks.tolist()], counts))


class _Block:
    """Arrays for n samples; columns of 8 bytes and of 4 bytes are stored separately."""

    def __init__(self, layout: Channel, n: int) -> None:
        self.layout = layout
        self.table = np.empty((len(layout.names), 3), np.int64)
        wide = narrow = offset = 0
        for number, name in enumerate(layout.names, 1):
            size = layout.dtype[name].itemsize
            if size == 8:
                self.table[number - 1] = offset + 1, number << 3 | 1, wide
                wide += 1
            else:
                self.table[number - 1] = offset + 1, number << 3 | 5, -1 - narrow
                narrow += 1
            offset += 1 + size
        self.heads, self.sequence = np.empty((2, n), np.int64), np.empty(n, np.uint32)
        self.wide, self.narrow = np.empty((wide, n), np.uint64), np.empty((narrow, n), np.uint32)

    def columns(self) -> Columns:
        fields: dict[str, NDArray[Any]] = {}
        for name, (_, _, column) in zip(self.layout.names, self.table.tolist(), strict=True):
            bits = self.wide[column] if column >= 0 else self.narrow[-1 - column]
            fields[name] = bits.view(self.layout.dtype[name])
        return Columns(self.heads[0], self.heads[1], self.sequence, fields)


def _read_any(
    source: LogSource, chunks: NDArray[np.intp], counts: NDArray[np.int64], ids: NDArray[np.int64], layout: Channel
) -> Columns:
    """As `read_columns`, for messages in any valid protobuf encoding of the schema."""
    expected = dict(zip(chunks.tolist(), counts.tolist(), strict=True))
    found = [find_messages(data, ids, expected[chunk]) for chunk, data in source.each(chunks)]
    fields = layout.unpack_any(part.payload(row) for part in found for row in range(len(part.places)))
    nothing = np.empty(0, np.int64)
    return Columns(
        np.concatenate([nothing, *(part.log_ns for part in found)]),
        np.concatenate([nothing, *(part.publish_ns for part in found)]),
        np.concatenate([np.empty(0, np.uint32), *(part.sequences for part in found)]),
        fields,
    )
