"""Figures draw the measured and the predicted values: numbers, signs, units."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis import NotEnoughData, draw_bode, draw_multipliers, draw_orbit, draw_residuals, simulate_run
from analysis.figures.angles import degree_ticks, whole_turns
from analysis.figures.fit import FitCurve
from analysis.figures.multipliers import speed_point
from analysis.figures.order_vectors import changes_speed, passed_vectors
from analysis.figures.page import page
from analysis.figures.sheet import MODEL_LOOK
from analysis.figures.slip import draw_slip
from analysis.figures.stability_map import MapPoint, draw_points_on_map
from analysis.figures.stamp_lag import lag_words
from analysis.figures.waterfall import draw_waterfall
from tests.figures.drawn_texts import drawn_texts
from tests.figures.figure_runs import LAG_S, MODEL, point, run_up, run_up_history


def curve(figure: Figure, panel: int, name: str) -> Line2D:
    """A labelled line of a panel."""
    return next(line for line in figure.axes[panel].get_lines() if line.get_label() == name)


def test_a_displacement_that_leads_the_mark_has_a_positive_phase() -> None:
    run = run_up()
    leading = 1e-3 * np.cos(run_up_history().phase(run.x_time_s)[:, 0] + math.radians(30))
    figure = draw_bode(replace(run, x_m=leading))
    phase, amplitude = figure.axes[0].get_lines()[0], curve(figure, 2, "measured")
    late = np.asarray(amplitude.get_xdata()) > 300
    assert np.allclose(np.asarray(phase.get_ydata(), float)[late], 30, atol=0.5)
    assert np.allclose(np.asarray(amplitude.get_ydata(), float)[late], 1.0, atol=0.01)  # mm, 0–peak
    assert "lead positive" in figure.axes[0].get_ylabel()


def test_the_models_own_run_up_lies_on_itself_but_for_the_stamps_lag() -> None:
    found = passed_vectors(run_up(), MODEL)
    for name, measured in found.measured.items():
        simulated = found.simulated[name]
        size = np.interp(measured.speed_rad_s, simulated.speed_rad_s, np.abs(simulated.amplitude_m))
        seen = size > 0.1 * size.max()
        assert np.abs(measured.amplitude_m[seen]) == pytest.approx(size[seen], abs=0.02 * size.max())
    lags = [float(text) for text in re.findall(r"[xy] (\d+\.\d+) ± \d+\.\d+ ms late", lag_words(found)[0])]
    assert lags == pytest.approx([1e3 * LAG_S] * 2, abs=0.3)  # free vibration lags with its own frequency


def test_a_wrong_spring_is_no_lag_of_the_stamps() -> None:
    """Stamps that are early by twice as much still make a line; a resonance at another place does not."""
    found = passed_vectors(replace(run_up(), x_time_s=run_up().x_time_s - 3 * LAG_S), MODEL)
    match = re.search(r"x (\d\.\d+) ± (\d\.\d+) ms early, y (\d\.\d+) ± \d\.\d+ ms late", lag_words(found)[0])
    assert match is not None, lag_words(found)
    x, x_std, y = (float(text) for text in match.groups())
    assert abs(x - 2e3 * LAG_S) < 2 * x_std < 1.2  # plus free vibration
    assert y == pytest.approx(1e3 * LAG_S, abs=0.3)
    stiff = replace(MODEL, physics=replace(MODEL.physics, k2_N_per_m=1.07 * MODEL.physics.k2_N_per_m))
    words = " ".join(lag_words(passed_vectors(run_up(), stiff)))
    assert re.search(r"No lag of the stamps explains .* rms in y", words)
    assert not re.search(r"y \d+\.\d+ ± \d+\.\d+ ms", words)


@pytest.mark.parametrize("kept", [0, 1])
def test_too_few_vectors_yield_no_lag(kept: int) -> None:
    """A run that was cut at its start, or a laser without samples."""
    found = passed_vectors(run_up(), MODEL)
    few = {
        name: replace(seen, amplitude_m=np.where(np.arange(len(seen.speed_rad_s)) < kept, seen.amplitude_m, np.nan))
        for name, seen in found.measured.items()
    }
    assert lag_words(replace(found, measured=few)) == []
    still = {name: replace(seen, amplitude_m=0 * seen.amplitude_m) for name, seen in found.measured.items()}
    assert lag_words(replace(found, measured=still)) == []


def test_one_laser_is_enough_for_a_bode_plot() -> None:
    figure = draw_bode(replace(run_up(), y_m=np.empty(0), y_time_s=np.empty(0)), MODEL)
    assert [axes.get_ylabel()[0] for axes in figure.axes] == ["x", "x"]


def test_a_stop_at_its_end_makes_no_run_up_of_a_point() -> None:
    assert changes_speed(run_up())
    assert not changes_speed(point("D"))
    with pytest.raises(NotEnoughData, match="expected a run through speeds"):
        draw_bode(point("D"))


def test_the_simulated_point_ends_where_the_measured_one_does() -> None:
    run = point("A")
    simulated = simulate_run(run, MODEL)
    assert simulated is not None
    own = run.angle_rad[run.angle_time_s < simulated.time_s[-1]][-200:].mean(axis=0)
    assert np.degrees(simulated.angle_rad[-200:].mean(axis=0)) == pytest.approx(np.degrees(own), abs=1.0)


def test_the_orbits_numbers_are_those_of_the_run() -> None:
    title = draw_orbit(point("A"), MODEL).axes[0].get_title(loc="left")
    run = point("A")
    late = (run.x_time_s > 25) & (run.x_time_s < 33)
    major = float(re.findall(r"\n([\d.]+) ×", title)[0])
    assert major == pytest.approx(1e3 * np.sqrt(2) * np.std(run.x_m[late]), rel=0.02)
    assert "forward" in title


def test_angles_of_both_pendulums_end_within_one_turn() -> None:
    time = np.linspace(0.0, 5.0, 500)
    angles = np.radians(np.column_stack([np.linspace(0, 1090, 500), np.linspace(180, -120, 500)]))
    angles[-150:] = np.radians([1090, -120])
    assert whole_turns(time, angles) == pytest.approx([6 * math.pi, -2 * math.pi])
    ticks, (low, high) = degree_ticks(-0.2, 360.0)
    assert low < -0.2 < 360.0 < high
    assert set(np.diff(ticks)) == {90.0}


def test_the_multipliers_of_a_point_are_in_both_panels() -> None:
    figure = draw_multipliers([speed_point(point("A"))], MODEL)
    text = next(t.text for t in drawn_texts(figure) if t.text.startswith("A: III"))
    largest = float(text.rpartition(" ")[2])
    plane = next(line for line in figure.axes[0].get_lines() if line.get_label() == text)
    moduli = np.hypot(np.asarray(plane.get_xdata(), float), np.asarray(plane.get_ydata(), float))
    assert moduli.max() == pytest.approx(largest, abs=1e-3)
    assert len(moduli) == 8


def test_a_slip_point_stands_still_on_the_rotor() -> None:
    figure = draw_slip([point("A")])
    marks = [line for line in figure.axes[2].get_lines() if str(line.get_label()).endswith("measured")]
    assert [float(np.asarray(line.get_ydata())[0]) for line in marks] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_small_residuals_are_in_micrometres() -> None:
    time = np.linspace(0.0, 5.0, 4000)
    fitted = 2.0 * np.cos(19 * time)
    figure = draw_residuals([FitCurve("ring-down-x: x", time, fitted + 2e-3, fitted, "mm", "displacement")])
    assert any(axes.get_ylabel() == "rest, µm" for axes in figure.axes)
    assert any("rms 2 µm" in axes.get_title(loc="left") for axes in figure.axes)


def test_a_page_takes_its_title_as_text() -> None:
    text = page(draw_orbit(point("A")), "a < b & <script>alert(1)</script>")
    assert "<script>alert" not in text


def test_every_order_of_a_cascade_is_named_where_its_line_ends() -> None:
    figure = draw_waterfall(run_up(), MODEL)
    figure.draw_without_rendering()
    for axes in figure.axes:
        names = {text.get_text(): text.get_window_extent() for text in axes.texts}
        lines = [
            line for line in axes.get_lines() if line.get_zorder() == 1.5 and len(np.asarray(line.get_xdata())) > 2
        ]
        assert len(lines) == 3
        area = axes.get_window_extent()
        for order, line in enumerate(lines, 1):
            ends = axes.transData.transform(line.get_xydata())
            end = ends[ends[:, 0] <= area.x1 + 1][-1]
            box = names[f"{order}×"]
            away = max(box.x0 - end[0], end[0] - box.x1, box.y0 - end[1], end[1] - box.y1)
            assert away < 20  # px at 100 a inch
        low, high = axes.get_ylim()
        reach = max(
            float(np.max(np.asarray(line.get_ydata(), float))) for line in axes.get_lines() if line not in lines
        )
        assert reach > low + 0.85 * (high - low)


def test_slip_of_a_locked_run_up_is_labelled_and_each_line_is_named_once() -> None:
    figure = draw_slip([run_up()], MODEL)
    (legend,) = figure.legends
    looks = [(line.get_color(), line.get_linestyle(), line.get_marker()) for line in legend.get_lines()]
    assert len(set(looks)) == len(looks)
    assert any("locked throughout: run-up-1.mcap" in text.text for text in drawn_texts(figure))
    assert not any("locked throughout" in text.text for text in drawn_texts(draw_slip([point("A")])))
    model = next(line for line in figure.axes[2].get_lines() if line.get_color() == MODEL_LOOK["color"])
    assert model.get_label() in {text.get_text() for text in legend.get_texts()}


def test_a_stability_map_in_grey_darkens_from_stable_to_unstable() -> None:
    figure = draw_points_on_map(MODEL.physics, [MapPoint("A", 0.83, "III")], "map")
    filled = next(each for each in figure.axes[0].collections if len(each.get_facecolor()) > 5)
    grey = np.asarray(filled.get_facecolor())[:, :3] @ [0.299, 0.587, 0.114]
    assert np.all(np.diff(grey) < -0.02)
    assert any("triangle type III" in text.text for text in drawn_texts(figure))
