"""Sentences below figures: lags, intervals, curves that leave a plot, alignment, missing signals."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from analysis import NotEnoughData, draw_bode, draw_orbit
from analysis.figures.alignment import aligned
from analysis.figures.intervals import NAME
from analysis.figures.kinds import KINDS
from analysis.figures.order_vectors import passed_vectors
from analysis.figures.parameter_history import Value, draw_parameter_history
from analysis.figures.stamp_lag import lag_words
from daq.signals.run import Release, Run
from tests.figures.drawn_texts import drawn_texts
from tests.figures.figure_runs import LAG_S, MODEL, point, ring_down, run_up

draw_time, draw_polar = KINDS["time"].draw, KINDS["polar"].draw
_EMPTY = np.empty(0)


def words(figure: Figure) -> str:
    """All texts of a figure in one line."""
    return re.sub(r"\s+", " ", " ".join(text.text for text in drawn_texts(figure)))


@cache
def drawn(draw: Callable[..., Figure], with_model: bool) -> Figure:
    """The run-up's figure, drawn once for all tests that read it."""
    return draw(run_up(), MODEL) if with_model else draw(run_up())


def later(run: Run, shift_s: float) -> Run:
    """The same run in a log that began earlier."""
    return replace(
        run,
        x_time_s=run.x_time_s + shift_s,
        y_time_s=run.y_time_s + shift_s,
        angle_time_s=run.angle_time_s + shift_s,
        mark_time_s=run.mark_time_s + shift_s,
        motor_start_s=run.motor_start_s + shift_s,
        releases=tuple(replace(release, time_s=release.time_s + shift_s) for release in run.releases),
    )


@pytest.mark.parametrize("draw", [draw_bode, draw_polar, draw_orbit, draw_time])
def test_every_figure_of_lasers_and_phase_names_their_lag(draw: Callable[..., Figure]) -> None:
    (sentence,) = lag_words(passed_vectors(run_up(), MODEL))
    assert sentence in words(drawn(draw, with_model=True))
    assert "stamps that are shifted" not in words(drawn(draw, with_model=False))


@pytest.mark.parametrize("draw", [draw_orbit, draw_time])
def test_a_shift_at_one_speed_is_named_as_a_phase(draw: object) -> None:
    run = point("D")  # whose lasers are stamped a little early or late themselves
    shifted = replace(run, x_time_s=run.x_time_s + LAG_S, y_time_s=run.y_time_s + LAG_S)
    assert callable(draw)
    late = [late_ms(words(draw(each, MODEL))) for each in (run, shifted)]
    for name in "xy":
        assert late[1][name] - late[0][name] == pytest.approx(1e3 * LAG_S, abs=0.02)


def late_ms(text: str) -> dict[str, float]:
    """Lag of the stamps of x and y in the text of a figure; negative: early."""
    assert "At one speed a shift of the stamps cannot be separated from a phase" in text
    found = re.findall(r"([xy]) [\d.]+ ± [\d.]+° (?:ahead|behind), as of stamps ([\d.]+) ms (early|late)", text)
    return {name: float(ms) * (1 if which == "late" else -1) for name, ms, which in found}


def test_bands_hold_the_models_own_vectors() -> None:
    figure = drawn(draw_bode, with_model=True)
    found = passed_vectors(run_up(), MODEL).corrected["x"]
    lower = figure.axes[2]
    band = next(c for c in lower.collections if isinstance(c, PolyCollection) and c.get_label() == NAME)
    edge = np.asarray(band.get_paths()[0].vertices, float)
    at = int(np.argmax(found.std_m))
    here = edge[np.isclose(edge[:, 0], 30 / math.pi * found.speed_rad_s[at]), 1]
    half = 1e3 * 1.96 * found.std_m[at]
    assert here.max() - here.min() == pytest.approx(min(2 * half, half + 1e3 * abs(found.amplitude_m[at])), rel=1e-6)
    text = words(figure)
    match = re.search(r"95 % intervals of the measured vectors.*?x ± ([\d.]+)…([\d.]+) µm", text)
    assert match is not None, text
    assert [float(number) for number in match.groups()] == pytest.approx(
        [1e6 * 1.96 * float(limit(found.std_m)) for limit in (np.min, np.max)], rel=0.06
    )


@pytest.mark.parametrize("draw", [draw_polar, draw_orbit])
def test_intervals_are_drawn_and_named_in_the_plane(draw: Callable[..., Figure]) -> None:
    figure = drawn(draw, with_model=False)
    assert any(patch.get_label() == NAME for axes in figure.axes for patch in axes.patches)
    assert "95 % intervals of the measured vectors" in words(figure)


