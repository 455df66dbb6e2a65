"""Decision about the words of a laser's stream after an answer on its line has announced other words.

Such an answer can be correct, late, damaged or false, and the stream continues after it without a pause. The stream
itself therefore decides. The bytes that follow are decoded with the old words and with the announced words until one
of the two has given a few blocks without surplus bytes that continue one another. No sample is returned before the
decision; afterwards all bytes are decoded with the words that fit. The decision depends on the bytes alone, not on
their split into reads.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.drivers.optoncdt import sensor_answers, wire as optoncdt

_MIN_BLOCKS = 3  # consecutive blocks that decide
_MAX_BYTES = 4096  # undecided after this many bytes, the old words are kept


def _continues(before: NDArray[np.int64], after: NDArray[np.int64]) -> bool:
    """Whether counter and timestamp are those of the next sample, at any rate of a sensor."""
    counts, ticks = (after - before).tolist()
    wraps = optoncdt.COUNTER_WRAP, optoncdt.TIMESTAMP_WRAP
    return counts % wraps[0] == 1 and 0 < ticks % wraps[1] < 1.0 / optoncdt.TICK_S


@dataclass
class _Reading:
    """Decoding of the stream with one choice of words.

    Attributes:
        decoder: decoder with these words.
        row: number of consecutive blocks without surplus bytes.
        chain: number of consecutive blocks whose counter and timestamp continue.
        last: counter and ticks of the last block; None before the first.
    """

    decoder: optoncdt.BlockDecoder
    row: int = 0
    chain: int = 0
    last: NDArray[np.int64] | None = None

    def feed(self, byte: bytes) -> list[str]:
        """Take one byte; return the lines of text that it completes."""
        found = self.decoder.feed(byte)
        if found.skipped_bytes:
            self.row, self.chain, self.last = 0, 0, None
        places = sensor_answers.places_of(self.decoder.words)
        for values in found.values:
            self.row += 1
            if places is None:
                continue
            tick = int(optoncdt.timestamp_ticks(values[places.low], values[places.high]))
            now = np.array([int(values[places.counter]), tick], np.int64)
            self.chain = self.chain + 1 if self.last is not None and _continues(self.last, now) else 1
            self.last = now
        return found.text

    @property
    def rank(self) -> int:
        """2 if counter and timestamp continue from block to block, 1 if the blocks have the right length, else 0."""
        return 2 if self.chain >= _MIN_BLOCKS else 1 if self.row >= _MIN_BLOCKS else 0


class WordsTrial:
    """A pending decision between old and announced words.

    Args:
        decoder: decoder that has stopped after the answer; it is not changed.
        announced: words that the answer announces.

    Attributes:
        announced: words of the last such answer. An answer that comes before the decision replaces the earlier one.
        held: bytes since the first answer.
    """

    def __init__(self, decoder: optoncdt.BlockDecoder, announced: tuple[str, ...]) -> None:
        self.held: bytes = b""
        self._old = _Reading(copy.deepcopy(decoder))
        self._old.decoder.follow_answers = False
        self._compare(announced)

    def _compare(self, announced: tuple[str, ...]) -> None:
        self.announced = announced
        self._new = _Reading(optoncdt.BlockDecoder(announced))
        self._new.decoder.feed(self._old.decoder.unread)

    def feed(self, data: bytes) -> tuple[bool | None, list[str], bytes]:
        """Take bytes until the decision.

        Returns:
            True for the announced words, False for the old words, None while undecided; lines of text among the bytes
            taken; bytes not taken.
        """
        lines: list[str] = []
        for at in range(len(data)):
            byte = data[at : at + 1]
            self.held += byte
            ended = self._old.feed(byte)
            self._new.feed(byte)
            for line in ended:
                if (announced := sensor_answers.announced(line)) is not None:
                    self._compare(announced)
            lines += ended
            old, new = self._old.rank, self._new.rank
            if max(old, new):
                return new >= old, lines, data[at + 1 :]
            if len(self.held) >= _MAX_BYTES:
                return False, lines, data[at + 1 :]
        return None, lines, b""
