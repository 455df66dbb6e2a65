"""Time history: displacements, pendulum angles and speed over a whole run, with a close view of a few revolutions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.errors import NotEnoughData
from analysis.figures.alignment import aligned
from analysis.figures.angles import ANGLE_FOOT, degree_ticks, whole_turns
from analysis.figures.order_vectors import changes_speed, compared_vectors
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stamp_lag import lag_words
from analysis.figures.steady_part import steady_part
from analysis.figures.style import GOOD, MEASURED, MODEL, band, bins_for, label, outline
from analysis.rig_model import RigModel
from analysis.simulated_run import NOT_FOLLOWED, SimulatedRun, simulate_run
from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM

Pair = tuple[Array, Array]

_CLOSE_TURNS = 4  # of the close view
_CLOSE_CYCLES = 8  # of the close view of a standing rotor
_STANDING_HZ = 3.0  # assumed vibration frequency of a standing rotor
_CLOSE_SAMPLES = 700


@dataclass(frozen=True)
class _Row:
    """One signal: times and displayed values; those of the model and of the other run; whether it is an angle."""

    text: str
    own: Pair
    model: Pair | None
    other: Pair | None
    is_angle: bool = False


def draw_time(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Draw the whole run (left) and some revolutions (right): the last at one speed, else at the largest displacement.

    Args:
        run: any run; signals that were not recorded have no row.
        model: model; its simulation with measured speed, lock angles and releases. A standing rotor is not simulated.
        over: another run, aligned by common events (`alignment`).
    Raises:
        NotEnoughData: the run has neither displacements nor angles.
    """
    simulated = None if model is None else simulate_run(run, model)
    alignment = None if over is None else aligned(run, over, Path(over.source).name)
    rows = _rows(run, simulated, over, 0.0 if alignment is None else alignment.shift_s)
    if not rows:
        raise NotEnoughData(f"{run.source}: expected displacements, pendulum angles or index marks, it has none")
    whole, close = _spans(run)
    foot = [ANGLE_FOOT] if any(row.is_angle for row in rows) else []
    foot.append(
        "Displacements about their mean. A band is the least and the largest sample of each stretch, not samples."
    )
    if alignment is not None:
        foot.append(alignment.words)
    if model is not None and simulated is None:
        foot.append(NOT_FOLLOWED)
    compared = compared_vectors(run, simulated)
    foot += [] if compared is None else lag_words(compared)
    names = (
        "" if model is None else f"same run simulated, {model.name}",
        "" if over is None else Path(over.source).name,
    )
    with sheet(WIDTH_IN, 0.5 + 1.2 * len(rows), f"Time history: {Path(run.source).name} ({run.test})", foot) as figure:
        grid = figure.subplots(len(rows), 2, sharex="col", width_ratios=(2.4, 1), squeeze=False)
        for (left, right), row in zip(grid, rows, strict=True):
            _draw(left, row, whole, names, bins_for((whole[1] - whole[0]) * _turns_Hz(run)))
            _draw(right, row, close, names, _CLOSE_SAMPLES)
            label(left, y=row.text)
            for release in run.releases:
                left.axvline(release.time_s, color="#444444", lw=0.8, ls=":")
        label(grid[0, 0], title="whole run (dotted line: release)" if run.releases else "whole run")
        label(grid[0, 1], title=f"{close[1] - close[0]:.2g} s of it")
        for axes in grid[-1]:
            label(axes, "time since the run's start, s")
        grid[0, 0].set_xlim(*whole)
        grid[0, 1].set_xlim(*close)
        figure.align_ylabels(grid)
    return figure


def _rows(run: Run, simulated: SimulatedRun | None, over: Run | None, shift: float) -> list[_Row]:
    rows: list[_Row] = []
    for name in "xy":
        own = _displacement(run, name)
        if own is not None:
            other = None if over is None else _displacement(over, name, shift)
            model = None
            if simulated is not None:
                values = simulated.x_m if name == "x" else simulated.y_m
                model = simulated.time_s, 1e3 * (values - values.mean())
            rows.append(_Row(f"{name}, mm", own, model, other))
    for j, name in enumerate(("θ3, °", "θ4, °")):
        if len(run.angle_time_s) and np.isfinite(run.angle_rad[:, j]).any():
            turns = whole_turns(run.angle_time_s, run.angle_rad)[j]
            own = run.angle_time_s, np.degrees(run.angle_rad[:, j] - turns)
            model = None if simulated is None else (simulated.time_s, np.degrees(simulated.angle_rad[:, j] - turns))
            other = None
            if over is not None and len(over.angle_time_s):
                own_turns = whole_turns(over.angle_time_s, over.angle_rad)[j]
                other = over.angle_time_s + shift, np.degrees(over.angle_rad[:, j] - own_turns)
            rows.append(_Row(name, own, model, other, is_angle=True))
    if len(run.mark_time_s) > 2:
        other = None if over is None or len(over.mark_time_s) < 3 else _speed(over, shift)
        rows.append(_Row("speed, rpm", _speed(run), None, other))
    return rows


