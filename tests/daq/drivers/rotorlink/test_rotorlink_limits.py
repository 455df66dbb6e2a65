"""Pipeline of a RotorLink node at its limits: counts, times, restarts and events of every kind of frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.items import RX, TX, Batch, DeviceEvent
from rig_configs import load_rig

CONFIG = load_rig("virtual").devices["encoder"]
START_NS = 1_700_000_000_000_000_000
LOST, REPEATS = rotorlink.FLAG_SAMPLES_LOST, rotorlink.FLAG_REPEATS
Items = list[Batch | DeviceEvent]


class Line:
    """A pipeline whose reads arrive at the node's own time, and what it has returned."""

    def __init__(self, identity: dict[str, Any] | None = None, **settings: Any) -> None:
        self.pipeline = NodePipeline("encoder", CONFIG.model_copy(update=settings), identity or {})
        self.items: Items = []

    def at(self, us: int, *frames: bytes) -> Items:
        found = self.pipeline.feed(RX, b"".join(map(rotorlink.wire, frames)), START_NS + 1000 * us)
        self.items += found
        return found

    def mark(self, seq: int, us: int, node: int = 1) -> Items:
        return self.at(us, mark(seq, us, node))

    def end(self) -> Items:
        self.items += (found := self.pipeline.feed(RX, b"", START_NS))
        return found

    def events(self, kind: str) -> list[DeviceEvent]:
        return [item for item in self.items if isinstance(item, DeviceEvent) and item.kind == kind]

    def values(self, name: str) -> list[Any]:
        batches = [item for item in self.items if isinstance(item, Batch) and name in item.columns]
        return [value for batch in batches for value in batch.columns[name].tolist()]

    @property
    def losses(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}


def mark(seq: int, us: int, node: int = 1) -> bytes:
    return rotorlink.IndexMark(node, seq % 65536, us % 2**32, 7).pack()


def block(seq: int, index: int, us: int, n: int = 10, flags: int = 0, period_us: int = 1000) -> bytes:
    counts = np.column_stack([np.arange(n) + index % 1000, np.arange(n)]).astype(np.int32)
    return rotorlink.EncoderBlock(1, seq % 65536, index % 2**32, us % 2**32, period_us, flags, counts).pack()


def wrapped(seq: int, us: int, inner: bytes) -> bytes:
    return rotorlink.Wrapped(0x30, seq, us, -60, rotorlink.parse_node(inner)).pack()


# --- frames lost on air ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("restarts", [False, True])
def test_a_first_block_across_the_wrap_of_the_node_s_clock_has_no_negative_times(restarts: bool) -> None:
    line = Line()
    if restarts:  # the first block after a restart is a first block, too
        line.at(-30_000_000, block(0, 90_000, 30_000_000))
        line.items.clear()
    line.at(5_000, block(1, 0, -4_000))
    line.at(15_000, block(2, 10, 6_000))
    line.end()
    node_us = np.array(line.values("node_time_us"), np.int64)
    assert len(line.events("restart")) == restarts
    assert len(node_us) == 20
    assert np.all(np.diff(node_us) == 1_000)
    assert node_us[0] == 2**32 - 4_000


# --- restarts --------------------------------------------------------------------------------------------------


# --- samples ---------------------------------------------------------------------------------------------------


def test_samples_that_overlap_are_taken_once_with_all_their_columns() -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0))
    line.at(14_000, block(1, 5, 5_000, flags=3))
    assert line.at(14_100, block(2, 5, 5_000), block(3, 0, 0, n=5)) == []
    assert line.values("index") == list(range(15))
    assert line.values("flags") == [0] * 10 + [3] * 5
    assert line.values("count_a") == list(range(15))
    assert line.values("count_b") == [*range(10), *range(5, 10)]
    assert line.values("theta3_rad") == pytest.approx([k * 2 * math.pi / 4096 for k in range(15)])
    assert line.losses == {}


