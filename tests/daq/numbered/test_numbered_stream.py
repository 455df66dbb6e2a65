"""Places of numbered messages against a model of sender, line and host that shares no code with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given, strategies as st

from daq.numbered.messages import Count, Stretch, chained
from daq.numbered.stream import NumberedStream

MS = 1_000_000
FOUND_MS = 250.0  # within which a loss is found that only the host's time shows
START_NS = 1_700_000_000_000_000_000


@dataclass
class World:
    """Messages of a sender and their way to the host; the content of a message is its true number.

    Attributes:
        period_ms: true time between two messages.
        size: number of different numbers.
        first: number of the first message.
        sent: messages on the line: time, ms, number as received, true number.
    """

    period_ms: float
    size: int
    first: int = 0
    sent: list[tuple[float, int, int]] = field(default_factory=list[tuple[float, int, int]])

    def send(self, count: int, *, lost: Callable[[int], bool] = lambda k: False) -> World:
        """Send messages 0 … count - 1 at the sender's pace."""
        self.sent += [(k * self.period_ms, (self.first + k) % self.size, k) for k in range(count) if not lost(k)]
        return self

    def read(self, stream: NumberedStream[list[int]], ends_ms: list[float]) -> list[Stretch[list[int]]]:
        """Give the stream what has come by the ends of reads; a stall of the host is a long read."""
        out: list[Stretch[list[int]]] = []
        at = 0
        for end in ends_ms:
            part: list[tuple[float, int, int]] = []
            while at < len(self.sent) and self.sent[at][0] <= end:
                part.append(self.sent[at])
                at += 1
            if part:
                numbers = np.array([number for _, number, _ in part])
                out += stream.feed(numbers, [true for *_, true in part], START_NS + round(end * MS))
        return [*out, *stream.end()]


def reads(until_ms: float, every_ms: float, stalls: Sequence[tuple[float, float]] = ()) -> list[float]:
    """Ends of reads in ms; none within the stalls (begin, duration)."""
    ends = np.arange(every_ms, until_ms + 2 * every_ms, every_ms)
    kept = [end for end in ends.tolist() if not any(begin < end < begin + long for begin, long in stalls)]
    return sorted({*kept, *(begin + long for begin, long in stalls)})


def numbered(count: Count) -> NumberedStream[list[int]]:
    return NumberedStream(count, chained)


def contents(found: list[Stretch[list[int]]]) -> list[int]:
    return chained([stretch.rows for stretch in found])


def offsets(found: list[Stretch[list[int]]]) -> list[int]:
    """Continuous number minus true number of each message."""
    return [int(n) - k for stretch in found for n, k in zip(stretch.numbers, stretch.rows, strict=True)]


def lost(found: list[Stretch[list[int]]]) -> int:
    return sum(stretch.lost for stretch in found)


worlds = st.builds(
    World,
    period_ms=st.sampled_from([0.25, 1.0, 5.0, 42.0]),
    size=st.sampled_from([1, 4, 16, 256, 2**16, 2**32]),
    first=st.integers(0, 2**32),
)
stalls = st.lists(st.tuples(st.floats(0.2, 0.8), st.floats(1.0, 900.0)), max_size=3)


@given(worlds, st.floats(1.0, 40.0), stalls, st.floats(-5e-4, 5e-4), st.booleans())
def test_a_host_that_reads_late_loses_nothing(
    world: World, every_ms: float, late: list[tuple[float, float]], error: float, checked: bool
) -> None:
    """For all numbers of bits, all delays of reads, and with the error of a quartz."""
    assume(world.size > 1 or every_ms < 0.8 * world.period_ms)  # else no read is in time for long
    count = 1500
    end_ms = count * world.period_ms
    stream = numbered(Count(world.size, world.period_ms * (1 + error) * MS, is_checked=checked))
    found = world.send(count).read(stream, reads(end_ms, every_ms, [(at * end_ms, long) for at, long in late]))
    assert contents(found) == list(range(count))
    assert (lost(found), len(set(offsets(found)))) == (0, 1)
    assert not any(stretch.is_restart for stretch in found)


