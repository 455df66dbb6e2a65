"""A figure as one HTML file without network access: the SVG, and a script that zooms and pans it."""

from __future__ import annotations

from html import escape
from importlib import resources
from pathlib import Path

from matplotlib.figure import Figure

from analysis.errors import BadFigureName
from analysis.figures.readout import Readout
from analysis.figures.style import save, to_svg
from rig_basics.whole_file import write_whole_text

SUFFIXES = (".svg", ".png", ".pdf", ".html")
_TEMPLATE = "page.html"


def write_figure(path: str | Path, figure: Figure, title: str, readout: Readout | None = None) -> None:
    """Write a figure in the format of the file's suffix: .svg, .png, .pdf or .html.

    Args:
        path: file to write; its folder must exist.
        figure: figure to write.
        title: title of an HTML page, also read by screen readers.
        readout: values that an HTML page displays at the pointer.
    Raises:
        BadFigureName: an unsupported suffix.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadFigureName(f"figure {path}: expected a name ending in {', '.join(SUFFIXES)}")
    if path.suffix.lower() == ".html":
        write_whole_text(path, page(figure, title, readout))
        return
    save(path, figure)


def page(figure: Figure, title: str, readout: Readout | None = None) -> str:
    """Return the HTML text. Wheel, pinch, + and − zoom, dragging and arrow keys pan, double click or 0 resets."""
    text = resources.files("analysis.figures").joinpath(_TEMPLATE).read_text(encoding="utf-8")
    text = text.replace("{{title}}", escape(title)).replace("{{readout}}", readout.as_json() if readout else "null")
    return text.replace("{{figure}}", to_svg(figure, "figure", title))
