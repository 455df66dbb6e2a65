"""Decoding of bytes from an RF60x sensor to packets.

Complete packets with consecutive numbers are decoded with numpy, all other bytes one by one. Both give the same results
for the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig_drivers.riftek.wire import NUMBERS, RESULT_BYTES, UPDATED

_ANSWER, _ANSWER_MASK = 0x80, 0xC0
_JOINING = RESULT_BYTES - 1  # bytes of a packet that was cut because reception began within it
_WINDOW, _WINDOW_LIMIT = 16, 4096  # packets tested at once: few after damage, more without


class ResultRow(NamedTuple):
    """One result of a stream.

    Attributes:
        code: the result, 0 … 65535.
        updated: whether it is a new one.
        step: number of packets by which it follows the preceding result, modulo 4: 1 … 4, without answers.
        skipped: number of bytes since the preceding result that do not belong to a packet.
    """

    code: int
    updated: bool
    step: int
    skipped: int


@dataclass(frozen=True)
class DecodedResults:
    """Result of one call of `ResultDecoder.feed`.

    Attributes:
        code: results, int64, shape (n,).
        updated: see Row, bool, shape (n,).
        step, skipped: see Row, int64, shape (n,).
        doubted: indices of results whose packet turned out to be too long, from the first of these results; -1 is the
            last result of the preceding call.
        answers: data of answers.
        skipped_bytes: number of bytes that do not belong to a packet.
    """

    code: NDArray[np.int64]
    updated: NDArray[np.bool_]
    step: NDArray[np.int64]
    skipped: NDArray[np.int64]
    doubted: tuple[int, ...]
    answers: tuple[bytes, ...]
    skipped_bytes: int


_Block = tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]


class ResultDecoder:
    """Decode the bytes of one sensor to results and answers. The result does not depend on the split into calls.

    A packet is a run of exactly four bytes with the same high half. A run of eight bytes is two packets with three lost
    between them. If the preceding packet was complete, a packet is returned with its fourth byte. After damage the
    beginning of a packet is unknown: a packet is then returned when the byte after it has ended the run. A run of any
    other length makes a packet of it that was already returned doubtful: either this packet is complete and the
    following bytes belong to a damaged one, or bytes of two packets have merged.
    """

    def __init__(self) -> None:
        self._head = 0  # high half of the present run; 0 without a run
        self._run = bytearray()  # data of its bytes, at most those of two packets
        self._length, self._whole = 0, RESULT_BYTES  # bytes of the run, and of the expected packet
        self._longest = 2 * RESULT_BYTES  # largest valid length of a run
        self._ended_well = False  # whether the preceding run consisted of complete packets
        self._wanted: int | None = None  # bytes of the expected answer; None without one
        self._answering = False  # whether the run is that answer
        self._sure = False  # whether the run begins with the first byte of a packet
        self._number: int | None = None  # number of the last packet
        self._owed = 0  # packets lost before an answer, to be added to the step of the next result
        self._joining = _JOINING
        self._since = 0  # bytes skipped since the last result
        self._window = _WINDOW
        self._clear()

    def _clear(self) -> None:
        self._blocks: list[_Block] = []
        self._rows: list[ResultRow] = []
        self._count = 0
        self._doubted: list[int] = []
        self._answers: list[bytes] = []
        self._skipped = 0

    def expect(self, wire_bytes: int | None) -> None:
        """Set the length of the answer that the next packet without a new result is; None for no answer."""
        self._wanted = wire_bytes

    def feed(self, data: bytes) -> DecodedResults:
        """Decode the next bytes of the line.

        Args:
            data: any number of bytes, in the order of arrival.
        """
        self._clear()
        position = 0
        while position < len(data):
            if self._at_boundary and len(data) - position >= RESULT_BYTES:
                taken = self._take_clean(data, position)
                position += RESULT_BYTES * taken
                if taken:
                    continue
            self._byte(data[position])
            position += 1
            while position < len(data) and not self._at_boundary:
                self._byte(data[position])
                position += 1
        self._close_block()
        columns = self._blocks[0] if len(self._blocks) == 1 else _joined(self._blocks)
        return DecodedResults(*columns, tuple(self._doubted), tuple(self._answers), self._skipped)

    @property
    def _at_boundary(self) -> bool:
        """Whether a packet has just been returned and the next one should begin."""
        return self._sure and self._length == self._whole and self._wanted is None

    def _take_clean(self, data: bytes, position: int) -> int:
        """Decode consecutive complete packets with consecutive numbers, at most a window; return their number."""
        count = min(self._window, (len(data) - position) // RESULT_BYTES)
        rows = np.frombuffer(data, np.uint8, RESULT_BYTES * count, position).reshape(count, RESULT_BYTES)
        heads = rows[:, 0] & 0xF0
        assert self._number is not None
        numbers = ((np.arange(1, count + 1) + self._number) & 3).astype(np.uint8)
        good = (heads & 0xB0) == (0x80 | numbers << 4)
        good &= ((rows & 0xF0) == heads[:, None]).all(axis=1)
        taken = count if good.all() else int(good.argmin())
        if taken < count:
            self._window = _WINDOW
        elif taken == self._window:
            self._window = min(2 * self._window, _WINDOW_LIMIT)
        if not taken:
            return 0
        self._close_block()
        four = (rows[:taken] & 0x0F).astype(np.int64)
        code = four[:, 0] | four[:, 1] << 4 | four[:, 2] << 8 | four[:, 3] << 12
        step, skipped = np.ones(taken, np.int64), np.zeros(taken, np.int64)
        step[0] += self._owed
        skipped[0] = self._since
        self._owed = self._since = 0
        self._blocks.append((code, (heads[:taken] & UPDATED) != 0, step, skipped))
        self._count += taken
        self._head, self._number = int(heads[taken - 1]), int(numbers[taken - 1])
        self._length = self._whole = RESULT_BYTES
        self._longest = 2 * RESULT_BYTES
        self._run = bytearray(RESULT_BYTES)
        self._answering = False
        return taken

    def _byte(self, byte: int) -> None:
        head = byte & 0xF0 if byte >= 0x80 else 0
        if head != self._head or not head:
            self._end_run()
            self._begin_run(head)
        if not head:
            self._skip(1)
            return
        self._length += 1
        if self._length <= self._longest:
            self._run.append(byte & 0x0F)
            if self._length == self._whole and self._sure:
                self._packet(self._run[: self._whole])
        elif self._length == self._longest + 1 and not self._answering:
            self._too_long()
        else:
            self._skip(1)

    def _begin_run(self, head: int) -> None:
        self._head, self._length = head, 0
        self._run.clear()
        self._answering = self._wanted is not None and head & _ANSWER_MASK == _ANSWER
        self._whole = self._wanted if self._answering and self._wanted is not None else RESULT_BYTES
        self._longest = self._whole if self._answering else 2 * self._whole
        self._sure = self._ended_well or self._answering

    def _end_run(self) -> None:
        """End the run: it is one packet, two packets, or damage after which the beginning of a packet is unknown."""
        length, whole = self._length, self._whole
        self._ended_well = bool(self._head) and length in (whole, self._longest)
        if self._ended_well:
            if not self._sure:
                self._packet(self._run[:whole])
            if length > whole:
                self._packet(self._run[whole:])
        elif length < whole:
            self._skip(length)
        elif length < self._longest:
            self._too_long()

    def _too_long(self) -> None:
        """Skip the bytes of packets that cannot be separated; a packet that was already returned becomes doubtful."""
        if self._sure:
            self._doubted.append(self._count - 1)
        self._skip(self._length - (self._whole if self._sure else 0))

    def _packet(self, halves: bytearray) -> None:
        number = self._head >> 4 & 3
        lost = 0 if self._number is None else (number - self._number - 1) % NUMBERS
        self._number, self._joining = number, 0
        if self._answering:
            self._owed += lost
            self._wanted = None
            self._answers.append(_bytes_of(halves))
            return
        low, high = _bytes_of(halves)
        self._rows.append(ResultRow(low | high << 8, bool(self._head & UPDATED), 1 + lost + self._owed, self._since))
        self._count += 1
        self._owed = self._since = 0

    def _skip(self, count: int) -> None:
        """Count bytes that do not belong to a packet, except those of a packet that began before the reception."""
        joining = min(count, self._joining)
        self._joining -= joining
        self._skipped += count - joining
        self._since += count - joining

    def _close_block(self) -> None:
        if self._rows:
            code, updated, step, skipped = zip(*self._rows, strict=True)
            self._blocks.append(
                (
                    np.array(code, np.int64),
                    np.array(updated, np.bool_),
                    np.array(step, np.int64),
                    np.array(skipped, np.int64),
                )
            )
            self._rows = []


def _joined(blocks: list[_Block]) -> _Block:
    whole = [(np.empty(0, np.int64), np.empty(0, np.bool_), np.empty(0, np.int64), np.empty(0, np.int64)), *blocks]
    return (
        np.concatenate([block[0] for block in whole]),
        np.concatenate([block[1] for block in whole]),
        np.concatenate([block[2] for block in whole]),
        np.concatenate([block[3] for block in whole]),
    )


def _bytes_of(halves: bytearray) -> bytes:
    return bytes(low | high << 4 for low, high in zip(halves[::2], halves[1::2], strict=True))
