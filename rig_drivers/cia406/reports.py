"""Instants of samples, positions over revolutions, and index marks: the same for both ways of sampling.

What the identity from the opening of an encoder states about its reports, checked; a log may contain any value.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.errors import DeviceError
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import Encoder


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

    The instant is interpolated linearly between the positions before and after it. A mark occurs in both directions of
    rotation. After a mark the shaft must turn by an eighth of a revolution before the same position gives another one,
    so that a position that flickers around 0 at rest gives one mark only. From one sample to the next the shaft turns
    by less than half a revolution. Where samples are missing, it turns on with the mean speed before.

    Args:
        per_turn: counts per revolution.
        period_ns: period of the samples, ns.
    """

    _AWAY = 0.125  # of a revolution
    _GAP = 1.5  # periods without a position after which some are missing
    _MEAN = 8  # steps over which the speed is averaged: one that is wrong must not count as rotation
    _LEAST = 1 / 512  # of a revolution: smaller movements may be noise of a shaft at rest
    _LONGEST_NS = 1_000_000_000  # after a longer pause the revolutions in between are unknown, and no mark is given

    def __init__(self, per_turn: int, period_ns: int) -> None:
        self._per_turn, self._period_ns, self._gap_ns = per_turn, period_ns, self._GAP * period_ns
        self._last: Instant | None = None
        self._past: deque[tuple[int, float]] = deque(maxlen=self._MEAN + 1)  # time, ns, and revolutions, without a gap
        self._mean_rate, self._mean_ns = 0.0, -self._LONGEST_NS  # newest mean speed, revolutions per ns, and its time
        self._edge: int | None = None  # revolution of the newest mark, until the shaft has left it

    def feed(self, instant: Instant, counts: int) -> list[tuple[int, int, int]]:
        """Take the next position; return the marks before it: revolution, time and own time, ns (see Instant)."""
        last, self._last = self._last, instant
        position = counts / self._per_turn
        step_ns = 0 if last is None else instant.time_ns - last.time_ns
        if last is None or not 0 < step_ns <= self._LONGEST_NS:
            self._past.clear()
            self._past.append((instant.time_ns, position))
            return []
        before = self._past[-1][1]
        expected = before + (self._mean_per_ns() * step_ns if step_ns > self._gap_ns else 0.0)
        now = expected + math.remainder(position - expected, 1.0)
        if step_ns > self._gap_ns:
            self._past.clear()
        self._past.append((instant.time_ns, now))
        out: list[tuple[int, int, int]] = []
        first, final = sorted((before, now))
        edges = range(math.ceil(first), math.floor(final) + 1)
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

    def lateness_ns(self, instant: Instant, counts: int) -> float:
        """Return by how much later than its instant a position was sampled, from the speed before, ns.

        It is 0 if the speed is not known, or so small that noise could be the cause. Whole revolutions are not seen: a
        difference of more than half a revolution may be one in the other direction.
        """
        rate = self._mean_per_ns() if self._past else 0.0
        if abs(rate) * self._MEAN * self._period_ns < self._LEAST:
            return 0.0
        past_ns, position = self._past[-1]
        expected = position + rate * (instant.time_ns - past_ns)
        difference = math.remainder(counts / self._per_turn - expected, 1.0)
        return difference / rate if abs(difference) >= self._LEAST else 0.0

    def _mean_per_ns(self) -> float:
        """Return the mean speed, revolutions per ns, limited; 0 if it is not known.

        With too few positions since the last gap, as on a busy host, it is the one at that gap.
        """
        (from_ns, begin), (to_ns, end) = self._past[0], self._past[-1]
        if len(self._past) > self._MEAN // 2:
            most = 0.5 / self._period_ns
            self._mean_rate, self._mean_ns = min(max((end - begin) / (to_ns - from_ns), -most), most), to_ns
        return self._mean_rate if to_ns - self._mean_ns < self._LONGEST_NS else 0.0


_ANY_POSITION = 2**32
_MAX_OFFSET = 8 - wire.POSITION_BYTES


def positions_of(encoder: Encoder, per_turn: int, identity: Mapping[str, Any]) -> int:
    """Return the number of different positions of an encoder; unlimited if it was not queried."""
    positions = identity.get(f"{encoder.name}_positions", _ANY_POSITION)
    if (
        type(positions) is int
        and 0 < positions <= _ANY_POSITION
        and (positions == _ANY_POSITION or positions % per_turn == 0)
    ):
        return positions
    raise DeviceError(
        f"identity of encoder {encoder.name}: expected a number of positions that is a multiple of {per_turn}, got "
        f"{positions!r:.80}"
    )


def sign_of(encoder: Encoder, identity: Mapping[str, Any]) -> int:
    """Return 1 if positions grow with the angle, also of an encoder that was not queried, otherwise -1."""
    counter_clockwise = identity.get(f"{encoder.name}_counter_clockwise", encoder.positive == "ccw")
    return 1 if bool(counter_clockwise) == (encoder.positive == "ccw") else -1


def offset_of(encoder: Encoder, identity: Mapping[str, Any]) -> int:
    """Return the place of the position in its reports, bytes; 0 if it was not queried."""
    offset = identity.get(f"{encoder.name}_offset", 0)
    if type(offset) is int and 0 <= offset <= _MAX_OFFSET:
        return offset
    raise DeviceError(
        f"identity of encoder {encoder.name}: expected a place of the position from 0 to {_MAX_OFFSET} bytes, got "
        f"{offset!r:.80}"
    )
