"""Frames of a node that its XBee module delivers late, or twice: a module repeats what was not acknowledged."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.sender import Sender
from daq.items import RX, Batch, DeviceEvent
from tests.rig_drivers.xbee.test_stream import START_NS, api, pipeline

BLOCK_MS, SAMPLES = 20, 5
UP_MS = 60_000  # for which the node has run when the log begins
LATE = 85  # blocks, 1.7 s: an acknowledgement of a Zigbee network is waited for for 1.6 s


class Radio:
    """A pipeline, and what it has returned; a block is sent when its last sample is due and arrives 5 ms later."""

    def __init__(self, first_seq: int = 65_500, first_index: int = 0) -> None:
        self.pipeline = pipeline()
        self.items: list[Batch | DeviceEvent] = []
        self._first_seq, self._first_index = first_seq, first_index

    def payload(self, i: int, up_ms: int = UP_MS) -> bytes:
        numbers = np.arange(SAMPLES) + SAMPLES * i
        counts = np.column_stack([3 * numbers, 2048 - numbers]).astype(np.int32)
        seq, index = (self._first_seq + i) & 0xFFFF, self._first_index + int(numbers[0])
        time_us = 1000 * (up_ms + BLOCK_MS * i) % 2**32
        return rotorlink.EncoderBlock(1, seq, index, time_us, 4000, 96, counts).pack()

    def arrives(self, payload: bytes, at_block: float) -> None:
        host_ns = START_NS + int(1_000_000 * (BLOCK_MS * (at_block + 1) + 5))
        self.items += self.pipeline.feed(RX, api(payload), host_ns)

    def blocks(self, first: int, behind: int, lost: set[int] | frozenset[int] = frozenset()) -> None:
        for i in range(first, behind):
            if i not in lost:
                self.arrives(self.payload(i), i)

    def ends(self) -> Radio:
        self.items += self.pipeline.feed(RX, b"", START_NS)
        return self

    def values(self, name: str) -> list[Any]:
        batches = [each for each in self.items if isinstance(each, Batch)]
        return [v for each in batches for v in each.columns[name].tolist()]

    @property
    def times_ms(self) -> list[float]:
        times = np.concatenate([each.time_ns for each in self.items if isinstance(each, Batch)])
        return ((times - START_NS) / 1e6).tolist()

    def kinds(self) -> list[str]:
        return [each.kind for each in self.items if isinstance(each, DeviceEvent)]

    @property
    def losses(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}


def samples_of(*blocks: range) -> list[int]:
    return [SAMPLES * i + k for each in blocks for i in each for k in range(SAMPLES)]


def test_a_block_that_arrives_seconds_late_is_no_restart() -> None:
    radio = Radio()
    radio.blocks(0, 10 + LATE, {10})
    radio.arrives(radio.payload(10), 10 + LATE - 0.5)
    radio.blocks(10 + LATE, 120)
    radio.ends()
    assert "restart" not in radio.kinds()
    assert radio.values("index") == samples_of(range(10), range(11, 120))
    assert radio.losses == {"radio_frames": 1, "samples": SAMPLES}
    assert radio.times_ms == pytest.approx([4 * k + 9 for k in radio.values("index")], abs=1e-3)


def test_blocks_that_arrive_twice_change_nothing() -> None:
    once, twice = Radio(), Radio()
    once.blocks(0, 200)
    for i in range(200):
        twice.arrives(twice.payload(i), i)
        if i % 7 == 0:
            twice.arrives(twice.payload(i), i + 0.2)
        if i >= LATE and i % 5 == 0:
            twice.arrives(twice.payload(i - LATE), i + 0.4)
    assert once.ends().values("index") == twice.ends().values("index") == samples_of(range(200))
    assert once.times_ms == twice.times_ms
    assert (twice.losses, twice.kinds()) == ({}, [])


def test_a_block_that_arrives_after_the_next_one_takes_its_place() -> None:
    radio = Radio()
    for i in range(0, 90, 3):
        for k in (i, i + 2, i + 1):
            radio.arrives(radio.payload(k), i + 2)
    assert radio.ends().values("index") == samples_of(range(90))
    assert all(a < b for a, b in pairwise(radio.times_ms))
    assert "samples" not in radio.losses


def test_blocks_wait_from_the_first_late_one_on_although_gaps_were_not_filled() -> None:
    radio = Radio()
    radio.blocks(0, 60, {10, 20, 30, 40, 50})
    for first in (60, 80):
        radio.blocks(first, first + 5, {first + 3})
        radio.arrives(radio.payload(first + 3), first + 4.5)
        radio.blocks(first + 5, first + 20)
    radio.ends()
    assert radio.losses["samples"] == 6 * SAMPLES, "the second late block is taken"
    radio = Radio()
    radio.blocks(0, 60, {10, 20, 30, 40, 50})
    for i in (55, 56):  # twice, but not late
        radio.arrives(radio.payload(i), 59)
    radio.items.clear()
    radio.blocks(61, 63)
    assert radio.values("index") == samples_of(range(61, 63)), "they do not wait"


def test_blocks_that_arrive_late_while_the_node_s_clock_wraps_are_no_restart() -> None:
    radio = Radio(first_index=1_000_000)
    for i in range(300):
        radio.arrives(radio.payload(i, 4_294_967 - 1000), i)
        if i >= LATE:
            radio.arrives(radio.payload(i - LATE, 4_294_967 - 1000), i + 0.5)
    radio.ends()
    assert radio.values("index") == [1_000_000 + k for k in samples_of(range(300))]
    assert (radio.losses, radio.kinds()) == ({}, [])


@pytest.mark.parametrize("late_by", [1, 40, 90])
@pytest.mark.parametrize("up_ms", [500, UP_MS])
def test_other_late_frames_are_neither_taken_nor_a_restart(late_by: int, up_ms: int) -> None:
    frames = (
        rotorlink.IndexMark(1, 65_510, 1000 * (up_ms + 200), 4),
        rotorlink.Acknowledge(1, 65_510, 3, 0),
        rotorlink.NodeStatus(1, 65_510, 1000 * (up_ms + 200), 3700, 250, 8, 0, 1, 4, 4096),
    )
    for frame in frames:
        radio = Radio()
        for i in [*range(10), *range(11, 11 + late_by)]:
            radio.arrives(radio.payload(i, up_ms), i)
        radio.arrives(frame.pack(), 10.5 + late_by)
        for i in range(11 + late_by, 110):
            radio.arrives(radio.payload(i, up_ms), i)
        radio.ends()
        assert radio.kinds() == ["gap", "gap"]
        assert radio.values("index") == samples_of(range(10), range(11, 110))


def test_of_a_node_without_blocks_a_mark_shows_the_restart() -> None:
    radio = Radio()
    for seq, us in ((500, 30_000_000), (501, 31_000_000), (500, 30_000_000), (0, 1_000_000), (1, 2_000_000)):
        radio.arrives(rotorlink.IndexMark(1, seq, us, 1).pack(), 100)
    assert radio.values("node_time_us") == [30_000_000, 31_000_000, 1_000_000, 2_000_000]
    assert radio.kinds() == ["restart"]


def test_after_a_restart_in_the_first_seconds_a_block_shows_it() -> None:
    radio, again = Radio(first_seq=100), Radio(first_seq=1)
    for i in range(100):
        radio.arrives(radio.payload(i, up_ms=0), i)
    radio.arrives(rotorlink.IndexMark(1, 0, 1_000, 0).pack(), 149)
    for i in range(30):
        radio.arrives(again.payload(i, up_ms=0), 150 + i)
    assert radio.kinds() == ["restart"]
    assert radio.ends().values("index") == samples_of(range(100), range(30))


@pytest.mark.parametrize("silent_ms", [0, 3000, 9000])
def test_a_restart_is_recognised_as_before(silent_ms: int) -> None:
    radio = Radio(first_seq=100)
    radio.blocks(0, 50, {20})
    again = Radio(first_seq=0)
    for i in range(30):
        radio.arrives(again.payload(i, up_ms=0), 50 + i + silent_ms / BLOCK_MS)
    assert radio.ends().values("index") == samples_of(range(20), range(21, 50), range(30))
    assert radio.kinds().count("restart") == 1
    assert radio.losses == {"radio_frames": 1, "samples": SAMPLES}


@pytest.mark.parametrize(("off_ms", "restarts"), [(100, 0), (101, 1), (-100, 0), (-101, 1)])
def test_a_late_block_whose_index_does_not_fit_its_time_is_of_another_node(off_ms: int, restarts: int) -> None:
    radio = Radio()
    radio.blocks(0, 200)
    radio.arrives(radio.payload(100, up_ms=UP_MS + off_ms), 199.5)
    assert radio.kinds().count("restart") == restarts


@pytest.mark.parametrize(
    ("behind_us", "up_us", "passed_us", "late"),
    [
        (1, 2_000_001, 0, True),
        (1, 2_000_000, 0, False),  # it may have started again after the newest frame, which was itself 2 s late
        (1_700_000, 4_000_001, 2_000_000, True),
        (1_700_000, 4_000_000, 2_000_000, False),
        (10_000_000, 30_000_000, 0, True),
        (10_000_001, 30_000_000, 0, False),
        (0, 30_000_000, 0, False),
        (-1, 30_000_000, 0, False),
        (1, 2_000_001, -5_000_000, True),  # the host's clock was set back
        (2_000, 2**32 - 1_000, 0, True),  # the clock has wrapped since
    ],
)
def test_what_a_restart_cannot_explain_is_late(behind_us: int, up_us: int, passed_us: int, late: bool) -> None:
    sender = Sender()
    assert not sender.is_late(up_us, START_NS, up_us)
    sender.feed(0, (up_us + behind_us) % 2**32, START_NS)
    assert sender.is_late(up_us, START_NS + 1000 * passed_us, up_us) is late
