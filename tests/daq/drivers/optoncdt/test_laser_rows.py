"""A laser that measures at another rate than in its rig file is decoded correctly, and the rate is reported."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.items import RX, Batch, DeviceEvent
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
