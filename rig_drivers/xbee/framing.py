"""XBee API frames on a serial line: decoding of bytes to frame data, and encoding.

A frame on the line consists of ``7E``, the length of the frame data (u16, big endian), the frame data, and a checksum:
FFh minus the low byte of the sum of the data. With escapes (AP=2) every byte ``7E 7D 11 13`` after the start is sent as
``7D`` followed by the byte ^ 20h. Length and checksum refer to the data without escapes.
"""

from __future__ import annotations

from dataclasses import dataclass

START, ESCAPE = 0x7E, 0x7D
SPECIAL = frozenset((START, ESCAPE, 0x11, 0x13))
"""Bytes that AP=2 escapes, except for the start of a frame."""
MAX_FRAME_BYTES = 300
"""Longest accepted frame data: a payload of 250 bytes after the longest head, with room for an answer of the module."""


def encode(data: bytes, *, escaped: bool) -> bytes:
    """Encode frame data for the line.

    Args:
        data: frame data, at most 65535 bytes.
        escaped: whether bytes are escaped (AP=2).
    """
    tail = len(data).to_bytes(2, "big") + data + bytes([0xFF - (sum(data) & 0xFF)])
    if escaped:
        tail = b"".join(bytes((ESCAPE, b ^ 0x20)) if b in SPECIAL else bytes((b,)) for b in tail)
    return bytes((START,)) + tail


@dataclass(frozen=True)
class DamagedPart:
    """A part of the line that does not contain an intact frame.

    Attributes:
        reason: "checksum", "length", "garbage" (bytes between frames), and with escapes "cut" (a frame begins before
            the preceding one is complete) or "escape" (an unnecessary or a missing escape).
    """

    reason: str


class _Broken(Exception):
    """The bytes from the present start to `end` are not a frame."""

    def __init__(self, reason: str, end: int) -> None:
        super().__init__(reason)
        self.reason, self.end = reason, end


class ApiDecoder:
    """Decode the bytes of the line to frame data. The result does not depend on the split into calls.

    Memory is bounded. A start without an intact frame is dropped alone and the search continues after it, so a damaged
    length affects only its own frame. Further failures within the bytes that the damaged frame may have had belong to
    the same damage and are not counted again. Nor is the rest of a frame counted in which a log begins. Without escapes
    a start may be data; then failures within a frame's length before the first intact frame are not counted.

    Args:
        escaped: whether bytes are escaped (AP=2).
    """

    def __init__(self, *, escaped: bool) -> None:
        self._escaped = escaped
        self._line = bytearray()  # bytes that are not decided yet
        self._before = 0  # number of bytes that were decided
        self._blamed_until = 0 if escaped else MAX_FRAME_BYTES  # starts before this position are not new damage …
        self._excused_until = 2 * MAX_FRAME_BYTES  # … nor are other bytes before this position
        self._garbage = 0

    def feed(self, data: bytes) -> list[bytes | DamagedPart]:
        """Decode the next bytes of the line.

        Returns:
            Frame data and damages in the order of the line.
        """
        self._line += data
        found: list[bytes | DamagedPart] = []
        while self._line:
            start = self._line.find(START)
            self._skip(len(self._line) if start < 0 else start, found)
            if start < 0:
                break
            try:
                frame = self._frame()
            except _Broken as broken:
                self._end_garbage(found)
                self._blame(broken, found)
                self._drop(1)
                continue
            if frame is None:
                break
            self._end_garbage(found)
            content, end = frame
            found.append(content)
            self._drop(end)
            self._blamed_until = self._excused_until = self._before
        return found

    def _blame(self, broken: _Broken, found: list[bytes | DamagedPart]) -> None:
        """Report a damage unless it is part of a damage that was already reported."""
        if self._before < self._blamed_until:
            return
        found.append(DamagedPart(broken.reason))
        self._blamed_until = self._excused_until = self._before + broken.end
        if broken.reason == "length":  # the true length of the frame is unknown
            self._blamed_until = self._excused_until = self._before + MAX_FRAME_BYTES
        if self._escaped:  # a start byte is never data, and the bytes before the next one belong to this frame
            self._blamed_until = self._before + 1
            self._excused_until = self._before + 2 * MAX_FRAME_BYTES

    def _drop(self, count: int) -> None:
        del self._line[:count]
        self._before += count

    def _skip(self, count: int, found: list[bytes | DamagedPart]) -> None:
        """Skip bytes before a start."""
        while count:
            step = min(count, MAX_FRAME_BYTES - self._garbage)
            fresh = min(step, max(0, self._before + step - self._excused_until))
            self._drop(step)
            self._garbage += fresh
            count -= step
            if self._garbage >= MAX_FRAME_BYTES:
                self._end_garbage(found)

    def _end_garbage(self, found: list[bytes | DamagedPart]) -> None:
        if self._garbage:
            found.append(DamagedPart("garbage"))
            self._garbage = 0

    def _frame(self) -> tuple[bytes, int] | None:
        """Return the data of the frame that begins here and its end on the line; None if it is incomplete.

        Raises:
            _Broken: no frame begins here.
        """
        head, end = self._plain(2)
        if len(head) < 2:
            return None
        length = int.from_bytes(head, "big")
        if not 1 <= length <= MAX_FRAME_BYTES:
            raise _Broken("length", end)
        size = 2 + length + 1
        frame, end = self._plain(size)
        if len(frame) < size:
            return None
        if sum(frame[2:]) & 0xFF != 0xFF:
            raise _Broken("checksum", end)
        return frame[2:-1], end

    def _plain(self, count: int) -> tuple[bytes, int]:
        """Return up to `count` bytes after the start with escapes undone, and their end on the line.

        Raises:
            _Broken: the bytes are impossible in a frame with escapes.
        """
        if not self._escaped:
            return bytes(self._line[1 : 1 + count]), 1 + count
        out, i, line = bytearray(), 1, self._line
        while len(out) < count and i < len(line):
            byte = line[i]
            if byte in SPECIAL:
                if byte == START:
                    raise _Broken("cut", i)
                if byte != ESCAPE:
                    raise _Broken("escape", i)
                if i + 1 == len(line):
                    break
                if line[i + 1] == START:
                    raise _Broken("cut", i + 1)
                i += 1
                byte = line[i] ^ 0x20
                if byte not in SPECIAL:
                    raise _Broken("escape", i)
            out.append(byte)
            i += 1
        return bytes(out), i
