"""Compiled passes over the bytes of an MCAP file: message records, message indexes, chunk indexes.

Every length is compared with the available bytes before it is used. The functions release the interpreter lock, so
threads scan several chunks at once. Some take more than 8 arguments: numba cannot pass an object of the interpreter.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

BROKEN, OTHER_LAYOUT, OTHER_COUNT = -1, -2, -3
"""Results instead of a number: incomplete records; a message of another layout; another number than announced."""
MESSAGE_HEAD_BYTES = 22  # channel id, sequence, log time, publish time
_RECORD_HEAD = 9
_ZSTD = np.uint32(int.from_bytes(b"zstd", "little"))
_MAX_BYTES = np.int64(2**60)  # sums of a few such sizes do not overflow
_FAR = np.uint64(2**64 - 1)


@njit(cache=True, nogil=True)
def _eight(data: Any, at: Any) -> Any:  # pragma: no cover - compiled
    """Little-endian number of 8 bytes; written out with unsigned positions, so that it is compiled to one load."""
    i = np.uint64(at)
    return (
        np.uint64(data[i])
        | np.uint64(data[i + np.uint64(1)]) << np.uint64(8)
        | np.uint64(data[i + np.uint64(2)]) << np.uint64(16)
        | np.uint64(data[i + np.uint64(3)]) << np.uint64(24)
        | np.uint64(data[i + np.uint64(4)]) << np.uint64(32)
        | np.uint64(data[i + np.uint64(5)]) << np.uint64(40)
        | np.uint64(data[i + np.uint64(6)]) << np.uint64(48)
        | np.uint64(data[i + np.uint64(7)]) << np.uint64(56)
    )


@njit(cache=True, nogil=True)
def _four(data: Any, at: Any) -> Any:  # pragma: no cover - compiled
    i = np.uint64(at)
    return (
        np.uint32(data[i])
        | np.uint32(data[i + np.uint64(1)]) << np.uint32(8)
        | np.uint32(data[i + np.uint64(2)]) << np.uint32(16)
        | np.uint32(data[i + np.uint64(3)]) << np.uint32(24)
    )


@njit(cache=True, nogil=True)
def _two(data: Any, at: Any) -> Any:  # pragma: no cover - compiled
    i = np.uint64(at)
    return np.int64(data[i]) | np.int64(data[i + np.uint64(1)]) << 8


@njit(cache=True, nogil=True)
def _record_end(data: Any, position: Any) -> Any:  # pragma: no cover - compiled
    """End of the record at `position` of a chunk, -1 if it is not a record that a chunk may contain."""
    size = len(data)
    if size - position < _RECORD_HEAD:
        return -1
    length = _eight(data, position + 1)
    if data[position] == 0 or length > np.uint64(size - position - _RECORD_HEAD):
        return -1
    if data[position] == 5 and length < np.uint64(MESSAGE_HEAD_BYTES):
        return -1
    return position + _RECORD_HEAD + np.int64(length)


@njit(cache=True, nogil=True)
def tally(
    data: NDArray[np.uint8], counts: NDArray[np.int64], touched: NDArray[np.int64], times: NDArray[np.uint64]
) -> tuple[int, int]:  # pragma: no cover - compiled
    """Count an unpacked chunk's messages.

    Args:
        data: records of the chunk, uint8 (size,).
        counts: int64 (65536,) of zeros, receives the number of messages by channel id.
        touched: int64 (65536,), receives the ids with messages, in order of occurrence.
        times: uint64 (4,), receives first and last log time, first and last publish time.

    Returns:
        Number of ids, -1 if the chunk does not consist of whole records; number of records other than messages.
    """
    times[0] = times[2] = _FAR
    times[1] = times[3] = 0
    found = others = 0
    position = 0
    while position < len(data):
        end = _record_end(data, position)
        if end < 0:
            return -1, others
        if data[position] == 5:
            channel = _two(data, position + 9)
            if counts[channel] == 0:
                touched[found] = channel
                found += 1
            counts[channel] += 1
            log_time = _eight(data, position + 15)
            publish_time = _eight(data, position + 23)
            times[0] = min(times[0], log_time)
            times[1] = max(times[1], log_time)
            times[2] = min(times[2], publish_time)
            times[3] = max(times[3], publish_time)
        else:
            others += 1
        position = end
    return found, others


@njit(cache=True, nogil=True)
def spans(data: NDArray[np.uint8], first: np.int64, last: np.int64) -> bool:  # pragma: no cover - compiled
    """Return True if the log times of an unpacked chunk span `first` to `last`, ns; true without messages."""
    earliest, latest = _FAR, np.uint64(0)
    position = 0
    while position < len(data):
        end = _record_end(data, position)
        if end < 0:
            return False
        if data[position] == 5:
            log_time = _eight(data, position + 15)
            earliest, latest = min(earliest, log_time), max(latest, log_time)
        position = end
    return bool(earliest > latest or (earliest == np.uint64(first) and latest == np.uint64(last)))


@njit(cache=True, nogil=True)
def loose_messages(block: NDArray[np.uint8]) -> int:  # pragma: no cover - compiled
    """End of the whole message records at the start of `block`, which are outside of any chunk."""
    position = 0
    while position < len(block) and block[position] == 5:
        end = _record_end(block, position)
        if end < 0:
            break
        position = end
    return position


@njit(cache=True, nogil=True)
def definitions(data: NDArray[np.uint8], places: NDArray[np.int64]) -> int:  # pragma: no cover - compiled
    """Store offset and end of a chunk's schemas and channels in `places`, int64 (n, 2); return their number."""
    found = 0
    position = 0
    while position < len(data):
        end = _record_end(data, position)
        if end < 0:
            return BROKEN
        if data[position] == 3 or data[position] == 4:
            if found < len(places):
                places[found, 0] = position
                places[found, 1] = end
            found += 1
        position = end
    return found