def test_the_orbits_band_is_as_wide_as_its_interval() -> None:
    run = point("D")
    noisy = replace(run, x_m=run.x_m + 2e-3 * np.random.default_rng(3).standard_normal(len(run.x_m)))
    figure = draw_orbit(noisy)
    half_um = float(re.findall(r"x ± ([\d.]+) µm", words(figure))[0])
    band, measured = figure.axes[0].patches[0], figure.axes[0].get_lines()[1]
    beyond = np.asarray(band.get_xy(), float)[:, 0].max() - np.asarray(measured.get_xdata(), float).max()
    assert 1e3 * beyond == pytest.approx(half_um, rel=0.06)


def test_steady_curves_that_leave_a_plot_are_named() -> None:
    found = passed_vectors(run_up(), MODEL).steady["x"]
    largest = 1e3 * float(np.max(np.abs(found.amplitude_m)))
    for draw in (draw_bode, draw_polar):
        assert f"steady response leaves the plot: x reaches {largest:.3g} mm" in words(drawn(draw, with_model=True))


def test_both_phase_panels_have_one_step() -> None:
    run = run_up()
    figure = draw_bode(replace(run, y_m=1e-3 * np.cos(np.interp(run.y_time_s, run.mark_time_s, run.mark_phase_rad))))
    steps = [set(np.round(np.diff(axes.get_yticks()), 6)) for axes in figure.axes[:2]]
    assert steps[0] == steps[1]
    assert len(steps[0]) == 1


def test_runs_over_each_other_coincide_where_the_same_happened() -> None:
    released, plucked = point("A"), ring_down()
    commanded = replace(run_up(), motor_start_s=0.5)
    found = aligned(released, later(released, 1.25), "b.mcap")
    assert found.shift_s == pytest.approx(-1.25)
    assert "so that the first releases coincide" in found.words
    found = aligned(commanded, later(commanded, -0.75), "b.mcap")
    assert found.shift_s == pytest.approx(0.75)
    assert "first motor commands" in found.words
    found = aligned(plucked, later(ring_down(2), 2.0), "b.mcap")
    assert found.shift_s == pytest.approx(-2.0, abs=2e-4)
    assert "through rest after the pluck" in found.words
    found = aligned(plucked, commanded, "b.mcap")
    assert found.shift_s == 0.0
    assert "begins where this log begins" in found.words


def test_a_pluck_is_where_it_was_released_however_long_it_was_held() -> None:
    run = ring_down()

    def held(hold_s: float) -> Run:
        time = np.arange(0.0, 1.0 + hold_s + 6.0, 1e-3)
        since = time - 1.0 - hold_s
        swing = np.exp(-0.4 * np.maximum(since, 0)) * np.cos(6 * np.pi * np.maximum(since, 0))
        return replace(run, x_time_s=time, x_m=2e-3 * np.where(time < 1.0, 0.0, swing))

    assert aligned(held(0.4), held(1.9), "b.mcap").shift_s == pytest.approx(-1.5, abs=1e-3)


def test_the_time_history_states_what_coincides() -> None:
    figure = draw_time(point("A"), None, later(point("A"), 1.25))
    assert "is shifted by −1.250 s so that the first releases coincide" in words(figure)


@pytest.mark.parametrize(
    ("run", "missing"),
    [
        (ring_down(), ["no index mark (the rotor stood, or no tachometer was recorded)"]),
        (replace(ring_down(), motor_start_s=0.4), ["the tachometer detected nothing"]),
        (replace(run_up(), x_m=_EMPTY, x_time_s=_EMPTY, y_m=_EMPTY, y_time_s=_EMPTY), ["no displacement (neither"]),
        (
            replace(ring_down(), x_m=_EMPTY, x_time_s=_EMPTY, y_m=_EMPTY, y_time_s=_EMPTY),
            ["no displacement (neither laser has a sample)", "and no index mark"],
        ),
    ],
)
def test_the_error_lists_all_that_a_log_lacks(run: Run, missing: list[str]) -> None:
    with pytest.raises(NotEnoughData) as error:
        draw_bode(run, MODEL)
    for part in missing:
        assert part in str(error.value)
    assert ("no displacement" in str(error.value)) == (not len(run.x_m))


