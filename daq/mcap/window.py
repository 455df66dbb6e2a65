"""Sequential access to a file: a window that reads ahead, and the search for the next intact record."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable

import numpy as np
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import NDArray

from daq.errors import LogError
from daq.mcap.chunks import EVER_NS, HEAD_BYTES, parse_head
from daq.mcap.file_bytes import PIECE_BYTES, FileBytes
from daq.mcap.records import RECORD_HEAD, DamageError, check_attachment, check_metadata, parse, read_record
from daq.mcap.scan import Messages
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

_CREDIBLE = re.compile(
    rb"\x06(?=.{36}(?:\x04\0\0\0zstd|\0\0\0\0|\x03\0\0\0lz4))|[\x07\x09\x0c](?=.{4}\0{4})|\x0f(?=\x04\0{7})", re.DOTALL
)
_LOOK_AHEAD = 64
_METADATA_BYTES = 2**20
_TEXT_KINDS = frozenset((Opcode.METADATA, Opcode.ATTACHMENT))
_SUMMARY_KINDS = frozenset((2, 3, 4, 8, 10, 11, 13, 14))


class Window:
    """Bytes of a file, read ahead.

    Args:
        file: the open file.
        ours: True if written by this package; affects which records are intact.
    """

    def __init__(self, file: FileBytes, ours: bool) -> None:
        self.file: FileBytes = file
        self.ours: bool = ours
        self._base, self._data = 0, memoryview(b"")

    def view(self, start: int, end: int) -> memoryview:
        """Return the bytes from `start` to `end`.

        Raises:
            DamageError: the file is shorter, or the disk fails.
        """
        if start < self._base or end > self._base + len(self._data):
            length = min(max(end - start, PIECE_BYTES), self.file.size - start)
            try:
                self._data, self._base = memoryview(self.file.read(start, length)), start
            except LogError:  # possibly only the bytes after `end` cannot be read
                try:
                    return memoryview(self.file.read(start, end - start))
                except LogError as fault:
                    raise DamageError(str(fault)) from fault
            if end - start > length:
                raise DamageError(
                    f"the file ends inside a record: {number_of(end - start, 'byte')} announced, {length} left"
                )
        return self._data[start - self._base : end - self._base]

    def has(self, position: int, data: bytes) -> bool:
        """Return True if these bytes are at `position`."""
        try:
            return position + len(data) <= self.file.size and bytes(self.view(position, position + len(data))) == data
        except DamageError:  # usual: a part can be read, which the caller does
            return False

    def head(self, position: int) -> tuple[int, int]:
        """Return opcode and end of the record at `position`.

        Raises:
            DamageError: the file ends before the record.
        """
        if self.file.size - position < RECORD_HEAD.size:
            raise DamageError("the file ends inside a record's head")
        opcode, length = RECORD_HEAD.unpack(self.view(position, position + RECORD_HEAD.size))
        end = position + RECORD_HEAD.size + length
        if end > self.file.size:
            left = self.file.size - position - RECORD_HEAD.size
            raise DamageError(f"the file ends inside a record: {number_of(length, 'byte')} announced, {left} left")
        return opcode, end

    def next_credible(self, position: int, spend: Callable[[int], bool]) -> int:
        """Return the position of the next valid record from `position` on; the file's size if none is found.

        Args:
            position: start of the search, bytes.
            spend: called with the number of bytes that a closer check reads; returns False if the budget is used up.
        """
        while position < self.file.size:
            end = min(position + PIECE_BYTES, self.file.size)
            try:
                piece = self.file.read(position, min(end + _LOOK_AHEAD, self.file.size) - position)
            except LogError as fault:  # a read fault of the disk
                _log.debug("%s: the search for intact records continues at byte %d: %s", self.file.path, end, fault)
                position = end
                continue
            for match in _CREDIBLE.finditer(piece):
                if match.start() >= end - position:
                    break
                if self._credible(position + match.start(), spend):
                    return position + match.start()
            position = end
        return self.file.size

    def _credible(self, position: int, spend: Callable[[int], bool]) -> bool:
        try:
            opcode, end = self.head(position)
            return self._is_plausible(opcode, position, end) and (
                opcode not in _TEXT_KINDS or (spend(end - position) and self._is_intact(opcode, position))
            )
        except DamageError:  # usual: this is the question
            return False

    def _is_plausible(self, opcode: int, position: int, end: int) -> bool:
        """Return True if the head of a record is that of its kind. Metadata and attachments are checked as a whole."""
        if opcode == Opcode.CHUNK:
            parse_head(self.view(position, min(end, position + HEAD_BYTES)), end - position)
        elif opcode == Opcode.MESSAGE_INDEX:
            sizes = bytes(self.view(position + 9, min(end, position + 15)))
            return len(sizes) == 6 and int.from_bytes(sizes[2:], "little") <= end - position - 15
        elif opcode == Opcode.DATA_END:
            return self.head(end)[0] in _SUMMARY_KINDS
        return True

    def _is_intact(self, opcode: int, position: int) -> bool:
        """Return True if a metadata record or an attachment is complete and has the right CRC."""
        if opcode == Opcode.METADATA:
            body = read_record(self.file, position, _METADATA_BYTES)[1]
            return parse(records.Metadata, body) is not None and bool(check_metadata(body, self.ours))
        check_attachment(self.file, position, True)
        return True


def indexes_behind(
    window: Window, position: int, messages: Messages | None
) -> tuple[int, dict[int, int], tuple[int, int] | None, bool]:
    """Read the message index records from `position` on.

    Args:
        window: the file.
        position: end of a chunk, or start of a message index, bytes.
        messages: those of the chunk; None if they are not available.

    Returns:
        Their end; messages by channel id; first and last log time; False if one lists something else than the chunk
        contains.

    Raises:
        DamageError: a message index contradicts itself.
    """
    counts, parts, channel_ids = dict[int, int](), [np.empty((0, 2), np.uint64)], [0]
    while position < window.file.size:
        try:
            opcode, end = window.head(position)
            if opcode != Opcode.MESSAGE_INDEX:
                break
            channel_id, part = _message_index(bytes(window.view(position + RECORD_HEAD.size, end)))
        except DamageError:
            if counts:
                break
            raise
        counts[channel_id] = counts.get(channel_id, 0) + len(part)
        parts.append(part)
        channel_ids.append(channel_id)
        position = end
    entries = np.concatenate(parts)
    log_ns = entries[:, 0]
    span = (int(log_ns.min()), int(log_ns.max())) if len(log_ns) and log_ns.max() <= EVER_NS else None  # has no CRC
    ids = np.repeat(channel_ids, [len(part) for part in parts])
    return position, counts, span, messages is None or _fits(ids, entries, messages)


def _message_index(body: bytes) -> tuple[int, NDArray[np.uint64]]:
    """Return channel id, and log time and offset of each of the n messages, (n, 2)."""
    size = int.from_bytes(body[2:6], "little")
    if len(body) < 6 or size % 16 or size > len(body) - 6:
        raise DamageError("a message index of the wrong length")
    return int.from_bytes(body[:2], "little"), np.frombuffer(body, "<u8", size // 8, 6).reshape(-1, 2)


def _fits(channel_ids: NDArray[np.int64], entries: NDArray[np.uint64], messages: Messages) -> bool:
    """Return True if every entry is a message of the chunk."""
    rows = np.searchsorted(messages.offsets, entries[:, 1].astype(np.int64))
    if (rows >= len(messages)).any():
        return False
    same = (messages.offsets[rows] == entries[:, 1]) & (messages.log_ns[rows] == entries[:, 0])
    return bool((same & (messages.channel_ids[rows] == channel_ids)).all())
