# pyright: strict, reportUnknownMemberType=false
"""Orbits: the disk centre's path with the index mark, measured beside the model's ellipse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from numpy.typing import NDArray

from analysis.errors import NotEnoughData
from analysis.figures.order_vectors import (
    RPM,
    Vectors,
    changes_speed,
    passed_vectors,
)
from analysis.figures.sheet import MODEL_LOOK, OVER_LOOK, WIDTH_IN, Look, sheet
from analysis.figures.steady_part import steady_part
from analysis.figures.style import GREY, MEASURED, label
from analysis.quantities.orbits import OrbitEllipse, orbit_ellipse
from analysis.quantities.order_tracking import order_track
from analysis.quantities.rotor_phase import phase_at
from analysis.rig_model import RigModel
from daq.signals.run import Run

Array = NDArray[np.float64]

_ELLIPSE_LOOK: Look = {"color": MEASURED, "ls": "-", "lw": 2.6, "alpha": 0.6}
_RAW_TURNS = 3
_RAW_POINTS = 400  # drawn of them
_WINDOW_TURNS = 4
_PANELS = 6
_MARGIN = 0.1  # of the larger extent, on either side
_INTERVALS = 5  # of ticks
_ROUND = 2e-3  # difference of the axes over the major one below which an orbit has no inclination worth a number
_AT_REST_M = 1e-8
_FOOT = (
    "Index mark (filled measured, hollow model): where the disk centre is when the imbalance points along +x. Arrow: "
    "sense of motion; the rotor turns counterclockwise, from x to y."
)


@dataclass(frozen=True)
class OrbitPanel:
    """One speed's orbit: measured samples of some revolutions (mm) and 1× ellipses."""

    speed_rad_s: float
    raw_mm: tuple[Array, Array]
    measured: OrbitEllipse
    model: OrbitEllipse | None
    over: OrbitEllipse | None = None


