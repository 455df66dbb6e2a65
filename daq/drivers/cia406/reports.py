"""Instants of samples, positions over revolutions, and index marks: the same for both ways of sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Instant:
    """The instant of a sample.

    Attributes:
        number: number of the sample: of its SYNC, or of the encoder's own report.
        time_ns: instant on the common clock, ns since 1970.
        own_ns: instant on the clock that is recorded with the sample, ns: the common clock with SYNC, otherwise the
            encoder's own timer from its first report on.
    """

    number: int
    time_ns: int
    own_ns: int


class Turns:
    """Position of an encoder without the step at the end of a revolution.

    Args:
        per_turn: counts per revolution.
        zero_counts: raw position at the angle 0.
        sign: 1 if raw positions grow with the angle, otherwise -1.
    """

    def __init__(self, per_turn: int, zero_counts: int, sign: int) -> None:
        self._per_turn, self._zero, self._sign = per_turn, zero_counts, sign
        self._counts: int | None = None

    def counts(self, raw: int) -> int:
        """Return the continuous position, counts: the one within half a revolution of the position before."""
        value = self._sign * (raw - self._zero)
        before, half = self._counts or 0, self._per_turn // 2
        self._counts = before + (value - before + half) % self._per_turn - half
        return self._counts


class Marks:
    """Index marks of a shaft encoder: the instants at which its position passes whole revolutions.

    The instant is interpolated linearly between the reports before and after it. A mark occurs in both directions of
    rotation. After a mark the shaft must turn by an eighth of a revolution before the same position gives another one,
    so that a position that flickers around 0 at rest gives one mark only. Reports may be missing: the revolutions in
    between are those of the speed before.

    Args:
        per_turn: counts per revolution.
    """

    _AWAY = 0.125  # of a revolution
    _MOST_PER_NS = 1e-7  # revolutions per ns, 6000 rpm: a faster step is no rotation
    _LONGEST_NS = 1_000_000_000  # after a longer pause the revolutions in between are unknown, and no mark is given

    def __init__(self, per_turn: int) -> None:
        self._per_turn = per_turn
        self._last: Instant | None = None
        self._turns = 0.0  # position of the last report, revolutions
        self._per_ns = 0.0  # speed, revolutions per ns
        self._edge: int | None = None  # revolution of the newest mark, until the shaft has left it

    def feed(self, instant: Instant, counts: int) -> list[tuple[int, int, int]]:
        """Take the next position; return the marks before it: revolution, time and own time, ns (see Instant)."""
        last, self._last = self._last, instant
        position = counts / self._per_turn
        step_ns = 0 if last is None else instant.time_ns - last.time_ns
        if last is None or not 0 < step_ns <= self._LONGEST_NS:
            self._turns, self._per_ns = position, 0.0
            return []
        expected = self._turns + self._per_ns * step_ns
        now = expected + math.remainder(position - expected, 1.0)
        before, self._turns = self._turns, now
        speed = (now - before) / step_ns
        self._per_ns = speed if abs(speed) <= self._MOST_PER_NS else 0.0
        first, final = sorted((before, now))
        edges = range(math.ceil(first), math.floor(final) + 1)
        out: list[tuple[int, int, int]] = []
        for edge in edges if now >= before else reversed(edges):
            if edge in (self._edge, before):
                continue
            share = (edge - before) / (now - before)
            time_ns = round(last.time_ns + share * (instant.time_ns - last.time_ns))
            out.append((edge, time_ns, round(last.own_ns + share * (instant.own_ns - last.own_ns))))
            self._edge = edge
        if self._edge is not None and abs(now - self._edge) > self._AWAY:
            self._edge = None
        return out
