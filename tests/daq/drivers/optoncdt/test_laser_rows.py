"""A laser that measures at another rate than in its rig file is decoded correctly, and the rate is reported."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.items import RX, TX, Batch, DeviceEvent
from rig_configs import load_rig
from tests.effort import cases

LASER = load_rig("virtual").devices["laser_x"]
START_NS = 1_700_000_000_000_000_000
_SETTLING = 8  # rows after which another sampling period is detected


def stream(counters: np.ndarray, rate_Hz: float, tick0: int = 0) -> bytes:
    """Blocks of these samples, made at this rate; the first sample of all is counter 0 at `tick0`."""
    ticks = tick0 + np.rint(counters * (1e5 / rate_Hz)).astype(np.int64)
    codes = distance_words.code(np.full(len(counters), 0.0125), 0.025)
    return optoncdt.encode_block(
        np.column_stack([codes, counters % 2**18, ticks & 0xFFFF, ticks >> 16 & 0xFFFF]).astype(np.uint32)
    )


def read(
    pipeline: LaserPipeline,
    counters: np.ndarray,
    rate_Hz: float,
    sizes: list[int],
    tick0: int = 0,
    begin_s: float = 0.0,
) -> list[Batch | DeviceEvent]:
    """Read the blocks of these samples in portions of these sizes, when their bytes have been sent."""
    data, out = stream(counters, rate_Hz, tick0), list[Batch | DeviceEvent]()
    at, k = 0, 0
    while at < len(data):
        end = min(len(data), at + sizes[k % len(sizes)])
        sent_s = begin_s + (counters[(end - 1) // 12] - counters[0]) / rate_Hz
        out += pipeline.feed(RX, data[at:end], START_NS + round(sent_s * 1e9))
        at, k = end, k + 1
    return out


def laser() -> LaserPipeline:
    return LaserPipeline("laser_x", LASER, {})


def ticks_of(items: list[Batch | DeviceEvent]) -> np.ndarray:
    return np.concatenate([i.columns["device_ticks"] for i in items if isinstance(i, Batch)]).astype(np.int64)


@settings(max_examples=cases(20, 60))
@example(3694.0, 0, [54], 0)
@example(7825.0, 0, [60], 81)
@given(
    st.floats(300.0, 10_000.0),
    st.integers(0, 2**20),
    st.lists(st.integers(50, 900), min_size=1, max_size=5),
    st.integers(0, 400),
)
def test_at_any_rate_samples_and_losses_are_right(rate_Hz: float, tick0: int, sizes: list[int], lost: int) -> None:
    """Of samples that are lost once the host has received samples for 0.3 s, and the rate is known."""
    counters = np.concatenate([np.arange(3000), np.arange(3000 + lost, 3600 + lost)])
    pipeline = laser()
    items = read(pipeline, counters, rate_Hz, sizes, tick0)
    expected = tick0 + np.rint(counters * (1e5 / rate_Hz)).astype(np.int64)
    found = ticks_of(items)
    missed = np.setdiff1d(expected, found)
    assert len(missed) == len(expected) - len(found) == pipeline.losses["damaged"] <= _SETTLING
    assert set(missed.tolist()) <= set(expected[:_SETTLING].tolist())
    assert lost <= pipeline.losses["samples"] <= lost + len(missed)
    assert "restart" not in [e.kind for e in items if isinstance(e, DeviceEvent)]
    rates = [e.facts["rate_Hz"] for e in items if isinstance(e, DeviceEvent) and e.kind == "rate"]
    if abs(rate_Hz / 4000 - 1) > 0.005:
        assert rates[-1] == pytest.approx(rate_Hz, rel=2e-3)
        assert len(rates) <= 2
    elif abs(rate_Hz / 4000 - 1) < 1e-4:
        assert not rates


def test_samples_after_a_gap_within_a_read_are_handed_out_with_it() -> None:
    pipeline = laser()
    pipeline.feed(RX, stream(np.arange(100), 4000.0), START_NS)
    items = pipeline.feed(RX, stream(np.r_[100:110, 113:123], 4000.0), START_NS + 5_000_000)
    assert ticks_of(items).tolist() == [25 * k for k in (*range(100, 110), *range(113, 123))]


@pytest.mark.parametrize("rate_Hz", [1000.0, 2000.0, 3597.0, 3656.0, 4090.0, 7911.0])
def test_a_sensor_that_comes_back_at_another_rate_restarts_once_and_is_read_on(rate_Hz: float) -> None:
    pipeline = laser()
    before = read(pipeline, np.arange(20_000, 22_000), 4000.0, [500])
    after = read(pipeline, np.arange(100, 1100), rate_Hz, [500], 7, begin_s=1.5)
    assert len(ticks_of(before)) == 2000
    assert len(ticks_of(after)) >= 1000 - _SETTLING
    assert [e.kind for e in after if isinstance(e, DeviceEvent)].count("restart") == 1
    assert pipeline.losses["samples"] <= pipeline.losses["damaged"] <= _SETTLING
    reported = [e for e in after if isinstance(e, DeviceEvent) and e.kind == "rate"]
    assert reported[0].facts["nominal_Hz"] == 4000
    assert "the rig file states 4000" in reported[0].text


def test_a_rate_that_changes_while_the_sensor_measures_is_no_restart() -> None:
    pipeline = laser()
    read(pipeline, np.arange(3000), 4000.0, [700])
    ticks_then = 3000 * 25
    # one after the other by the counter; from here on 50 ticks apart
    items = read(pipeline, np.arange(3000, 4000), 2000.0, [700], ticks_then - 3000 * 50, begin_s=0.75)
    assert np.array_equal(ticks_of(items), ticks_then + 50 * np.arange(1000))
    assert [e.kind for e in items if isinstance(e, DeviceEvent)] == ["rate"]
    assert not any(pipeline.losses.values())


MS = 1_000_000
Items = list[Batch | DeviceEvent]


def laser_with(rate_Hz: float = 4000.0, **more: Any) -> LaserPipeline:
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
    pipe = laser_with(lever_ratio=0.5, range_m=0.1)
    codes = distance_words.code(np.array([0.05, 0.075, 0.05]), 0.1)
    (batch,) = pipe.feed(RX, blocks(np.arange(250_000, 250_003), codes=codes), START_NS)
    assert isinstance(batch, Batch)
    assert batch.columns["displacement_m"] == pytest.approx([0, 0.05, 0], abs=4e-6)
    assert batch.time_ns.tolist() == [START_NS - 500_000, START_NS - 250_000, START_NS]
    assert batch.columns["device_ticks"].tolist() == [25 * n for n in (250_000, 250_001, 250_002)]
    assert batch.columns["flags"].tolist() == [0, 0, 0]
    assert pipe.losses["samples"] == 0


def test_only_bytes_before_the_first_block_are_no_damage() -> None:
    pipe = laser_with()
    (damage, _) = pipe.feed(
        RX, b"\xff\xff" + blocks(np.arange(4)) + b"\xff\xff\xff" + blocks(np.arange(4, 9)), START_NS
    )
    assert isinstance(damage, DeviceEvent)
    assert (damage.text, damage.facts) == ("3 bytes skipped that belong to no block", {"bytes": 3})
    assert pipe.losses["bytes"] == 3


def test_a_block_that_is_cut_at_the_end_of_a_read_is_damage() -> None:
    pipe = laser_with()
    pipe.feed(RX, blocks(np.arange(100)), START_NS)
    assert values(pipe.feed(RX, blocks(np.arange(100, 101)), START_NS + MS), "counter") == [100]
    pipe.feed(RX, blocks(np.arange(101, 110)) + blocks(np.arange(110, 111))[:6], START_NS + 3 * MS)
    items = pipe.feed(RX, blocks(np.arange(110, 120)), START_NS + 5 * MS)
    assert values(items, "counter") == [*range(110, 120)]
    assert [(event.kind, event.facts) for event in events(items)] == [("damage", {"bytes": 6})]


def test_commands_of_the_host_give_no_samples_and_the_start_ends_the_sign_of_a_lost_set_up() -> None:
    pipe = laser_with()
    assert pipe.feed(TX, blocks(np.arange(40)), START_NS) == []
    for turn in range(9):
        pipe.feed(RX, b"\xff", START_NS + 250 * turn * MS)
        assert pipe.status.set_up_lost == ""
    pipe.feed(RX, b"\xff", START_NS + 2001 * MS)
    assert pipe.status.set_up_lost == "it sends bytes that give no samples, so it may have other settings"
    pipe.feed(TX, b"OUTPUT RS422\n", START_NS + 2002 * MS)
    assert pipe.status.set_up_lost == ""
