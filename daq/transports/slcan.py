"""LAWICEL text (slcan): the representation of CAN frames at the byte seam, independent of the adapter.

    tIIILDD…   11-bit identifier     TIIIIIIIILDD…   29-bit identifier     r…, R…   remote request, no data

Every line ends with CR. A single BEL (0x07) is the adapter's negative acknowledgement. Four hex digits of adapter time
may follow the data; they are ignored. Source: LAWICEL CAN232 manual.
"""

import re
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rig_basics.texts import number_of

LINE_LIMIT_BYTES = 64
BEL = "\a"
_FRAME = re.compile(
    rb"(?:t([0-9A-Fa-f]{3})|T([0-9A-Fa-f]{8})|r([0-9A-Fa-f]{3})|R([0-9A-Fa-f]{8}))([0-8])([0-9A-Fa-f]*)"
)
_ANSWER = re.compile(rb"[zZ]?|F[0-9A-Fa-f]{2}|[Vv][0-9A-Za-z.]{4}|N(?:[0-9A-Za-z]{4}){1,2}")
_ORDER = re.compile(rb"|[CLOAPEFVvN]|S[0-8]|s[0-9A-Fa-f]{4,6}|[mM][0-9A-Fa-f]{8}|[XZQUW][0-9]")
_LINE_END = re.compile(rb"[\r\x07]")
_LONGEST_FRAME = 30  # characters: letter, identifier of 8 digits, length, 16 digits of data, 4 of time
_MANY_BYTES = 1000
_FEW_BYTES = 200  # of a read: fewer are decoded faster line by line
_WEIGHTS = np.uint32(16) ** np.arange(7, -1, -1, dtype=np.uint32)
_PLACES = np.arange(1, _LONGEST_FRAME)
_NOT_HEX = 0xFF
_HEX_VALUE = np.full(256, _NOT_HEX, np.uint8)
_HEX_VALUE[np.frombuffer(b"0123456789ABCDEF", np.uint8)] = np.arange(16)
_HEX_VALUE[np.frombuffer(b"abcdef", np.uint8)] = np.arange(10, 16)


@dataclass(frozen=True)
class CanFrame:
    """One classic CAN frame.

    Attributes:
        arbitration_id: identifier of 11 bits, or of 29 bits if `extended`.
        data: 0 … 8 bytes; for a remote request as many zeros as bytes are requested.
        extended: whether the identifier has 29 bits.
        remote: whether the frame is a request for data.
    """

    arbitration_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False


@dataclass(frozen=True)
class DecodedLines:
    """Result of one call of `LineDecoder.feed`.

    Attributes:
        frames: CAN frames in order.
        other_lines: answers of an adapter without CR: ``""`` (done), ``"z"``/``"Z"`` (sent), ``"V1013"`` …, BEL as
            ``"\\a"``. From a host: its commands to the adapter.
        damaged: number of lines that are neither: unknown letter, wrong digits, wrong length, foreign bytes, too long.
    """

    frames: list[CanFrame]
    other_lines: list[str]
    damaged: int


@dataclass(frozen=True)
class FrameBlock:
    """Result of one call of `LineDecoder.feed_block`: the content of a DecodedLines with the frames as arrays.

    Attributes:
        arbitration_id: identifiers in order of arrival, shape (n,).
        extended, remote: see CanFrame; shape (n,).
        length: number of data bytes, shape (n,).
        data: bytes of each frame, followed by zeros, shape (n, 8).
        other_lines, damaged: see DecodedLines.
    """

    arbitration_id: NDArray[np.uint32]
    extended: NDArray[np.bool_]
    remote: NDArray[np.bool_]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    other_lines: list[str]
    damaged: int

    def __len__(self) -> int:
        return len(self.arbitration_id)

    def frames(self) -> list[CanFrame]:
        """Return the frames as objects."""
        whole = np.ascontiguousarray(self.data).tobytes()
        columns = (self.arbitration_id, self.length, self.extended, self.remote)
        rows = zip(range(0, len(whole), 8), *(column.tolist() for column in columns), strict=True)
        return [
            CanFrame(identifier, whole[at : at + length], extended, remote)
            for at, identifier, length, extended, remote in rows
        ]


def encode(frame: CanFrame) -> bytes:
    """Encode a frame as a line, including its CR.

    Raises:
        ValueError: the identifier or the data do not fit a classic CAN frame.
    """
    digits, limit = (8, 0x1FFFFFFF) if frame.extended else (3, 0x7FF)
    if not 0 <= frame.arbitration_id <= limit or len(frame.data) > 8:
        raise ValueError(
            f"expected an identifier up to {limit:#x} and up to 8 bytes, "
            f"got {frame.arbitration_id:#x} and {number_of(len(frame.data), 'byte')}"
        )
    letter = "r" if frame.remote else "t"
    letter = letter.upper() if frame.extended else letter
    data = "" if frame.remote else frame.data.hex().upper()
    return f"{letter}{frame.arbitration_id:0{digits}X}{len(frame.data)}{data}\r".encode()


