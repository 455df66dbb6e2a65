# pyright: strict
"""Which words a laser's stream is made of, after an answer on its line has told of others.

An answer can be true, late, damaged or somebody's joke, and the stream goes on behind it without a pause. So the
stream itself decides: what follows is decoded by the old words and by the told ones, until one of them has given a few
blocks without a byte too many that go on from one another. Until then nothing is handed out; then all is, by the words
that fit. The decision depends on the bytes alone, not on how they were split into reads.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.drivers.optoncdt import wire as optoncdt

_ENOUGH = 3  # blocks in a row
_MOST_BYTES = 4096  # undecided after so many, the old words stay

Follows = Callable[[NDArray[np.int64], NDArray[np.int64]], bool]


@dataclass
class _Reading:
    """The stream as it looks by some words."""

    decoder: optoncdt.StreamDecoder
    row: int = 0
    chain: int = 0
    last: NDArray[np.int64] | None = None

    def feed(self, byte: bytes, follows: Follows) -> list[str]:
        """Take one byte; returns lines of text it ends."""
        found = self.decoder.feed(byte)
        if found.skipped_bytes:
            self.row, self.chain, self.last = 0, 0, None
        places = optoncdt.places_of(self.decoder.words)
        for values in found.values:
            self.row += 1
            if places is None:
                continue
            tick = int(optoncdt.timestamp_ticks(values[places.low], values[places.high]))
            now = np.array([int(values[places.counter]), tick], np.int64)
            self.chain = self.chain + 1 if self.last is not None and follows(self.last, now) else 1
            self.last = now
        return found.text

    @property
    def rank(self) -> int:
        """2: counter and timestamp go on from block to block; 1: the blocks have the right length; 0: neither yet."""
        return 2 if self.chain >= _ENOUGH else 1 if self.row >= _ENOUGH else 0


class WordsTrial:
    """A decision under way.

    Args:
        decoder: as it stopped behind the answer; it is left as it is.
        told: the words the answer told of.
        follows: whether one sample's (counter, ticks) may directly follow another's.

    Attributes:
        told: words of the last such answer; one that comes while it is undecided takes the place of the first.
        held: bytes since the first answer.
    """

    def __init__(self, decoder: optoncdt.StreamDecoder, told: tuple[str, ...], follows: Follows) -> None:
        self.held = b""
        self._follows = follows
        self._old = _Reading(copy.deepcopy(decoder))
        self._old.decoder.heed_answers = False
        self._compare(told)

    def _compare(self, told: tuple[str, ...]) -> None:
        self.told = told
        self._new = _Reading(optoncdt.StreamDecoder(told))
        self._new.decoder.feed(self._old.decoder.unread)

    def feed(self, data: bytes) -> tuple[bool | None, list[str], bytes]:
        """Take bytes until it is decided.

        Returns:
            True for the told words, False for the old ones, None while undecided; lines of text among the bytes
            taken; bytes not taken.
        """
        lines: list[str] = []
        for at in range(len(data)):
            byte = data[at : at + 1]
            self.held += byte
            ended = self._old.feed(byte, self._follows)
            self._new.feed(byte, self._follows)
            for line in ended:
                if (told := optoncdt.announced(line)) is not None:
                    self._compare(told)
            lines += ended
            old, new = self._old.rank, self._new.rank
            if max(old, new):
                return new >= old, lines, data[at + 1 :]
            if len(self.held) >= _MOST_BYTES:
                return False, lines, data[at + 1 :]
        return None, lines, b""
