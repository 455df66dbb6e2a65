"""LAWICEL text (slcan), the line of CAN adapters with a serial port: to the records of `can_frames`, and back.

    tIIILDD…   11-bit identifier     TIIIIIIIILDD…   29-bit identifier     r…, R…   remote request, no data

Every line ends with CR. A single BEL (0x07) is the adapter's negative acknowledgement. Four hex digits of adapter time
may follow the data; they are ignored. `HostText` is the host's end of the line, `AdapterText` the adapter's. Source:
LAWICEL CAN232 manual.
"""

import re
from collections import deque
from dataclasses import dataclass
from functools import lru_cache

from daq.transports.can_frames import AdapterMessage, CanFrame, FrameDecoder, adapter_message, encode as record_of

LINE_LIMIT_BYTES = 64
BEL = "\a"
BIT_RATES = {125_000: "S4", 250_000: "S5", 500_000: "S6", 1_000_000: "S8"}
"""Bit rates of a bus, bit/s, with the adapter's command."""
_FRAME = re.compile(
    rb"(?:t([0-9A-Fa-f]{3})|T([0-9A-Fa-f]{8})|r([0-9A-Fa-f]{3})|R([0-9A-Fa-f]{8}))([0-8])([0-9A-Fa-f]*)"
)
_ANSWER = re.compile(rb"[zZ]?|F[0-9A-Fa-f]{2}|[Vv][0-9A-Za-z.]{4}|N(?:[0-9A-Za-z]{4}){1,2}")
_ORDER = re.compile(rb"|[CLOAPEFVvN]|S[0-8]|s[0-9A-Fa-f]{4,6}|[mM][0-9A-Fa-f]{8}|[XZQUW][0-9]")
_LINE_END = re.compile(rb"([\r\x07])")


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
    """Encode a frame as a line, including its CR."""
    letter, digits = ("r" if frame.remote else "t"), 3
    if frame.extended:
        letter, digits = letter.upper(), 8
    data = "" if frame.remote else frame.data.hex().upper()
    return f"{letter}{frame.arbitration_id:0{digits}X}{len(frame.data)}{data}\r".encode()


class LineDecoder:
    """Decode the bytes of an adapter to CAN frames. The result does not depend on the split into calls.

    Memory is bounded. `feed` does not raise.

    Args:
        of_host: whether the bytes were sent by a host: they may contain commands to an adapter, but no answers.
    """

    def __init__(self, *, of_host: bool = False) -> None:
        self._words = _ORDER if of_host else _ANSWER
        self._begun = b""  # line without its end; cut where it is too long to be a line

    def feed(self, data: bytes) -> DecodedLines:
        """Decode the next bytes.

        Args:
            data: any number of bytes, in the order of arrival.
        """
        frames: list[CanFrame] = []
        other: list[str] = []
        damaged = 0
        *pieces, tail = _LINE_END.split(self._begun + data)
        for piece, end in zip(pieces[::2], pieces[1::2], strict=True):
            line = _cut(piece)
            content = _read(line, self._words)
            if isinstance(content, CanFrame):
                frames.append(content)
            elif content is None:
                damaged += 1
            elif line or end == b"\r":  # nothing stands before a BEL
                other.append(content)
            if end == b"\x07":
                other.append(BEL)
        self._begun = _cut(tail)
        return DecodedLines(frames, other, damaged)


def _cut(line: bytes) -> bytes:
    """Return a line without the LF of the line before, cut behind the bytes that are too many."""
    return line.lstrip(b"\n")[: LINE_LIMIT_BYTES + 1]


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


class HostText:
    """The host's end of an adapter's line.

    The first line may be cut at its beginning, so that its damage is not counted. The adapter's answers come in the
    order of the commands: BEL in answer to none refuses a frame.
    """

    def __init__(self) -> None:
        self._records, self._lines = FrameDecoder(), LineDecoder()
        self._joined = False
        self._pending = deque[str]()  # commands to the adapter itself, not answered yet

    def sent(self, data: bytes) -> bytes:
        """Return the text for records of the host."""
        out: list[bytes] = []
        for message in self._records.feed(data).messages:
            if isinstance(message, CanFrame):
                out.append(encode(message))
                continue
            kind, number = message
            commands = ["", "C", BIT_RATES[number], "O"] if kind is AdapterMessage.OPEN else ["C"]
            self._pending += commands
            out += [f"{command}\r".encode() for command in commands]
        return b"".join(out)

    def received(self, text: bytes) -> bytes:
        """Return the records for text of the adapter."""
        joins = not self._joined and _LINE_END.search(text)
        cut = joins.end() if joins else 0
        self._joined = self._joined or cut > 0
        first, tail = self._lines.feed(text[:cut]), self._lines.feed(text[cut:])
        frames, other = first.frames + tail.frames, first.other_lines + tail.other_lines
        out = self._answered(other)
        if frames:
            self._pending.clear()  # the bus is open
        if tail.damaged:
            out += adapter_message(AdapterMessage.DAMAGED, tail.damaged)
        return out + record_of(*frames)

    def _answered(self, lines: list[str]) -> bytes:
        out, refused = b"", 0
        for line in lines:
            if line in ("", BEL):
                refused += line == BEL and not self._pending
                if (self._pending.popleft() if self._pending else "") == "O":
                    out += adapter_message(AdapterMessage.OPEN_REFUSED if line == BEL else AdapterMessage.OPENED)
            elif line in ("z", "Z"):  # a frame was sent: earlier commands to the adapter are not pending any more
                self._pending.clear()
        return out + (adapter_message(AdapterMessage.REFUSED, refused) if refused else b"")


class AdapterText:
    """The adapter's end of its line."""

    def __init__(self) -> None:
        self._records, self._lines = FrameDecoder(), LineDecoder(of_host=True)
        self._bitrate = 0

    def received(self, text: bytes) -> tuple[bytes, bytes]:
        """Return the records for text of the host, and the adapter's answers as text."""
        found = self._lines.feed(text)
        answers, out = BEL.encode() * found.damaged, b""
        for line in found.other_lines:
            if line[:1] == "S":
                self._bitrate = next((rate for rate, command in BIT_RATES.items() if command == line), 0)
            if line[:1] in {"O", "C"}:
                kind = AdapterMessage.OPEN if line[0] == "O" else AdapterMessage.CLOSE
                out += adapter_message(kind, self._bitrate if line[0] == "O" else 0)
            answers += {"V": b"V1013\r", "N": b"N4F1C\r"}.get(line[:1], b"\r")
        for frame in found.frames:
            answers += b"Z\r" if frame.extended else b"z\r"
        return out + record_of(*found.frames), answers

    def sent(self, data: bytes) -> bytes:
        """Return the text for records of the bus; damaged records are a damaged line."""
        found = self._records.feed(data)
        return b"?\r" * found.damaged + b"".join(map(encode, found.frames))
