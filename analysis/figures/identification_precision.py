"""Work–precision of the estimators: time over error in units of the bound, one panel per case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.figures.style import GREY, drawing, label
from analysis.figures.work_precision import COLOURS, draw_front

_COLUMNS, _ROW_IN, _FOOT_IN = 3, 2.7, 1.4
_OWN_MARKERS, _PEER_MARKERS = "osD", "^vPXh<>*d"
_MAX_ERROR = 1e6  # in units of the bound; larger errors are drawn here


@dataclass(frozen=True)
class Mark:
    """One method in one case.

    Attributes:
        case: case of the panel.
        method, setting: method and its setting; peers are labelled by method, our estimators by setting.
        error: largest rms error over its bound.
        seconds: computing time per record, s.
        peer: whether the method is from another project.
        fails: whether it failed on some records; drawn hollow.
        front, front_of_all: whether it is on the front of our settings, and on that of all methods.
    """

    case: str
    method: str
    setting: str
    error: float
    seconds: float
    peer: bool
    fails: bool
    front: bool
    front_of_all: bool


def draw_identification_precision(marks: Sequence[Mark], alike: float, machine: str = "") -> Figure:
    """Draw times over errors in units of the bound, both logarithmic.

    Args:
        marks: methods in the order of panels and legend.
        alike: error below which methods count as equal; shaded.
        machine: line below the figure.
    """
    cases: dict[str, list[Mark]] = {}
    for mark in marks:
        cases.setdefault(mark.case, []).append(mark)
    looks = _looks(marks)
    lines = max(1, ceil(len(cases) / _COLUMNS))
    height = _ROW_IN * lines + _FOOT_IN
    with drawing(12.0, height) as figure:
        panels = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
        figure.subplots_adjust(
            left=0.06, right=0.985, top=1 - 0.3 / height, bottom=_FOOT_IN / height, wspace=0.2, hspace=0.5
        )
        for axes, (case, members) in zip(panels, cases.items(), strict=False):
            _panel(axes, members, looks, alike)
            label(axes, title=case)
        for axes in panels[len(cases) :]:
            axes.set_visible(False)
        label(panels[0], "largest rms error over its bound", "time a record, s")
        handles = [Line2D([], [], label=name, **look) for name, look in looks.items()]
        handles += [
            Line2D([], [], color="black", lw=1.2, label="front of our settings"),
            Line2D([], [], color="black", lw=1.2, ls=":", label="front with peers"),
        ]
        figure.legend(handles=handles, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 0.25 / height))
        figure.text(0.06, 0.08 / height, machine, fontsize=7.5, color=GREY, parse_math=False)
        return figure


def _looks(marks: Sequence[Mark]) -> dict[str, dict[str, Any]]:
    """Return marker and colour by name in the legend: ours black, peers coloured."""
    looks: dict[str, dict[str, Any]] = {}
    for peer in (False, True):
        for i, name in enumerate(dict.fromkeys(_name(m) for m in marks if m.peer == peer)):
            markers = _PEER_MARKERS if peer else _OWN_MARKERS
            colour = COLOURS[i % len(COLOURS)] if peer else "black"
            looks[name] = {"marker": markers[i % len(markers)], "ls": "", "color": colour, "ms": 6}
    return looks


def _name(mark: Mark) -> str:
    return f"{mark.method} (peer)" if mark.peer else f"ours, {mark.setting}"


def _panel(axes: Axes, marks: Sequence[Mark], looks: dict[str, dict[str, Any]], alike: float) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.axvspan(alike, min(0.5, *(m.error for m in marks)), color=GREY, alpha=0.12, lw=0)
    draw_front(axes, [(_shown(m), m.seconds) for m in marks if m.front], "-")
    draw_front(axes, [(_shown(m), m.seconds) for m in marks if m.front_of_all], ":")
    for mark in marks:
        look: dict[str, Any] = {**looks[_name(mark)], **({"mfc": "none"} if mark.fails else {})}
        axes.plot([_shown(mark)], [mark.seconds], **look)


def _shown(mark: Mark) -> float:
    return min(mark.error, _MAX_ERROR)
