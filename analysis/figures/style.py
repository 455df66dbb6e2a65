"""Common style of all figures: colours that colour-blind readers can distinguish, thin lines, light background."""

from __future__ import annotations

import io
import re
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory
from numpy.typing import NDArray

from analysis.errors import BadFigureName
from rig_basics.whole_file import written_whole

Array = NDArray[np.floating]

MEASURED = "#0072B2"
MODEL = "#D55E00"
GOOD = "#009E73"
GREY = "#666666"
DASHES = (0, (5, 2))
"""Dashes of computed curves; measured curves remain visible between them."""

_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "rig-report",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "axes.labelcolor": "#222222",
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


@contextmanager
def drawing(width_in: float, height_in: float) -> Generator[Figure]:
    """Create a figure in the report's style, without a window and without changes of global state."""
    with mpl.rc_context(_SETTINGS):
        yield Figure(figsize=(width_in, height_in))


def save(path: Path, figure: Figure) -> None:
    """Write a figure in the format of the file's suffix.

    Raises:
        BadFigureName: the suffix is not .svg, .png or .pdf.
    """
    if path.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise BadFigureName(f"figure {path}: expected a name ending in .svg, .png or .pdf")
    metadata = {"Date": None} if path.suffix.lower() == ".svg" else None
    with written_whole(path) as part:
        with mpl.rc_context(_SETTINGS):
            figure.savefig(part, dpi=160, format=path.suffix.lower()[1:], metadata=metadata)
        if path.suffix.lower() == ".svg":
            part.write_text(_short(part.read_text(encoding="utf-8")), encoding="utf-8")


def to_svg(figure: Figure, name: str, description: str) -> str:
    """Return the figure as one <svg> element whose ids start with `name`, so that a page can contain many.

    Args:
        figure: figure.
        name: letters and digits, different for each figure of a page.
        description: text for screen readers.
    """
    out = io.StringIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL)
    text = re.sub(r'\b(id=")', rf"\1{name}-", text)
    text = re.sub(r"(url\(#|href=\"#)", rf"\1{name}-", text)
    return _short(text).replace("<svg ", f'<svg role="img" aria-label="{_attribute(description)}" ', 1)


def _short(svg: str) -> str:
    """Round paths to a hundredth of a point, which reduces the size to a third without a visible change."""
    return re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d{2})\d+", r"\1", path[0]), svg)


def _attribute(text: str) -> str:
    for sign, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        text = text.replace(sign, entity)
    return text


def label(axes: Axes, x: str | None = None, y: str | None = None, title: str | None = None) -> None:
    """Set labels as plain text, so that a dollar sign in a name is not parsed."""
    drawn = cast("Any", axes)
    for text, put in ((x, drawn.set_xlabel), (y, drawn.set_ylabel), (title, drawn.set_title)):
        if text is not None:
            put(text, parse_math=False)


def pin(figure: Figure, grid: NDArray[Any], left: float, bottom: float) -> None:
    """Fix the labels of the first column and the last row in the figure, and titles on their axes.

    Otherwise each drawing searches positions that cover no tick, which takes a third of its time.

    Args:
        figure: figure of the axes.
        grid: axes in rows and columns.
        left, bottom: middle of the labels, share of the figure.
    """
    for axes in grid.flat:
        axes.set_title(axes.get_title("left"), y=1.0, pad=5.0, parse_math=False)
    for axes in grid[:, 0]:
        axes.yaxis.set_label_coords(left, 0.5, blended_transform_factory(figure.transFigure, axes.transAxes))
    for axes in grid[-1]:
        axes.xaxis.set_label_coords(0.5, bottom, blended_transform_factory(axes.transAxes, figure.transFigure))


def envelope(time: Array, values: Array, bins: int) -> tuple[Array, Array, Array]:
    """Return middle, least and largest value of each bin; empty bins are NaN."""
    edges = np.asarray(np.linspace(time[0], time[-1], bins + 1), np.float64)
    low, high = np.full(bins, np.nan), np.full(bins, np.nan)
    where: NDArray[np.intp] = np.searchsorted(time, edges[1:-1])
    for i, part in enumerate(np.split(values, where)):
        finite = part[np.isfinite(part)]
        if len(finite):
            low[i], high[i] = finite.min(), finite.max()
    return 0.5 * (edges[:-1] + edges[1:]), low, high


def bins_for(cycles: float, most: int = 400) -> int:
    """Return the number of bins of an envelope: bins shorter than a vibration cycle would cause beats."""
    return int(min(most, cycles)) if cycles > 60 else most


def band(axes: Axes, time: Array, values: Array, colour: str, name: str, *, bins: int = 420) -> None:
    """Draw measured samples: all of them if few, otherwise the band that they fill (see `bins_for`)."""
    if len(time) <= 2 * bins:
        axes.plot(time, values, color=colour, lw=2.6, alpha=0.55, label=name)
        return
    middle, low, high = envelope(time, values, bins)
    axes.fill_between(middle, low, high, color=colour, alpha=0.5, lw=2.0, label=name)


def outline(axes: Axes, time: Array, values: Array, colour: str, name: str, *, bins: int = 420) -> None:
    """Draw a computed motion dashed over a measured band: its envelope as two lines, or the curve if it is short."""
    if len(time) <= 2 * bins:
        axes.plot(time, values, color=colour, ls=DASHES, lw=0.9, label=name)
        return
    middle, low, high = envelope(time, values, bins)
    axes.plot(middle, low, color=colour, ls=DASHES, lw=0.9, label=name)
    axes.plot(middle, high, color=colour, ls=DASHES, lw=0.9)
