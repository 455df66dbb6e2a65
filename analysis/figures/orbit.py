"""Orbits: path of the disk centre with the index mark, measured, with the model's ellipse."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator

from analysis.figures.intervals import TIMES, TIMES_IN_PLANE, area, interval_words
from analysis.figures.order_vectors import (
    ByName,
    OrderVectors,
    PassedVectors,
    changes_speed,
    passed_vectors,
    vectors_at_end,
)
from analysis.figures.recorded import need_vectors
from analysis.figures.sheet import MODEL_LOOK, OVER_LOOK, WIDTH_IN, Look, sheet
from analysis.figures.stamp_lag import correction_words, lag_words
from analysis.figures.steady_part import SteadyPart, steady_part
from analysis.figures.style import GREY, MEASURED, label
from analysis.quantities.orbits import OrbitEllipse, orbit_ellipse
from analysis.quantities.stamp_lag import unknown_lag
from analysis.rig_model import RigModel
from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM

_ELLIPSE_LOOK: Look = {"color": MEASURED, "ls": "-", "lw": 2.6, "alpha": 0.6}
_RAW_TURNS = 3
_RAW_POINTS = 400  # drawn samples of these turns
_PANELS = 6
_MARGIN = 0.1  # of the larger extent, on either side
_INTERVALS = 5  # of ticks
_MIN_ECCENTRIC_SHARE = 2e-3  # difference of the axes over the major one below which no inclination is written
_AT_REST_M = 1e-8
_SMALL_M = 1e-4  # semi-axis below which µm are used
_NOISE_STDS = 3.5  # semi-axis in deviations: noise alone exceeds it with a probability of 1 %
_MIN_TUBE_SHARE = 0.99  # least distance from a tube's inner edge to its middle over its radius
_FOOT = (
    "Index mark (filled measured, hollow model): position of the disk centre when the imbalance points along +x. "
    "Arrow: sense of motion; the rotor turns counterclockwise, from x to y."
)


@dataclass(frozen=True)
class OrbitPanel:
    """Orbit at one speed: measured samples of some revolutions (mm), 1× ellipses, deviations of measured vectors."""

    speed_rad_s: float
    raw_mm: tuple[Array, Array]
    measured: OrbitEllipse
    std_m: tuple[float, float]
    model: OrbitEllipse | None
    over: OrbitEllipse | None = None


def draw_orbit(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Draw the orbit at the end of a run at one speed; of a run-up six orbits through its resonances.

    Args:
        run, over: runs with both displacements and index marks; the second is drawn over the first.
        model: model; its steady state at the measured speed and pendulum angles, for a run-up its simulation.
    Raises:
        NotEnoughData: a displacement is missing, or the rotor did not turn.
    """
    need_vectors(run, "an orbit", both=True)
    passing = changes_speed(run)
    panels, compared = _passing(run, model, over) if passing else _steady(run, model, over)
    foot = [_FOOT, *interval_words(compared.corrected), *lag_words(compared), *correction_words(compared)]
    rows, columns = (2, 3) if passing else (1, 1)
    size = (WIDTH_IN, 6.0) if passing else (5.6, 4.9)
    what = "model's ellipse, same run-up" if passing else "model's ellipse"
    named = "" if model is None else f"{what} ({model.name})"
    with sheet(*size, f"Orbit, 1×: {Path(run.source).name} ({run.test})", foot) as figure:
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, panel in zip(grid.flat, panels, strict=True):
            _panel(axes, panel, named, "" if over is None else f"measured, {Path(over.source).name}")
        for axes in grid[-1]:
            label(axes, "x, mm")
        for axes in grid[:, 0]:
            label(axes, y="y, mm")
    return figure


def _steady(run: Run, model: RigModel | None, over: Run | None) -> tuple[list[OrbitPanel], PassedVectors]:
    """Return the orbit of the last seconds, and its measured vectors with those of the model."""
    part = steady_part(run)
    measured, predicted = vectors_at_end(run, part), _steady_model(run, part, model)
    other = None
    if over is not None:
        need_vectors(over, "an orbit", both=True)
        other = _ellipse_of(vectors_at_end(over, steady_part(over)))
    last = part.last_turns(_RAW_TURNS)
    panel = OrbitPanel(
        part.speed_rad_s,
        _raw(run, last.from_s, last.to_s),
        _ellipse_of(measured),
        _stds(measured),
        _ellipse_of(predicted) if predicted else None,
        other,
    )
    lags = {name: unknown_lag(run.clocks, name) for name in measured}
    return [panel], PassedVectors(measured, predicted, {}, lags, measured)


