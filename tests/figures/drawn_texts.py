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


@dataclass(frozen=True)
class DrawnText:
    text: str
    box: Bbox
    size_pt: float


def drawn_texts(figure: Figure) -> list[DrawnText]:
    """Every text that comes onto the paper; tick labels outside of their axis do not."""
    found: list[DrawnText] = []
    original = Text.draw

    def draw(self: Text, renderer: Any, *args: Any, **kwargs: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            found.append(DrawnText(self.get_text(), self.get_window_extent(renderer), float(self.get_fontsize())))
        original(self, renderer, *args, **kwargs)

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # once without looking: a layout may still move
    with patch.object(Text, "draw", draw):
        canvas.draw()
    return found


def faults(figure: Figure) -> list[str]:
    """Texts that overlap, leave the figure or are too small, and legends on plots; a sentence each."""
    texts = drawn_texts(figure)
    paper = figure.bbox
    said = [f"{t.text!r} is {t.size_pt:g} pt" for t in texts if t.size_pt < LEAST_FONT_PT]
    said += [
        f"{t.text!r} leaves the figure"
        for t in texts
        if t.box.x0 < paper.x0 - 1 or t.box.x1 > paper.x1 + 1 or t.box.y0 < paper.y0 - 1 or t.box.y1 > paper.y1 + 1
    ]
    said += [f"{a.text!r} and {b.text!r} overlap" for a, b in combinations(texts, 2) if _overlap(a.box, b.box)]
    for legend in [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]:
        box = legend.get_window_extent()
        said += [f"a legend lies on {_name(axes)}" for axes in figure.axes if _overlap(box, axes.get_window_extent())]
    return said


def _name(axes: Axes) -> str:
    return axes.get_title(loc="left") or axes.get_ylabel() or "a plot"


def _overlap(a: Bbox, b: Bbox) -> bool:
    return min(a.x1, b.x1) - max(a.x0, b.x0) > _TOUCH_PX and min(a.y1, b.y1) - max(a.y0, b.y0) > _TOUCH_PX
