"""The overview of a log: every kind of log can be drawn, and what is drawn is what is there."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from analysis.errors import BadFigureName
from analysis.figures import log_overview
from analysis.figures.log_marks import Marks
from analysis.figures.log_overview import COLUMNS, Trace, draw_log_overview
from daq.channels import LASER_X, PENDULUMS, TACHO, Channel
from daq.items import Batch, DeviceEvent
from daq.log import content as log_content, open_log
from daq.log.file import LogFile
from tests.daq.small_log import write_small_log

T0 = 1_700_000_000_000_000_000


def drawn(log: Path, title: str = "") -> Figure:
    """The figure as it would be saved."""
    figures: list[Figure] = []
    with patch.object(log_overview, "save", lambda path, figure: figures.append(figure)), open_log(log) as opened:
        draw_log_overview(opened, Path("figure.svg"), title)
    return figures[0]


def labels(figure: Figure) -> list[str]:
    return [axes.get_ylabel() for axes in figure.axes]


def write(path: Path, channel: Channel, time_s: np.ndarray, *events: tuple[float, DeviceEvent], **columns: Any) -> Path:
    """A log of one channel and some events."""
    whole = {name: columns.get(name, np.zeros(len(time_s))) for name in channel.names}
    time_ns = T0 + np.round(time_s * 1e9).astype(np.int64)
    with LogFile(path, {}, {}, (), T0) as log:
        if len(time_s):
            log.batch(Batch(channel, time_ns, np.arange(len(time_s), dtype=np.uint32), whole), time_ns)
        for at_s, event in events:
            log.event(event, T0 + round(at_s * 1e9))
        return log.finish({})


def band(figure: Figure, row: int, number: int = 0) -> np.ndarray:
    """Corners of a band drawn in a row, (n, 2)."""
    return np.concatenate([path.vertices for path in figure.axes[row].collections[number].get_paths()])


def test_every_channel_of_a_whole_log(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "small.mcap", steps=60, opened_at=30, reported=(0, 1))
    figure = drawn(log, "small $ log 転\x1b")
    assert labels(figure) == ["x, mm", "y, mm", "pendulums, °", "speed, rpm"]
    assert "small $ log ??" in [text.get_text() for text in figure.texts]
    low, high = figure.axes[-1].get_xlim()
    assert low == 0
    assert high == pytest.approx(0.59, abs=0.02)
    assert "A, B released" in [text.get_text() for text in figure.axes[0].texts]


def test_a_cut_log_an_empty_one_and_one_with_a_single_sample(tmp_path: Path) -> None:
    whole = write_small_log(tmp_path / "small.mcap", steps=60)
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    figure = drawn(cut)
    assert labels(figure)
    assert [text.get_text() for text in figure.axes[0].texts] == ["log cut here"]
    empty = drawn(write(tmp_path / "empty.mcap", LASER_X, np.empty(0)))
    assert labels(empty) == [""]
    assert "no samples" in empty.axes[0].texts[0].get_text()
    assert labels(drawn(write(tmp_path / "one.mcap", LASER_X, np.zeros(1)))) == ["x, mm"]
    assert labels(drawn(write(tmp_path / "mark.mcap", TACHO, np.zeros(1)))) == [""]


def test_a_bad_name_is_refused(tmp_path: Path) -> None:
    with open_log(write(tmp_path / "one.mcap", LASER_X, np.zeros(1))) as log, pytest.raises(BadFigureName):
        draw_log_overview(log, tmp_path / "figure.doc")


def test_the_band_holds_every_sample_for_any_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(0, 60, 1e-3)
    values = np.sin(7 * time) * 1e-3
    values[30_001] = 0.005
    path = write(tmp_path / "run.mcap", LASER_X, time, displacement_m=values)
    at_once = band(drawn(path), 0)
    assert at_once[:, 1].max() == pytest.approx(5.0)
    assert at_once[:, 1].min() == pytest.approx(-1.0, abs=1e-3)
    monkeypatch.setattr(log_content, "_STRETCH_MESSAGES", 7001)
    assert np.array_equal(band(drawn(path), 0), at_once)


def test_speed_of_the_marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.concatenate([np.arange(0, 10, 0.5), np.arange(20, 30, 0.25)])
    mapped = time + 0.02 * np.exp(-time)  # the map to the common clock settles: the node's own clock is used
    node_us = np.rint(1e6 * time).astype(np.int64)
    path = write(tmp_path / "run.mcap", TACHO, mapped, revolutions=np.arange(len(time)), node_time_us=node_us)
    figure = drawn(path)
    places = band(figure, 0)
    monkeypatch.setattr(log_content, "_STRETCH_MESSAGES", 7)
    assert np.array_equal(band(drawn(path), 0), places)
    assert labels(figure) == ["speed, rpm"]
    assert set(np.round(places[np.isfinite(places[:, 1]), 1], 6)) == {120.0, 240.0}
    assert not ((places[:, 0] > 10) & (places[:, 0] < 20)).any()


def test_angles_leave_at_180_and_come_in_at_minus_180(tmp_path: Path) -> None:
    time = np.arange(0, 10, 0.1)
    angle = np.radians(np.linspace(0, 1000, len(time)))  # nearly three turns
    figure = drawn(write(tmp_path / "run.mcap", PENDULUMS, time, theta3_rad=angle, theta4_rad=angle))
    turns = [c for c in figure.axes[0].collections if c.get_label() == "θ3" or c.get_label().startswith("_")]
    assert figure.axes[0].get_ylim() == (-190, 190)
    shown = np.concatenate([path.vertices for c in turns for path in c.get_paths()])
    expected = (np.degrees(angle) + 180) % 360 - 180
    for at, value in zip(time, expected, strict=True):
        assert np.any((np.abs(shown[:, 0] - at) < 1e-6) & (np.abs(shown[:, 1] - value) < 1e-6))


def test_losses_are_shaded_where_they_are_and_happenings_named(tmp_path: Path) -> None:
    time = np.arange(0, 10, 0.01)
    gap = DeviceEvent("gap", "laser_x", "100 samples lost", {"samples": 100, "span_s": 1.0})
    fault = DeviceEvent("fault", "encoder", "wrong")
    figure = drawn(write(tmp_path / "run.mcap", LASER_X, time, (5.0, gap), (7.0, fault)))
    (axes,) = figure.axes
    shaded = [patch for patch in axes.patches if patch.get_alpha() == 0.25]
    assert len(shaded) == 1
    assert shaded[0].get_x() == pytest.approx(4.0, abs=0.02)
    assert shaded[0].get_x() + shaded[0].get_width() == pytest.approx(5.0, abs=0.03)
    assert [text.get_text() for text in axes.texts] == ["encoder fault"]
    assert [legend.get_texts()[0].get_text() for legend in figure.legends] == ["lost or missing"]
    assert not drawn(write(tmp_path / "fine.mcap", LASER_X, time)).legends


def test_what_the_file_lacks_is_shaded(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    values = np.random.default_rng(1).normal(size=400)
    with LogFile(path, {}, {}, (), T0) as log:
        for second in range(10):
            time_ns = T0 + second * 10**9 + np.arange(40) * 10**7
            columns = {**{name: np.zeros(40) for name in LASER_X.names}, "displacement_m": values[40 * second :][:40]}
            log.batch(Batch(LASER_X, time_ns, np.arange(40, dtype=np.uint32), columns), time_ns)
            log.flush()
        log.finish({})
    data = bytearray(path.read_bytes())
    with open_log(path) as whole:
        assert whole.complete
    start = -1
    for _ in range(6):
        start = data.index(b"\x28\xb5\x2f\xfd", start + 1)  # a chunk's content, by the mark zstd begins with
    data[start + 20] ^= 1
    path.write_bytes(data)
    with open_log(path) as damaged:
        missing = next(missing for missing in damaged.verify() if missing.start_ns is not None)
    figure = drawn(path)
    shaded = [patch for patch in figure.axes[0].patches if patch.get_alpha() == 0.25]
    assert shaded[0].get_x() == pytest.approx(((missing.start_ns or 0) - T0) * 1e-9, abs=0.02)


@given(
    st.lists(st.tuples(st.floats(0, 10), st.floats(-1e6, 1e6)), max_size=60),
    st.integers(1, 80),
)
def test_a_trace_keeps_the_extremes(samples: list[tuple[float, float]], repeats: int) -> None:
    time = np.repeat(np.array([t for t, _ in samples]), repeats)
    values = np.repeat(np.array([v for _, v in samples]), repeats)
    trace = Trace((0.0, 10.0))
    for part in range(0, len(time), 97):
        trace.add(time[part : part + 97], values[part : part + 97])
    found, low, high = trace.band()
    assert trace.is_empty == (len(samples) == 0)
    assert len(found) <= 2 * (2 * COLUMNS)
    assert (np.diff(found) >= 0).all()
    if samples:
        assert (np.nanmin(low), np.nanmax(high)) == (values.min(), values.max())


def test_a_trace_leaves_out_nan_and_breaks_at_gaps() -> None:
    trace = Trace((0.0, 10.0))
    time = np.concatenate([np.arange(0, 4, 0.01), np.arange(6, 10, 0.01), [11.0, -1.0]])
    values = np.where(time == time[7], np.nan, 1.0)
    trace.add(time, values)
    found, low, _ = trace.band()
    assert len(found) == 800  # one is NaN, two are outside, one marks the gap
    assert np.flatnonzero(np.isnan(low)).tolist() == [399]


def test_marks_take_bounded_room_and_words_do_not_overlap() -> None:
    marks = Marks((0.0, 100.0), COLUMNS)
    for number in range(10_000):
        marks.add({"kind": "fault", "device": f"device {number % 7}", "text": ""}, number * 0.01)
        marks.add({"kind": "gap", "device": "laser_x", "span_s": 1e9}, number * 0.01)
        marks.add({"kind": "lock", "state": "moving", "text": "pendulum A moving"}, number * 0.01)
        marks.add({"kind": None, "device": None}, float("1e300"))
    figure = Figure(figsize=(8.6, 2))
    axes = figure.subplots()
    axes.set_xlim(0, 100)
    marks.draw([axes])
    assert 2 < len(axes.texts) < 12
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in axes.texts]
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
    assert boxes[-1].x1 < axes.get_window_extent().x1 + 20
