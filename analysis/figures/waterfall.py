"""Waterfall: a cascade of amplitude spectra over speed (over time at one speed), measured and simulated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.errors import NotEnoughData
from analysis.figures.passages import Passage, PassageSignal, passages
from analysis.figures.sheet import LEAST_FONT_PT, WIDTH_IN, sheet
from analysis.figures.style import MEASURED, MODEL, label
from analysis.quantities.spectra import amplitude_spectrum
from analysis.rig_model import RigModel
from daq.signals.run import Run
from rig_basics.arrays import Array

_SPECTRA, _POINTS = 27, 200
_MIN_PEAK_SHARE = 0.01  # of the tallest line: lower lines do not hide the spectra behind them
_TALLEST = 0.28  # height of the largest line over that of the axis
_TITLE_PAD_PT = 14.0  # names of natural frequencies are below the title
_ORDERS = (1, 2, 3)
_LABEL_HALF_WIDTH = 0.03  # of an order's label over the frequency axis
_STRIP = 0.08  # height above all spectra for the orders' labels over that of the axis
_ORDER_SHARE = 2.6  # largest frequency of the axis over the largest 1×
_CHIRP = 1.6  # window times √(change of frequency per second): the shortest that a passing line fills
_WINDOW_S = (0.6, 8.0)


@dataclass(frozen=True)
class _Cascade:
    """Spectra at levels (speeds or times): shapes (n,), (m,), (n, m) in Hz and mm."""

    levels: Array
    frequency_Hz: Array
    amplitude_mm: Array


@dataclass(frozen=True)
class _Row:
    """Common scale of one displacement's panels: levels from `low` to `high`, level units per mm."""

    low: float
    high: float
    scale: float
    tallest_mm: float

    @classmethod
    def of(cls, shown: Sequence[_Cascade]) -> _Row:
        low, high = min(float(c.levels[0]) for c in shown), max(float(c.levels[-1]) for c in shown)
        tallest = max(float(np.max(c.amplitude_mm)) for c in shown)
        return cls(low, high, _TALLEST * (high - low) / tallest, tallest)

    def heights(self, cascade: _Cascade) -> Array:
        """Return the spectra as positions on the axis, shape (n, m)."""
        return cascade.levels[:, None] + self.scale * cascade.amplitude_mm