@njit(cache=True, nogil=True)
def locate(
    data: NDArray[np.uint8],
    wanted: NDArray[np.int64],
    places: NDArray[np.int64],
    log_times: NDArray[np.int64],
    publish_times: NDArray[np.int64],
) -> int:  # pragma: no cover - compiled
    """Find messages.

    Args:
        data: records of an unpacked chunk, uint8 (size,).
        wanted: channel ids, int64 (k,); empty selects every message.
        places: int64 (n, 3), receives offset of the record, its end, channel id.
        log_times, publish_times: int64 (n,).

    Returns:
        Number of messages, BROKEN, or OTHER_COUNT if the number is not n.
    """
    found = 0
    position = 0
    while position < len(data):
        end = _record_end(data, position)
        if end < 0:
            return BROKEN
        if data[position] == 5:
            channel = _two(data, position + 9)
            take = len(wanted) == 0
            for k in range(len(wanted)):
                take |= wanted[k] == channel
            if take:
                if found == len(places):
                    return OTHER_COUNT
                places[found, 0] = position
                places[found, 1] = end
                places[found, 2] = channel
                log_times[found] = np.int64(_eight(data, position + 15))
                publish_times[found] = np.int64(_eight(data, position + 23))
                found += 1
        position = end
    return found if found == len(places) else OTHER_COUNT


