"""The open file of a log: chunks are read from the disk when they are needed, and checked at every read.

A damaged chunk is excluded from then on and listed in `missing`. If a chunk does not match the file's index, the index
is discarded and the whole file is walked.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.errors import LogError
from daq.mcap.chunks import BARE, HEAD_BYTES, ChunkHead, parse_head, unpack
from daq.mcap.contents import Contents
from daq.mcap.damage import topics_of
from daq.mcap.file_bytes import PIECE_BYTES, FileBytes
from daq.mcap.missing import Missing
from daq.mcap.reader import survey, walk
from daq.mcap.records import DamageError, read_attachment
from daq.mcap.scan import spans

_CACHE_BYTES = 64 * 2**20
_THREADS = min(4, os.cpu_count() or 1)
_MIN_PARALLEL_BYTES = 2**20  # reading less takes less time than starting a thread
T = TypeVar("T")


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
        self._kept: dict[int, NDArray[np.uint8]] = {}  # unpacked chunks by their offset
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

    def for_each(self, chunks: NDArray[np.intp], task: Callable[[int, NDArray[np.uint8]], T]) -> list[tuple[int, T]]:
        """Apply a function to the records of each chunk, in several threads if the chunks are large.

        Args:
            chunks: numbers in the table, ascending.
            task: called with the chunk's number and its records, uint8.

        Returns:
            Number and result of every chunk that is not damaged, in file order.

        Raises:
            IndexWrongError: a chunk does not match the index.
        """
        groups, keep = self._groups(chunks), self._may_keep(chunks)

        def run(group: NDArray[np.intp]) -> list[tuple[int, T]]:
            return [(chunk, task(chunk, data)) for chunk, data in self._read(group, keep)]

        if len(groups) < 2 or self.contents.table.packed[chunks].sum() < _MIN_PARALLEL_BYTES:
            return [result for group in groups for result in run(group)]
        with ThreadPoolExecutor(_THREADS) as pool:
            return [result for results in pool.map(run, groups) for result in results]

    def each(self, chunks: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Yield number and records of each chunk that is not damaged, in file order; a few chunks are read at a time.

        Raises:
            IndexWrongError: a chunk does not match the index.
        """
        keep = self._may_keep(chunks)
        for group in self._groups(chunks):
            yield from self._read(group, keep)

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
        cuts = np.flatnonzero(is_far | in_next_piece) + 1
        return np.split(chunks, cuts)

    def _read(self, group: NDArray[np.intp], keep: bool) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        table = self.contents.table
        first, last = int(group[0]), int(group[-1])
        begin, end = int(table.start[first]), int(table.start[last] + table.length[last])
        block: memoryview | None = None
        for chunk in group.tolist():
            start = int(table.start[chunk])
            data = self._kept.get(start)
            if data is None and start not in self._lost:
                if block is None:
                    block = self._block(begin, end)
                data = self._unpack(chunk, block[start - begin : start - begin + int(table.length[chunk])])
                if keep and data is not None:
                    self._keep(start, data)
            if data is not None:
                yield chunk, data

    def _block(self, begin: int, end: int) -> memoryview:
        """Return bytes of the file; fewer if the disk fails or the file was cut meanwhile."""
        if self.file.closed:
            raise LogError(f"{self.file.path}: expected an open log, it was closed: read what you need before close()")
        try:
            return memoryview(self.file.read(begin, end - begin))
        except LogError:  # usual: the chunks are read one by one, and those that cannot be read are listed
            return memoryview(b"")

    def _unpack(self, chunk: int, record: memoryview) -> NDArray[np.uint8] | None:
        """Return the checked records of a chunk; None if it is damaged, which is noted in `missing`."""
        table = self.contents.table
        start, length = int(table.start[chunk]), int(table.length[chunk])
        try:
            if len(record) != length:
                record = memoryview(self.file.read(start, length))
            data = np.frombuffer(self._checked(chunk, record), np.uint8)
            if table.crc is None and not spans(data, table.start_ns[chunk], table.end_ns[chunk]):
                raise IndexWrongError("a chunk with messages at other times than the index lists")
        except (DamageError, LogError) as damage:
            if self.file.closed:
                raise
            self._lose(chunk, str(damage))
            return None
        return data

    def _keep(self, start: int, data: NDArray[np.uint8]) -> None:
        """Keep an unpacked chunk, and drop the oldest ones beyond the limit."""
        with self._lock:
            self._kept[start] = data
            self._kept_bytes += len(data)
            while self._kept_bytes > _CACHE_BYTES:
                self._kept_bytes -= len(self._kept.pop(next(iter(self._kept))))

    def _checked(self, chunk: int, record: memoryview) -> bytes | memoryview:
        table, ours = self.contents.table, self.contents.header.ours
        unpacked = int(table.unpacked[chunk])
        if table.kind[chunk] == BARE:
            assert table.crc is not None
            return unpack(record, ChunkHead(0, 0, unpacked, int(table.crc[chunk]), 0, "", 0, unpacked), True)
        try:
            head = parse_head(record[:HEAD_BYTES], int(table.length[chunk]))
            times = int(table.start_ns[chunk]), int(table.end_ns[chunk])
            if (head.unpacked, head.kind, head.packed) != (
                unpacked,
                int(table.kind[chunk]),
                int(table.packed[chunk]),
            ) or (table.crc is None and times != (head.start_ns, head.end_ns)):
                raise DamageError("a chunk that does not match the index")
        except DamageError as damage:
            if table.crc is None:
                raise IndexWrongError(str(damage)) from damage
            raise  # `walk` found the chunk intact: the file was changed since
        if table.crc is not None:
            head = replace(head, crc=int(table.crc[chunk]))
        return unpack(record[head.data_at :], head, ours)

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
