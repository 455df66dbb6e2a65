"""The chunk being filled: message records and their positions, written in place by compiled loops.

A message record consists of 31 bytes and the message: opcode, length, channel, sequence, log time, publish time.
Numbers of the format are little-endian and unaligned. The loops store them byte by byte at unsigned positions, which
the compiler combines into one store of eight bytes.
"""

import struct
from collections.abc import Iterable
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numba import njit
from numpy.typing import ArrayLike, NDArray

RECORD_HEAD_BYTES = 31
"""Bytes of a message record in front of its message."""
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = 15, 16  # of a message index record
_RECORD_HEAD = struct.Struct("<BQHIQQ")
_ENTRIES = 1024  # initial capacity, messages
_HEAD_ROOM = 64  # free bytes before the records, for the head of the chunk record


class OpenChunk:
    """Records of the next chunk.

    Attributes:
        size: size of the records so far, bytes.
        extremes: largest log time − publish time and publish time − log time of its messages, ns, uint64 (2,).

    Args:
        chunk_bytes: expected size; the buffer grows if necessary and shrinks again at `clear`.
    """

    def __init__(self, chunk_bytes: int) -> None:
        self._usual_bytes = chunk_bytes
        self._data = np.empty(0, np.uint8)
        self._channel_ids = np.empty(_ENTRIES, np.uint16)
        self._log_times, self._offsets = np.empty(_ENTRIES, np.uint64), np.empty(_ENTRIES, np.uint64)
        self.extremes: NDArray[np.uint64] = np.zeros(2, np.uint64)
        self._messages = 0
        self.clear()

    def clear(self) -> None:
        """Start the next chunk."""
        usual = _HEAD_ROOM + self._usual_bytes
        if not usual <= len(self._data) <= 2 * usual:
            self._data = np.empty(usual, np.uint8)
        self.size: int = 0
        self._messages = 0
        self.extremes[:] = 0

    @property
    def records(self) -> memoryview:
        """Records so far, valid until the next call."""
        return self._data.data[_HEAD_ROOM : _HEAD_ROOM + self.size]

    @property
    def index(self) -> tuple[NDArray[np.uint16], NDArray[np.uint64], NDArray[np.uint64]]:
        """Channel ids, log times and offsets of the n messages so far, each (n,), valid until the next call."""
        n = self._messages
        return self._channel_ids[:n], self._log_times[:n], self._offsets[:n]

    def framed(self, head: bytes, tail: bytes) -> memoryview:
        """Return the records with bytes before and after them, not copied; valid until the next call."""
        self._make_room(len(tail), 0)
        start, end = _HEAD_ROOM - len(head), _HEAD_ROOM + self.size
        self._data.data[start:_HEAD_ROOM] = head
        self._data.data[end : end + len(tail)] = tail
        return self._data.data[start : end + len(tail)]

    def append(self, record: bytes) -> None:
        """Add a record that is not a message."""
        self._make_room(len(record), 0)
        at = _HEAD_ROOM + self.size
        self._data.data[at : at + len(record)] = record
        self.size += len(record)

    def add_message(self, channel_id: int, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add one message; times 0 … 2**64 - 1 ns, sequence 0 … 2**32 - 1."""
        self._make_room(RECORD_HEAD_BYTES + len(data), 1)
        at, n = _HEAD_ROOM + self.size, self._messages
        _RECORD_HEAD.pack_into(
            self._data.data,
            at,
            Opcode.MESSAGE,
            RECORD_HEAD_BYTES - 9 + len(data),
            channel_id,
            sequence,
            log_time,
            publish_time,
        )
        self._data.data[at + RECORD_HEAD_BYTES : at + RECORD_HEAD_BYTES + len(data)] = data
        self._channel_ids[n], self._log_times[n], self._offsets[n] = channel_id, log_time, self.size
        late = log_time - publish_time
        side = 0 if late >= 0 else 1
        self.extremes[side] = max(int(self.extremes[side]), abs(late))
        self.size += RECORD_HEAD_BYTES + len(data)
        self._messages += 1

    def add_messages(self, channel_id: int, block: "MessageBlock", first: int, count: int) -> None:
        """Add messages `first` … `first + count - 1` of a block."""
        self._make_room(count * block.record_bytes, count)
        n = self._messages
        _put_messages(
            self._data,
            _HEAD_ROOM + self.size,
            block.record_bytes,
            channel_id,
            block.log_times,
            block.publish_times,
            block.sequences,
            block.messages,
            first,
            count,
            self.extremes,
        )
        _put_entries(
            self._channel_ids,
            self._log_times,
            self._offsets,
            n,
            channel_id,
            block.log_times,
            first,
            count,
            self.size,
            block.record_bytes,
        )
        self.size += count * block.record_bytes
        self._messages += count

    def _make_room(self, size: int, messages: int) -> None:
        used = _HEAD_ROOM + self.size
        if used + size > len(self._data):
            self._data = _grown(self._data, used, used + size)
        n = self._messages
        if n + messages > len(self._offsets):
            self._channel_ids, self._log_times, self._offsets = (
                _grown(array, n, n + messages) for array in (self._channel_ids, self._log_times, self._offsets)
            )


def _grown(array: NDArray[Any], used: int, wanted: int) -> NDArray[Any]:
    """Return the array with a capacity of at least `wanted`."""
    larger = np.empty(max(wanted, 2 * len(array)), array.dtype)
    larger[:used] = array[:used]
    return larger


class MessageBlock:
    """n messages of one size in the form that the compiled loops need.

    Args:
        messages: (n,) of any dtype whose items are whole messages.
        log_times, publish_times: one value or (n,), ns.
        sequences: one value or (n,), taken modulo 2**32.

    Raises:
        ValueError: another shape, values that are not integers, or times before 1970.
    """

    def __init__(
        self, messages: NDArray[Any], log_times: ArrayLike, publish_times: ArrayLike, sequences: ArrayLike
    ) -> None:
        if messages.ndim != 1:
            raise ValueError(f"expected messages of shape (n,), got {messages.shape}")
        self.count: int = len(messages)
        self.record_bytes: int = RECORD_HEAD_BYTES + messages.dtype.itemsize
        data = np.ascontiguousarray(messages)
        self.messages: NDArray[np.uint8] = _plain(data.view(np.uint8)) if data.nbytes else np.empty(0, np.uint8)
        self.log_times: NDArray[np.int64] = self._column("log times", log_times)
        self.publish_times: NDArray[np.int64] = self._column("publish times", publish_times)
        self.sequences: NDArray[np.int64] = self._column("sequences", sequences)
        least = _least(self.log_times, self.publish_times)
        if least < 0:
            raise ValueError(f"expected log and publish times in ns since 1970, got {least}")

    def _column(self, what: str, values: ArrayLike) -> NDArray[np.int64]:
        array = np.asarray(values)
        if array.dtype.kind not in "iu" or array.shape not in ((), (1,), (self.count,)):
            raise ValueError(
                f"expected {what} as one integer or {self.count}, got {array.dtype} of shape {array.shape}"
            )
        return _plain(np.ascontiguousarray(array, np.int64))


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array aligned and writable; other arrays would need another compilation of the loops."""
    return array if array.flags.behaved else array.copy()


def message_indexes(
    channel_ids: NDArray[np.uint16], log_times: NDArray[np.uint64], offsets: NDArray[np.uint64]
) -> tuple[bytes, dict[int, int], dict[int, int]]:
    """Return the message index records of a chunk, one per channel, entries in order of log time.

    Args:
        channel_ids, log_times, offsets: (n,), per message; the offset is the start of its record in the chunk.

    Returns:
        The concatenated records, the offset of each channel's record, and the number of messages per channel.
    """
    counts = np.bincount(channel_ids)
    present = np.flatnonzero(counts)
    sizes = _INDEX_HEAD_BYTES + _INDEX_ENTRY_BYTES * counts[present]
    out = np.empty(int(sizes.sum()), np.uint8)
    if not _put_indexes(out, channel_ids, log_times, offsets, counts):
        order = np.lexsort((log_times, channel_ids))
        _put_indexes(out, channel_ids[order], log_times[order], offsets[order], counts)
    ids: Iterable[int] = present.tolist()
    starts = (np.cumsum(sizes) - sizes).tolist()
    return out.tobytes(), dict(zip(ids, starts, strict=True)), dict(zip(ids, counts[present].tolist(), strict=True))


def compile_loops() -> None:
    """Compile everything now (or load it from numba's cache), so that no samples are delayed by it later."""
    chunk = OpenChunk(64)
    chunk.add_messages(1, MessageBlock(np.zeros(1, "V1"), 0, 0, 0), 0, 1)
    message_indexes(*chunk.index)


# compiled loops take more than 8 arguments: numba cannot pass an object of the interpreter
_U = np.uint64


@njit(nogil=True, inline="always")
def _put2(out: Any, at: Any, value: Any) -> None:  # pragma: no cover - compiled
    out[at] = np.uint8(value)
    out[at + _U(1)] = np.uint8(value >> _U(8))


@njit(nogil=True, inline="always")
def _put4(out: Any, at: Any, value: Any) -> None:  # pragma: no cover - compiled
    _put2(out, at, value)
    _put2(out, at + _U(2), value >> _U(16))


@njit(nogil=True, inline="always")
def _put8(out: Any, at: Any, value: Any) -> None:  # pragma: no cover - compiled
    _put4(out, at, value)
    _put4(out, at + _U(4), value >> _U(32))


@njit(cache=True, nogil=True)
def _least(log_times: Any, publish_times: Any) -> Any:  # pragma: no cover - compiled
    least = np.int64(0)
    for time in log_times:
        least = min(least, time)
    for time in publish_times:
        least = min(least, time)
    return least


@njit(cache=True, nogil=True)
def _put_messages(
    out: Any,
    start: int,
    record_bytes: int,
    channel_id: int,
    log_times: Any,
    publish_times: Any,
    sequences: Any,
    messages: Any,
    first: int,
    count: int,
    extremes: Any,
) -> None:  # pragma: no cover - compiled
    """Write `count` message records at out[start]; columns of length 1 apply to all."""
    log_step, publish_step, sequence_step = len(log_times) > 1, len(publish_times) > 1, len(sequences) > 1
    size = _U(record_bytes - RECORD_HEAD_BYTES)
    at, message_at = _U(start), _U(first) * size
    for i in range(first, first + count):
        log_time, publish_time = log_times[i * log_step], publish_times[i * publish_step]
        out[at] = np.uint8(5)
        _put8(out, at + _U(1), _U(record_bytes - 9))
        _put2(out, at + _U(9), _U(channel_id))
        _put4(out, at + _U(11), _U(sequences[i * sequence_step]))
        _put8(out, at + _U(15), _U(log_time))
        _put8(out, at + _U(23), _U(publish_time))
        for k in range(size):
            out[at + _U(RECORD_HEAD_BYTES) + k] = messages[message_at + k]
        if log_time >= publish_time:
            extremes[0] = max(extremes[0], _U(log_time - publish_time))
        else:
            extremes[1] = max(extremes[1], _U(publish_time - log_time))
        at += _U(record_bytes)
        message_at += size


@njit(cache=True, nogil=True)
def _put_entries(
    channel_ids: Any,
    log_times: Any,
    offsets: Any,
    at: int,
    channel_id: int,
    times: Any,
    first: int,
    count: int,
    offset: int,
    record_bytes: int,
) -> None:  # pragma: no cover - compiled
    """Store the positions of `count` records that begin at `offset`."""
    step = len(times) > 1
    for i in range(count):
        channel_ids[at + i] = channel_id
        log_times[at + i] = times[(first + i) * step]
        offsets[at + i] = offset + i * record_bytes


@njit(cache=True, nogil=True)
def _put_indexes(
    out: Any, channel_ids: Any, log_times: Any, offsets: Any, counts: Any
) -> bool:  # pragma: no cover - compiled
    """Write the message index records of all channels; False if the log times of a channel do not ascend."""
    places, latest = np.zeros(len(counts), np.uint64), np.zeros(len(counts), np.uint64)
    at = _U(0)
    for channel_id in range(len(counts)):
        if counts[channel_id]:
            size = _U(counts[channel_id]) * _U(_INDEX_ENTRY_BYTES)
            out[at] = np.uint8(7)
            _put8(out, at + _U(1), size + _U(6))
            _put2(out, at + _U(9), _U(channel_id))
            _put4(out, at + _U(11), size)
            places[channel_id] = at + _U(_INDEX_HEAD_BYTES)
            at += size + _U(_INDEX_HEAD_BYTES)
    ascending = True
    for i in range(len(channel_ids)):
        channel_id = channel_ids[i]
        place = places[channel_id]
        _put8(out, place, log_times[i])
        _put8(out, place + _U(8), offsets[i])
        places[channel_id] = place + _U(_INDEX_ENTRY_BYTES)
        ascending &= log_times[i] >= latest[channel_id]
        latest[channel_id] = log_times[i]
    return ascending
