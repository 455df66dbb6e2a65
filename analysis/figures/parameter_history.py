"""Parameters of a rig over time: one panel each, joint values with 95 % intervals, and values of single logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, cast

import numpy as np
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from analysis.figures.log_marks import drawable
from analysis.figures.sheet import LEAST_FONT_PT
from analysis.figures.style import GREY, MEASURED, MODEL, drawing, label
from rig_basics.arrays import Array

_TIMES = 1.96  # standard deviations of a 95 % interval
_COLUMNS = 2
_OUT = "#CC3311"
_MAX_PANEL_RATIO = 9.0  # panel height over the range of the joint intervals, so that these remain readable
_MARGIN = 0.08
_LEAST_DAYS = 1e-3  # an axis of less than 86 s has ticks of fractions of a second, or none
_MAX_WRITTEN = 2  # off-scale values that are written out
_FOOT = (
    "Panels contain single logs' values up to nine times the range of the joint intervals; an interval may leave its "
    "panel. Arrows at an edge: values off the scale."
)


@dataclass(frozen=True)
class Value:
    """Value of a parameter at an instant.

    Attributes:
        name: name of the parameter, as in parameters.toml.
        time: time of the value.
        value, std: value and standard uncertainty, SI.
        text: name of the file or test; size of the change for a marked change.
        left_out: whether the joint estimate excludes it.
    """

    name: str
    time: datetime
    value: float
    std: float
    text: str
    left_out: bool = False


def draw_parameter_history(
    joint: Sequence[Value], single: Sequence[Value], changes: Sequence[Value], units: Mapping[str, str], rig: str = ""
) -> Figure:
    """Draw one panel per parameter over time.

    Args:
        joint: joint estimates.
        single: values of single logs, drawn small.
        changes: significant changes, marked at the first instant after them.
        units: parameters to draw, in order, with their units.
        rig: name of the rig for the title.
    """
    rows = -(-len(units) // _COLUMNS)
    with drawing(10.4, 1.15 + 1.9 * rows) as figure:
        grid = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True)
        figure.subplots_adjust(
            left=0.115,
            right=0.985,
            top=1 - 0.62 / (1.15 + 1.9 * rows),
            bottom=0.75 / (1.15 + 1.9 * rows),
            hspace=0.35,
            wspace=0.28,
        )
        panels = list(grid.flat)
        for axes, (name, unit) in zip(panels, units.items(), strict=False):
            _panel(axes, name, unit, joint, single, changes)
        for axes in panels[len(units) :]:
            axes.set_visible(False)
        days = _days([v for v in (*joint, *single, *changes) if v.name in units])
        if len(days) and np.ptp(days) < _LEAST_DAYS:  # one instant
            panels[0].set_xlim(days[0] - 0.5, days[0] + 0.5)
        for axes in panels[max(0, len(units) - _COLUMNS) : len(units)]:
            locator = AutoDateLocator(maxticks=7)
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
            axes.tick_params(labelbottom=True)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="upper right", ncols=len(names), fontsize=8.5)
        title = "Parameters over time" + (f": {drawable(rig)}" if rig else "")
        figure.text(0.012, 0.985, title, va="top", fontsize=11, parse_math=False)
        figure.text(0.012, 0.008, _FOOT, va="bottom", fontsize=LEAST_FONT_PT, color=GREY, parse_math=False)
        return figure


def _panel(
    axes: Axes, name: str, unit: str, joint: Sequence[Value], single: Sequence[Value], changes: Sequence[Value]
) -> None:
    own = [v for v in joint if v.name == name]
    axes.errorbar(
        _days(own),
        [v.value for v in own],
        [_TIMES * v.std for v in own],
        fmt="o-",
        color=MEASURED,
        ms=4.5,
        lw=0.9,
        capsize=2.5,
        label="joint estimate, 95 %",
        zorder=3,
    )
    for out, colour, text in ((False, GREY, "one log"), (True, _OUT, "left out")):
        shown = [v for v in single if v.name == name and v.left_out == out]
        if shown or not out:
            axes.errorbar(
                _days(shown),
                [v.value for v in shown],
                [_TIMES * v.std for v in shown],
                fmt=".",
                color=colour,
                ms=3.5,
                lw=0.6,
                alpha=0.55,
                label=text,
                zorder=2,
            )
    for change in (c for c in changes if c.name == name):
        at = _days([change])[0]
        axes.axvline(at, color=MODEL, lw=1.0, ls=":", zorder=1)
        axes.annotate(
            change.text,
            (at, 1.0),
            (3, -9),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=8,
            color=MODEL,
            parse_math=False,
        )
    _limits(axes, own, [v for v in single if v.name == name])
    axes.ticklabel_format(axis="y", useOffset=False)
    short = name.partition("_")[0]
    label(axes, y="" if unit == "1" else unit, title=short)
    axes.margins(x=0.04)


def _days(values: Sequence[Value]) -> Array:
    """Return times in the units of matplotlib."""
    return np.array([float(cast("Any", dates).date2num(v.time)) for v in values])


def _limits(axes: Axes, own: Sequence[Value], single: Sequence[Value]) -> None:
    """Include all joint intervals, and values of single logs as far as the joint ones remain readable.

    Values beyond the limits are marked by an arrow at the edge, and their numbers are written above the panel.
    """
    low = min(v.value - _TIMES * v.std for v in own)
    high = max(v.value + _TIMES * v.std for v in own)
    span = (high - low) or 1e-6 * abs(high)
    room = 0.5 * (_MAX_PANEL_RATIO - 1) * span
    shown = [v for v in single if low - room <= v.value <= high + room]
    ends = [low, high, *(end for v in shown for end in (v.value - _TIMES * v.std, v.value + _TIMES * v.std))]
    bottom, top = max(min(ends), low - room), min(max(ends), high + room)
    margin = _MARGIN * (top - bottom)
    axes.set_ylim(bottom - margin, top + margin)
    beyond = [v for v in single if not low - room <= v.value <= high + room]
    for value in beyond:
        up = value.value > high
        axes.plot(
            _days([value]),
            [top + 0.4 * margin if up else bottom - 0.4 * margin],
            marker="^" if up else "v",
            ms=5.5,
            ls="",
            mfc="white",
            mec=_OUT if value.left_out else GREY,
            clip_on=False,
            zorder=4,
        )
    if beyond:
        axes.set_title(_beyond_words(beyond), loc="right", fontsize=LEAST_FONT_PT, color=GREY, parse_math=False)


def _beyond_words(beyond: Sequence[Value]) -> str:
    """List values off the scale, as far as there is room."""
    numbers = list(dict.fromkeys(f"{v.value:.5g} ± {_TIMES * v.std:.2g}" for v in beyond))  # a log may be in two files
    more = f" and {len(numbers) - _MAX_WRITTEN} more" if len(numbers) > _MAX_WRITTEN else ""
    return f"off scale: {', '.join(numbers[:_MAX_WRITTEN])}{more}"
