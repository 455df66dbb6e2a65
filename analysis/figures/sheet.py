"""A figure with head and foot: title, a legend outside the plots, and the meaning of its axes.

The plots keep the requested size; head and foot are added with the height of their text.
"""

from __future__ import annotations

import textwrap
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any

from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend

from analysis.figures.log_marks import drawable
from analysis.figures.style import GOOD, GREY, MEASURED, MODEL, drawing

LEAST_FONT_PT = 7.5
"""Smallest font size when the figure is printed at its own size."""
WIDTH_IN = 8.6

PHASE = "phase, ° (lead positive)"
"""Label of every axis of phase; `PHASE_FOOT` is its long form."""
PHASE_FOOT = (
    "Phase: x = Re(X e^{iψ}), ψ = 0 where the imbalance (index mark) points along +x; positive: the displacement's "
    "peak leads the mark. Displacements are positive as in the rig file; a laser's distance increases away from it."
)
AMPLITUDE = "amplitude, mm (0–peak)"

Look = dict[str, Any]
MEASURED_LOOK: Look = {"color": MEASURED, "ls": "-", "lw": 3.0, "alpha": 0.55}  # wide, to be visible under a model
MODEL_LOOK: Look = {"color": MODEL, "ls": (0, (5, 2)), "lw": 1.2}
STEADY_LOOK: Look = {"color": "black", "ls": (0, (1, 1.5)), "lw": 1.0}
OVER_LOOK: Look = {"color": GOOD, "ls": (0, (6, 1.5, 1, 1.5)), "lw": 1.2}

_TITLE_PT, _FOOT_PT, _LEGEND_PT = 10.0, LEAST_FONT_PT, 8.5
_MARGIN_IN, _GAP_IN = 0.08, 0.06
_TITLE_LETTERS, _FOOT_LETTERS = 12.5, 17.0  # per inch
_LINE = 1.3  # height of a line over its font size


@contextmanager
def sheet(width_in: float, height_in: float, title: str, foot: Sequence[str] = ()) -> Generator[Figure]:
    """Create a figure whose plots have the requested size; on exit title, legend and foot are placed around them.

    The legend contains every labelled artist of all axes once, in their order.
    """
    with drawing(width_in, height_in) as figure:
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.05, wspace=0.0, hspace=0.0)
        yield figure
        legend = _legend(figure, width_in - 2 * _MARGIN_IN)
        titles = textwrap.wrap(drawable(title), int(width_in * _TITLE_LETTERS)) if title else []
        notes = [line for each in foot for line in textwrap.wrap(drawable(each), int(width_in * _FOOT_LETTERS))]
        title_in = len(titles) * _TITLE_PT * _LINE / 72
        legend_in = legend.get_window_extent().height / figure.dpi if legend else 0.0
        head_in = _MARGIN_IN + title_in + (_GAP_IN + legend_in if legend else 0.0) + 1.5 * _GAP_IN
        foot_in = _MARGIN_IN + len(notes) * _FOOT_PT * _LINE / 72 if notes else 0.0
        whole_in = height_in + head_in + foot_in
        figure.set_size_inches(width_in, whole_in)
        at = 1 - _MARGIN_IN / whole_in
        figure.text(
            _MARGIN_IN / width_in,
            at,
            "\n".join(titles),
            fontsize=_TITLE_PT,
            va="top",
            linespacing=_LINE,
            parse_math=False,
        )
        if legend is not None:
            legend.set_bbox_to_anchor((_MARGIN_IN / width_in, at - (title_in + _GAP_IN) / whole_in))
        if notes:
            figure.text(
                _MARGIN_IN / width_in,
                _MARGIN_IN / 2 / whole_in,
                "\n".join(notes),
                fontsize=_FOOT_PT,
                va="bottom",
                color=GREY,
                linespacing=_LINE,
                parse_math=False,
            )
        engine = figure.get_layout_engine()
        assert isinstance(engine, ConstrainedLayoutEngine)
        engine.set(rect=(0, foot_in / whole_in, 1, 1 - (foot_in + head_in) / whole_in))
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # the layout is final on every canvas


def _legend(figure: Figure, room_in: float) -> Legend | None:
    """Create the legend with as few lines as the width allows; None without labelled artists."""
    shown: dict[str, Artist] = {}
    for axes in figure.axes:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(text, handle)
    if not shown:
        return None
    for columns in range(len(shown), 0, -1):
        legend = figure.legend(
            list(shown.values()),
            [drawable(text) for text in shown],
            loc="upper left",
            ncols=columns,
            fontsize=_LEGEND_PT,
            borderaxespad=0.0,
            borderpad=0.0,
            handlelength=2.6,
            columnspacing=1.6,
        )
        legend.set_in_layout(False)
        if legend.get_window_extent().width <= room_in * figure.dpi or columns == 1:
            return legend
        legend.remove()
    return None
