"""LAWICEL text (slcan): the representation of CAN frames at the byte seam, independent of the adapter.

    tIIILDD…   11-bit identifier     TIIIIIIIILDD…   29-bit identifier     r…, R…   remote request, no data

Every line ends with CR. A single BEL (0x07) is the adapter's negative acknowledgement. Four hex digits of adapter time
may follow the data; they are ignored. Source: LAWICEL CAN232 manual.
"""

import re
from dataclasses import dataclass
from functools import lru_cache

LINE_LIMIT_BYTES = 64
BEL = "\a"
_FRAME = re.compile(
    rb"(?:t([0-9A-Fa-f]{3})|T([0-9A-Fa-f]{8})|r([0-9A-Fa-f]{3})|R([0-9A-Fa-f]{8}))([0-8])([0-9A-Fa-f]*)"
)
_ANSWER = re.compile(rb"[zZ]?|F[0-9A-Fa-f]{2}|[Vv][0-9A-Za-z.]{4}|N(?:[0-9A-Za-z]{4}){1,2}")
_ORDER = re.compile(rb"|[CLOAPEFVvN]|S[0-8]|s[0-9A-Fa-f]{4,6}|[mM][0-9A-Fa-f]{8}|[XZQUW][0-9]")
_LINE_END = re.compile(rb"[\r\x07]")


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


def encode(frame: CanFrame) -> bytes:
    """Encode a frame as a line, including its CR.

    Raises:
        ValueError: the identifier or the data do not fit a classic CAN frame.
    """
    digits, limit = (8, 0x1FFFFFFF) if frame.extended else (3, 0x7FF)
    if not 0 <= frame.arbitration_id <= limit or len(frame.data) > 8:
        raise ValueError(
            f"expected an identifier up to {limit:#x} and up to 8 bytes, "
            f"got {frame.arbitration_id:#x} and {len(frame.data)} bytes"
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
