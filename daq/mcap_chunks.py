"""A chunk of an MCAP file: unpacked within bounds, its CRC checked, split into records."""

import zlib
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from daq.errors import LogError
from daq.mcap_writer import RECORD_HEAD_BYTES

CHUNK_LIMIT_BYTES = 256 * 2**20
"""Largest chunk that is unpacked; a header that says more is taken as damage."""
HEAD = np.dtype([("channel_id", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")])
"""What the content of a message record begins with; the message itself follows."""


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk's packed records stand in the file, bytes.

    Attributes:
        start: offset of the packed data.
        packed: their length; `unpacked` after decompression.
        compression: ``""``, ``"zstd"``, or one that is not supported.
        crc: of the unpacked records, 0 when the writer gave none.
    """

    start: int
    packed: int
    unpacked: int
    compression: str
    crc: int


@dataclass(frozen=True)
class Scan:
    """Records of an unpacked chunk: opcodes, offsets of their content, content lengths, each of shape (n,)."""

    data: NDArray[np.uint8]
    opcodes: NDArray[np.uint8]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def heads(self, rows: NDArray[np.intp]) -> NDArray[Any]:
        """Ids and times of message records: structured (n,) of `HEAD`."""
        return gather(self, rows, HEAD.itemsize).view(HEAD)[:, 0]

    def channel_ids(self) -> NDArray[np.int64]:
        """Channel of each record, -1 for those that are no message."""
        message = self.opcodes == Opcode.MESSAGE
        at = np.where(message, self.offsets, 0)
        return np.where(message, self.data[at] | self.data[at + 1].astype(np.int64) << 8, -1)


@numba.njit(cache=True)
def _scan(data: Any, opcodes: Any, offsets: Any, lengths: Any) -> int:  # pragma: no cover - compiled
    """Split `data` into records, at most as many as the arrays hold; returns their number, -1 when they do not fit."""
    position = 0
    count = 0
    size = len(data)
    while position < size:
        if size - position < 9:
            return -1
        length = np.uint64(0)
        for k in range(8):
            length |= np.uint64(data[position + 1 + k]) << np.uint64(8 * k)
        if length > np.uint64(size - position - 9):
            return -1
        if data[position] == 5 and length < np.uint64(22):
            return -1
        if count < len(opcodes):
            opcodes[count] = data[position]
            offsets[count] = position + 9
            lengths[count] = np.int64(length)
        count += 1
        position += 9 + np.int64(length)
    return count


@numba.njit(cache=True)
def _gather(data: Any, offsets: Any, out: Any) -> None:  # pragma: no cover - compiled
    """Copy out.shape[1] bytes from each offset."""
    for row in range(len(offsets)):
        start = offsets[row]
        for k in range(out.shape[1]):
            out[row, k] = data[start + k]


def gather(scan: Scan, rows: NDArray[np.intp], size: int) -> NDArray[np.uint8]:
    """Contents of the records `rows`, which all are `size` bytes long, as uint8 (n, size)."""
    out = np.empty((len(rows), size), np.uint8)
    _gather(scan.data, scan.offsets[rows], out)
    return out


def scan_records(data: bytes) -> Scan:
    """Find the records in an unpacked chunk.

    Raises:
        LogError: the records do not fill it exactly.
    """
    view = np.frombuffer(data, np.uint8)
    guess = len(view) // (9 + RECORD_HEAD_BYTES) + 64
    while True:
        opcodes, offsets, lengths = np.empty(guess, np.uint8), np.empty(guess, np.int64), np.empty(guess, np.int64)
        count = _scan(view, opcodes, offsets, lengths)
        if count < 0:
            raise LogError(f"expected records that fill a chunk of {len(view)} bytes, they run over its end")
        if count <= guess:
            return Scan(view, opcodes[:count], offsets[:count], lengths[:count])
        guess = count


def unpack_chunk(file: Any, place: ChunkPlace) -> bytes:
    """Decompressed and checked records of a chunk.

    Args:
        file: the whole file, anything that slices to bytes.
        place: from `Contents.chunks`.

    Raises:
        LogError: unknown compression, a size other than announced, or a wrong CRC.
    """
    if place.unpacked > CHUNK_LIMIT_BYTES:
        raise LogError(f"expected a chunk of at most {CHUNK_LIMIT_BYTES} bytes, its header says {place.unpacked}")
    packed = bytes(file[place.start : place.start + place.packed])
    if place.compression == "":
        data = packed
    elif place.compression == "zstd":
        data = _unpack_zstd(packed, place.unpacked)
    else:
        raise LogError(f"expected zstd or no compression, got {place.compression!r}: convert the file with 'mcap'")
    if len(data) != place.unpacked:
        raise LogError(f"expected {place.unpacked} bytes in a chunk, got {len(data)}")
    if place.crc and zlib.crc32(data) != place.crc:
        raise LogError(f"expected CRC {place.crc:#010x} of a chunk, its bytes give {zlib.crc32(data):#010x}")
    return data


def _unpack_zstd(packed: bytes, unpacked: int) -> bytes:
    try:
        announced = zstandard.frame_content_size(packed)  # -1 when the frame does not say
        if announced not in (-1, unpacked):
            raise LogError(f"expected {unpacked} bytes in a chunk, its zstd frame announces {announced}")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=max(unpacked, 1))
    except zstandard.ZstdError as fault:
        raise LogError(f"expected a zstd frame in a chunk, got damaged data ({fault})") from fault


def payload(scan: Scan, row: int) -> bytes:
    """The message in record `row`."""
    start, end = scan.offsets[row] + HEAD.itemsize, scan.offsets[row] + scan.lengths[row]
    return scan.data[start:end].tobytes()
