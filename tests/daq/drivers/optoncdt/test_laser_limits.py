"""Pipeline of an optoNCDT on a serial line at its limits: gaps, rates, damage, error codes, words without samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.items import RX, TX, Batch, DeviceEvent

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
Items = list[Batch | DeviceEvent]


def laser(rate_Hz: float = 4000.0, **more: Any) -> LaserPipeline:
    table = {"driver": "optoncdt", "port": "p", "axis": "x", "rate_Hz": rate_Hz, **more}
    return LaserPipeline("laser_x", Laser.model_validate(table), {})


def blocks(counters: np.ndarray, ticks: np.ndarray | None = None, codes: np.ndarray | int = 30_000) -> bytes:
    """Blocks of these samples; by default at 4 kHz."""
    time = 25 * counters if ticks is None else ticks
    words = [np.full(len(counters), codes), counters % 2**18, time & 0xFFFF, time >> 16 & 0xFFFF]
    return optoncdt.encode_block(np.column_stack(words).astype(np.uint32))


def events(items: Items, kind: str = "") -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and kind in ("", item.kind)]


def values(items: Items, name: str) -> list[Any]:
    return [value for item in items if isinstance(item, Batch) for value in item.columns[name].tolist()]


def test_samples_have_the_scale_of_the_lever_and_the_times_of_their_ticks() -> None:
    """In the middle of the range, and a quarter of it farther: by the formula of the model."""
    pipe = laser(lever_ratio=0.5, range_m=0.1)
    codes = distance_words.code(np.array([0.05, 0.075, 0.05]), 0.1)
    (batch,) = pipe.feed(RX, blocks(np.arange(250_000, 250_003), codes=codes), START_NS)
    assert isinstance(batch, Batch)
    assert batch.columns["displacement_m"] == pytest.approx([0, 0.05, 0], abs=4e-6)
    assert batch.time_ns.tolist() == [START_NS - 500_000, START_NS - 250_000, START_NS]
    assert batch.columns["device_ticks"].tolist() == [25 * n for n in (250_000, 250_001, 250_002)]
    assert batch.columns["flags"].tolist() == [0, 0, 0]
    assert pipe.losses["samples"] == 0


def test_only_bytes_before_the_first_block_are_no_damage() -> None:
    pipe = laser()
    (damage, _) = pipe.feed(
        RX, b"\xff\xff" + blocks(np.arange(4)) + b"\xff\xff\xff" + blocks(np.arange(4, 9)), START_NS
    )
    assert isinstance(damage, DeviceEvent)
    assert (damage.text, damage.facts) == ("3 bytes skipped that belong to no block", {"bytes": 3})
    assert pipe.losses["bytes"] == 3


def test_a_block_that_is_cut_at_the_end_of_a_read_is_damage() -> None:
    pipe = laser()
    pipe.feed(RX, blocks(np.arange(100)), START_NS)
    assert values(pipe.feed(RX, blocks(np.arange(100, 101)), START_NS + MS), "counter") == [100]
    pipe.feed(RX, blocks(np.arange(101, 110)) + blocks(np.arange(110, 111))[:6], START_NS + 3 * MS)
    items = pipe.feed(RX, blocks(np.arange(110, 120)), START_NS + 5 * MS)
    assert values(items, "counter") == [*range(110, 120)]
    assert [(event.kind, event.facts) for event in events(items)] == [("damage", {"bytes": 6})]


def test_commands_of_the_host_give_no_samples_and_the_start_ends_the_sign_of_a_lost_set_up() -> None:
    pipe = laser()
    assert pipe.feed(TX, blocks(np.arange(40)), START_NS) == []
    for turn in range(9):
        pipe.feed(RX, b"\xff", START_NS + 250 * turn * MS)
        assert pipe.status.set_up_lost == ""
    pipe.feed(RX, b"\xff", START_NS + 2001 * MS)
    assert pipe.status.set_up_lost == "it sends bytes that give no samples, so it may have other settings"
    pipe.feed(TX, b"OUTPUT RS422\n", START_NS + 2002 * MS)
    assert pipe.status.set_up_lost == ""