def _displacement(run: Run, name: str, shift: float = 0.0) -> Pair | None:
    time, values = (run.x_time_s, run.x_m) if name == "x" else (run.y_time_s, run.y_m)
    return (time + shift, 1e3 * (values - float(np.nanmean(values)))) if np.isfinite(values).any() else None


def _speed(run: Run, shift: float = 0.0) -> Pair:
    middle = 0.5 * (run.mark_time_s[1:] + run.mark_time_s[:-1])
    return middle + shift, TO_RPM * np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)


def _turns_Hz(run: Run) -> float:
    """Return the mean frequency of rotation, for bins no shorter than a cycle; 0 if the rotor does not turn."""
    if len(run.mark_time_s) < 3:
        return 0.0
    return float((len(run.mark_time_s) - 1) / (run.mark_time_s[-1] - run.mark_time_s[0]))


def _spans(run: Run) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the whole run and the interval of the close view, s."""
    times = [t for t in (run.x_time_s, run.y_time_s, run.angle_time_s, run.mark_time_s) if len(t)]
    whole = (min(float(t[0]) for t in times), max(float(t[-1]) for t in times))
    if len(run.mark_time_s) > 2 and not changes_speed(run):
        try:
            part = steady_part(run).last_turns(_CLOSE_TURNS)
        except NotEnoughData:  # usual: a short log; the whole run is shown
            return whole, whole
        return whole, (part.from_s, part.to_s)
    largest = [(float(np.nanmax(np.abs(d[1]))), d) for d in (_displacement(run, "x"), _displacement(run, "y")) if d]
    if not largest:
        return whole, whole
    time, values = max(largest, key=lambda pair: pair[0])[1]
    at = float(time[np.nanargmax(np.abs(values))])
    turns_Hz = float(np.interp(at, *_speed(run))) / 60 if len(run.mark_time_s) > 2 else 0.0
    width = _CLOSE_TURNS / turns_Hz if turns_Hz > 0 else _CLOSE_CYCLES / _STANDING_HZ
    start = min(max(at - (width / 2 if turns_Hz > 0 else 0.0), whole[0]), max(whole[1] - width, whole[0]))
    return whole, (start, min(start + width, whole[1]))


def _draw(axes: Axes, row: _Row, span: tuple[float, float], names: tuple[str, str], bins: int) -> None:
    time, values = _within(row.own, span)
    if len(time) > 1:
        if len(time) > 2 * bins:
            band(axes, time, values, MEASURED, "measured", bins=bins)
        else:
            axes.plot(time, values, color=MEASURED, lw=2.6, alpha=0.5, label="measured")
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if len(time) else (0.0, 1.0)
    if row.other is not None:
        other_time, other = _within(row.other, span)
        if len(other_time) > 1:
            outline(axes, other_time, other, GOOD, names[1], bins=bins)
            for line in axes.get_lines()[-2:]:
                line.set_linestyle((0, (6, 1.5, 1, 1.5)) if line.get_color() == GOOD else line.get_linestyle())
            low, high = min(low, float(np.nanmin(other))), max(high, float(np.nanmax(other)))
    if row.model is not None:
        model_time, model = _within(row.model, span)
        if len(model_time) > 1:
            before = len(axes.get_lines())
            outline(axes, model_time, model, MODEL, names[0], bins=bins)
            for line in axes.get_lines()[before:]:
                line.set_linestyle((0, (5, 2)))
            low, high = min(low, float(np.nanmin(model))), max(high, float(np.nanmax(model)))
    _limits(axes, row, low, high)


def _limits(axes: Axes, row: _Row, low: float, high: float) -> None:
    if row.is_angle:
        ticks, limits = degree_ticks(low, high)
        axes.set_yticks(ticks)
        axes.set_ylim(*limits)
        return
    room = max(0.08 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-6)
    axes.set_ylim(low - room, high + room)
    axes.ticklabel_format(axis="y", useOffset=False)


def _within(pair: Pair, span: tuple[float, float]) -> Pair:
    time, values = pair
    inside = (time >= span[0]) & (time <= span[1]) & np.isfinite(values)
    if math.isclose(span[0], span[1]):
        inside[:] = True
    return time[inside], values[inside]
