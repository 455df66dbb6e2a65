"""Marks and times of a rotor that contradict the number of samples or of turns: clock steps, bounces, missing turns.

The bytes are those of a sender written for these tests: a rotor at 900 rpm and more, with blocks of 29 samples and
marks at the instants at which it passes its index.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.drivers.index_marks import SHORTEST_NS, MarkSequence, lost_turns
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.items import RX, Batch, DeviceEvent
from rig_configs import load_rig

CONFIG = load_rig("virtual").devices["encoder"]
START_NS = 1_700_000_000_000_000_000
N, PERIOD_US = 29, 1000


def turns_at(seconds: float) -> float:
    """Turns of a rotor that speeds up from 15 to 18 turns per second."""
    return 15.0 * seconds + 0.15 * seconds**2


def instants(until_s: float) -> list[float]:
    """True times of the index marks."""
    fine = np.arange(0.0, until_s, 1e-4)
    found = np.interp(np.arange(1, int(turns_at(until_s))), turns_at(fine), fine)
    return found.tolist()


@dataclass
class Sender:
    """A node that counts samples exactly, and stamps blocks and marks by its clock.

    Attributes:
        step_s, step_at_s: step of its clock.
        bounce_s: time from a mark to the second one of a bouncing index.
        unseen: numbers of marks that the node does not see.
        lost_blocks: numbers of blocks that are lost on air.
        delay_s: of a frame.
    """

    step_s: float = 0.0
    step_at_s: float = 4.0
    bounce_s: float = 0.0
    bounces: Callable[[int], bool] = lambda n: True
    unseen: frozenset[int] = frozenset()
    lost_blocks: frozenset[int] = frozenset()
    delay_s: Callable[[int], float] = lambda n: 1e-3
    true_s: list[float] = field(default_factory=lambda: instants(8.0))

    def clock_us(self, true_s: float) -> int:
        return round((true_s + (self.step_s if true_s >= self.step_at_s else 0.0)) * 1e6) + 1_000_000

    def frames(self) -> Iterator[tuple[float, bytes]]:
        marks, revolutions = list[tuple[float, int, int]](), 0
        for n, at in enumerate(self.true_s):
            if n not in self.unseen:
                revolutions += 1
                marks.append((at, 1, revolutions))
                if self.bounce_s and self.bounces(n):
                    revolutions += 1
                    marks.append((at + self.bounce_s, 1, revolutions))
        ends = [((k + 1) * N * PERIOD_US * 1e-6, 0, k) for k in range(int(8.0 / (N * PERIOD_US * 1e-6)))]
        for seq, (at, is_mark, number) in enumerate(heapq.merge(marks, ends)):
            if is_mark:
                yield at + self.delay_s(seq), rotorlink.IndexMark(1, seq, self.clock_us(at), number).pack()
            elif number not in self.lost_blocks:
                counts = np.zeros((N, 2), np.int32)
                first_us = self.clock_us(at - N * PERIOD_US * 1e-6)
                yield (
                    at + self.delay_s(seq),
                    rotorlink.EncoderBlock(1, seq, number * N, first_us, PERIOD_US, 0, counts).pack(),
                )


class Received:
    """What a pipeline has made of a sender's bytes."""

    def __init__(self, sender: Sender) -> None:
        self.pipeline = NodePipeline("encoder", CONFIG, {})
        self.items: list[Batch | DeviceEvent] = []
        for at_s, frame in sender.frames():
            self.items += self.pipeline.feed(RX, rotorlink.wire(frame), START_NS + round(at_s * 1e9))
        self.items += self.pipeline.feed(RX, b"", START_NS + 9_000_000_000)

    def column(self, name: str, topic: str) -> np.ndarray:
        found = [b for b in self.items if isinstance(b, Batch) and b.channel.topic == topic]
        return np.concatenate([b.time_ns if name == "time_ns" else b.columns[name] for b in found])

    def events(self, kind: str) -> list[DeviceEvent]:
        return [item for item in self.items if isinstance(item, DeviceEvent) and item.kind == kind]

    def mark_s(self) -> np.ndarray:
        return self.column("node_time_us", "tacho") * 1e-6 - 1.0


