"""Walk over an MCAP file from its start to its end that uses everything intact.

Chunks are used only with the right CRC. Lengths in the file are compared with the available bytes before they are used.
After an invalid record the walk searches the next intact one and continues there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from mcap import records
from mcap.opcode import Opcode

from daq.errors import LogError
from daq.mcap.checksum import crc32
from daq.mcap.chunks import CHUNK_LIMIT_BYTES, HEAD_BYTES, ChunkHead, parse_head, unpack
from daq.mcap.damage import FileDamage, Held, Place
from daq.mcap.file_bytes import PIECE_BYTES, FileBytes
from daq.mcap.open_chunk import MESSAGE_HEAD
from daq.mcap.records import (
    RECORD_HEAD,
    AttachmentPlace,
    DamageError,
    Definitions,
    Facts,
    Header,
    check_attachment,
    check_metadata,
    parse,
)
from daq.mcap.scan import Messages, record_places
from daq.mcap.table import TableBuilder, TakenChunk
from daq.mcap.window import Window, indexes_behind
from daq.mcap.writer import MAGIC
from rig_basics.texts import number_of

_METADATA_LIMIT_BYTES = 64 * 2**20
_STRETCH_BYTES = 4 * PIECE_BYTES
_DEFINED_OPCODES = frozenset(Opcode)
_OF_SUMMARY = frozenset(
    (
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.STATISTICS,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    )
)


class Walk:
    """One pass over the records of a file; `run` fills the attributes.

    Args:
        file: the open file.
        header: program that wrote the file.
        no_summary: reason why the summary cannot be used; "" if it can.
        progress: called with the completed share of the file, 0 … 1.

    Attributes:
        table: intact chunks.
        damage: damaged places.
        definitions, facts, attachments: other intact contents.
        finished: True if the file has its end.
        position: end of the walk, bytes.
        announced: number of messages according to an intact summary, None without one.
        no_crc: number of records without CRC by kind, in files of other writers.
    """

    def __init__(
        self,
        file: FileBytes,
        header: Header,
        no_summary: str,
        progress: Callable[[float], None] | None,
    ) -> None:
        self.file: FileBytes = file
        self.header: Header = header
        self.no_summary: str = no_summary
        self.window: Window = Window(file, header.ours)
        self.progress = progress
        self.damage: FileDamage = FileDamage()
        self.definitions: Definitions = Definitions()
        self.table: TableBuilder = TableBuilder(self.definitions)
        self.facts: list[Facts] = []
        self.attachments: list[AttachmentPlace] = []
        self.loose: list[tuple[int, int]] = []
        self.no_crc: dict[str, int] = {}
        self.last: Messages | None = None  # of the last intact chunk: its message indexes follow
        self.last_counts: dict[int, int] = {}
        self.indexed: dict[int, int] = {}  # messages listed by its message indexes so far
        self.last_start: int = -1
        self.unnamed: set[int] = set()  # positions of intact chunks whose message indexes do not list all messages
        self.open_place: Place | None = None  # following message indexes belong to it
        self.left_out_end: int = -1
        self.search_from: int = len(MAGIC)  # end of the last certainly intact record, or of the last one searched for
        self.budget: int = 8 * file.size + 2**28  # may be searched without result; hostile files nest records
        self.crc: int | None = 0  # of the data section so far; None after an excluded range
        self.data_ended: bool = False
        self.finished: bool = False
        self.summary_start: int = 0
        self.statistics: bytes = b""
        self.announced: int | None = None

    def run(self) -> None:
        """Walk the file."""
        position = 0
        try:
            self._pass(0, len(MAGIC))
            position = len(MAGIC)
            opcode, end = self.window.head(position)
            if opcode != Opcode.HEADER:
                raise DamageError("no header")
            parse(records.Header, bytes(self.window.view(position + 9, min(end, position + PIECE_BYTES))))
            self._pass(position, end)
            position = end
        except DamageError as damage:
            position = self._resume(position, f"the header is damaged: {damage}")
        while not self.finished and self.budget > 0:
            try:
                if position >= self.file.size:
                    if self.left_out_end != position:
                        break
                    self.left_out_end = -1
                    raise DamageError("the file ends after a chunk that was left out")
                end = self._record(position)
                self._pass(position, end)
                position = end
            except DamageError as damage:
                position = self._resume(position, str(damage))
        self.position = position
        self._keep_loose()

    def _pass(self, position: int, end: int) -> None:
        """Accept an intact range."""
        if self.crc is not None and not self.data_ended:
            for at in range(position, end, PIECE_BYTES):
                self.crc = crc32(self.window.view(at, min(end, at + PIECE_BYTES)), self.crc)
        if end != self.left_out_end:
            self.search_from = max(self.search_from, end)
        if self.progress is not None:
            self.progress(end / self.file.size)

    def _resume(self, position: int, why: str) -> int:
        """Note the damage and return the position of the next intact record, or the end of the file.

        The search begins after the last certainly intact record, since a wrong length may have skipped some.
        """
        self.crc = None
        found = self.window.next_credible(self.search_from, self._spend)
        self._spend(max(0, position - found))
        self.search_from = found + 1
        place = self.open_place
        if place is None or place.end < position:
            place = self.damage.note(position, position + 1, why, len(self.table))
        place.start, place.end = min(place.start, found), max(place.end, found)
        self.open_place = place
        return found

    def _spend(self, size: int) -> bool:
        self.budget -= size
        return self.budget > 0

    def _record(self, position: int) -> int:
        """Process the record at `position`; return the position of the next one."""
        opcode, end = self.window.head(position)
        if opcode == Opcode.MESSAGE_INDEX:
            return self._message_indexes(position)
        self._end_of_indexes(position)
        if opcode == Opcode.CHUNK:
            return self._chunk(position, end)
        if opcode == Opcode.MESSAGE and not self.header.ours:
            return self._loose(position, end)
        if opcode == Opcode.METADATA:
            self._metadata(position, end)
        elif opcode == Opcode.ATTACHMENT:
            place, has_crc = check_attachment(self.file, position, self.header.ours)
            self.attachments.append(place)
            self._count_without_crc("attachment", has_crc)
        elif opcode == Opcode.DATA_END:
            self._data_end(position, end)
        elif opcode == Opcode.FOOTER:
            self._footer(position, end)
        elif opcode in _OF_SUMMARY and self.data_ended:
            if opcode == Opcode.STATISTICS:
                self.statistics = bytes(self.window.view(position + RECORD_HEAD.size, min(end, position + PIECE_BYTES)))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and not self.header.ours:
            self.definitions.take(opcode, bytes(self.window.view(position + RECORD_HEAD.size, end)))
        elif opcode == 0 or self.header.ours or opcode in _DEFINED_OPCODES:
            raise DamageError(f"a record of kind {opcode:#04x}, which is not allowed here")
        self.open_place = None
        return end

    def _message_indexes(self, position: int) -> int:
        """Process the message indexes of a chunk; those of a damaged chunk give its former contents."""
        whole = self.last.indexes() if self.last and not self.indexed else b""
        if whole and self.window.has(position, whole):  # the usual case
            self.indexed = dict(self.last_counts)
            self.unnamed.discard(self.last_start)
            return position + len(whole)
        end, counts, span, fits = indexes_behind(self.window, position, self.last)
        if fits and self.last and all(self.last_counts.get(channel) == count for channel, count in counts.items()):
            self.indexed |= counts
            if self.indexed == self.last_counts:
                self.unnamed.discard(self.last_start)
        elif self.open_place is not None:
            self.open_place.held = [*(self.open_place.held or []), Held(counts, span)]
            self.open_place.end = max(self.open_place.end, end)
        else:
            place = self.damage.note(position, end, "message indexes that do not fit their chunk", len(self.table))
            if counts == {channel: n for channel, n in self.last_counts.items() if channel not in self.indexed}:
                place.held = []
            self.indexed |= counts
        return end

    def _end_of_indexes(self, position: int) -> None:
        """Check at the next record whether the message indexes of the last intact chunk list every message."""
        lacking = {c: n for c, n in self.last_counts.items() if self.indexed.get(c) != n}
        if lacking and (self.indexed or self.header.ours):
            size, place = sum(15 + 16 * n for n in lacking.values()), self.open_place
            if place is not None and place.end - place.start == size:
                place.held = []  # the damaged range is as long as the missing indexes
            elif place is None:
                text = "message indexes before this place do not list every message of their chunk"
                self.damage.note(position, position, text, len(self.table)).held = []
        self.last, self.last_counts, self.indexed = None, {}, {}

    def _chunk(self, position: int, end: int) -> int:
        self.open_place = None
        head = parse_head(self.window.view(position, min(end, position + HEAD_BYTES)), end - position)
        try:
            chunk = self.read_chunk(position, end, head)
        except DamageError as damage:
            self._spend(head.packed + min(head.unpacked, CHUNK_LIMIT_BYTES))
            self.open_place = self.damage.note(position, end, f"{damage}, left out", len(self.table))
            self.crc = None
            self.left_out_end = end  # the length may be wrong: the search still begins inside the chunk …
            self.search_from = max(self.search_from, position + 1)  # … but not at this very chunk again
            return end
        earlier = self.table.add(position, head, chunk, trusted=not self.header.ours)
        if earlier is not None:
            text = f"the chunk of byte {earlier} again, copied over the original contents; used once"
            self.open_place = self.damage.note(position, end, text, len(self.table))
        elif chunk.counts and self.header.ours and chunk.times[:2] != (head.start_ns, head.end_ns):
            text = "a chunk whose head has other times than its messages; those of the messages are used"
            self.damage.note(position, end, text, len(self.table)).held = []
        self._count_without_crc("chunk", head.crc)
        self.last, self.last_counts, self.last_start = chunk.messages, chunk.counts, position
        self.unnamed.add(position)
        return end

    def read_chunk(self, position: int, end: int, head: ChunkHead) -> TakenChunk:
        """Read, unpack, verify and count the chunk at `position`.

        Raises:
            DamageError: the chunk is damaged.
        """
        if head.packed > CHUNK_LIMIT_BYTES + PIECE_BYTES:
            raise DamageError(
                f"a chunk of {number_of(head.packed, 'packed byte')}, more than the {CHUNK_LIMIT_BYTES} that are read"
            )
        packed = self.window.view(position, end)[head.data_at : head.data_at + head.packed]
        return self.table.count(unpack(packed, head, self.header.ours))

    def _loose(self, position: int, end: int) -> int:
        """Process messages outside of chunks, which have no CRC."""
        block = self.window.view(position, min(self.file.size, max(end, position + PIECE_BYTES)))
        offsets, sizes, length = record_places(block, Opcode.MESSAGE)
        too_short = sizes < MESSAGE_HEAD.size
        if too_short.any():
            length = int(offsets[too_short.argmax()])
        if not length:
            raise DamageError("a message shorter than its own head")
        if self.loose and self.loose[-1][1] == position and position - self.loose[-1][0] < _STRETCH_BYTES:
            self.loose[-1] = self.loose[-1][0], position + length
        else:
            self.loose.append((position, position + length))
        return position + length

    def _keep_loose(self) -> None:
        """Use messages outside of chunks only in a file without chunks; otherwise they are damaged records."""
        chunked = len(self.table) > 0
        for start, end in self.loose:
            if chunked:
                self.damage.note(start, end, "messages outside of chunks, left out", len(self.table))
                continue
            try:
                chunk = self.table.count(self.file.read(start, end - start))
                self.table.add(start, ChunkHead(0, 0, end - start, chunk.crc, "", 0, end - start), chunk, trusted=True)
                self._count_without_crc("series of messages", 0)
            except (DamageError, LogError) as damage:
                self.damage.note(start, end, f"{damage}, left out", len(self.table))

    def _metadata(self, position: int, end: int) -> None:
        if end - position > _METADATA_LIMIT_BYTES:
            raise DamageError(f"metadata of {number_of(end - position, 'byte')}")
        body = bytes(self.window.view(position + RECORD_HEAD.size, end))
        self.facts.append(check_metadata(body, self.header.ours))
        self._count_without_crc("metadata record", self.facts[-1].has_crc)

    def _count_without_crc(self, what: str, crc: int) -> None:
        if not crc:
            self.no_crc[what] = self.no_crc.get(what, 0) + 1

    def _data_end(self, position: int, end: int) -> None:
        if end - position < RECORD_HEAD.size + 4:
            raise DamageError("an end of the data of the wrong length")
        crc = int.from_bytes(self.window.view(position + RECORD_HEAD.size, position + RECORD_HEAD.size + 4), "little")
        self._count_without_crc("data section", crc)
        if crc and crc == self.crc and not self.data_ended:  # the right CRC shows that duplicates were written
            written = self.table.keep_all()
            self.damage.places = [place for place in self.damage.places if place.start not in written]
        if self.crc is not None and crc != self.crc and (crc or self.header.ours):
            text = "the CRC of the whole data section is wrong, though every chunk in it is right"
            self.damage.note(0, position, text, len(self.table)).held = []
        self.data_ended, self.summary_start = True, end

    def _footer(self, position: int, end: int) -> None:
        if end - position != RECORD_HEAD.size + 20 or not self.data_ended:
            raise DamageError("a footer of another length than 20 bytes, or before the end of the data")
        closing = self.window.view(end, min(self.file.size, end + len(MAGIC)))
        if bytes(closing) != MAGIC:
            raise DamageError(f"no {MAGIC!r} after the footer")
        self.finished = True
        summary_start, _, crc = struct.unpack("<QQI", self.window.view(position + RECORD_HEAD.size, end))
        self._count_without_crc("summary", crc)
        try:  # an intact summary may have moved: the file may have become longer before it
            right = crc == 0 or self.file.crc(self.summary_start, end - 4) == crc
        except LogError:  # usual: noted as a damaged summary below
            right = False
        if self.statistics and right and (crc or not self.header.ours):
            self.announced = parse(records.Statistics, self.statistics).message_count
        if not right or (summary_start not in (0, self.summary_start)) or (self.header.ours and self.no_summary):
            text = f"the summary cannot be used: {self.no_summary}" if self.no_summary else "the summary is damaged"
            self.damage.note(self.summary_start, end, text, len(self.table)).held = []
        if end + len(MAGIC) < self.file.size:
            text = "bytes after the end of the log, which do not belong to it"
            self.damage.note(end + len(MAGIC), self.file.size, text, len(self.table)).held = []
