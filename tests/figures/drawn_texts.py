"""What a figure writes, as it is drawn: each text with its box, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any
from unittest.mock import patch

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from analysis.figures.sheet import LEAST_FONT_PT

_TOUCH_PX = 1.5  # boxes have a margin about the letters
_APART_PX = (4.0, 3.0)  # side by side, one above the other; closer texts read as one


@dataclass(frozen=True)
class DrawnText:
    text: str
    box: Bbox
    size_pt: float
    owner: Axes | None
    """Whose tick labels, title or annotation it is; None for the figure's own and for legends."""


def drawn_texts(figure: Figure) -> list[DrawnText]:
    """Every text that comes onto the paper; tick labels outside of their axis do not."""
    found: list[DrawnText] = []
    original = Text.draw

    def draw(self: Text, renderer: Any, *args: Any, **kwargs: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            box = self.get_window_extent(renderer)
            own = self.axes if isinstance(self.axes, Axes) else None
            found.append(DrawnText(self.get_text(), box, float(self.get_fontsize()), owners.get(self, own)))
        original(self, renderer, *args, **kwargs)

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # once without looking: a layout may still move
    ticks = [(axes, t) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for t in axis.get_major_ticks()]
    owners: dict[Text, Axes] = {label: axes for axes, tick in ticks for label in (tick.label1, tick.label2)}
    with patch.object(Text, "draw", draw):
        canvas.draw()
    return found


def faults(figure: Figure) -> list[str]:
    """Texts too near, on another plot, off the figure or too small, and legends on plots; a sentence each."""
    texts = drawn_texts(figure)
    paper = figure.bbox
    faulty = [f"{t.text!r} is {t.size_pt:g} pt" for t in texts if t.size_pt < LEAST_FONT_PT]
    faulty += [
        f"{t.text!r} leaves the figure"
        for t in texts
        if t.box.x0 < paper.x0 - 1 or t.box.x1 > paper.x1 + 1 or t.box.y0 < paper.y0 - 1 or t.box.y1 > paper.y1 + 1
    ]
    faulty += [f"{a.text!r} and {b.text!r} overlap" for a, b in combinations(texts, 2) if _overlap(a.box, b.box)]
    faulty += [f"{a.text!r} and {b.text!r} stand too close" for a, b in combinations(texts, 2) if _close(a.box, b.box)]
    faulty += [
        f"{t.text!r} lies on {_name(axes)}"
        for t in texts
        for axes in figure.axes
        if t.owner is not None and _apart(t.owner, axes) and _overlap(t.box, axes.get_window_extent())
    ]
    for legend in [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]:
        box = legend.get_window_extent()
        faulty += [f"a legend lies on {_name(axes)}" for axes in figure.axes if _overlap(box, axes.get_window_extent())]
    return faulty


def _name(axes: Axes) -> str:
    return axes.get_title(loc="left") or axes.get_ylabel() or "a plot"


def _apart(a: Axes, b: Axes) -> bool:
    """Whether two axes have plots of their own; twins and secondary axes have not."""
    return not _overlap(a.get_window_extent(), b.get_window_extent())


def _gaps(a: Bbox, b: Bbox) -> tuple[float, float]:
    return max(a.x0, b.x0) - min(a.x1, b.x1), max(a.y0, b.y0) - min(a.y1, b.y1)


def _close(a: Bbox, b: Bbox) -> bool:
    sideways, above = _gaps(a, b)
    return sideways < _APART_PX[0] and above < _APART_PX[1] and not _overlap(a, b)


def _overlap(a: Bbox, b: Bbox) -> bool:
    return max(_gaps(a, b)) < -_TOUCH_PX