@pytest.mark.parametrize(
    ("index", "us", "flags", "missing"),
    [
        (10, 10_000, LOST, 0),
        (10, 9_000, LOST, 0),
        (10, 13_000, LOST, 3),
        (10, 13_000, 0, 0),
        (10, 13_000, 3 | LOST, 3),
        (10, 13_000, 3, 0),
        (13, 15_000, LOST, 3),  # the index shows how many
        (5, 13_000, LOST, 0),
    ],
)
def test_the_node_s_clock_counts_samples_that_it_lost_only_before_the_next_index(
    index: int, us: int, flags: int, missing: int
) -> None:
    for first in (0, 70_000):
        line = Line()
        line.at(9_000, block(0, first, 0))
        line.at(us + 9_000, block(1, first + index, us, flags=flags))
        line.end()
        steps = {} if flags & LOST else {"clock_steps": 1}
        assert line.losses == ({"samples": missing} if missing else steps)
        assert line.values("index") == [first + k for k in (*range(10), *range(max(10, index), index + 10))]


@pytest.mark.parametrize("n", [5, 10])
def test_a_block_that_brings_nothing_new_leaves_the_time_of_the_next_sample(n: int) -> None:
    line = Line()
    line.at(9_000, block(0, 0, 0))
    line.at(60_000, block(1, 0, 50_000, n=n))
    line.at(62_000, block(2, 10, 53_000, flags=LOST))
    assert line.losses == {"samples": 43}


def test_without_its_angles_or_marks_a_node_gives_only_the_others() -> None:
    for settings, topics in (({"angles": False}, ["tacho"]), ({"index_marks": False}, ["pendulums"] * 2)):
        line = Line(**settings)
        line.at(9_000, block(0, 0, 0))
        line.at(9_500, mark(1, 9_500))
        line.at(29_000, block(2, 20, 20_000))
        line.end()
        assert [item.channel.topic for item in line.items if isinstance(item, Batch)] == topics
        assert line.losses == ({"samples": 10} if topics[0] == "pendulums" else {})


def test_marks_and_locks_have_the_times_of_the_node_s_clock() -> None:
    line = Line()
    for second in range(5):
        line.mark(2 * second, 1_000_000 * second)
        line.at(1_000_000 * second + 1000, rotorlink.LockEvent(1, 2 * second + 1, 1_000_000 * second, 2, 1, 7).pack())
    times = [int(t) for item in line.items if isinstance(item, Batch) for t in item.time_ns]
    assert times == [START_NS + 1_000_000_000 * second for second in range(5)]
    assert line.values("node_time_us") == [1_000_000 * second for second in range(5)]
    locks = line.events("lock")
    assert [event.facts["time_ns"] for event in locks] == times
    assert {(event.text, event.facts["pendulum"]) for event in locks} == {("pendulum A released", 2)}
    assert line.at(4_000_000, rotorlink.LockEvent(1, 10, 4_000_000, 3, 1, 7).pack())[0].text == "pendulum B released"


# --- the node's number and status ------------------------------------------------------------------------------


def test_the_number_of_the_rig_file_counts_more_than_that_of_the_identity() -> None:
    line = Line({"node": 3}, node=5)
    line.mark(0, 0, 3)
    line.mark(0, 0, 5)
    assert [event.facts for event in line.events("foreign")] == [{"node": 3}]
    assert len(line.values("revolutions")) == 1


# --- the dongle and other frames on the line -------------------------------------------------------------------


def test_a_frame_that_the_dongle_sends_again_is_not_taken() -> None:
    line = Line()
    line.at(1_000, wrapped(0, 1_000, mark(0, 1_000)))
    line.at(2_000, wrapped(1, 2_000, mark(1, 2_000)))
    assert line.at(2_500, wrapped(1, 2_000, mark(2, 2_500))) == []
    assert line.pipeline.status.heard_frames == (0, 1)


def test_what_the_host_sends_or_an_echo_of_it_gives_nothing() -> None:
    line = Line()
    line.mark(0, 0)
    assert line.pipeline.feed(TX, rotorlink.wire(mark(5, 5_000)), START_NS) == []
    assert line.at(1_000, rotorlink.NodeCommand(1, 50, 3).pack(), rotorlink.Ping(1, 60).pack()) == []
    line.mark(1, 10_000)
    assert line.losses == {}
