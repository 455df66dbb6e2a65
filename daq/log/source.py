"""The open file of a log: chunks are read from the disk when they are needed, and checked at every read.

A damaged chunk is excluded from then on and listed in `missing`. If a chunk does not match the file's index, the index
is discarded and the whole file is walked.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.errors import LogError
from daq.mcap.chunks import HEAD_BYTES, ChunkHead, parse_head, unpack
from daq.mcap.contents import Contents
from daq.mcap.damage import topics_of
from daq.mcap.file_bytes import PIECE_BYTES, FileBytes
from daq.mcap.missing import Missing
from daq.mcap.reader import survey, walk
from daq.mcap.records import DamageError, read_attachment

_CACHE_BYTES = 64 * 2**20
_GROUPS_AHEAD = 2
_GROUP_BYTES = 16 * 2**20  # of chunks that are unpacked together


class IndexWrongError(Exception):
    """A chunk does not match the file's index."""


class LogSource:
    """An open log file.

    Args:
        path: path of the file.
        check: called with the completed share while the whole file is read. None: an intact index is sufficient.

    Raises:
        OSError: the file cannot be opened.
        LogError: the file is not an MCAP file.
    """

    def __init__(self, path: Path, check: Callable[[float], None] | None = None) -> None:
        self.file: FileBytes = FileBytes(path)
        try:
            self.contents: Contents = walk(self.file, check) if check else survey(self.file)
        except BaseException:
            self.file.close()
            raise
        self.missing: list[Missing] = list(self.contents.missing)
        self._lost: set[int] = set()  # offsets of damaged chunks
        self._kept: dict[int, bytes] = {}  # unpacked chunks by their offset
        self._kept_bytes = 0
        self._lock = threading.Lock()

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attachments by name, read and checked at the first access."""
        found: dict[str, bytes] = {}
        for place in self.contents.attachments:
            try:
                found[place.name] = read_attachment(self.file, place, self.contents.header.ours).data
            except DamageError as damage:
                text = f"{damage}: attachment {place.name[:80]!r} was left out"
                self.missing.append(Missing(text, place.start, place.start + place.length, messages=0))
        return found

    def walk(self, progress: Callable[[float], None] | None = None) -> None:
        """Read the whole file and replace the index by what is found."""
        self.contents = walk(self.file, progress)
        with self._lock:
            self.missing[:] = self.contents.missing
            self._lost.clear()
            self._kept.clear()
            self._kept_bytes = 0
        self.__dict__.pop("attachments", None)

    def close(self) -> None:
        """Close the file."""
        self._kept.clear()
        self.file.close()

    def each(self, chunks: NDArray[np.intp]) -> Iterator[tuple[int, bytes, memoryview]]:
        """Yield each chunk that is not damaged, in file order; a few chunks are read at a time.

        Args:
            chunks: numbers in the table, ascending.

        Yields:
            The chunk's number, its records, and the bytes of the file after it, which begin with its message indexes.

        Raises:
            IndexWrongError: a chunk does not match the index.
        """
        keep, groups = self._may_keep(chunks), self._groups(chunks)
        most = int(self.contents.table.unpacked[chunks].max(initial=0))
        if len(groups) < 2 or most > PIECE_BYTES:  # starting a thread takes longer; large chunks are read one by one
            for group in groups:
                yield from self._read(group, keep)
            return
        ahead: deque[Future[list[tuple[int, bytes, memoryview]]]] = deque()
        with ThreadPoolExecutor(1) as pool:  # reading, decompression and CRC run in parallel
            for group in groups:
                ahead.append(pool.submit(self._read_all, group, keep))
                if len(ahead) > _GROUPS_AHEAD:
                    yield from ahead.popleft().result()
            while ahead:
                yield from ahead.popleft().result()

    def _may_keep(self, chunks: NDArray[np.intp]) -> bool:
        """Return True if the unpacked chunks are few enough to be kept for the next channel."""
        return bool(self.contents.table.unpacked[chunks].sum() <= _CACHE_BYTES)

    def _groups(self, chunks: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        """Group the chunks that are close enough in the file to be read together."""
        table = self.contents.table
        if not len(chunks):
            return []
        starts, ends = table.start[chunks], table.start[chunks] + table.length[chunks]
        is_far = starts[1:] - ends[:-1] > PIECE_BYTES // 8
        in_next_piece = starts[1:] // PIECE_BYTES != starts[:-1] // PIECE_BYTES
        unpacked = np.cumsum(table.unpacked[chunks]) // _GROUP_BYTES
        cuts = np.flatnonzero(is_far | in_next_piece | (unpacked[1:] != unpacked[:-1])) + 1
        return np.split(chunks, cuts)

    def _read(self, group: NDArray[np.intp], keep: bool) -> Iterator[tuple[int, bytes, memoryview]]:
        table = self.contents.table
        begin, end = int(table.start[group[0]]), table.end_of_indexes(int(group[-1]), self.file.size)
        block: memoryview | None = None
        for chunk in group.tolist():
            start, length = int(table.start[chunk]), int(table.length[chunk])
            data = self._kept.get(start)
            if block is None:
                block = self._block(begin, end)
            if data is None and start not in self._lost:
                data = self._unpack(chunk, block[start - begin : start - begin + length])
                if keep and data is not None:
                    self._keep(start, data)
            if data is not None:
                yield chunk, data, block[start - begin + length :]

    def _read_all(self, group: NDArray[np.intp], keep: bool) -> list[tuple[int, bytes, memoryview]]:
        return list(self._read(group, keep))

    def _block(self, begin: int, end: int) -> memoryview:
        """Return bytes of the file; fewer if the disk fails or the file was cut meanwhile."""
        if self.file.closed:
            raise LogError(f"{self.file.path}: expected an open log, it was closed: read what you need before close()")
        try:
            return memoryview(self.file.read(begin, end - begin))
        except LogError:  # usual: the chunks are read one by one, and those that cannot be read are listed
            return memoryview(b"")

    def _unpack(self, chunk: int, record: memoryview) -> bytes | None:
        """Return the checked records of a chunk; None if it is damaged, which is noted in `missing`."""
        table = self.contents.table
        start, length = int(table.start[chunk]), int(table.length[chunk])
        try:
            if len(record) != length:
                record = memoryview(self.file.read(start, length))
            return self._checked(chunk, record)
        except (DamageError, LogError) as damage:
            if self.file.closed:
                raise
            self._lose(chunk, str(damage))
            return None

    def _keep(self, start: int, data: bytes) -> None:
        """Keep an unpacked chunk, and drop the oldest ones beyond the limit."""
        with self._lock:
            self._kept[start] = data
            self._kept_bytes += len(data)
            while self._kept_bytes > _CACHE_BYTES:
                self._kept_bytes -= len(self._kept.pop(next(iter(self._kept))))

    def _checked(self, chunk: int, record: memoryview) -> bytes:
        table, ours = self.contents.table, self.contents.header.ours
        unpacked = int(table.unpacked[chunk])
        if table.crc is None:
            try:
                head = parse_head(record[:HEAD_BYTES], int(table.length[chunk]))
                if (head.unpacked, head.start_ns, head.end_ns) != (
                    unpacked,
                    int(table.start_ns[chunk]),
                    int(table.end_ns[chunk]),
                ):
                    raise DamageError("a chunk that does not match the index")
            except DamageError as damage:
                raise IndexWrongError(str(damage)) from damage
        elif table.bare[chunk]:
            head = ChunkHead(0, 0, unpacked, int(table.crc[chunk]), "", 0, unpacked)
        else:  # `walk` found the chunk intact: another head means that the file was changed since
            head = replace(parse_head(record[:HEAD_BYTES], int(table.length[chunk])), crc=int(table.crc[chunk]))
            if head.unpacked != unpacked:
                raise DamageError("a chunk that does not match the index")
        return unpack(record[head.data_at : head.data_at + head.packed], head, ours)

    def _lose(self, chunk: int, why: str) -> None:
        """Exclude a chunk from now on, and list in `missing` what it contained."""
        table = self.contents.table
        start, end = int(table.start[chunk]), int(table.start[chunk] + table.length[chunk])
        with self._lock:
            if start in self._lost:
                return
            self._lost.add(start)
            counts = dict(table.entries(chunk))
            self.missing.append(
                Missing(
                    f"{why}, left out",
                    start,
                    end,
                    int(table.start_ns[chunk]),
                    int(table.end_ns[chunk]),
                    topics_of(counts, self.contents.definitions),
                    sum(counts.values()),
                )
            )
            for channel, count in counts.items():
                self.contents.counts[channel] -= count