@njit(cache=True, nogil=True)
def collect(
    data: NDArray[np.uint8],
    wanted: NDArray[np.int64],
    message_bytes: int,
    fields: NDArray[np.int64],
    heads: NDArray[np.int64],
    sequence: NDArray[np.uint32],
    wide: NDArray[np.uint64],
    narrow: NDArray[np.uint32],
    row: int,
    room: int,
) -> int:  # pragma: no cover
    """Copy messages of constant layout into columns.

    Args:
        data: records of an unpacked chunk, uint8 (size,).
        wanted: channel ids, int64 (k,).
        message_bytes: size of a message.
        fields: int64 (f, 3): offset of the field's value, which follows its tag byte, the tag, column number; 8-byte
            columns count from 0, 4-byte columns from -1 downwards.
        heads: int64 (2, n): log and publish times. sequence: uint32 (n,).
        wide: uint64 (a, n), narrow: uint32 (b, n): columns of 8 and of 4 bytes.
        row, room: row of the first message, and required number of messages.

    Returns:
        Number of messages, BROKEN, OTHER_LAYOUT or OTHER_COUNT.
    """
    last = row + room
    position = 0
    while position < len(data):
        end = _record_end(data, position)
        if end < 0:
            return BROKEN
        if data[position] == 5:
            channel = _two(data, position + 9)
            take = False
            for k in range(len(wanted)):
                take |= wanted[k] == channel
            if take:
                if row == last:
                    return OTHER_COUNT
                start = position + _RECORD_HEAD + MESSAGE_HEAD_BYTES
                if end - start != message_bytes:
                    return OTHER_LAYOUT
                sequence[row] = _four(data, position + 11)
                heads[0, row] = np.int64(_eight(data, position + 15))
                heads[1, row] = np.int64(_eight(data, position + 23))
                for f in range(len(fields)):
                    at = start + fields[f, 0]
                    if np.int64(data[at - 1]) != fields[f, 1]:
                        return OTHER_LAYOUT
                    column = fields[f, 2]
                    if column >= 0:
                        wide[column, row] = _eight(data, at)
                    else:
                        narrow[-1 - column, row] = _four(data, at)
                row += 1
        position = end
    return room if row == last else OTHER_COUNT


@njit(cache=True, nogil=True)
def message_indexes(
    block: NDArray[np.uint8], data: NDArray[np.uint8], entries: NDArray[np.int64], times: NDArray[np.uint64]
) -> tuple[int, int, int]:  # pragma: no cover - compiled
    """Parse the message index records that follow a chunk, and compare them with the chunk.

    Args:
        block: bytes after the chunk, uint8 (size,).
        data: records of the chunk, uint8; empty if they are not available.
        entries: int64 (n, 2), receives channel id and number of messages per record.
        times: uint64 (2,), receives first and last log time.

    Returns:
        End of the last whole index in `block`, number of records, offset of the first wrong one or -1.
    """
    position = found = 0
    wrong = -1
    while len(block) - position >= _RECORD_HEAD + 6 and block[position] == 7 and found < len(entries):
        length = _eight(block, position + 1)
        if length > np.uint64(len(block) - position - _RECORD_HEAD):
            break
        channel = _two(block, position + 9)
        size = np.uint64(_four(block, position + 11))
        if size != length - np.uint64(6) or size % np.uint64(16) != 0:
            break
        count = np.int64(size) // 16
        entries[found, 0] = channel
        entries[found, 1] = count
        for k in range(count):
            at = position + 15 + 16 * k
            log_time = _eight(block, at)
            times[0] = min(times[0], log_time)
            times[1] = max(times[1], log_time)
            offset = _eight(block, at + 8)
            if len(data) and wrong < 0:
                if offset > np.uint64(len(data) - min(len(data), _RECORD_HEAD + MESSAGE_HEAD_BYTES)):
                    wrong = position
                else:
                    o = np.int64(offset)
                    if data[o] != 5 or _two(data, o + 9) != channel or _eight(data, o + 15) != log_time:
                        wrong = position
        found += 1
        position += _RECORD_HEAD + np.int64(length)
    return int(position), found, int(wrong)


