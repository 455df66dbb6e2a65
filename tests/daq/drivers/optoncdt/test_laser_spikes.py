"""Lone false distances: marked where nothing else explains them, and nothing else is marked."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from daq.channels import suspects
from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.drivers.spikes import LOOK_AHEAD, SpikeWatch
from daq.items import RX, Batch, DeviceEvent
from rig_configs import load_rig

STEP_M = 0.025 * 1.02 / distance_words.CODE_MAX
MIDDLE = 32_760
START_NS = 1_700_000_000_000_000_000


def marked(codes: NDArray[np.floating], invalid: NDArray[np.bool_] | None = None) -> NDArray[np.intp]:
    """Which samples are marked in a stream of codes, in one read."""
    words = np.clip(np.rint(codes), 0, distance_words.CODE_MAX).astype(np.uint32)
    if invalid is not None:
        words[invalid] = 262_078
    return np.flatnonzero(suspects(SpikeWatch().feed(words, np.arange(len(words)) % optoncdt.COUNTER_WRAP)))


def pluck(time: NDArray[np.floating]) -> NDArray[np.floating]:
    """Held for half a second and released, every ten seconds; m."""
    t = np.mod(time, 10.0) - 0.5
    free = 5e-3 * np.exp(-1.2 * t) * np.cos(58.4 * t) + 0.5e-3 * np.exp(-t) * np.sin(188.5 * t)
    return np.where(t < 0, 5e-3, free)


def run_up(time: NDArray[np.floating]) -> NDArray[np.floating]:
    """Through a resonance of 11 mm up to 2400 rpm; m."""
    f = 40.0 * time / time[-1]
    return 11e-3 / np.sqrt(1 + ((f - 11) / 0.8) ** 2) * np.sin(2 * np.pi * np.cumsum(f) * (time[1] - time[0]))


def knocks(time: NDArray[np.floating]) -> NDArray[np.floating]:
    """A velocity jump every 1.37 s, with ringing far above the modes; m."""
    t = np.mod(time, 1.37)
    ringing = 2e-5 * np.exp(-60 * t) * np.sin(1131 * t) + 1e-5 * np.exp(-200 * t) * np.sin(4398 * t)
    return 2e-3 * np.exp(-3 * t) * np.sin(125.7 * t) + ringing


def still(time: NDArray[np.floating]) -> NDArray[np.floating]:
    """Moves by less than the sensor's step."""
    return 0.7 * STEP_M * np.sin(0.3 * time)


@pytest.mark.parametrize("rate", [250, 1000, 4000, 10_000])
@pytest.mark.parametrize("motion", [pluck, run_up, knocks, still])
@pytest.mark.parametrize("noise_codes", [0.0, 0.4, 10.0])
def test_no_real_motion_is_marked(rate: int, motion, noise_codes: float) -> None:
    time = np.arange(40 * rate) / rate
    noise = noise_codes * np.random.default_rng(rate).standard_normal(len(time))
    assert len(marked(MIDDLE + motion(time) / STEP_M + noise)) == 0


def test_leaving_the_range_at_resonance_marks_nothing() -> None:
    time = np.arange(160_000) / 4000
    codes = MIDDLE + 1.3 * run_up(time) / STEP_M + np.random.default_rng(3).standard_normal(len(time))
    beyond = (codes < 0) | (codes > distance_words.CODE_MAX)
    assert beyond.any()
    assert len(marked(codes, beyond)) == 0


def test_coloured_noise_marks_nothing() -> None:
    white = np.random.default_rng(5).standard_normal(200_000)
    coloured = np.convolve(white, 0.97 ** np.arange(300), "same")
    assert len(marked(MIDDLE + 25 * coloured / coloured.std())) == 0


@pytest.mark.parametrize(("rate", "noise_codes", "least_bit"), [(4000, 1.0, 5), (4000, 10.0, 8), (250, 1.0, 7)])
def test_flipped_bits_are_marked_from_some_size_on(rate: int, noise_codes: float, least_bit: int) -> None:
    time = np.arange(30_000) / rate
    noise = noise_codes * np.random.default_rng(7).standard_normal(len(time))
    words = np.rint(MIDDLE + 5e-3 / STEP_M * np.cos(58.4 * time) + noise).astype(np.int64)
    places = np.arange(700, len(words) - 50, 61)
    for bit in range(least_bit, 16):
        flipped = words.copy()
        flipped[places] ^= 1 << bit
        seen = places[flipped[places] <= distance_words.CODE_MAX]  # the others are error codes
        found = marked(flipped)
        assert len(np.setdiff1d(found, places)) == 0
        assert len(np.intersect1d(found, seen)) > 0.9 * len(seen)