def _steady_model(run: Run, part: SteadyPart, model: RigModel | None) -> ByName:
    """Return the model's vectors at the part's speed, one row each; empty without a steady state."""
    if model is None:
        return {}
    if run.releases:
        _, angles = part.cut(run.angle_time_s, run.angle_rad)
        state = model.steady_state(part.speed_rad_s, angles.mean(axis=0).tolist() if len(angles) else None)
        if state is None:
            return {}
        shown = model.shown_orders(state.x_m, -1j * state.y_m)
    else:
        held_x, held_y = model.locked(np.array([part.speed_rad_s]))
        shown = complex(held_x[0]), complex(held_y[0])
    if not np.isfinite(shown).all():
        return {}
    speed = np.array([part.speed_rad_s])
    return {name: OrderVectors(speed, np.array([value]), np.zeros(1)) for name, value in zip("xy", shown, strict=True)}


def _ellipse_of(found: ByName, speed_rad_s: float | None = None) -> OrbitEllipse:
    """Return the ellipse at a speed, by default the only one."""
    at = float(found["x"].speed_rad_s[0]) if speed_rad_s is None else speed_rad_s
    return orbit_ellipse(_at(found["x"], at), _at(found["y"], at), *_stds(found, at))


def _stds(found: ByName, speed_rad_s: float | None = None) -> tuple[float, float]:
    """Return standard deviations of x's and y's vectors at a speed, by default the only one, m."""
    x, y = (
        float(np.interp(v.speed_rad_s[0] if speed_rad_s is None else speed_rad_s, v.speed_rad_s, v.std_m))
        for v in (found["x"], found["y"])
    )
    return x, y


def _raw(run: Run, start: float, end: float) -> tuple[Array, Array]:
    """Return samples about their mean, y interpolated at the times of x, mm."""
    inside = (run.x_time_s >= start) & (run.x_time_s <= end)
    times = run.x_time_s[inside]
    x, y = run.x_m[inside], np.interp(times, run.y_time_s, run.y_m)
    step = max(1, len(times) // _RAW_POINTS)
    return 1e3 * (x - float(np.nanmean(x)))[::step], 1e3 * (y - float(np.nanmean(y)))[::step]


def _passing(run: Run, model: RigModel | None, over: Run | None) -> tuple[list[OrbitPanel], PassedVectors]:
    """Return orbits below, at and above both resonances of a run-up, one per panel, and all vectors."""
    found = passed_vectors(run, model)
    other = None
    if over is not None:
        need_vectors(over, "an orbit", both=True)
        other = passed_vectors(over, model).corrected
    measured = found.corrected
    x, y = measured["x"], measured["y"]
    peaks = sorted(float(v.speed_rad_s[np.argmax(np.abs(v.amplitude_m))]) for v in (x, y))
    low, high = max(x.speed_rad_s[0], y.speed_rad_s[0]), min(x.speed_rad_s[-1], y.speed_rad_s[-1])
    middle = math.sqrt(peaks[0] * peaks[1])
    speeds = np.clip([0.8 * peaks[0], peaks[0], middle, 0.92 * peaks[1], peaks[1], high], low, high)
    predicted = found.simulated or found.steady
    panels: list[OrbitPanel] = []
    marks = np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)
    for speed in speeds.tolist():
        at = int(np.argmin(np.abs(marks - speed)))
        raw = _raw(run, float(run.mark_time_s[max(at - 1, 0)]), float(run.mark_time_s[min(at + 2, len(marks))]))
        shown = _ellipse_of(predicted, speed) if predicted else None
        second = None if other is None or not _within(other, speed) else _ellipse_of(other, speed)
        own, std = _ellipse_of(measured, speed), _stds(measured, speed)
        panels.append(OrbitPanel(speed, raw, own, std, shown, second))
    return panels, found


def _within(found: ByName, speed_rad_s: float) -> bool:
    """Whether a run went through a speed."""
    return all(v.speed_rad_s.min() <= speed_rad_s <= v.speed_rad_s.max() for v in found.values())


def _at(found: OrderVectors, speed: float) -> complex:
    """Return the vector at a speed."""
    return complex(
        np.interp(speed, found.speed_rad_s, found.amplitude_m.real),
        np.interp(speed, found.speed_rad_s, found.amplitude_m.imag),
    )