def test_an_orbit_without_one_laser_names_it() -> None:
    with pytest.raises(NotEnoughData, match="no displacement y"):
        draw_orbit(replace(run_up(), y_m=_EMPTY, y_time_s=_EMPTY))


def test_an_orbit_lost_in_noise_has_no_sense() -> None:
    run = point("A")
    noise = np.random.default_rng(5).standard_normal((2, len(run.x_m)))
    still = replace(run, x_m=3e-6 * noise[0], y_m=3e-6 * noise[1][: len(run.y_m)], releases=(Release(0, 1.0),))
    title = draw_orbit(still).axes[0].get_title(loc="left")
    assert "lost in noise" in title
    assert "µm" in title


def holding(run: Run, hold_s: float) -> Run:
    """A run-up that stays at its last speed for a while."""
    turn_s = float(np.diff(run.mark_time_s)[-1])
    marks = run.mark_time_s[-1] + turn_s * np.arange(1, int(hold_s / turn_s))
    time = np.arange(0.0, float(marks[-1]), 1e-3)
    mark_time = np.append(run.mark_time_s, marks)
    phase = np.append(run.mark_phase_rad, run.mark_phase_rad[-1] + 2 * math.pi * np.arange(1, len(marks) + 1))
    psi = np.interp(time, mark_time, phase)
    return replace(
        run,
        x_time_s=time,
        x_m=1e-3 * np.cos(psi),
        y_time_s=time,
        y_m=1e-3 * np.sin(psi),
        mark_time_s=mark_time,
        mark_phase_rad=phase,
    )


def test_a_run_through_speeds_has_no_spectrum_but_that_of_a_stretch_at_one_speed() -> None:
    with pytest.raises(NotEnoughData, match=r"goes from \d+\.\d to 8\d\d\.\d rpm.*draw its waterfall"):
        KINDS["spectrum"].draw(run_up(), MODEL)
    run = holding(run_up(), 6.0)
    figure = KINDS["spectrum"].draw(run, MODEL)
    text = words(figure)
    assert re.search(r"longest stretch at one speed, [5-7]\.\d s at 8\d\d\.\d rpm", text), text
    assert "the run goes through" in text
    line = next(each for each in figure.axes[0].get_lines() if each.get_label() == "full spectrum, measured")
    frequency, values = (np.asarray(each, float) for each in line.get_data())
    turns_Hz = 1 / float(np.diff(run.mark_time_s)[-1])
    assert frequency[np.argmax(values)] == pytest.approx(turns_Hz, abs=0.5)  # forward, of the speed that is held
    assert values.max() == pytest.approx(1.0, rel=0.1)
    assert values[np.abs(frequency - turns_Hz / 2) < 1].max() < 0.01


def test_the_simulated_spectrum_lies_on_its_own_measured_one() -> None:
    figure = KINDS["spectrum"].draw(point("D"), MODEL)
    lines = {str(line.get_label()): line for line in figure.axes[0].get_lines()}
    peaks = {name: float(np.max(np.asarray(line.get_ydata(), float))) for name, line in lines.items() if "full" in name}
    assert set(peaks) == {"full spectrum, measured", "full spectrum, same run simulated, parameters.toml"}
    assert min(peaks.values()) == pytest.approx(max(peaks.values()), rel=0.03)


def test_single_logs_are_seen_next_to_the_joint_estimate() -> None:
    begun = datetime(2026, 3, 1, 9, 0, tzinfo=UTC)
    joint = [Value("zeta1_1", begun, 0.02, 1e-6, "campaign")]
    near = [Value("zeta1_1", begun + timedelta(minutes=i), 0.02 + 6e-6 * (i - 1), 3e-6, f"log {i}") for i in range(3)]
    far = Value("zeta1_1", begun + timedelta(minutes=9), 0.0212, 4e-5, "log far", left_out=True)
    figure = draw_parameter_history(joint, [*near, far], [], {"zeta1_1": "1"})
    axes = figure.axes[0]
    low, high = axes.get_ylim()
    assert all(low < value.value < high for value in near)
    joint_share = 2 * 1.96e-6 / (high - low)
    assert 0.08 < joint_share < 0.5
    assert "off scale: 0.0212 ± 7.8e-05" in words(figure)
    arrows = [line for line in axes.get_lines() if line.get_marker() == "^"]
    assert len(arrows) == 1
    assert low < float(np.asarray(arrows[0].get_ydata(), float)[0]) < high
    assert "off scale" not in words(draw_parameter_history(joint, near, [], {"zeta1_1": "1"})).split("Arrows")[0]
