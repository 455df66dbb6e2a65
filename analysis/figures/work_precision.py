"""Work–precision: time over true error, one marker per method, with the front of the best methods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.figures.style import GREY, drawing, label
from dynamics.bench.records import ROUNDING, Measurement

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D1F", "#444444")
_OWN_MARKERS, _PEER_MARKERS = "osD^vPXh", "1234"
_MIN_ERROR = ROUNDING / 10  # smaller errors are due to rounding and are drawn here


def draw_work_precision(
    rows: Sequence[Measurement], multipliers_case: str, motion_case: str, machine: str = ""
) -> Figure:
    """Draw times over true errors, both logarithmic. Left: largest multiplier; right: motion.

    Args:
        rows: compared rows (dynamics.bench.records.compared); rows without a true error are left out.
        multipliers_case, motion_case: case of each panel.
        machine: line below the figure.
    """
    with drawing(10.4, 5.4) as figure:
        left, right = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.07, right=0.98, top=0.9, bottom=0.33, wspace=0.2)
        title = f"largest multiplier of the balanced state, {multipliers_case}"
        error = "true error of the largest multiplier, relative to max(1, modulus)"
        _panel(
            left, [r for r in rows if (r.service, r.case) == ("multipliers", multipliers_case)], title, error, "point"
        )
        error = "true error of the pendulums' angles at the end, rad"
        title = f"20 s of motion after a {motion_case}"
        _panel(right, [r for r in rows if (r.service, r.case) == ("motion", motion_case)], title, error, "run")
        figure.text(0.07, 0.015, machine, fontsize=7.5, color=GREY, parse_math=False)
        return figure


def _panel(axes: Axes, rows: Sequence[Measurement], title: str, error: str, per: str) -> None:
    known = [r for r in rows if r.true_error is not None]
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    label(axes, error, f"time a {per}, s", title)
    if not known:
        axes.text(0.5, 0.5, "no reference ran: no true errors", transform=axes.transAxes, ha="center")
        return
    draw_front(axes, [(_shown(r), r.seconds) for r in known if r.front], "-")
    draw_front(axes, [(_shown(r), r.seconds) for r in known if r.front_of_all], ":")
    methods = dict.fromkeys((r.method, r.peer) for r in known if not r.automatic)
    own = [m for m, peer in methods if not peer]
    peers = [m for m, peer in methods if peer]
    handles: list[Line2D] = []
    for names, markers, peer in ((own, _OWN_MARKERS, False), (peers, _PEER_MARKERS, True)):
        for i, name in enumerate(names):
            colour = GREY if peer else COLOURS[i % len(COLOURS)]
            look: dict[str, Any] = {
                "marker": markers[i % len(markers)],
                "ls": "",
                "color": colour,
                "ms": 9 if peer else 5,
            }
            same = [r for r in known if r.method == name and not r.automatic]
            axes.plot([_shown(r) for r in same], [r.seconds for r in same], **look)
            handles.append(Line2D([], [], label=f"{name} (peer)" if peer else name, **look))
    chosen = [r for r in known if r.automatic]
    star: dict[str, Any] = {"marker": "*", "ls": "", "color": "black", "ms": 11, "mfc": "#F0E442"}
    axes.plot([_shown(r) for r in chosen], [r.seconds for r in chosen], **star)
    taken = ", ".join(dict.fromkeys(method for r in chosen for method in r.chosen))
    handles += [
        Line2D([], [], label=f"automatic ({taken}), with its error bound", **star),
        Line2D([], [], color="black", lw=1.2, label="front of our methods"),
        Line2D([], [], color="black", lw=1.2, ls=":", label="front with peers"),
    ]
    axes.legend(handles=handles, fontsize=7.5, ncols=2, loc="upper left", bbox_to_anchor=(-0.08, -0.16))


def _shown(row: Measurement) -> float:
    return max(row.true_error or 0.0, _MIN_ERROR)


def draw_front(axes: Axes, points: Sequence[tuple[float, float]], dashes: str) -> None:
    """Draw the front as steps through (error, seconds): least time for each error."""
    front = sorted(points, key=lambda p: p[1])
    axes.step([p[0] for p in front], [p[1] for p in front], "k", ls=dashes, lw=1.2, where="pre", zorder=1)
