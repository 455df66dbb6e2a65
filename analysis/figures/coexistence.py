"""Figure of `rig map --quantity coexisting`: the stable motions at every point."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from analysis.figures.map_frames import frame_of, what_if
from analysis.figures.readout import Readout
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import draw_borders, set_plane
from analysis.maps.coexistence import MOTIONS, CoexistenceMap, words_of
from daq.version import software_version
from dynamics.stability.borders import Borders

_HEIGHT_IN = 4.6
_KNOWN = {
    "I": "#56B4E9",
    "III": "#009E73",
    "slipping": "#D55E00",
    "I + slipping": "#E69F00",
    "III + slipping": "#999933",
    "I + III": "#0072B2",
    "I + III + slipping": "#882255",
    "nothing stable found": "#d9d9d9",
    "no answer": "#ffffff",
}


def draw_coexistence(found: CoexistenceMap, borders: Borders | None = None) -> tuple[Figure, Readout | None]:
    """Draw a map of coexisting motions, and return the values that a page displays at the pointer.

    Args:
        found: map.
        borders: borders of the balanced state's stability, drawn over the map.
    """
    question, rig = found.question, found.question.loaded()
    title = f"{rig.name}: which motions are stable{what_if(question)}"
    with sheet(WIDTH_IN, _HEIGHT_IN, title, _foot(found, borders)) as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        _draw_classes(axes, found)
        if borders is not None:
            draw_borders(axes, borders)
        set_plane(axes, (found.x, found.y), frame_of(question))
    return figure, _readout(found, axes) if min(len(found.x), len(found.y)) > 1 else None


def _draw_classes(axes: Axes, found: CoexistenceMap) -> None:
    stable = np.where(np.isnan(found.arrays["stable"]), -1.0, found.arrays["stable"])
    values = np.unique(stable)
    names = [words_of(np.nan if value < 0 else float(value)) for value in values.tolist()]
    others = iter(colormaps["tab20b"](np.linspace(0, 1, 20)).tolist())
    colours = [_KNOWN.get(name) or next(others) for name in names]
    norm = BoundaryNorm(np.arange(len(values) + 1) - 0.5, len(values)) if len(values) > 1 else None
    number = np.searchsorted(values, stable)
    axes.pcolormesh(
        found.x, found.y, number, cmap=ListedColormap(colours), norm=norm, shading="nearest", rasterized=True
    )
    shares = found.shares
    for name, colour in zip(names, colours, strict=True):
        text = f"{name} · {100 * shares[name]:.1f} %"
        axes.plot([], [], ls="", marker="s", ms=8, mfc=colour, mec="#888888", mew=0.6, label=text)


def _foot(found: CoexistenceMap, borders: Borders | None) -> list[str]:
    question = found.question
    notes = [
        "I: balanced, II: pendulums opposed, III: together, each stable by its own multipliers; slipping: a stable "
        "orbit on which pendulums turn against the rotor for ever, found from a neighbour or from three releases."
    ]
    if borders is not None:
        notes.append("Black line: border of the balanced state's stability.")
    notes.append(
        f"Made by pendulum-balancer-rig {software_version()} of {question.rig.source} {question.rig.digest[:19]}."
    )
    return notes


def _readout(found: CoexistenceMap, axes: Axes) -> Readout:
    question, arrays = found.question, found.arrays
    layers = {f"|multiplier| of {name}": arrays[f"multiplier_{name}"] for name in MOTIONS}
    layers = {name: values for name, values in layers.items() if np.any(np.isfinite(values))}
    return Readout.over(axes, (question.x, question.y), found.x, found.y, layers)