@given(worlds, st.floats(1.0, 10.0), st.lists(st.tuples(st.integers(300, 1200), st.integers(1, 3000)), max_size=2))
def test_lost_messages_are_counted_exactly(world: World, every_ms: float, gaps: list[tuple[int, int]]) -> None:
    """The host reads in time, a cycle of the number is longer than its delay, and one loss is found before the next."""
    assume(world.size * world.period_ms > 4 * (10 + every_ms))
    behind = [
        range(at + sum(n for _, n in gaps[:i]), at + sum(n for _, n in gaps[: i + 1])) for i, (at, _) in enumerate(gaps)
    ]
    apart = max(300, FOUND_MS / world.period_ms)
    assume(all(a.stop + apart < b.start for a, b in pairwise(behind)))
    count = 1500 + sum(n for _, n in gaps)
    stream = numbered(Count(world.size, world.period_ms * MS))
    world.send(count, lost=lambda k: any(k in gap for gap in behind))
    found = world.read(stream, reads(count * world.period_ms, every_ms))
    assert contents(found) == [k for *_, k in world.sent]
    assert (lost(found), len(set(offsets(found)))) == (count - len(world.sent), 1)
    assert not any(stretch.is_restart for stretch in found)


@given(
    worlds,
    st.floats(1.0, 10.0),
    st.floats(130.0, 20_000.0),
    st.integers(0, 2**32),
    st.booleans(),
)
def test_a_sender_that_starts_again_is_seen_and_all_its_messages_are_kept(
    world: World, every_ms: float, off_ms: float, begins: int, checked: bool
) -> None:
    """Its number after the pause is that of a short gap, or of one of whole cycles, by chance only."""
    cycle_ms = world.size * world.period_ms
    assume(cycle_ms > 20 * (10 + every_ms + world.period_ms + 2e-3 * off_ms))
    count = 600
    off = round(off_ms / world.period_ms)
    due = world.first + count + off
    from_due_ms = ((begins - due + world.size // 2) % world.size - world.size // 2) * world.period_ms
    assume(abs(from_due_ms) > 2 * (10 + every_ms + world.period_ms + 2e-3 * off_ms) and (begins - due) % world.size > 8)
    assume(8 < (begins - world.first - count) % world.size < world.size - 1)  # else it goes on counting, or repeats
    assume(from_due_ms > 0 or from_due_ms < -125)  # a smaller lateness may be a delay of the line
    stream = numbered(Count(world.size, world.period_ms * MS, is_checked=checked))
    world.send(count)
    end_ms = (count + off) * world.period_ms
    world.sent += [(end_ms + k * world.period_ms, (begins + k) % world.size, count + k) for k in range(count)]
    found = world.read(stream, reads(end_ms + count * world.period_ms, every_ms))
    assert contents(found) == list(range(2 * count))
    (at,) = (i for i, stretch in enumerate(found) if stretch.is_restart)
    assert found[at].rows[0] == count
    assert len(set(offsets(found[:at]))) == len(set(offsets(found[at:]))) == 1
    assert abs(found[at].lost - off) <= 2 + (every_ms + 1) / world.period_ms + 2e-3 * off


@given(worlds, st.floats(1.0, 20.0), st.lists(st.tuples(st.integers(50, 950), st.integers(1, 2**32)), max_size=4))
def test_damaged_numbers_are_dropped_alone(world: World, every_ms: float, damage: list[tuple[int, int]]) -> None:
    assume(world.size >= 256)
    changes = {at: by % world.size for at, by in damage if by % world.size}
    assume(all(b - a > 5 for a, b in pairwise(sorted(changes))))
    world.send(1000)
    world.sent = [(t, (number + changes.get(k, 0)) % world.size, k) for t, number, k in world.sent]
    stream = numbered(Count(world.size, world.period_ms * MS, is_checked=False))
    found = world.read(stream, reads(1000 * world.period_ms, every_ms))
    assert contents(found) == [k for k in range(1000) if k not in changes]
    assert (stream.damaged, lost(found), len(set(offsets(found)))) == (len(changes), len(changes), 1)
    assert not any(stretch.is_restart for stretch in found)


@given(
    st.sampled_from([1.0, 5.0, 42.0]),
    st.sampled_from([256, 2**16]),
    st.lists(st.tuples(st.integers(50, 950), st.integers(0, 7)), max_size=5),
    st.sets(st.integers(50, 950), max_size=5),
)
def test_messages_that_come_again_or_late_are_dropped_and_counted(
    period_ms: float, size: int, again: list[tuple[int, int]], gone: set[int]
) -> None:
    """A network may keep a packet for a few others, or deliver it twice."""
    world = World(period_ms, size).send(1000, lost=lambda k: k in gone)
    copies = [((k + by) * period_ms + 0.3, k % size, k) for k, by in again if k not in gone and k + by not in gone]
    assume(len({round(t) for t, *_ in copies}) == len(copies))
    world.sent = sorted([*world.sent, *copies])
    stream = numbered(Count(size, period_ms * MS, late_messages=8))
    found = world.read(stream, sorted({t + 0.2 for t, *_ in world.sent}))  # each datagram is read alone
    assert contents(found) == [k for k in range(1000) if k not in gone]
    assert (lost(found), stream.repeated) == (len(gone), len(copies))
    assert not any(stretch.is_restart for stretch in found)


@pytest.mark.parametrize("ratio", [0.125, 0.8, 0.97, 1.03, 1.25, 8.0])
@given(st.sampled_from([1.0, 5.0]), st.floats(1.0, 5.0))
def test_losses_of_a_sender_with_another_rate_are_counted(ratio: float, period_ms: float, every_ms: float) -> None:
    world = World(period_ms * ratio, 2**16).send(4000, lost=lambda k: 2000 <= k < 2020)
    found = world.read(numbered(Count(2**16, period_ms * MS)), reads(4000 * period_ms * ratio, every_ms))
    assert contents(found) == [k for *_, k in world.sent]
    assert (lost(found), len(set(offsets(found)))) == (20, 1)
    assert not any(stretch.is_restart for stretch in found)


@given(
    st.sampled_from([1, 4, 16, 256]),
    st.lists(st.tuples(st.integers(200, 3000), st.integers(1, 2000)), min_size=1, max_size=3),
    stalls,
    st.floats(1.0, 40.0),
    st.booleans(),
)
def test_the_clock_of_the_sender_shows_whole_cycles_although_the_host_reads_late(
    size: int, gaps: list[tuple[int, int]], late: list[tuple[float, float]], every_ms: float, checked: bool
) -> None:
    gone = {k for at, n in gaps for k in range(at, at + n)}
    world = World(1.0, size).send(6000, lost=lambda k: k in gone)
    count = Count(size, 1.0 * MS, clock_size=2**32, clock_step=1000.0, is_checked=checked)
    stream = numbered(count)
    out: list[Stretch[list[int]]] = []
    for end, group in groupby(world.sent, key=_end_of(reads(6000, every_ms, [(6000 * a, b) for a, b in late]))):
        part = list(group)
        times = np.array([2**32 - 1_000_000 + 1000 * k for *_, k in part]) % 2**32
        out += stream.feed(np.array([n for _, n, _ in part]), [k for *_, k in part], START_NS + round(end * MS), times)
    out += stream.end()
    assert contents(out) == [k for *_, k in world.sent]
    assert (lost(out), len(set(offsets(out)))) == (len(gone), 1)


@dataclass
class Packets:
    """Packets of a sender whose radio loses and repeats them; they are read one after the other, with their rows.

    Attributes:
        rows: number of rows in a packet.
        period_ms: time between two rows.
        clock: range of the sender's clock in µs; 0 without one.
    """

    rows: int
    period_ms: float
    clock: int
    came: list[tuple[float, int, int]] = field(default_factory=list[tuple[float, int, int]])

    def arrive(self, packet: int, late: float = 0.0, begins: int = 0) -> None:
        """Receive a packet later than due by a number of packets; the sender began to count at a packet."""
        self.came.append(((packet + 1 + late) * self.rows * self.period_ms, packet, begins))

    def read(self, stream: NumberedStream[list[int]]) -> list[Stretch[list[int]]]:
        out: list[Stretch[list[int]]] = []
        for at_ms, packet, begins in sorted(self.came):
            true = np.arange(self.rows) + self.rows * packet
            since = true - self.rows * begins
            times = np.rint(since * self.period_ms * 1000).astype(np.int64) % self.clock if self.clock else None
            out += stream.feed(since % 2**16, true.tolist(), START_NS + round(at_ms * MS), times)
        return [*out, *stream.end()]

    def stream(self) -> NumberedStream[list[int]]:
        clock = (self.clock, 1000 * self.period_ms) if self.clock else (0, 1.0)
        period_ns = self.period_ms * MS
        return numbered(Count(2**16, period_ns, 1.0, *clock, late_messages=2000, look_ahead_ns=2e9))


packets = st.builds(
    Packets,
    rows=st.sampled_from([1, 4, 16]),
    period_ms=st.sampled_from([2.0, 5.0]),
    clock=st.sampled_from([0, 2**26, 2**32]),
)


@given(
    packets,
    st.dictionaries(st.integers(3, 50), st.integers(1, 3), max_size=12),
    st.sets(st.integers(3, 50), max_size=8),
    st.dictionaries(st.integers(3, 50), st.integers(0, 9), max_size=8),
)
@example(Packets(16, 5.0, 0), {}, {7}, {3: 0, 4: 0, 5: 1, 6: 3})  # copies alone while others wait for a gap
def test_packets_that_come_late_fill_their_gaps_and_copies_are_dropped(
    radio: Packets, late: dict[int, int], gone: set[int], again: dict[int, int]
) -> None:
    """The first late packet shows that the sender sends packets again; without it gaps are not waited for for ever."""
    late = {1: 1} | {k: by for k, by in late.items() if k not in gone}
    for packet in range(60):
        if packet not in gone:
            radio.arrive(packet, late.get(packet, 0) * 1.01)
    copies = {k: by for k, by in again.items() if k not in gone}
    for packet, by in copies.items():
        radio.arrive(packet, late.get(packet, 0) * 1.01 + by + 0.3)
    stream = radio.stream()
    found = radio.read(stream)
    rows = [row for k in range(60) if k not in gone for row in range(radio.rows * k, radio.rows * (k + 1))]
    assert contents(found) == rows
    assert (lost(found), stream.repeated) == (radio.rows * len(gone), radio.rows * len(copies))
    assert len(set(offsets(found))) == 1
    assert not any(stretch.is_restart for stretch in found)


@given(packets, st.floats(600.0, 900.0), st.dictionaries(st.integers(2, 7), st.integers(1, 30), max_size=5))
def test_a_sender_whose_number_and_clock_start_again_is_no_late_one(
    radio: Packets, ran_ms: float, again: dict[int, int]
) -> None:
    """Number and time of the new packets are those of earlier ones; they reach the next ones after the decision."""
    ran = round(ran_ms / (radio.rows * radio.period_ms))
    off = round(300 / (radio.rows * radio.period_ms)) + 1
    for packet in range(ran):
        radio.arrive(packet)
    for packet, by in again.items():
        radio.arrive(packet, min(by, ran - 1 - packet) + 0.3)
    enough = 2 * off
    for packet in range(ran + off, ran + off + enough):
        radio.arrive(packet, begins=ran + off)
    found = radio.read(radio.stream())
    after = radio.rows * (ran + off)
    assert contents(found) == [*range(radio.rows * ran), *range(after, after + radio.rows * enough)]
    assert [stretch.rows[0] for stretch in found if stretch.is_restart] == [after]


def _end_of(ends: list[float]) -> Callable[[tuple[float, int, int]], float]:
    """Return the end of the read that a message belongs to."""
    return lambda message: ends[int(np.searchsorted(ends, message[0]))]