@njit(cache=True, nogil=True, forceinline=True)  # a call counts references to its arrays, a fifth of the time
def _index_entries(
    block: Any,
    at: Any,
    n: Any,
    chunk_end: Any,
    following: Any,
    room: Any,
    channels: Any,
    counts: Any,
    entry: Any,
    totals: Any,
) -> Any:  # pragma: no cover
    """Store the n entries of a chunk index, from the last to the first: each message index ends where the next begins.

    Returns:
        True if they are contiguous from `chunk_end` on and list no more messages than the chunk can contain.
    """
    sound = True
    for k in range(n - 1, -1, -1):
        offset = np.int64(_eight(block, at + 10 * k + 2))
        size = following - offset - 15
        messages = size >> 4
        room -= messages
        sound &= (offset >= chunk_end) & (size >= 0) & ((size & 15) == 0) & (room >= 0)
        if not sound:
            break
        channel = np.uint64(_two(block, at + 10 * k))
        channels[np.uint64(entry + k)] = channel
        counts[np.uint64(entry + k)] = messages
        totals[channel] += messages
        following = offset
    return sound


@njit(cache=True, nogil=True)
def chunk_indexes(
    block: NDArray[np.uint8],
    numbers: NDArray[np.int64],
    kinds: NDArray[np.uint8],
    first_entry: NDArray[np.int64],
    channels: NDArray[np.uint16],
    counts: NDArray[np.uint32],
    totals: NDArray[np.int64],
    state: NDArray[np.int64],
) -> int:  # pragma: no cover - compiled
    """Store the chunk index records at the start of `block` in arrays.

    Args:
        block: bytes of the summary, uint8 (size,).
        numbers: int64 (6, n): record start, record length, packed and unpacked bytes, first and last log time.
        kinds: uint8 (n,): 0 not compressed, 1 zstd, 2 anything else.
        first_entry: int64 (n + 1,): index of each chunk's first entry in `channels` (uint16) and `counts` (uint32).
        totals: int64 (65536,): the numbers of messages by channel id are added to it.
        state: int64 (3,), updated: chunks and entries so far, and the end of the last chunk's indexes in the file.
            Chunks must be in order and must not overlap.

    Returns:
        Number of bytes processed, or BROKEN. The rest begins with another or an incomplete record.
    """
    position = 0
    while len(block) - position >= _RECORD_HEAD and block[position] == 8:
        length = _eight(block, position + 1)
        if length > np.uint64(len(block) - position - _RECORD_HEAD):
            break
        at = position + _RECORD_HEAD
        end = at + np.int64(length)
        chunk, entry = state[0], state[1]
        if length < np.uint64(64) or chunk == len(kinds):
            return BROKEN
        map_bytes = np.int64(_four(block, at + 32))
        name_at = at + 36 + map_bytes + 8
        n = map_bytes // 10
        if map_bytes % 10 or name_at + 4 > end or entry + n > len(channels):
            return BROKEN
        name_bytes = np.int64(_four(block, name_at))
        behind = np.int64(_eight(block, name_at - 8))
        start, size = np.int64(_eight(block, at + 16)), np.int64(_eight(block, at + 24))
        packed, unpacked = np.int64(_eight(block, end - 16)), np.int64(_eight(block, end - 8))
        first, last = np.int64(_eight(block, at)), np.int64(_eight(block, at + 8))
        if name_at + 4 + name_bytes + 16 != end or start < state[2] or min(size, packed, unpacked, first, last) < 0:
            return BROKEN
        if behind < 0 or max(start, size, packed, unpacked, behind) >= _MAX_BYTES:
            return BROKEN
        following, room = start + size + behind, unpacked // (_RECORD_HEAD + MESSAGE_HEAD_BYTES)
        if not _index_entries(block, at + 36, n, start + size, following, room, channels, counts, entry, totals):
            return BROKEN
        numbers[0, chunk], numbers[1, chunk], numbers[2, chunk] = start, size, packed
        numbers[3, chunk], numbers[4, chunk], numbers[5, chunk] = unpacked, first, last
        is_zstd = name_bytes == 4 and _four(block, name_at + 4) == _ZSTD
        kinds[chunk] = 0 if name_bytes == 0 else (1 if is_zstd else 2)
        state[0], state[1], state[2] = chunk + 1, entry + n, following
        first_entry[chunk + 1] = entry + n
        position = end
    return int(position)
