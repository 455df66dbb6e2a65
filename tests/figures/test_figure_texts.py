"""Every kind of figure can be read: no text on another, none off the paper, none too small, no legend on a curve."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from analysis.figures.fit import FitCurve
from analysis.figures.health import draw_health
from analysis.figures.kinds import KINDS
from analysis.figures.multipliers import draw_multipliers, speed_point
from analysis.figures.parameter_history import Value, draw_parameter_history
from analysis.figures.plane_maps import draw_map
from analysis.figures.residuals import draw_residuals
from analysis.figures.sheet import sheet
from analysis.figures.slip import draw_slip
from analysis.figures.stability_map import MapPoint, draw_points_on_map
from analysis.maps.answers import MapAnswer, answer
from analysis.maps.axes import MapAxis
from analysis.maps.families import BestValue, BorderFamily, SearchRange
from analysis.maps.question import MapQuestion, rig_source
from daq.log import open_log
from daq.signals.run import Run
from tests.daq.small_log import write_small_log
from tests.effort import THOROUGH, thorough
from tests.figures.drawn_texts import drawn_texts, faults
from tests.figures.figure_runs import MODEL, point, ring_down, run_up

_OF_RUNS: dict[str, tuple[Callable[[], Figure], ...]] = {
    "time": (
        lambda: KINDS["time"].draw(run_up(), MODEL),
        lambda: KINDS["time"].draw(point("A"), MODEL, point("B")),
        lambda: KINDS["time"].draw(ring_down(), MODEL, ring_down(2)),
    ),
    "orbit": (
        lambda: KINDS["orbit"].draw(run_up(), MODEL),
        lambda: KINDS["orbit"].draw(_sized(0.25), MODEL),
        lambda: KINDS["orbit"].draw(_sized(1.1), MODEL),
        lambda: KINDS["orbit"].draw(point("A"), MODEL, point("B")),
    ),
    "dial": (
        lambda: KINDS["dial"].draw(point("A"), MODEL, point("B")),
        lambda: KINDS["dial"].draw(point("D")),
        lambda: KINDS["dial"].draw(point("D"), MODEL),
    ),
    "bode": (lambda: KINDS["bode"].draw(run_up(), MODEL, run_up(2)), lambda: KINDS["bode"].draw(run_up())),
    "polar": (lambda: KINDS["polar"].draw(run_up(), MODEL, run_up(2)),),
    "waterfall": (
        lambda: KINDS["waterfall"].draw(run_up(), MODEL, run_up(2)),
        lambda: KINDS["waterfall"].draw(point("D"), MODEL),
    ),
    "spectrum": (
        lambda: KINDS["spectrum"].draw(point("A"), MODEL, point("B")),
        lambda: KINDS["spectrum"].draw(ring_down(), MODEL),
    ),
    "orders": (
        lambda: KINDS["orders"].draw(run_up(), MODEL, run_up(2)),
        lambda: KINDS["orders"].draw(point("D"), MODEL),
    ),
}


def _sized(share: float) -> Run:
    """A run-up of other amplitudes: other ticks."""
    return replace(run_up(), x_m=share * run_up().x_m, y_m=share * run_up().y_m)


def _values(name: str, std: float) -> list[Value]:
    begun = datetime(2026, 3, 1, 9, 0, tzinfo=UTC)
    return [
        Value(name, begun + timedelta(days=3 * i), 1.0 + 0.01 * i, std, f"campaign {i}", left_out=i == 2)
        for i in range(5)
    ]


def _history() -> Figure:
    names = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "c3_Nms_per_rad", "c4_Nms_per_rad", "SP_kg_m")
    joint = [v for name in names for v in _values(name, 0.004)]
    single = [v for name in names for v in _values(name, 0.02)]
    changes = [Value("k1_N_per_m", joint[2].time, 0.0, 0.0, "+1.2 %")]
    return draw_parameter_history(joint, single, changes, dict.fromkeys(names, "N/m"), "virtual")


def test_a_history_of_one_file_has_a_day_around_it() -> None:
    (value, *_) = _values("k1_N_per_m", 0.004)
    drawn = draw_parameter_history([value], [], [], {"k1_N_per_m": "N/m"}, "virtual")
    drawn.savefig(io.BytesIO())  # warnings are errors
    low, high = drawn.axes[0].get_xlim()
    assert high - low == pytest.approx(1.0)


def _residuals() -> Figure:
    time = np.linspace(0.0, 12.0, 20000)
    fitted = 2.5 * np.exp(-0.3 * time) * np.cos(19.0 * time)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(time))
    ring_down_x = FitCurve("ring-down-x: x", time, fitted + noise, fitted, "mm", "displacement")
    angle = 40 * fitted[:900]
    return draw_residuals([ring_down_x, FitCurve("spin-down: A", time[:900], angle + noise[:900], angle, "°", "angle")])


def _answered(columns: int = 40, rows: int = 12, **more: Any) -> MapAnswer:
    x = MapAxis(("speed_ratio",), 0.5, 6.0, columns)
    y = MapAxis(("suspension.zeta1", "suspension.zeta2"), 0.005, 0.2, rows, True)
    return answer(MapQuestion(rig_source("virtual"), x, y, quantity="decay-rate", accuracy=1e-6, **more))


def _map() -> Figure:
    return draw_map(_answered())[0]


def _family() -> Figure:
    """Only the thorough run searches the best value: tests/analysis/test_best_value.py tests the search."""
    damping = ("pendulums.a.damping_Nms_per_rad", "pendulums.b.damping_Nms_per_rad")
    family, best = BorderFamily(damping, (1e-3, 4e-3)), SearchRange(damping, 1e-4, 1e-2, True)
    if THOROUGH:
        return draw_map(_answered(family=family, best=best, borders=True))[0]
    found = _answered(10, 4, family=family, borders=True)
    values = np.geomspace(best.low, best.high, 19)
    shares = 0.8 - 0.1 * np.log10(values / values[12]) ** 2
    made_up = BestValue(
        values, shares, np.full(19, 2e-3), values[12], (values[11], values[13]), shares[12], 1e-3, at_end=False
    )
    return draw_map(replace(found, question=replace(found.question, best=best), best=made_up))[0]


_OTHERS: dict[str, Callable[[], Figure]] = {
    "slip": lambda: draw_slip([point("A"), point("B"), point("D")], MODEL),
    "multipliers": lambda: draw_multipliers([speed_point(point(name)) for name in "ABD"], MODEL),
    "map": lambda: draw_points_on_map(
        MODEL.physics,
        [MapPoint("A", 0.83, "III"), MapPoint("B", 1.6, "I"), MapPoint("C", 2.6, "not settled")],
        "Stability map: virtual, parameters.toml",
    ),
    "plane map": _map,
    "family of borders": _family,
    "residuals": _residuals,
    "history": _history,
}


_MORE = {("time", 0), ("orbit", 1), ("orbit", 3), ("dial", 1), ("bode", 1), ("waterfall", 1), ("orders", 1)}
"""Figures whose parts the other figures of their kind have too."""


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        pytest.param(kind, i, marks=thorough if (kind, i) in _MORE else ())
        for kind, draws in _OF_RUNS.items()
        for i in range(len(draws))
    ],
)
def test_a_figure_of_runs_can_be_read(kind: str, number: int) -> None:
    assert faults(_OF_RUNS[kind][number]()) == []


@pytest.mark.parametrize("kind", list(_OTHERS))
def test_a_figure_of_several_can_be_read(kind: str) -> None:
    assert faults(_OTHERS[kind]()) == []


def test_the_health_of_a_log_can_be_read(tmp_path: Path) -> None:
    with open_log(write_small_log(tmp_path / "small.mcap")) as log:
        assert faults(draw_health(log)) == []


def test_every_curve_of_a_logs_health_is_in_the_legend(tmp_path: Path) -> None:
    with open_log(write_small_log(tmp_path / "small.mcap")) as log:
        figure = draw_health(log)
    (legend,) = figure.legends
    named = {text.get_text().split(",")[0] for text in legend.get_texts()}
    assert {"laser/x", "laser/y", "pendulums", "tacho", "motor"} <= named
    looks = {(line.get_color(), line.get_linestyle()) for line in legend.get_lines()}
    assert {(line.get_color(), line.get_linestyle()) for line in figure.axes[2].get_lines()} <= looks


def test_every_kind_is_looked_at() -> None:
    of_no_log = {"plane map", "family of borders"}
    assert set(_OF_RUNS) | set(_OTHERS) | {"health"} == set(KINDS) | of_no_log


def test_a_long_title_and_a_long_legend_are_broken_into_lines() -> None:
    with sheet(5.0, 2.0, "a title of many words " * 8, ["a foot note of many words " * 12]) as figure:
        axes = figure.add_subplot()
        for i in range(7):
            axes.plot([0, 1], [0, i], label=f"a curve with a long name, number {i}")
    assert faults(figure) == []
    assert len(drawn_texts(figure)) > 9


def test_texts_of_neighbours_are_seen() -> None:
    figure = Figure(figsize=(4, 2))
    left, right = figure.add_axes((0.1, 0.2, 0.38, 0.7)), figure.add_axes((0.52, 0.2, 0.38, 0.7))
    for axes, name in ((left, "left"), (right, "right")):
        axes.set_title(name, loc="left", fontsize=8)
    left.set_yticks([])
    right.set_yticks([0.5], ["−10.0"])
    right.set_xticks([])
    left.set_xticks([0.40, 0.52], ["one", "two"], fontsize=7.5)
    text = " ".join(faults(figure))
    assert "'−10.0' lies on left" in text
    assert "'one' and 'two' stand too close" in text


def test_what_is_wrong_is_seen() -> None:
    figure = Figure(figsize=(3, 2))
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    axes.set_axis_off()
    axes.plot([0, 1], [0, 1], label="curve")
    axes.legend(loc="center")
    axes.text(0.2, 0.1, "one")
    axes.text(0.21, 0.1, "two")
    axes.text(0.6, 0.1, "small", fontsize=7)
    axes.text(0.9, 0.9, "far too long for the figure")
    text = " ".join(faults(figure))
    assert "'one' and 'two' overlap" in text
    assert "'small' is 7 pt" in text
    assert "leaves the figure" in text
    assert "a legend lies on" in text