@pytest.mark.parametrize("step_s", [0.05, -0.05, 0.3, -0.3, 0.005])
@pytest.mark.parametrize("step_at_s", [4.0, 4.0125, 4.02])
@pytest.mark.parametrize("lost", [frozenset[int](), frozenset(range(136, 140))])
def test_a_step_of_the_node_s_clock_is_an_event_and_later_times_are_right(
    step_s: float, step_at_s: float, lost: frozenset[int]
) -> None:
    sender = Sender(step_s=step_s, step_at_s=step_at_s, lost_blocks=lost)
    found = Received(sender)
    (event,) = found.events("clock")
    assert event.facts["step_s"] == pytest.approx(step_s, abs=2e-6)
    assert abs((event.facts["time_ns"] - START_NS) * 1e-9 - step_at_s) < (len(lost) + 2) * 0.03
    assert found.pipeline.losses["clock_steps"] == 1
    index, own_us = found.column("index", "pendulums"), found.column("node_time_us", "pendulums").astype(np.int64)
    assert np.array_equal(own_us - own_us[0], index * PERIOD_US)
    off = np.abs(found.mark_s() - np.array(sender.true_s))
    assert np.count_nonzero(off > 2e-6) <= (abs(step_s) < 0.01), "less than a block may hide in one"
    assert not found.events("restart")
    assert np.max(np.abs(found.column("time_ns", "tacho") - START_NS - np.array(sender.true_s) * 1e9)) < 60e6


def test_jitter_of_time_stamps_and_a_rounded_period_are_no_steps() -> None:
    class Rounded(Sender):
        def clock_us(self, true_s: float) -> int:
            return round(true_s * 1e6 * 1.0004 + 450 * np.sin(1e3 * true_s)) + 1_000_000

    assert not Received(Rounded(lost_blocks=frozenset(range(50, 90)))).events("clock")


@pytest.mark.parametrize("bounce_s", [0.0005, 0.003, 0.012])
@pytest.mark.parametrize("bounces", [lambda n: True, lambda n: n % 7 == 3])
def test_a_mark_that_bounces_counts_once(bounce_s: float, bounces: Callable[[int], bool]) -> None:
    sender = Sender(bounce_s=bounce_s, bounces=bounces)
    found = Received(sender)
    times = found.mark_s()
    doubled = [bounces(n) for n in range(len(sender.true_s))]
    first = int(doubled[0])  # before the first turn nothing shows the bounce of the first mark
    assert np.allclose(np.delete(times, 1) if first else times, sender.true_s, atol=2e-6)
    turns = found.column("revolutions", "tacho")
    assert np.array_equal(np.diff(turns), np.ones(len(turns) - 1))
    assert found.pipeline.losses["doubled_marks"] == sum(doubled) - first
    events = found.events("marks")
    assert 1 <= len(events) <= 9, "at most one each second"
    assert events[0].facts["span_s"] == pytest.approx(bounce_s, abs=2e-6)


@pytest.mark.parametrize("unseen", [frozenset({40}), frozenset({40, 41})])
def test_turns_that_the_node_did_not_count_are_an_event(unseen: frozenset[int]) -> None:
    found = Received(Sender(unseen=unseen))
    (event,) = found.events("marks")
    assert event.facts["turns"] == len(unseen) == found.pipeline.losses["turns"]
    assert event.facts["span_s"] == pytest.approx(0.064 * (1 + len(unseen)), rel=0.1)
    assert len(found.mark_s()) == len(Sender().true_s) - len(unseen)


@given(st.floats(0.5, 60.0), st.floats(0.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 0.02), st.integers(0, 2**32 - 1))
def test_no_constant_acceleration_gives_a_bounce_or_a_missing_turn(
    top_Hz: float, first: float, ramp: float, ripple: float, seed: int
) -> None:
    """From rest or from a speed, up or down, with a ripple and with jitter of the marks."""
    turns = np.arange(200) + first
    rising = np.sqrt(turns[turns > 0] * 2 / 40.0) / max(0.02, abs(ramp))  # from rest, up to 40 turns per second²
    times = rising if ramp > 0 else np.arange(200) / top_Hz
    rng = np.random.default_rng(seed)
    step = np.diff(times)
    times = np.cumsum(step * (1 + ripple * rng.standard_normal(len(step)).clip(-3, 3)))
    losses: dict[str, int] = {}
    marks = MarkSequence("encoder", losses)
    for number, at in enumerate(times.tolist()):
        marks.feed(round(at * 1e9), number, round(at * 1e9))
    assert losses == {}


def test_a_lost_turn_needs_even_neighbours() -> None:
    assert lost_turns(1.0, 2.0, 1.0) == 1
    assert lost_turns(1.0, 3.05, 1.1) == 2
    assert lost_turns(1.0, 2.0, 3.0) == 0, "it slows down"
    assert lost_turns(1.0, 1.5, 1.0) == 0, "no whole turn"
    assert SHORTEST_NS == 50_000_000
