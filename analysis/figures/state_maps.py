"""Figure of `rig map --quantity state|amplitude|settling-time`: end state of a release at every point."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.basins import HATCH, cells_of
from analysis.figures.map_frames import frame_of, what_if
from analysis.figures.readout import Readout
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import draw_borders, set_plane
from analysis.maps.states import RELEASED_RAD, STATES, StateMap
from daq.version import software_version
from dynamics.stability.borders import Borders

_HEIGHT_IN = 4.6
_COLOURS = {
    "refused": "#ffffff",
    "not settled": "#d9d9d9",
    "I": "#56B4E9",
    "II": "#CC79A7",
    "III": "#009E73",
    "one": "#56B4E9",
    "slipping": "#D55E00",
}
_WORDS = {
    "refused": "no answer",
    "not settled": "not settled",
    "I": "I: balanced",
    "II": "II: pendulums opposed",
    "III": "III: pendulums together",
    "one": "at rest",
    "slipping": "slipping for ever",
}
_SHOWN = {
    "amplitude": ("amplitude_m", 1e6, "disk's rms amplitude at the end, µm"),
    "settling-time": ("settled_s", 1.0, "time until the motion stayed near its end, s"),
}


def draw_states(found: StateMap, borders: Borders | None = None) -> tuple[Figure, Readout | None]:
    """Draw a map of releases, and return the values that a page displays at the pointer.

    Args:
        found: map.
        borders: borders of the balanced state's stability, drawn over the map.
    """
    question, rig = found.question, found.question.loaded()
    title = f"{rig.name}: where a release ends{what_if(question)}"
    with sheet(WIDTH_IN, _HEIGHT_IN, title, _foot(found, borders)) as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        if question.quantity == "state":
            _draw_classes(axes, found)
        else:
            _draw_numbers(figure, axes, found)
        if borders is not None:
            draw_borders(axes, borders)
        set_plane(axes, (found.x, found.y), frame_of(question))
    return figure, _readout(found, axes) if min(len(found.x), len(found.y)) > 1 else None


def _draw_classes(axes: Axes, found: StateMap) -> None:
    palette = ListedColormap([to_rgb(_COLOURS[name]) for name in STATES])
    norm = BoundaryNorm(np.arange(len(STATES) + 1) - 0.5, len(STATES))
    axes.pcolormesh(*_grid(found), found.state, cmap=palette, norm=norm, shading="nearest", rasterized=True)
    unsure = found.arrays["sure"] == 0
    if min(unsure.shape) > 1 and (cells := cells_of(found.x, found.y, unsure)):
        axes.add_collection(PolyCollection(cells, facecolor="none", edgecolor=HATCH, linewidth=0.0, hatch="////"))
    for name, share in found.shares.items():
        text = f"{_WORDS[name]} · {100 * share:.1f} %"
        axes.plot([], [], ls="", marker="s", ms=8, mfc=_COLOURS[name], mec="#888888", mew=0.6, label=text)


def _draw_numbers(figure: Figure, axes: Axes, found: StateMap) -> None:
    name, unit, text = _SHOWN[found.question.quantity]
    values = np.ma.masked_invalid(unit * found.arrays[name])
    positive = values.compressed()[values.compressed() > 0]
    wide = len(positive) > 0 and positive.max() > 30 * positive.min()
    norm = LogNorm(max(positive.min(), 1e-6 * positive.max()), positive.max()) if wide else None
    axes.set_facecolor(_COLOURS["not settled"])
    mesh = axes.pcolormesh(*_grid(found), values, cmap="viridis_r", norm=norm, shading="nearest", rasterized=True)
    figure.colorbar(mesh, ax=axes, pad=0.015).set_label(text)


def _grid(found: StateMap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return found.x, found.y


def _foot(found: StateMap, borders: Borders | None) -> list[str]:
    question = found.question
    a, b = (math.degrees(angle) for angle in RELEASED_RAD)
    notes = [
        f"At each point the locks hold A at {a:.1f}° and B at {b:.1f}°; after their release the motion is followed for "
        f"{question.seconds:g} s."
    ]
    if found.unsure_share > 0:
        unsure = f"{100 * found.unsure_share:.1f} %"
        notes.append(f"Hatched: {unsure} of the points, whose end state changes within the stated error.")
    if borders is not None:
        notes.append("Black line: border of the balanced state's stability.")
    if found.computed is not None:
        notes.append(
            f"{100 * found.computed.mean():.1f} % of the points are computed, the others are as their neighbours."
        )
    notes.append(
        f"Made by pendulum-balancer-rig {software_version()} of {question.rig.source} {question.rig.digest[:19]}."
    )
    return notes


def _readout(found: StateMap, axes: Axes) -> Readout:
    """Return the values at the pointer; the state by its number."""
    question, arrays = found.question, found.arrays
    named = ", ".join(f"{code} {name}" for code, name in enumerate(STATES) if name in found.shares)
    layers = {
        f"state ({named})": arrays["state"],
        "θ3, °": arrays["theta3_deg"],
        "θ4, °": arrays["theta4_deg"],
        "amplitude, µm": 1e6 * arrays["amplitude_m"],
        "settled after, s": arrays["settled_s"],
    }
    return Readout.over(axes, (question.x, question.y), found.x, found.y, layers)