def draw_waterfall(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Rows x and y; columns measured, other run, simulated run.

    Args:
        run: run with index marks; at one speed the spectra are over time.
        model: model; its motion with the same speed history.
        over: another run in a column of its own, because overlaid cascades are unreadable.
    Raises:
        NotEnoughData: no index marks, no displacement, or a run shorter than a few windows.
    """
    columns = passages(run, model, over)
    names = [name for name in "xy" if name in columns[0].signals]
    window_s = _window_s(columns[0])
    top_Hz = _top_Hz(columns[0])
    foot = [
        f"Spectra of {window_s:.2g} s (Hann), 0–peak amplitudes; the bar is the scale. Dashed: orders of the rotor. "
        "Dotted: natural frequencies of the column by the model."
    ]
    width = WIDTH_IN if len(columns) < 3 else 1.3 * WIDTH_IN
    with sheet(width, 3.4 * len(names), f"Waterfall: {Path(run.source).name} ({run.test})", foot) as figure:
        grid = figure.subplots(len(names), len(columns), squeeze=False, sharex=True, sharey="row")
        for row, name in zip(grid, names, strict=True):
            shown = [_cascade(p, p.signals[name], window_s, top_Hz, name) for p in columns if name in p.signals]
            shared = _Row.of(shown)
            for axes, passage, cascade in zip(row, columns, shown, strict=False):
                _draw(axes, cascade, shared, MODEL if passage.is_model else MEASURED)
                _orders(axes, passage, cascade, shared)
                _natural(axes, model, top_Hz)
                axes.set_title(f"{name}, {passage.title}", pad=_TITLE_PAD_PT, parse_math=False)
            bottom = shared.low - 0.03 * (shared.high - shared.low)
            top = max(float(np.max(shared.heights(cascade))) for cascade in shown)
            row[0].set_ylim(bottom, top + _STRIP * (top - bottom))
            label(row[0], y=columns[0].level_label)
        for axes in grid[-1]:
            label(axes, "frequency, Hz")
    return figure


def _window_s(passage: Passage) -> float:
    marks = passage.run.mark_time_s
    if not passage.by_speed:
        return min(4.0, float(marks[-1] - marks[0]) / 4)
    turn_Hz = 1 / np.diff(marks)
    change = float(np.max(turn_Hz) - np.min(turn_Hz)) / float(marks[-1] - marks[0])
    return float(np.clip(_CHIRP / math.sqrt(change), *_WINDOW_S))


def _top_Hz(passage: Passage) -> float:
    marks = passage.run.mark_time_s
    return _ORDER_SHARE * float(np.max(np.diff(passage.run.mark_phase_rad) / np.diff(marks))) / (2 * math.pi)


def _cascade(passage: Passage, signal: PassageSignal, window_s: float, top_Hz: float, name: str) -> _Cascade:
    first, last = float(passage.run.mark_time_s[0]), float(passage.run.mark_time_s[-1])
    fine = np.linspace(max(first, signal.time_s[0]) + window_s / 2, min(last, signal.time_s[-1]) - window_s / 2, 2000)
    if fine[-1] <= fine[0]:
        raise NotEnoughData(
            f"{passage.run.source}: {last - first:.1f} s of turning, a cascade needs several {window_s:.1f} s"
        )
    level = passage.level(fine)
    wanted = np.linspace(float(np.nanmin(level)), float(np.nanmax(level)), _SPECTRA)
    levels, rows, frequency = list[float](), list[Array](), np.empty(0)
    for value in wanted.tolist():
        at = float(fine[np.nanargmin(np.abs(level - value))])
        inside = (signal.time_s >= at - window_s / 2) & (signal.time_s <= at + window_s / 2)
        try:
            found = amplitude_spectrum(signal.time_s[inside], signal.value_m[inside], window_s=window_s)
        except ValueError:  # usual: the interval has a gap; its spectrum is left out
            continue
        grid = np.linspace(0.0, top_Hz, _POINTS)
        frequency = grid
        levels.append(value)
        rows.append(1e3 * np.interp(grid, found.frequency_Hz, found.values))
    if not rows:
        raise NotEnoughData(f"{passage.run.source}: no {window_s:.1f} s of {name} without a gap")
    return _Cascade(np.array(levels), frequency, np.array(rows))


def _draw(axes: Axes, cascade: _Cascade, shared: _Row, colour: str) -> None:
    levels, heights = cascade.levels, shared.heights(cascade)
    for i, (level, row, height) in enumerate(zip(levels, cascade.amplitude_mm, heights, strict=True)):
        order = 2.0 + 0.01 * (len(levels) - i)  # lower spectra are in front
        for part in _peaks(row, _MIN_PEAK_SHARE * shared.tallest_mm):  # only peaks hide the spectra behind them
            axes.fill_between(
                cascade.frequency_Hz[part], level, height[part], fc="white", ec="none", alpha=0.85, zorder=order
            )
        axes.plot(cascade.frequency_Hz, height, color=colour, lw=0.9, zorder=order + 0.001)
    axes.set_xlim(0, float(cascade.frequency_Hz[-1]))
    step = 10 ** math.floor(math.log10(shared.tallest_mm))
    bar = step * max(f for f in (1, 2, 5) if f * step <= shared.tallest_mm)
    at = 0.965 * float(cascade.frequency_Hz[-1])  # at the bottom, right of all orders
    foot = shared.low + 0.04 * (shared.high - shared.low)
    axes.plot([at, at], [foot, foot + shared.scale * bar], color="black", lw=2.2, zorder=6, solid_capstyle="butt")
    axes.text(
        at * 0.985,
        foot + 0.5 * shared.scale * bar,
        f"{bar:g} mm",
        ha="right",
        va="center",
        fontsize=8,
        zorder=6,
        bbox={"fc": "white", "ec": "none", "pad": 1.0},
    )


def _peaks(row: Array, least: float) -> list[slice]:
    """Return the intervals in which a spectrum exceeds its baseline, with one value on either side."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row > least, [False]]).astype(int)))
    return [slice(max(int(a) - 1, 0), int(b) + 1) for a, b in edges.reshape(-1, 2)]


def _orders(axes: Axes, passage: Passage, cascade: _Cascade, shared: _Row) -> None:
    """Draw orders along the run, each named at the end of its line: above the spectra, or at the right edge."""
    time = np.linspace(float(passage.run.mark_time_s[1]), float(passage.run.mark_time_s[-2]), 300)
    level, turns = passage.level(time), passage.orders_Hz(time)
    rising = np.argsort(level)
    level, turns = level[rising], turns[rising]
    top_Hz, heights = float(cascade.frequency_Hz[-1]), shared.heights(cascade)
    for k in _ORDERS:
        inside = np.flatnonzero(k * turns <= top_Hz)
        if not len(inside):
            continue
        axes.plot(k * turns, level, color="#555555", lw=0.8, ls=(0, (4, 3)), zorder=1.5)
        end_Hz, end = float(k * turns[inside[-1]]), float(level[inside[-1]])
        if inside[-1] == len(turns) - 1:
            near = np.abs(cascade.frequency_Hz - end_Hz) <= _LABEL_HALF_WIDTH * top_Hz
            _name(axes, f"{k}×", (end_Hz, max(end, float(np.max(heights[:, near])))), (0, 2), "center", "bottom")
        else:
            _name(axes, f"{k}×", (top_Hz, end), (3, 0), "left", "center")


def _natural(axes: Axes, model: RigModel | None, top_Hz: float) -> None:
    """Draw the column's natural frequencies, named above the plot."""
    natural: Sequence[float] = () if model is None else [w / (2 * math.pi) for w in model.speeds_rad_s]
    for i, value in enumerate(natural):
        if value < top_Hz:
            axes.axvline(value, color="#555555", lw=0.8, ls=":", zorder=1.5)
            axes.annotate(
                f"f{i + 1}",
                (value, 1),
                (0, 1),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                fontsize=LEAST_FONT_PT,
                ha="center",
                va="bottom",
                color="#333333",
            )


def _name(
    axes: Axes,
    text: str,
    at: tuple[float, float],
    off_pt: tuple[float, float],
    ha: Literal["left", "center"],
    va: Literal["bottom", "center"],
) -> None:
    axes.annotate(
        text,
        at,
        off_pt,
        textcoords="offset points",
        fontsize=LEAST_FONT_PT,
        ha=ha,
        va=va,
        color="#333333",
        zorder=6,
        annotation_clip=False,
    )
