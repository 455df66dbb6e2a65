"""θ at 0° and where its chart ends: number and curve agree, and no stroke runs across the chart."""

from __future__ import annotations

from multiprocessing import Pipe

import numpy as np
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from live.angles import FIRST_DEG, shown_deg, within_a_turn
from live.followers import Followers
from live.frames import decode
from live.levels import ChartRows, decimate
from live.model import LiveModel
from live.picture import Pictures, ViewerView
from live.watched import Watched
from rig_configs import load_rig

LAST_DEG = FIRST_DEG + 360
STEPS = st.lists(st.floats(-170, 170) | st.just(float("nan")), min_size=2, max_size=300)


def _strokes(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ends of all straight lines that the page draws: within a row, and from a row's end to the next one's begin."""
    ends = np.column_stack([low, high]).ravel()
    lines = np.column_stack([ends[:-1], ends[1:]])
    return lines[np.isfinite(lines).all(axis=1)]


@given(STEPS, st.integers(1, 400), st.floats(-1e4, 1e4))
@settings(deadline=None)
def test_a_row_shows_the_angles_it_stands_for_and_no_line_jumps_a_turn(
    steps: list[float], buckets: int, start: float
) -> None:
    angle = start + np.nancumsum(steps)
    angle[np.isnan(steps)] = np.nan
    time = 1e-3 * np.arange(len(angle))
    rows = decimate(time, angle, angle, 0.0, float(time[-1]) + 1e-3, buckets)
    shown = within_a_turn(rows)
    drawn = np.isfinite(shown.low)
    assert ((shown.low[drawn] >= FIRST_DEG - 1e-6) & (shown.high[drawn] <= LAST_DEG + 1e-6)).all()
    assert (shown.low[drawn] <= shown.high[drawn]).all()
    for at in np.unique(rows.time_s):
        row, parts = rows.time_s == at, shown.time_s == at
        low, high = rows.low[row][0], rows.high[row][0]
        if np.isnan(low):
            assert not np.isfinite(shown.low[parts]).any()
            continue
        span = np.nansum(shown.high[parts] - shown.low[parts])
        assert np.isclose(span, min(high - low, 360.0), atol=1e-6)
        for edge in (low, high):
            value = shown_deg(edge)
            inside = (shown.low[parts] - 1e-6 <= value) & (value <= shown.high[parts] + 1e-6)
            at_end = min(value - FIRST_DEG, LAST_DEG - value) < 1e-6
            assert inside.any() or at_end
    if rows.bucket_s == 0:  # samples: a pendulum that turns by less than half a turn a sample is followed
        lines = _strokes(shown.low, shown.high)
        assert (np.abs(lines[:, 1] - lines[:, 0]) <= 170 + 1e-6).all()


def test_a_pendulum_that_turns_on_draws_no_stroke_across_and_a_minimum_and_maximum_is_divided() -> None:
    time = np.arange(4.0)
    low, high = np.array([350.0, 353.0, 356.0, 400.0]), np.array([352.0, 357.0, 358.0, 800.0])
    shown = within_a_turn(ChartRows(time, low, high, 1.0))
    np.testing.assert_allclose(shown.low, [350, 353, np.nan, -5, -4, np.nan, -5])
    np.testing.assert_allclose(shown.high, [352, 355, np.nan, -3, -2, np.nan, 355])
    np.testing.assert_allclose(shown.time_s, [0, 1, 1, 1, 2, 2, 3])


def test_header_and_curve_have_the_same_value() -> None:
    ours, theirs = Pipe()
    with ours, theirs:
        watched = Watched(load_rig("virtual"), theirs, "virtual")
        model = LiveModel(watched.signals.rig)
        pictures = Pictures(watched, model, Followers(watched.signals, model))
        heard_ns = 10**18
        for degrees in (-0.1, 359.9, 0.1, -30.0, 354.9, 355.1, 719.0):
            heard_ns += 10**9
            times = heard_ns - np.arange(3, 0, -1, dtype=np.int64) * 10**6
            angle = np.radians(degrees) + np.zeros(3)
            columns = {"theta3_rad": angle, "theta4_rad": -angle, "flags": np.zeros(3, np.int64)}
            topic = watched.signals.rig.roles.angles
            assert topic is not None
            watched._take({"heard_ns": heard_ns, "rows": [(topic.topic, times, columns)], "events": [], "facts": None})
            header, drawn = decode(pictures.frame(ViewerView(0.5), 1))
            for name, value in zip(("theta3", "theta4"), header["theta"], strict=True):
                assert FIRST_DEG <= value < LAST_DEG
                assert drawn[f"{name}.low"][-1] == np.float32(value), degrees
            wanted = (degrees + 5) % 360 - 5
            assert np.isclose(header["theta"][0], wanted)