def wire(codes: NDArray[np.integer]) -> bytes:
    k = np.arange(len(codes))
    ticks = 25 * k
    return optoncdt.encode_block(np.column_stack([codes, k % 2**18, ticks & 0xFFFF, ticks >> 16]))


def laser() -> LaserPipeline:
    return LaserPipeline("laser_x", load_rig("virtual").devices["laser_x"], {})


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 1500), max_size=12), st.sets(st.integers(150, 590), max_size=4), st.integers(8, 15))
def test_the_flags_do_not_depend_on_the_reads(cuts: list[int], places: set[int], bit: int) -> None:
    codes = np.rint(MIDDLE + 900 * np.sin(np.arange(600) / 40)).astype(np.int64)
    codes[list(places)] ^= 1 << bit
    data = wire(codes)

    def flags(parts: list[bytes]) -> list[int]:
        pipeline = laser()
        items = [item for i, part in enumerate(parts) for item in pipeline.feed(RX, part, START_NS + i)]
        found = [int(flag) for item in items if isinstance(item, Batch) for flag in item.columns["flags"]]
        reported = sum(
            item.facts["suspect"] for item in items if isinstance(item, DeviceEvent) and item.kind == "suspect"
        )
        assert pipeline.losses["suspect"] == reported == sum(found)
        return found

    edges = [0, *sorted(cut * 5 % len(data) for cut in cuts), len(data)]
    assert flags([data]) == flags([data[a:b] for a, b in itertools.pairwise(edges)])


def test_a_false_sample_is_kept_as_it_came_marked_and_counted() -> None:
    codes = np.rint(MIDDLE + 900 * np.sin(np.arange(600) / 40)).astype(np.int64)
    codes[300] ^= 1 << 12
    pipeline = laser()
    batch, event = pipeline.feed(RX, wire(codes), START_NS)
    assert isinstance(batch, Batch)
    assert isinstance(event, DeviceEvent)
    assert batch.columns["code"][300] == codes[300]
    assert np.flatnonzero(suspects(batch.columns["flags"])).tolist() == [300]
    assert np.flatnonzero(batch.columns["flags"]).tolist() == [300 + LOOK_AHEAD]
    assert (event.kind, event.facts["suspect"], event.facts["time_ns"]) == ("suspect", 1, batch.time_ns[300])
    assert event.text == "a sample jumps out of the signal for one sample: marked as suspect"
    assert {kind: n for kind, n in pipeline.losses.items() if n} == {"suspect": 1}
    codes[400] ^= 1 << 12
    _, event = laser().feed(RX, wire(codes), START_NS)
    assert isinstance(event, DeviceEvent)
    assert event.text == "2 samples jump out of the signal for one sample: marked as suspect"


def test_identification_excludes_marked_samples_and_the_log_keeps_them(tmp_path: Path) -> None:
    from daq.log import open_log
    from daq.log.file import LogFile
    from daq.log.losses import losses_of
    from daq.signals.run import load_run

    rig = load_rig("virtual")
    codes = np.rint(MIDDLE + 900 * np.sin(np.arange(6000) / 40)).astype(np.int64)
    codes[3000] ^= 1 << 12
    path = tmp_path / "run.mcap"
    with LogFile(path, {"test": "ring-down-x"}, {"rig.json": rig.snapshot_json()}, ("laser_x",), START_NS) as log:
        for item in laser().feed(RX, wire(codes), START_NS):
            log.batch(item, START_NS) if isinstance(item, Batch) else log.event(item, START_NS)
        log.finish({})
    run = load_run(path)
    assert np.flatnonzero(np.isnan(run.x_m)).tolist() == [3000]
    with open_log(path) as opened:
        assert opened["laser/x"].code[3000] == codes[3000]
        assert losses_of(opened).by_device == {"laser_x": {"suspect": 1}}
