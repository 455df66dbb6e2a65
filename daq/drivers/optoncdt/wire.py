"""Micro-Epsilon optoNCDT triangulation lasers: the RS422 stream and the ASCII command answers on the same line.

A value is sent as three bytes, low six bits first:

    L  00dddddd   M  01dddddd   H  1Fdddddd      F = 0 on the first value of a measurement, 1 on the others

Every byte thus indicates which third it is. A block (one measurement with as many values as outputs are selected)
starts at F = 0. Command answers are ASCII (below 0x80, thus never an H byte) and may be sent between values.

A value is an L and an M directly before an H. Other bytes below 0x80 are text if printable, otherwise damage. A line is
therefore returned when the byte after its LF has arrived. Only the prompt ``->``, which no byte need follow, is
returned immediately. Source: ILD1420 manual, measurement data format and scaling pages.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from daq.drivers.optoncdt.sensor_answers import PROMPT, announced

COUNTER_WRAP = 2**18
"""The measurement counter restarts at 0 after this many measurements."""
TIMESTAMP_WRAP = 2**32
"""The timestamp restarts at 0 after this many ticks: 11 h 55 min 49.67 s."""
TICK_S = 1e-5
"""One timestamp tick, s."""
_LF, _CR, _TAB, _DASH, _ANGLE = b"\n\r\t->"
_TEXT = frozenset(range(0x20, 0x7F)) | {_LF, _CR, _TAB}
_LINE_LIMIT = 1024  # bytes; the longest known answers are GETINFO lines well under 100
_MAX_LINE_AGE = 256  # values without a text byte after which an unterminated line counts as damage
_WINDOW, _WINDOW_LIMIT = 16, 4096  # blocks that the fast path tests at once: few after damage, more without


@dataclass(frozen=True)
class DecodedBlocks:
    """Result of one call of `BlockDecoder.feed`.

    Attributes:
        values: raw 18-bit words of the complete blocks, uint32 of shape (blocks, words).
        text: answer lines without their line end; the prompt ``"->"`` is a separate item.
        skipped_bytes: number of bytes skipped to find the next block.
        skipped_first: number of those before the first block; all of them without a block.
        announced: other words that an answer announced; decoding stopped after that answer. None if no answer did.
        unread: bytes that were not decoded.
    """

    values: NDArray[np.uint32]
    text: list[str]
    skipped_bytes: int
    skipped_first: int = 0
    announced: tuple[str, ...] | None = None
    unread: bytes = b""


class BlockDecoder:
    """Decode the bytes of one sensor to measurement blocks and answer lines.

    The result does not depend on the split into calls.

    Args:
        words: names of the output values in stream order, for instance from `parse_outinfo`.
        follow_answers: whether `feed` stops after an answer that announces other words.
    """

    def __init__(self, words: Sequence[str], *, follow_answers: bool = False) -> None:
        self.follow_answers = follow_answers
        self._announced: tuple[str, ...] | None = None
        self._block: list[int] = []
        self._dropped = 0
        self.set_words(words)
        self._pending = bytearray()  # empty, an L, or an L and an M: possibly the start of a value
        self._line = bytearray()  # text of an incomplete line
        self._line_age = 0  # values since the last byte of that line
        self._window = _WINDOW  # number of blocks to test at once

    @property
    def words(self) -> tuple[str, ...]:
        """Names of the columns of `DecodedBlocks.values`."""
        return self._words

    def set_words(self, words: Sequence[str]) -> None:
        """Select the output values from now on; an incomplete block is dropped and counted by the next `feed`.

        Raises:
            ValueError: `words` is empty.
        """
        if not words:
            raise ValueError("expected at least one output word, got none: pass the names in stream order")
        self._words = tuple(words)
        self._kinds = np.tile(np.array([0x00, 0x40, 0xC0], np.uint8), (len(self._words), 1))
        self._kinds[0, 2] = 0x80
        self._dropped += 3 * len(self._block)
        self._block = []  # values of the incomplete block
        self._rows: list[NDArray[np.uint32]] = []
        self._text: list[str] = []
        self._skipped = 0
        self._skipped_first: int | None = None

    @property
    def unread(self) -> bytes:
        """Bytes taken that do not form a complete value or line yet."""
        return bytes(self._line + self._pending)

    def feed(self, data: bytes) -> DecodedBlocks:
        """Decode the next bytes of the line.

        Args:
            data: any number of bytes, in the order of arrival.
        """
        self._rows, self._text, self._skipped = [], [], self._dropped
        self._dropped, self._skipped_first, self._announced = 0, None, None
        position, width = 0, 3 * len(self._words)
        while position < len(data) and self._announced is None:
            if not self._block and not self._pending and len(data) - position >= width:
                taken = self._take_clean_blocks(data, position)
                position += taken * width
                if taken:
                    continue
            position = self._walk(data, position)
        if len(self._rows) == 1:
            values = self._rows[0]
        else:
            values = np.concatenate([np.empty((0, len(self._words)), np.uint32), *self._rows])
        first = self._skipped if self._skipped_first is None else self._skipped_first
        return DecodedBlocks(values, self._text, self._skipped, first, self._announced, data[position:])

    def _take_clean_blocks(self, data: bytes, position: int) -> int:
        """Decode complete consecutive blocks, at most a window of them; return their number.

        The window grows while the stream is undamaged, so that the bytes of a damaged stream are not tested repeatedly.
        """
        words = len(self._words)
        count = min(self._window, (len(data) - position) // (3 * words))
        triples = np.frombuffer(data, np.uint8, 3 * words * count, position).reshape(count, words, 3)
        rows = ((triples & 0xC0) == self._kinds).all(axis=(1, 2))
        taken = count if rows.all() else int(rows.argmin())
        if taken < count:
            self._window = _WINDOW
        elif taken == self._window:
            self._window = min(2 * self._window, _WINDOW_LIMIT)
        if taken:
            six = (triples[:taken] & 0x3F).astype(np.uint32)
            self._add_rows((six[..., 0] | six[..., 1] << 6 | six[..., 2] << 12).astype(np.uint32, copy=False))
            self._age_line(taken * words)
        return taken

    def _walk(self, data: bytes, position: int) -> int:
        """Decode byte by byte until a block is complete or the data ends; return the new position."""
        for index in range(position, len(data)):
            byte = data[index]
            if byte >= 0x80:
                if self._end_of_value(byte):
                    return index + 1
            elif byte < 0x40:
                if byte == _ANGLE and bytes(self._pending) == b"-":
                    self._pending.clear()
                    self._prompt()
                else:
                    self._flush_pending()
                    self._pending.append(byte)
            elif len(self._pending) == 1:
                self._pending.append(byte)
            else:
                self._flush_pending()
                self._text_byte(byte)
            if self._announced is not None:
                return index + 1
        return len(data)

    def _end_of_value(self, high: int) -> bool:
        """Take an H byte, which completes a value after an L and an M. Return whether it completed a block."""
        if len(self._pending) != 2:
            self._damage(len(self._pending) + 1)
            self._pending.clear()
            return False
        low, middle = self._pending
        self._pending.clear()
        self._age_line(1)
        continues = bool(high & 0x40)
        if continues and not self._block:  # a further value of a block whose start was not received
            self._skipped += 3
            return False
        if not continues and self._block:  # a new block although the last one is incomplete
            self._damage(0)
        self._block.append(low | (middle & 0x3F) << 6 | (high & 0x3F) << 12)
        if len(self._block) < len(self._words):
            return False
        self._add_rows(np.array([self._block], np.uint32))
        self._block.clear()
        return True

    def _add_rows(self, rows: NDArray[np.uint32]) -> None:
        if self._skipped_first is None:
            self._skipped_first = self._skipped
        self._rows.append(rows)

    def _flush_pending(self) -> None:
        """Treat the pending bytes as text: they are not the start of a value."""
        for byte in self._pending:
            self._text_byte(byte)
        self._pending.clear()

    def _text_byte(self, byte: int) -> None:
        if byte not in _TEXT or len(self._line) >= _LINE_LIMIT:
            self._damage(len(self._line) + 1)
            self._line.clear()
        elif byte == _LF:
            self._end_line()
        else:
            self._line.append(byte)
            self._line_age = 0

    def _end_line(self) -> None:
        line = self._line.decode("ascii").strip()
        self._line.clear()
        if line:
            self._text.append(line)
            words = announced(line) if self.follow_answers else None
            self._announced = words if words != self._words else None

    def _prompt(self) -> None:
        self._end_line()
        self._text.append(PROMPT)

    def _age_line(self, values: int) -> None:
        """Count an old incomplete line as damage: it consists of bytes of a damaged value."""
        if not self._line:
            return
        self._line_age += values
        if self._line_age > _MAX_LINE_AGE:
            self._skipped += len(self._line)
            self._line.clear()

    def _damage(self, count: int) -> None:
        """Drop `count` bytes and the incomplete block."""
        self._skipped += count + 3 * len(self._block)
        self._block.clear()


def encode_block(values: ArrayLike) -> bytes:
    """Encode measurement blocks as the sensor sends them.

    Args:
        values: raw words 0 … 2**18 - 1, integers of shape (blocks, words).

    Returns:
        3 × blocks × words bytes.

    Raises:
        ValueError: the shape is wrong, or a word needs more than 18 bits.
    """
    words = np.asarray(values, np.uint32)
    if words.ndim != 2 or words.shape[1] == 0:
        raise ValueError(f"expected an array (blocks, words), got shape {words.shape}")
    if words.size and words.max() >= 2**18:
        raise ValueError(f"expected 18-bit words (< 262144), got {words.max()}")
    out = np.empty((*words.shape, 3), np.uint8)
    out[..., 0] = words & 0x3F
    out[..., 1] = 0x40 | (words >> 6) & 0x3F
    out[..., 2] = 0xC0 | words >> 12
    out[:, 0, 2] &= 0xBF
    return out.tobytes()


def timestamp_ticks(lo: ArrayLike, hi: ArrayLike) -> NDArray[np.uint32]:
    """Return the sensor time in ticks of 10 µs from the two 16-bit timestamp words; it wraps at `TIMESTAMP_WRAP`."""
    low, high = np.asarray(lo, np.uint32), np.asarray(hi, np.uint32)
    return ((low & 0xFFFF) | (high & 0xFFFF) << 16).astype(np.uint32)
