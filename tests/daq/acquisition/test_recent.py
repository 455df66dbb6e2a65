"""The newest samples of a channel: the requested stretch is returned, and the memory is bounded."""

import numpy as np
from hypothesis import given, strategies as st

from daq.acquisition.recent import Recent
from daq.channels import TACHO
from daq.items import Batch

STEP_NS = 1_000_000


def batch(first, n):
    k = np.arange(first, first + n)
    return Batch(TACHO, 10**18 + STEP_NS * k, k.astype(np.uint32), {"revolutions": k, "node_time_us": 1000 * k})


@given(st.lists(st.integers(1, 700), max_size=60), st.integers(1, 4000), st.integers(-10, 20_000))
def test_it_holds_what_was_added_last(sizes, keep, back):
    recent = Recent(keep * STEP_NS / 1e9)
    total = 0
    for size in sizes:
        recent.add(batch(total, size))
        total += size
    since = max(total - back, 0)
    times, (turns,) = recent.last("tacho", ("revolutions",), 10**18 + STEP_NS * since)
    assert np.array_equal(times, 10**18 + STEP_NS * turns.astype(np.int64))
    assert np.array_equal(turns, np.arange(total - len(turns), total))
    assert len(turns) >= min(keep, total - since)  # all rows that must be kept and were requested
    assert len(turns) <= max(total - since, 0)
    assert len(recent.last("laser/x", ("code",))[0]) == 0
    recent.clear()
    assert len(recent.last("tacho", ())[0]) == 0


def test_hours_need_no_more_room_than_the_seconds_kept():
    recent = Recent(1000 * STEP_NS / 1e9)
    for turn in range(2000):
        recent.add(batch(50 * turn, 50))
    assert len(recent._tables["tacho"]._rows) <= 4 * 2000
    times, (turns,) = recent.last("tacho", ("revolutions",), 10**18 + STEP_NS * 99_000)
    assert (len(times), turns[0], turns[-1]) == (1000, 99_000, 99_999)


def test_what_was_handed_out_does_not_change():
    recent = Recent(1.0)
    recent.add(batch(0, 10))
    times, (turns,) = recent.last("tacho", ("revolutions",))
    for turn in range(1, 500):
        recent.add(batch(10 * turn, 10))
    assert turns.tolist() == list(range(10))
    assert times[0] == 10**18
