"""The amplitude interlock: a single sample beyond the limit does not trip it, a motion beyond the limit does."""

import numpy as np
from hypothesis import given, strategies as st

from daq.acquisition.exceedance import Exceedance


def tripped(values: np.ndarray, cuts: list[int]) -> bool:
    watch = Exceedance(1.0)
    return any(
        watch.feed(part) is not None for part in np.split(values, sorted(cut % (len(values) + 1) for cut in cuts))
    )


@given(st.sets(st.integers(0, 500), max_size=5), st.lists(st.integers(0, 500), max_size=9))
def test_it_trips_when_two_samples_stand_close_together(places, cuts):
    values = np.full(501, np.nan)
    values[::2] = 0.5
    values[list(places)] = -3.0
    close = any(b - a <= 64 for a, b in zip(sorted(places), sorted(places)[1:], strict=False))
    assert tripped(values, cuts) == close


def test_a_swing_that_only_just_goes_beyond_trips_at_any_rate():
    for rate in (250, 10_000):
        time = np.arange(2 * rate) / rate
        assert tripped(1.02 * np.sin(2 * np.pi * 10 * time), list(range(0, 2 * rate, 5)))


def test_it_returns_the_largest():
    assert Exceedance(1.0).feed(np.array([0.0, 2.0, -7.0, np.nan])) == 7.0
