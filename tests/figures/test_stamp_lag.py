"""Phases in figures: without the stamps' lag where it is estimated, with it in the interval where it is not."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from analysis import draw_bode, draw_orbit, draw_polar
from analysis.figures.intervals import NAME
from analysis.figures.order_vectors import passed_vectors
from analysis.quantities.stamp_lag import UNKNOWN_LAG_STD_S, fitted_lag
from daq.signals.run import Run
from tests.figures.figure_runs import MODEL, run_up

LAG_S = 12e-3  # of a radio


def words(figure: Figure) -> str:
    """The sentences below a figure."""
    return " ".join(" ".join(text.get_text().split()) for text in figure.texts)


def late_run_up(lag_s: float = LAG_S) -> Run:
    """A run-up whose lasers are stamped so much later than before."""
    run = run_up()
    return replace(run, x_time_s=run.x_time_s + lag_s, y_time_s=run.y_time_s + lag_s)


def vectors(lag_s: float, turned_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speeds, vectors through a resonance with a lag and a constant angle, and those without."""
    speed = np.linspace(5.0, 95.0, 300)
    plain = speed**2 / (45.0**2 - speed**2 + 2j * 0.05 * 45.0 * speed) * 1e-3
    return speed, plain * np.exp(1j * (math.radians(turned_deg) - speed * lag_s)), plain


@pytest.mark.parametrize("lag_s", [12e-3, -7e-3, 0.5e-3])
def test_a_lag_is_found_and_taken_out(lag_s: float) -> None:
    speed, late, plain = vectors(lag_s)
    found = fitted_lag(speed, late, plain)
    assert found is not None
    assert found.is_line
    assert found.lag_s == pytest.approx(lag_s, abs=1e-6)
    assert np.allclose(found.without(speed, late), plain, atol=1e-8)


@pytest.mark.parametrize("turned_deg", [25.0, -40.0])
def test_an_index_mark_at_a_wrong_angle_is_no_lag(turned_deg: float) -> None:
    """The correction must not hide it: the phase is no line through 0."""
    speed, turned, plain = vectors(0.0, turned_deg)
    found = fitted_lag(speed, turned, plain)
    assert found is not None
    assert not found.is_line


def test_a_resonance_at_another_speed_is_no_lag() -> None:
    speed, _, plain = vectors(0.0)
    other = speed**2 / (50.0**2 - speed**2 + 2j * 0.05 * 50.0 * speed) * 1e-3
    found = fitted_lag(speed, other, plain)
    assert found is not None
    assert not found.is_line


def test_a_bode_plot_lies_on_the_model_with_any_lag() -> None:
    """The phases of a lag of 12 ms were drawn 60° off at 900 rpm, with an interval of a hundredth of a degree."""
    figures = [draw_bode(late_run_up(lag), MODEL) for lag in (0.0, LAG_S)]
    for panel in (0, 1):
        lines = [figure.axes[panel].get_lines()[0] for figure in figures]
        speed = np.linspace(300.0, 900.0, 50)  # below, the vectors are small
        phases = [np.interp(speed, np.asarray(a.get_xdata(), float), np.asarray(a.get_ydata(), float)) for a in lines]
        apart = np.angle(np.exp(1j * np.radians(phases[1] - phases[0])), deg=True)
        assert np.isfinite(apart).mean() > 0.5
        assert np.nanmax(np.abs(apart)) < 5.0
    assert "drawn without this shift" in words(figures[1])


def test_the_vectors_lie_on_the_simulated_run() -> None:
    found = passed_vectors(late_run_up(), MODEL)
    for name, seen in found.corrected.items():
        model = found.simulated[name].at(seen.speed_rad_s)
        large = np.abs(model) > 0.3 * np.abs(model).max()
        apart = np.abs(np.angle(seen.amplitude_m[large] * np.conj(model[large]), deg=True))
        assert np.median(apart) < 1.0
        assert seen.lag_std_s == found.lags[name].std_s < 1e-3


def test_an_unknown_lag_is_part_of_the_phase_s_interval() -> None:
    figure = draw_bode(late_run_up())  # no model
    found = passed_vectors(late_run_up(), None).corrected["x"]
    expected = np.degrees(1.96 * found.speed_rad_s * UNKNOWN_LAG_STD_S)
    upper = figure.axes[0]
    band = next(c for c in upper.collections if isinstance(c, PolyCollection) and c.get_label() == NAME)
    edge = np.concatenate([np.asarray(path.vertices, float) for path in band.get_paths()])
    at = int(np.argmax(np.abs(found.amplitude_m)))  # where noise adds nothing
    here = edge[np.isclose(edge[:, 0], 30 / math.pi * found.speed_rad_s[at]), 1]
    assert here.max() - here.min() == pytest.approx(2 * expected[at], rel=0.02)


@pytest.mark.parametrize("draw", [draw_bode, draw_polar, draw_orbit])
def test_an_unknown_lag_is_named(draw) -> None:
    text = words(draw(late_run_up()))
    assert "against the rotor's phase is not known: ± 20 ms" in text
    (phase,) = re.findall(r"x ± [\d.…]+ µm, phase of the largest ± ([\d.]+)°", text)
    assert float(phase) > 10


@pytest.mark.parametrize("draw", [draw_bode, draw_polar, draw_orbit])
def test_one_clock_has_no_lag(draw) -> None:
    run = replace(run_up(), clocks={"x": "recorder", "y": "recorder", "phase": "recorder"})
    text = words(draw(run))
    assert "is not known" not in text
    (phase,) = re.findall(r"x ± [\d.…]+ µm, phase of the largest ± ([\d.]+)°", text)
    assert float(phase) < 1
