"""LAWICEL text (slcan): how CAN frames look at the byte seam, whatever adapter sits below.

    tIIILDD…   11-bit identifier     TIIIIIIIILDD…   29-bit identifier     r…, R…   remote request, no data

Every line ends with CR; a bare BEL (0x07) is the adapter's "no". Behind the data four hex digits of adapter time may
stand, which are ignored. Source: LAWICEL CAN232 manual.
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
        arbitration_id: 11 bits, or 29 bits when `extended`.
        data: 0 … 8 bytes; for a remote request that many zeros as data are wanted.
        extended: 29-bit identifier.
        remote: a request for data.
    """

    arbitration_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False


@dataclass(frozen=True)
class Decoded:
    """What one `LineDecoder.feed` found.

    Attributes:
        frames: CAN frames in order.
        other_lines: an adapter's answers without CR, ``""`` (done), ``"z"``/``"Z"`` (sent), ``"V1013"`` …, BEL as
            ``"\\a"``; of a host its orders to the adapter.
        damaged: lines that were neither: no known letter, wrong digits, wrong length, foreign bytes, overlong.
    """

    frames: list[CanFrame]
    other_lines: list[str]
    damaged: int


def encode(frame: CanFrame) -> bytes:
    """The frame as a line, CR included.

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
    """How many bytes the first line has, its end included; 0 when it does not end in them."""
    end = _LINE_END.search(data)
    return end.end() if end else 0


class LineDecoder:
    """Bytes of an adapter in, CAN frames out; any split into calls, bounded memory, never raises.

    Args:
        of_host: the bytes are a host's, so that orders to an adapter may stand among them, not answers.
    """

    def __init__(self, *, of_host: bool = False) -> None:
        self._words = _ORDER if of_host else _ANSWER
        self._line = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> Decoded:
        """Decode the next bytes.

        Args:
            data: any number of bytes, as they came.
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
        return Decoded(frames, other, damaged)

    def _plain_lines(self, data: bytes) -> Decoded:
        """What a quiet bus with a quiet adapter sends, nearly always: lines that end with CR, none begun before."""
        frames: list[CanFrame] = []
        other: list[str] = []
        *lines, rest = data.split(b"\r")
        damaged = 0
        for line in lines:
            damaged += 1 if len(line) > LINE_LIMIT_BYTES else _take(line, self._words, frames, other)
        self._extend(rest)
        return Decoded(frames, other, damaged)

    def _extend(self, piece: bytes) -> None:
        if not self._line:  # a CR LF adapter: the LF belongs to the line before
            piece = piece.lstrip(b"\n")
        self._line += piece[: LINE_LIMIT_BYTES + 1]
        if len(self._line) > LINE_LIMIT_BYTES:
            self._overlong = True
            del self._line[LINE_LIMIT_BYTES:]


def _take(line: bytes, words: re.Pattern[bytes], frames: list[CanFrame], other: list[str]) -> int:
    """Sort one line; returns 1 when it is damaged."""
    what = _read(line, words)
    if isinstance(what, CanFrame):
        frames.append(what)
    elif what is not None:
        other.append(what)
    return what is None


@lru_cache(4096)
def _read(line: bytes, words: re.Pattern[bytes]) -> CanFrame | str | None:
    """A frame, another line, or None of a damaged one. On a bus nearly every line has been there just before."""
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
