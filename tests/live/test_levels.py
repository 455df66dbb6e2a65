"""Decimation keeps the least and the largest value of every bucket, and memory is bounded."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from live.levels import Levels, decimate

VALUES = st.lists(st.floats(-1e3, 1e3) | st.just(float("nan")), min_size=1, max_size=400)


@given(VALUES, st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_every_bucket_keeps_its_least_and_largest_value(values: list[float], buckets: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(1e-3, 2e-2, len(values)))
    data = np.array(values)
    start, end = float(time[0]), float(time[-1]) + 1e-3
    found = decimate(time, data, data, start, end, buckets)
    if found.bucket_s == 0:
        kept = ~np.isin(found.time_s, time, invert=True)
        np.testing.assert_array_equal(found.low[kept], data)
        return
    assert len(data) > 2 * buckets
    number = np.floor(time / found.bucket_s).astype(int)
    shown = dict(
        zip(
            np.floor(found.time_s / found.bucket_s).astype(int).tolist(),
            zip(found.low, found.high, strict=True),
            strict=False,
        )
    )
    for bucket in set(number.tolist()):
        inside = data[number == bucket]
        low, high = shown[bucket]
        if np.isnan(inside).all():
            assert np.isnan(low)
            assert np.isnan(high)
        else:
            assert low == np.nanmin(inside)
            assert high == np.nanmax(inside)
    assert len(found.time_s) <= 2 * (buckets + 2)


@given(st.integers(1, 30_000), st.integers(50, 500), st.integers(1, 700))
@settings(max_examples=30)
def test_long_windows_show_the_same_extremes_from_longer_levels(count: int, buckets: int, block: int) -> None:
    time = np.arange(count) / 4000.0
    data = np.sin(900 * time) + 0.001 * np.arange(count)
    levels = Levels(kept=1000)
    for first in range(0, count, block):
        levels.add(time[first : first + block], data[first : first + block])
    found = levels.stretch(-1.0, float(time[-1]) + 1.0, buckets)
    covered = time <= (found.time_s[-1] if len(found.time_s) else -1)
    if count >= 4096 and found.bucket_s:
        assert np.nanmax(found.high) >= data[covered].max() - 1e-12
        assert np.nanmin(found.low) <= data[covered].min() + 1e-12


def test_what_is_kept_does_not_grow() -> None:
    levels = Levels(kept=4000)
    sizes: list[int] = []
    for second in range(60):
        time = second + np.arange(4000) / 4000.0
        levels.add(time, time)
        sizes.append(levels._samples._table.shape[1])
    assert max(sizes) <= 12_000
    assert len(set(sizes[10:])) == 1
    assert levels.newest_s == pytest.approx(59.99975)
    assert levels.between(59.0, 60.0)[0][0] > 59.0
    assert levels.last(59.5) == pytest.approx(59.5)


def test_a_line_breaks_where_samples_are_missing() -> None:
    time = np.r_[np.arange(100) / 1000.0, 0.5 + np.arange(100) / 1000.0]
    for buckets in (10, 400):
        found = decimate(time, time, time, 0.0, 0.6, buckets)
        hole = (found.time_s > 0.15) & (found.time_s < 0.45)
        gaps = np.flatnonzero(np.isnan(found.low))
        assert len(gaps) == 1
        assert not hole.any()


def test_few_samples_are_handed_out_as_they_are() -> None:
    time = np.arange(100) / 100.0
    found = decimate(time, time, time, 0.0, 1.0, 50)
    assert found.bucket_s == 0
    np.testing.assert_array_equal(found.low, time)
    assert decimate(time, time, time, 0.0, 1.0, 49).bucket_s == pytest.approx(1 / 49)


@pytest.mark.parametrize("buckets", [20, 1000])
def test_samples_that_arrive_together_at_one_time_are_one_line(buckets: int) -> None:
    """An adapter delivers three reports of a drive at once, and they get the time of the host."""
    time_s = np.repeat(np.arange(100) * 0.03, 3)
    value = np.full(300, 150.0)
    rows = decimate(time_s, value, value, 0.0, 3.0, buckets)
    assert not np.isnan(rows.low).any()
    missing = np.delete(time_s, np.s_[120:210])
    rows = decimate(missing, value[:210], value[:210], 0.0, 3.0, buckets)
    assert np.count_nonzero(np.isnan(rows.low)) == 1
