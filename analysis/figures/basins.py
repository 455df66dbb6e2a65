"""Basins: end state of each release of a grid, and time until it is reached."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from analysis.figures.style import GREY, drawing, label
from dynamics.steady.basins.basin_map import BasinMap
from dynamics.steady.basins.ends import End
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM

_COLOURS = {
    "I": ("#0072B2", "#56B4E9"),
    "II": ("#CC79A7", "#882255"),
    "III": ("#009E73", "#88C999"),
    "one": ("#0072B2", "#56B4E9"),
    "slipping": ("#D55E00", "#E69F00", "#F5D08A", "#8C3B00"),
}
_NOT_SETTLED = "#d9d9d9"
HATCH = "#00000080"
_LOCKS_DEG = (0.0, 180.0)


def colour_of(end: End) -> str:
    """Return the colour of an end state: that of its type, lighter for the second of two mirror images."""
    own = _COLOURS.get(end.name, ("#999933", "#DDCC77"))
    return own[end.mirror % len(own)]


def draw_basins(found: BasinMap, title: str, play_deg: float = 0.2) -> Figure:
    """Draw a basin map.

    Args:
        found: basin map.
        title: title of the figure.
        play_deg: play of the locks, for the note on the real release.
    Returns:
        Left: end state of each release over the lock angles of A and B, hatched at a boundary. Right: time until the
        motion stays near that state.
    """
    with drawing(10.6, 5.9) as figure:
        grid = figure.add_gridspec(1, 2, left=0.065, right=0.945, top=0.88, bottom=0.27, wspace=0.2)
        left, right = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
        _ends(left, found)
        _times(figure, right, found)
        for axes in (left, right):
            _frame(axes, found)
        figure.legend(
            handles=_legend(found),
            loc="lower left",
            bbox_to_anchor=(0.055, 0.045),
            ncol=2,
            fontsize=8.5,
            handlelength=1.6,
            columnspacing=2.5,
        )
        figure.text(
            0.065,
            0.015,
            f"+ release of the real locks, A at {_LOCKS_DEG[0]:g}°, B at {_LOCKS_DEG[1]:g}° (± {play_deg:g}° of play); "
            f"each release followed for {found.seconds:g} s at {found.speed_rad_s * TO_RPM:.1f} rpm",
            fontsize=8,
            color=GREY,
            parse_math=False,
        )
        figure.suptitle(title, x=0.02, y=0.965, ha="left", fontsize=11, parse_math=False)
        return figure


def _degrees(angles: Array) -> Array:
    return np.degrees(angles)


def _ends(axes: Axes, found: BasinMap) -> None:
    colours = [_NOT_SETTLED, *(colour_of(end) for end in found.ends)]
    palette = ListedColormap([to_rgb(colour) for colour in colours])
    x, y = _degrees(found.theta3_rad), _degrees(found.theta4_rad)
    norm = BoundaryNorm(np.arange(len(colours) + 1) - 1.5, len(colours))
    axes.pcolormesh(x, y, found.end, cmap=palette, norm=norm, shading="nearest", rasterized=True)
    axes.add_collection(LineCollection(_borders(x, y, found.end), colors="white", linewidths=0.7))
    cells = cells_of(x, y, ~found.sure)
    if cells:
        axes.add_collection(PolyCollection(cells, facecolor="none", edgecolor=HATCH, linewidth=0.0, hatch="////"))
    label(axes, "A held at θ3, degrees", "B held at θ4, degrees", "where a release ends")


def _borders(x: Array, y: Array, end: NDArray[np.int64]) -> list[list[tuple[float, float]]]:
    """Return the sides between cells with different end states."""
    across, up = _sides(x), _sides(y)
    lines = list[list[tuple[float, float]]]()
    for i, j in np.argwhere(end[:, 1:] != end[:, :-1]).tolist():
        lines.append([(across[j + 1], up[i]), (across[j + 1], up[i + 1])])
    for i, j in np.argwhere(end[1:] != end[:-1]).tolist():
        lines.append([(across[j], up[i + 1]), (across[j + 1], up[i + 1])])
    return lines


def cells_of(x: Array, y: Array, chosen: NDArray[np.bool_]) -> list[list[tuple[float, float]]]:
    """Return the corners of the chosen cells; neighbours in a row are merged so that the hatching is continuous."""
    across, up = _sides(x), _sides(y)
    found = list[list[tuple[float, float]]]()
    for i, row in enumerate(chosen):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        for begin, end in edges.reshape(-1, 2).tolist():
            left, right, low, high = across[begin], across[end], up[i], up[i + 1]
            found.append([(left, low), (right, low), (right, high), (left, high)])
    return found


def _sides(middles: Array) -> list[float]:
    half = 0.5 * (middles[1] - middles[0]) if len(middles) > 1 else 1.0
    inner = 0.5 * (middles[1:] + middles[:-1])
    return np.concatenate([[middles[0] - half], inner, [middles[-1] + half]]).tolist()


def _times(figure: Figure, axes: Axes, found: BasinMap) -> None:
    times = np.ma.masked_invalid(found.settled_s)
    mesh: QuadMesh = axes.pcolormesh(
        _degrees(found.theta3_rad),
        _degrees(found.theta4_rad),
        times,
        cmap="viridis_r",
        shading="nearest",
        rasterized=True,
    )
    axes.set_facecolor(_NOT_SETTLED)
    bar = figure.colorbar(mesh, ax=axes, pad=0.015)
    bar.set_label("s")
    label(axes, "A held at θ3, degrees", "B held at θ4, degrees", "time until the motion stays within 0.3° of it")


def _frame(axes: Axes, found: BasinMap) -> None:
    axes.grid(visible=False)
    axes.tick_params(axis="x", pad=8)
    for angles, axis, limits in (
        (_degrees(found.theta3_rad), axes.xaxis, axes.set_xlim),
        (_degrees(found.theta4_rad), axes.yaxis, axes.set_ylim),
    ):
        first, last = float(angles[0]), float(angles[-1])
        half = 0.5 * (last - first) / (len(angles) - 1) if len(angles) > 1 else 1.0
        limits(first - half, last + half)
        if last - first > 180:
            axis.set_ticks(np.arange(math.ceil((first - half) / 90) * 90, last + half + 1, 90))
    axes.plot(*_LOCKS_DEG, marker="+", ms=11, mew=2.2, color="white", zorder=5)
    axes.plot(*_LOCKS_DEG, marker="+", ms=10, mew=1.1, color="black", zorder=6)


def _legend(found: BasinMap) -> Sequence[Any]:
    handles = list[Patch]()
    for end, share in zip(found.ends, cast("list[float]", found.shares.tolist()), strict=False):
        handles.append(Patch(facecolor=colour_of(end), label=f"{end.words} · {100 * share:.1f} %"))
    left = float(found.shares[-1])
    if left > 0:
        handles.append(
            Patch(facecolor=_NOT_SETTLED, label=f"not settled within {found.seconds:g} s · {100 * left:.1f} %")
        )
    unsure = 1.0 - float(np.mean(found.sure))
    if unsure > 0:
        text = f"at a boundary: ± {math.degrees(found.stated_error_rad):.1g}° may change the end · {100 * unsure:.1f} %"
        handles.append(Patch(facecolor="white", edgecolor=HATCH, hatch="////", lw=0, label=text))
    return handles