def first_line_end(data: bytes) -> int:
    """Return the number of bytes of the first line including its end; 0 if the line is incomplete."""
    end = _LINE_END.search(data)
    return end.end() if end else 0


class LineDecoder:
    """Decode the bytes of an adapter to CAN frames. The result does not depend on the split into calls.

    Memory is bounded. `feed` does not raise.

    Args:
        of_host: whether the bytes were sent by a host: they may contain commands to an adapter, but no answers.
    """

    def __init__(self, *, of_host: bool = False) -> None:
        self._words = _ORDER if of_host else _ANSWER
        self._line = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> DecodedLines:
        """Decode the next bytes.

        Args:
            data: any number of bytes, in the order of arrival.
        """
        frames: list[CanFrame] = []
        other: list[str] = []
        if not self._line and not self._overlong and b"\x07" not in data and b"\n" not in data:
            return self._plain_lines(data)
        damaged = position = 0
        for end in _LINE_END.finditer(data):
            self._extend(data[position : end.start()])
            position = end.end()
            line = bytes(self._line)
            bell = end[0] == b"\x07"
            if self._overlong:
                damaged += 1
            elif line or not bell:
                damaged += _take(line, self._words, frames, other)
            if bell:
                other.append(BEL)
            self._line.clear()
            self._overlong = False
        self._extend(data[position:])
        return DecodedLines(frames, other, damaged)

    def feed_block(self, data: bytes) -> FrameBlock:
        """Decode the next bytes to arrays: `feed`, several times faster for reads of many frames."""
        if len(data) < _FEW_BYTES:
            found = self.feed(data)
            return _Rows.frames(found.frames).block(found.other_lines, found.damaged)
        other: list[str] = []
        damaged = 0
        if self._overlong:
            end = first_line_end(data) or len(data)
            begun = self.feed(data[:end])
            other, damaged, data = begun.other_lines, begun.damaged, data[end:]
        if self._line and not self._overlong:  # the first line began in an earlier read
            data = bytes(self._line) + data
            self._line.clear()
        characters = np.frombuffer(data + bytes(_LONGEST_FRAME), np.uint8)
        ends = np.flatnonzero((characters == ord("\r")) | (characters == ord(BEL)))
        starts = np.concatenate([[0], ends + 1])
        starts, rest = starts[:-1], data[int(starts[-1]) :]
        starts = starts + (characters[starts] == ord("\n")) * (starts < ends)
        rows = _Rows.of(characters, starts, ends - starts)
        bells = characters[ends] == ord(BEL)
        for i in np.flatnonzero(~rows.is_frame | bells).tolist():
            line = data[starts[i] : ends[i]].lstrip(b"\n")
            if not rows.is_frame[i] and (line or not bells[i]):
                scalar: list[CanFrame] = []
                damaged += len(line) > LINE_LIMIT_BYTES or _take(line, self._words, scalar, other)
                if scalar:
                    rows.put(i, scalar[0])
            if bells[i]:
                other.append(BEL)
        self._extend(rest)
        return rows.block(other, damaged)

    def feed_any(self, data: bytes) -> DecodedLines:
        """Decode the next bytes: `feed`, faster for long reads."""
        if len(data) < _MANY_BYTES:
            return self.feed(data)
        block = self.feed_block(data)
        return DecodedLines(block.frames(), block.other_lines, block.damaged)

    def _plain_lines(self, data: bytes) -> DecodedLines:
        """Decode lines that end with CR when no line is incomplete: the usual case, without BEL and LF."""
        frames: list[CanFrame] = []
        other: list[str] = []
        *lines, rest = data.split(b"\r")
        damaged = 0
        for line in lines:
            damaged += 1 if len(line) > LINE_LIMIT_BYTES else _take(line, self._words, frames, other)
        self._extend(rest)
        return DecodedLines(frames, other, damaged)

    def _extend(self, piece: bytes) -> None:
        if not self._line:  # a CR LF adapter: the LF belongs to the line before
            piece = piece.lstrip(b"\n")
        self._line += piece[: LINE_LIMIT_BYTES + 1]
        if len(self._line) > LINE_LIMIT_BYTES:
            self._overlong = True
            del self._line[LINE_LIMIT_BYTES:]


def _take(line: bytes, words: re.Pattern[bytes], frames: list[CanFrame], other: list[str]) -> int:
    """Append one line to the frames or to the other lines; return 1 if it is damaged, otherwise 0."""
    content = _read(line, words)
    if isinstance(content, CanFrame):
        frames.append(content)
    elif content is not None:
        other.append(content)
    return content is None


