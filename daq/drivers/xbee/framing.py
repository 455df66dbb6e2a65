# pyright: strict
"""XBee API frames on a serial line: bytes in, frame data out, and the other way round.

On the line stands ``7E``, the length of the frame data (u16, big endian), the frame data, and a checksum: FFh less the
low byte of the data's sum. With escapes (AP=2) every ``7E 7D 11 13`` behind the start is sent as ``7D`` and itself
^ 20h; length and checksum are of the data before that.
"""

from __future__ import annotations

from dataclasses import dataclass

START, ESCAPE = 0x7E, 0x7D
SPECIAL = frozenset((START, ESCAPE, 0x11, 0x13))
"""What AP=2 never sends as it is, but for the start."""
MAX_FRAME_BYTES = 300
"""Longest frame data taken: a payload of 250 bytes behind the longest head, with room for an answer of the module."""


def encode(data: bytes, *, escaped: bool) -> bytes:
    """Frame data as they go over the line.

    Args:
        data: of at most 65535 bytes.
        escaped: AP=2.
    """
    behind = len(data).to_bytes(2, "big") + data + bytes([0xFF - (sum(data) & 0xFF)])
    if escaped:
        behind = b"".join(bytes((ESCAPE, b ^ 0x20)) if b in SPECIAL else bytes((b,)) for b in behind)
    return bytes((START,)) + behind


@dataclass(frozen=True)
class Damage:
    """A place of the line that holds no sound frame.

    Attributes:
        reason: "checksum", "length", "garbage" (bytes between frames), and with escapes "cut" (a frame begins before
            the one before it is whole) or "escape" (an escape that none needs, or a byte that needs one).
    """

    reason: str


class _Broken(Exception):
    """What begins here is no frame, as far as `end`."""

    def __init__(self, reason: str, end: int) -> None:
        super().__init__(reason)
        self.reason, self.end = reason, end


class ApiDecoder:
    """Bytes of the line in, frame data out; the split into calls makes no difference, memory is bounded.

    A start that turns out to begin no sound frame is dropped alone and the search goes on behind it, so that a damaged
    length costs no frame but its own. What fails within the bytes that the damaged frame may have had is the same
    damage and not counted again. Nor is the rest of a frame in whose middle a log begins; without escapes, where a
    start may be data, that is whatever fails within a frame's length before the first sound frame.

    Args:
        escaped: AP=2.
    """

    def __init__(self, *, escaped: bool) -> None:
        self._escaped = escaped
        self._line = bytearray()  # what is not decided yet
        self._before = 0  # how many bytes of the line were
        self._blamed_until = 0 if escaped else MAX_FRAME_BYTES  # starts before it are no new damage …
        self._excused_until = 2 * MAX_FRAME_BYTES  # … nor are other bytes before it
        self._garbage = 0

    def feed(self, data: bytes) -> list[bytes | Damage]:
        """Decode the next bytes of the line.

        Returns:
            Frame data and damages in the order of the line.
        """
        self._line += data
        found: list[bytes | Damage] = []
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

    def _blame(self, broken: _Broken, found: list[bytes | Damage]) -> None:
        """Report a damage unless it is part of one reported before."""
        if self._before < self._blamed_until:
            return
        found.append(Damage(broken.reason))
        self._blamed_until = self._excused_until = self._before + broken.end
        if broken.reason == "length":  # nobody knows how long it was
            self._blamed_until = self._excused_until = self._before + MAX_FRAME_BYTES
        if self._escaped:  # a start is always one, and what stands before the next one belongs to this frame
            self._blamed_until = self._before + 1
            self._excused_until = self._before + 2 * MAX_FRAME_BYTES

    def _drop(self, count: int) -> None:
        del self._line[:count]
        self._before += count

    def _skip(self, count: int, found: list[bytes | Damage]) -> None:
        """Pass over bytes before a start."""
        while count:
            step = min(count, MAX_FRAME_BYTES - self._garbage)
            fresh = min(step, max(0, self._before + step - self._excused_until))
            self._drop(step)
            self._garbage += fresh
            count -= step
            if self._garbage >= MAX_FRAME_BYTES:
                self._end_garbage(found)

    def _end_garbage(self, found: list[bytes | Damage]) -> None:
        if self._garbage:
            found.append(Damage("garbage"))
            self._garbage = 0

    def _frame(self) -> tuple[bytes, int] | None:
        """Frame data of the frame that begins here and where it ends on the line; None when it is not whole yet.

        Raises:
            _Broken: none begins here.
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
        """The bytes behind the start, escapes undone, as many of `count` as have come, and where they end on the line.

        Raises:
            _Broken: they hold what no frame with escapes does.
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