def _panel(axes: Axes, panel: OrbitPanel, model: str, over: str) -> None:
    axes.plot(*panel.raw_mm, color=GREY, lw=0.6, alpha=0.8, label="samples of three revolutions")
    _ellipse(axes, panel.measured, _ELLIPSE_LOOK, "measured", filled=True)
    _interval(axes, panel)
    if panel.model is not None:
        _ellipse(axes, panel.model, MODEL_LOOK, model, filled=False)
    if panel.over is not None:
        _ellipse(axes, panel.over, OVER_LOOK, over, filled=True)
    _square(axes)
    sense, size = _words(panel.measured)
    axes.set_title(f"{TO_RPM * panel.speed_rad_s:.1f} rpm, {sense}\n{size}", fontsize=8.5, parse_math=False)


def _interval(axes: Axes, panel: OrbitPanel) -> None:
    """Draw a band along the measured ellipse, and the 95 % area of the index mark."""
    turn = np.linspace(0, 2 * math.pi, 361)
    path = np.array(_path(panel.measured, turn))
    scale = np.array([[max(1e3 * TIMES * std, 1e-9)] for std in panel.std_m])
    scaled = path / scale  # scaled so that the band is a tube of radius 1
    along = np.gradient(scaled, axis=1)
    across = np.array([-along[1], along[0]]) / np.maximum(np.hypot(along[0], along[1]), 1e-12)
    outer, inner = sorted((scaled + across, scaled - across), key=_extent, reverse=True)
    way = inner[:, :, None] - scaled[:, None, :]
    apart: Array = np.asarray(np.min(np.hypot(way[0], way[1]), axis=1), np.float64)
    inner = inner[:, apart > _MIN_TUBE_SHARE]  # elsewhere the tube has no hole
    around = scale * np.concatenate([outer, inner[:, ::-1]], axis=1)
    area(axes, around[0], around[1], MEASURED)
    mark = _path(panel.measured, np.zeros(1))
    wide = [1e3 * TIMES_IN_PLANE * std for std in panel.std_m]
    area(axes, mark[0] + wide[0] * np.cos(turn), mark[1] + wide[1] * np.sin(turn), MEASURED)


def _extent(path: Array) -> float:
    """Return the extent of a closed path, to distinguish the outer from the inner one."""
    return float(np.sum(np.ptp(path, axis=1)))


def _square(axes: Axes) -> None:
    """Set equal limits about the drawn paths, and fixed ticks that remain valid when the layout widens one axis."""
    drawn = axes.dataLim
    half = 0.5 * max(drawn.width, drawn.height)
    x, y = 0.5 * (drawn.x0 + drawn.x1), 0.5 * (drawn.y0 + drawn.y1)
    axes.update_datalim([(x - half, y - half), (x + half, y + half)])
    axes.margins(_MARGIN)
    half *= 1 + 2 * _MARGIN
    ticks = MaxNLocator(_INTERVALS, steps=[1, 2, 5, 10])
    axes.xaxis.set_major_locator(FixedLocator(ticks.tick_values(x - half, x + half)))
    axes.yaxis.set_major_locator(FixedLocator(ticks.tick_values(y - half, y + half)))
    axes.set_aspect("equal", adjustable="datalim")


def _words(orbit: OrbitEllipse) -> tuple[str, str]:
    """Return the sense of rotation, and semi-axes with inclination."""
    if orbit.major_m < _AT_REST_M:
        return "at rest", ""
    sense = orbit.precession if orbit.major_m > _NOISE_STDS * orbit.std_m else "lost in noise"
    at = (
        f" at {round(math.degrees(orbit.inclination_rad))}°".replace("-", "−")
        if orbit.major_m - abs(orbit.minor_m) > _MIN_ECCENTRIC_SHARE * orbit.major_m
        else ""
    )
    unit, times = ("µm", 1e6) if orbit.major_m < _SMALL_M else ("mm", 1e3)
    return sense, f"{times * orbit.major_m:.3g} × {times * abs(orbit.minor_m):.3g} {unit}{at}"


def _path(orbit: OrbitEllipse, phase: Array) -> tuple[Array, Array]:
    """Return x and y at phases, mm."""
    x, y = orbit.points(phase)
    return 1e3 * x, 1e3 * y


def _ellipse(axes: Axes, orbit: OrbitEllipse, look: Look, text: str, *, filled: bool) -> None:
    turn = np.linspace(0, 2 * math.pi, 361)
    axes.plot(*_path(orbit, turn), label=text, **look)
    colour = look["color"]
    mark = _path(orbit, np.zeros(1))
    axes.plot(
        *mark, marker="o" if filled else "s", ms=6.5, mfc=colour if filled else "white", mec=colour, ls="", zorder=5
    )
    if filled:
        (x0, x1), (y0, y1) = (c.tolist() for c in _path(orbit, np.array([0.9, 1.0])))
        axes.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.4})