@lru_cache(4096)
def _read(line: bytes, words: re.Pattern[bytes]) -> CanFrame | str | None:
    """Return a frame, another line, or None if the line is damaged. Cached: most lines on a bus repeat recent ones."""
    if line[:1] not in (b"t", b"T", b"r", b"R"):
        return line.decode("ascii") if words.fullmatch(line) else None
    match = _FRAME.fullmatch(line)
    if match is None:
        return None
    standard, extended, remote_standard, remote_extended, length_digit, digits = match.groups()
    remote = standard is None and extended is None
    arbitration_id = int(standard or extended or remote_standard or remote_extended, 16)
    is_extended = extended is not None or remote_extended is not None
    length = int(length_digit)
    expected = 0 if remote else 2 * length
    if len(digits) not in (expected, expected + 4) or arbitration_id > (0x1FFFFFFF if is_extended else 0x7FF):
        return None
    data = bytes(length) if remote else bytes.fromhex(digits[:expected].decode("ascii"))
    return CanFrame(arbitration_id, data, is_extended, remote)


@dataclass(frozen=True)
class _Rows:
    """Frames in lines, one row for each line; rows of other lines are not `is_frame`."""

    arbitration_id: NDArray[np.uint32]
    extended: NDArray[np.bool_]
    remote: NDArray[np.bool_]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    is_frame: NDArray[np.bool_]

    @classmethod
    def of(cls, characters: NDArray[np.uint8], starts: NDArray[np.intp], lengths: NDArray[np.intp]) -> "_Rows":
        """Read all lines that are frames.

        Args:
            characters: text, followed by at least `_LONGEST_FRAME` further bytes.
            starts, lengths: first character and number of characters of each line, shape (n,).
        """
        count = len(starts)
        rows = cls(
            np.zeros(count, np.uint32),
            np.zeros(count, np.bool_),
            np.zeros(count, np.bool_),
            np.zeros(count, np.uint8),
            np.zeros((count, 8), np.uint8),
            np.zeros(count, np.bool_),
        )
        letters = characters[starts]
        for letter, digits, remote in (("t", 3, False), ("T", 8, False), ("r", 3, True), ("R", 8, True)):
            there = np.flatnonzero((letters == ord(letter)) & (lengths > digits + 1))
            if len(there):
                rows._read(there, characters, starts[there], lengths[there], digits, remote)
        return rows

    @classmethod
    def frames(cls, frames: list[CanFrame]) -> "_Rows":
        """Return a row for each frame."""
        if not frames:
            return _NO_ROWS
        rows = cls.of(np.zeros(len(frames), np.uint8), np.arange(len(frames)), np.zeros(len(frames), np.intp))
        for row, frame in enumerate(frames):
            rows.put(row, frame)
        return rows

    def _read(
        self,
        there: NDArray[np.intp],
        characters: NDArray[np.uint8],
        starts: NDArray[np.intp],
        lengths: NDArray[np.intp],
        digits: int,
        remote: bool,
    ) -> None:
        """Read the lines `there`, which have the same letter."""
        width = min(_LONGEST_FRAME, int(lengths.max())) - 1
        value = _HEX_VALUE[characters[starts[:, None] + _PLACES[:width]]]
        behind = _PLACES[:width] >= lengths[:, None]
        right = ((value != _NOT_HEX) | behind).all(axis=1) & (lengths <= _LONGEST_FRAME)
        size = value[:, digits].astype(np.intp)
        spare = lengths - digits - 2 - (0 if remote else 2 * size)
        identifier = value[:, :digits].astype(np.uint32) @ _WEIGHTS[-digits:]
        right &= (size <= 8) & ((spare == 0) | (spare == 4)) & (identifier <= (0x7FF if digits == 3 else 0x1FFFFFFF))
        nibbles = np.zeros((len(there), 16), np.uint8)
        found = value[:, digits + 1 : digits + 17]
        nibbles[:, : found.shape[1]] = found
        data = nibbles[:, ::2] << 4 | nibbles[:, 1::2]
        data[np.arange(8) >= (0 if remote else 1) * size[:, None]] = 0
        at = there[right]
        self.arbitration_id[at], self.length[at], self.data[at] = identifier[right], size[right], data[right]
        self.extended[at], self.remote[at], self.is_frame[at] = digits == 8, remote, True

    def put(self, row: int, frame: CanFrame) -> None:
        """Set one row."""
        self.arbitration_id[row], self.extended[row] = frame.arbitration_id, frame.extended
        self.remote[row], self.length[row], self.is_frame[row] = frame.remote, len(frame.data), True
        self.data[row, : len(frame.data)] = np.frombuffer(frame.data, np.uint8)

    def block(self, other: list[str], damaged: int) -> FrameBlock:
        """Return the frames."""
        own = slice(None) if self.is_frame.all() else self.is_frame
        return FrameBlock(
            self.arbitration_id[own],
            self.extended[own],
            self.remote[own],
            self.length[own],
            self.data[own],
            other,
            damaged,
        )


_NO_ROWS = _Rows.of(np.zeros(0, np.uint8), np.zeros(0, np.intp), np.zeros(0, np.intp))