def draw_orbit(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """The orbit at the end of a run at one speed; of a run-up six orbits through its resonances.

    Args:
        run, over: with both displacements and index marks; the second is drawn over the first.
        model: its steady state at the measured speed with the pendulums as they were; of a run-up its own run-up.
    Raises:
        NotEnoughData: a displacement is missing, or the rotor did not turn.
    """
    if not (len(run.x_time_s) and len(run.y_time_s)):
        raise NotEnoughData(f"{run.source}: expected two displacements for an orbit, x or y has no sample")
    passing = changes_speed(run)
    panels = _passing(run, model) if passing else [_steady(run, model)]
    if over is not None and not passing:
        panels = [
            OrbitPanel(p.speed_rad_s, p.raw_mm, p.measured, p.model, _steady(over, None).measured) for p in panels
        ]
    rows, columns = (2, 3) if passing else (1, 1)
    size = (WIDTH_IN, 6.0) if passing else (5.6, 4.9)
    what = "model's ellipse, same run-up" if passing else "model's ellipse"
    named = "" if model is None else f"{what} ({model.name})"
    with sheet(*size, f"Orbit, 1×: {Path(run.source).name} ({run.test})", _FOOT_LINES) as figure:
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, panel in zip(grid.flat, panels, strict=True):
            _panel(axes, panel, named, "" if over is None else f"measured, {Path(over.source).name}")
        for axes in grid[-1]:
            label(axes, "x, mm")
        for axes in grid[:, 0]:
            label(axes, y="y, mm")
    return figure


_FOOT_LINES: Sequence[str] = (_FOOT,)


def _steady(run: Run, model: RigModel | None) -> OrbitPanel:
    part = steady_part(run)
    found: list[tuple[complex, float]] = []
    for time, values in ((run.x_time_s, run.x_m), (run.y_time_s, run.y_m)):
        t, v = part.cut(time, values)
        try:
            track = order_track(t, v, phase_at(run, t), revolutions=_WINDOW_TURNS)
        except ValueError as error:
            raise NotEnoughData(f"{run.source}: {error}") from error
        found.append(track.mean(1))
    orbit = None
    if model is not None and run.releases:
        _, angles = part.cut(run.angle_time_s, run.angle_rad)
        state = model.steady_state(part.speed_rad_s, angles.mean(axis=0).tolist() if len(angles) else None)
        orbit = None if state is None else orbit_ellipse(*model.shown_orders(state.x_m, -1j * state.y_m))
    elif model is not None:
        held_x, held_y = model.locked(np.array([part.speed_rad_s]))
        orbit = orbit_ellipse(complex(held_x[0]), complex(held_y[0])) if np.isfinite(held_x[0]) else None
    (x, x_std), (y, y_std) = found
    measured = orbit_ellipse(x, y, x_std, y_std)
    last = part.last_turns(_RAW_TURNS)
    return OrbitPanel(part.speed_rad_s, _raw(run, last.from_s, last.to_s), measured, orbit)


def _raw(run: Run, start: float, end: float) -> tuple[Array, Array]:
    """Samples about their mean, y's taken at x's instants, mm."""
    inside = (run.x_time_s >= start) & (run.x_time_s <= end)
    times = run.x_time_s[inside]
    x, y = run.x_m[inside], np.interp(times, run.y_time_s, run.y_m)
    step = max(1, len(times) // _RAW_POINTS)
    return 1e3 * (x - float(np.nanmean(x)))[::step], 1e3 * (y - float(np.nanmean(y)))[::step]


def _passing(run: Run, model: RigModel | None) -> list[OrbitPanel]:
    """Orbits below, at and above both resonances of a run-up, as many as there are panels."""
    found = passed_vectors(run, model)
    x, y = found.measured["x"], found.measured["y"]
    peaks = sorted(float(v.speed_rad_s[np.argmax(np.abs(v.amplitude_m))]) for v in (x, y))
    low, high = max(x.speed_rad_s[0], y.speed_rad_s[0]), min(x.speed_rad_s[-1], y.speed_rad_s[-1])
    middle = math.sqrt(peaks[0] * peaks[1])
    speeds = np.clip([0.8 * peaks[0], peaks[0], middle, 0.92 * peaks[1], peaks[1], high], low, high)
    beside = found.simulated or found.steady
    panels: list[OrbitPanel] = []
    marks = np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)
    for speed in speeds.tolist():
        at = int(np.argmin(np.abs(marks - speed)))
        raw = _raw(run, float(run.mark_time_s[max(at - 1, 0)]), float(run.mark_time_s[min(at + 2, len(marks))]))
        shown = None if not beside else orbit_ellipse(_at(beside["x"], speed), _at(beside["y"], speed))
        panels.append(OrbitPanel(speed, raw, orbit_ellipse(_at(x, speed), _at(y, speed)), shown))
    return panels


def _at(found: Vectors, speed: float) -> complex:
    return complex(
        np.interp(speed, found.speed_rad_s, found.amplitude_m.real),
        np.interp(speed, found.speed_rad_s, found.amplitude_m.imag),
    )


def _panel(axes: Axes, panel: OrbitPanel, model: str, over: str) -> None:
    axes.plot(*panel.raw_mm, color=GREY, lw=0.6, alpha=0.8, label="samples of three revolutions")
    _ellipse(axes, panel.measured, _ELLIPSE_LOOK, "measured", filled=True)
    if panel.model is not None:
        _ellipse(axes, panel.model, MODEL_LOOK, model, filled=False)
    if panel.over is not None:
        _ellipse(axes, panel.over, OVER_LOOK, over, filled=True)
    _square(axes)
    sense, size = _words(panel.measured)
    axes.set_title(f"{RPM * panel.speed_rad_s:.1f} rpm, {sense}\n{size}", fontsize=8.5, parse_math=False)


def _square(axes: Axes) -> None:
    """Equal limits about the drawn paths, and ticks that stay when the layout widens one of them: it left them room."""
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
    """Sense; semi-axes and inclination."""
    if orbit.major_m < _AT_REST_M:
        return "at rest", ""
    at = (
        f" at {round(math.degrees(orbit.inclination_rad))}°".replace("-", "−")
        if orbit.major_m - abs(orbit.minor_m) > _ROUND * orbit.major_m
        else ""
    )
    return f"{orbit.precession}", f"{1e3 * orbit.major_m:.3g} × {1e3 * abs(orbit.minor_m):.3g} mm{at}"


def _path(orbit: OrbitEllipse, phase: Array) -> tuple[Array, Array]:
    """x and y at phases, mm."""
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
