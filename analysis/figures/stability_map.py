"""Stability map of the balanced state, with the measured points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from analysis.figures.sheet import LEAST_FONT_PT
from analysis.figures.style import GREY, MODEL, drawing, label, to_svg
from dynamics import RotorParameters
from dynamics.stability.borders import Borders
from dynamics.stability.stability_map import StabilityMap, stability_map

Array = NDArray[np.floating]

_LEVELS = (0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.4, 1.8, 2.5)
USUAL = ("speed ratio Ω = ω/ω_n1", "stiffness ratio K = k2/k1")
_SHORT: dict[str, str] = {USUAL[0]: "Ω", USUAL[1]: "K"}
_HALO = [withStroke(linewidth=2.5, foreground="white")]  # keeps letters readable on any background
_MARKS = {"I": "o", "II": "s", "III": "^", "slipping": "X", "not settled": "P"}


_COLOURS = (  # of the levels' bands, each darker than the one before; stable bands are light in grey print
    "#fbfcff",
    "#f0f3fb",
    "#e4e9f6",
    "#d7def1",
    "#c9d3ec",
    "#f3c08a",
    "#e8ab6b",
    "#da9650",
    "#c67f38",
    "#a96724",
    "#7f4a15",
    "#4f2c0a",
)
_FOOT = (
    "Thick line: |multiplier| 1; the balanced state (type I) is stable where it is smaller. Marks: state as measured; "
    "circle type I, square type II,\ntriangle type III, cross slipping, plus not settled, diamond another. "
    "Dashed: resonances. Dotted: the rig's stiffness ratio."
)


@dataclass(frozen=True)
class MapPoint:
    """A point on the map: its name, speed ratio Ω and measured state."""

    name: str
    speed_ratio: float
    state: str


@dataclass(frozen=True)
class MapFrame:
    """Axes and marks of a map.

    Attributes:
        names: names of the axes.
        logarithmic: whether each axis is logarithmic.
        points: points marked on the rig's line.
        own: stiffness ratio of the rig, if y is the stiffness ratio and x the speed ratio; else neither points nor
            lines are drawn.
    """

    names: tuple[str, str] = USUAL
    logarithmic: tuple[bool, bool] = (False, False)
    points: Sequence[MapPoint] = ()
    own: float | None = None


def draw_stability_map(physics: RotorParameters, points: Sequence[MapPoint], name: str = "map") -> str:
    """Return an SVG of the largest Type I multiplier over Ω × K around the line of the points, for a report.

    Raises:
        NoBalancedState: the rig has no balanced state.
    """
    figure = draw_points_on_map(physics, points)
    return to_svg(figure, name, "Stability map of the balanced state over speed ratio and stiffness ratio")


def draw_points_on_map(physics: RotorParameters, points: Sequence[MapPoint], title: str = "") -> Figure:
    """Draw the same map as a separate figure.

    Args:
        physics: parameters of the rig.
        points: measured points.
        title: title of the figure.
    Raises:
        NoBalancedState: the rig has no balanced state.
    """
    own = physics.k2_N_per_m / physics.k1_N_per_m
    top = max([p.speed_ratio for p in points], default=4.0) * 1.15
    omega = np.linspace(0.35, max(top, 3.0), 160)
    ratio = np.linspace(min(1.0, 0.5 * own), max(3.0, 1.7 * own), 120)
    figure = stability_map_figure(physics, stability_map(physics, omega, ratio, 1e-4), points)
    if title:
        figure.set_size_inches(figure.get_figwidth(), figure.get_figheight() + 0.7)
        figure.subplots_adjust(top=0.97 - 0.3 / figure.get_figheight(), bottom=0.95 / figure.get_figheight())
        figure.text(
            0.012,
            0.06 / figure.get_figheight(),
            _FOOT,
            va="bottom",
            fontsize=LEAST_FONT_PT,
            color=GREY,
            parse_math=False,
        )
        figure.text(0.012, 1 - 0.08 / figure.get_figheight(), title, va="top", fontsize=10, parse_math=False)
    return figure


def stability_map_figure(physics: RotorParameters, found: StabilityMap, points: Sequence[MapPoint]) -> Figure:
    """Draw the largest Type I multiplier as filled contours, with both resonance lines and the rig's points."""
    own = physics.k2_N_per_m / physics.k1_N_per_m
    grid = MapGrid(found.x, found.y, found.multiplier_max)
    return _figure(grid, points, own)


@dataclass(frozen=True)
class MapGrid:
    """Values over x and y, shape (len(y), len(x)).

    Attributes:
        is_rate: whether the values are decay rates, 1/s, instead of multipliers.
    """

    x: Array
    y: Array
    values: Array
    is_rate: bool = False

    @property
    def border(self) -> float:
        """Value at the border of stability."""
        return 0.0 if self.is_rate else 1.0

    @property
    def name(self) -> str:
        """Label of the colour bar."""
        return "decay rate, 1/s" if self.is_rate else "largest |multiplier|"

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels of twelve bands, five of them stable; less stable bands are darker."""
        if not self.is_rate:
            return _LEVELS
        stable, unstable = (float(np.nanmax(sign * self.values, initial=0.0)) or 1.0 for sign in (1, -1))
        shares = (-0.9, -0.7, -0.5, -0.35, -0.2, -0.1, 0.0, 0.15, 0.3, 0.5, 0.75)
        return tuple(float(f"{share * (stable if share > 0 else unstable):.2g}") for share in shares)


def _figure(grid: MapGrid, points: Sequence[MapPoint], own: float) -> Figure:
    with drawing(8.6, 4.4) as figure:
        figure.subplots_adjust(left=0.075, right=1.04, top=0.97, bottom=0.12)
        draw_grid(figure.add_subplot(), grid, MapFrame(points=points, own=own))
        return figure


def draw_grid(axes: Axes, grid: MapGrid, frame: MapFrame, borders: Borders | None = None) -> None:
    """Draw values as filled contours with a bar, white where no value exists; one row or column as a curve.

    Args:
        axes: axes of the map.
        grid: values.
        frame: axes and marks.
        borders: drawn instead of the map's own contour, with line styles for flutter, divergence and period doubling.
    """
    x, y = grid.x, grid.y
    axes.grid(False)
    if min(len(x), len(y)) < 2:
        _one_line(axes, grid, frame)
        return
    colours = _COLOURS[::-1] if grid.is_rate else _COLOURS
    shown = np.ma.masked_invalid(grid.values)
    filled = axes.contourf(x, y, shown, levels=grid.levels, extend="both", colors=colours)
    if borders is None:
        axes.contour(x, y, shown, levels=[grid.border], colors="black", linewidths=1.6)
    else:
        draw_borders(axes, borders)
    set_plane(axes, (x, y), frame)
    figure = axes.figure
    bar = figure.colorbar(filled, ax=axes, ticks=grid.levels, pad=0.01, format="%g" if grid.is_rate else None)
    bar.set_label("decay rate, 1/s" if grid.is_rate else "largest |multiplier| over one revolution")


def set_plane(axes: Axes, grid: tuple[Array, Array], frame: MapFrame) -> None:
    """Set ranges and names of a map's axes; over speed and stiffness ratio also draw resonances and the rig's line."""
    x, y = grid
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    if frame.logarithmic[0]:
        axes.set_xscale("log")
    if frame.logarithmic[1]:
        axes.set_yscale("log")
    if frame.own is not None:
        _resonances(axes, x, y)
        if y[0] <= frame.own <= y[-1]:
            axes.axhline(frame.own, color="#333333", lw=0.6, ls=":")
            _points(axes, [p for p in frame.points if x[0] <= p.speed_ratio <= x[-1]], frame.own)
    label(axes, *frame.names)


_LINES = {"flutter": "-", "divergence": "--", "period doubling": ":"}


def draw_borders(axes: Axes, borders: Borders) -> None:
    """Draw each border with the line style of its kind of instability."""
    for branch in borders.branches:
        kinds = np.array(branch.kind)
        for kind in dict.fromkeys(branch.kind):
            here = kinds == kind
            here[:-1] |= here[1:]  # up to the start of the next kind
            axes.plot(
                np.where(here, branch.x, np.nan),
                np.where(here, branch.y, np.nan),
                color="black",
                lw=1.6,
                ls=_LINES[kind],
            )


def _one_line(axes: Axes, grid: MapGrid, frame: MapFrame) -> None:
    """Draw a map of one row or one column as a curve."""
    along_x = len(grid.x) > 1 or len(grid.y) == 1
    x, fixed = (grid.x, grid.y[0]) if along_x else (grid.y, grid.x[0])
    axes.grid(True)
    axes.plot(x, grid.values.ravel(), color=MODEL, marker="o" if len(x) == 1 else "")
    axes.axhline(grid.border, color="black", lw=0.9)
    if frame.logarithmic[0 if along_x else 1]:
        axes.set_xscale("log")
    name, other = frame.names if along_x else frame.names[::-1]
    label(axes, name, f"{grid.name} at {_SHORT.get(other, other)} = {fixed:g}")


def _resonances(axes: Axes, omega: Array, ratio: Array) -> None:
    """Draw Ω = 1 and Ω = √K."""
    if omega[0] <= 1 <= omega[-1]:
        axes.plot([1, 1], [ratio[0], ratio[-1]], color="#333333", ls="--", lw=1)
        axes.annotate(
            "Ω = 1", (1.0, ratio[0]), xytext=(-30, 5), textcoords="offset points", fontsize=8, path_effects=_HALO
        )
    second = ratio[(np.sqrt(ratio) >= omega[0]) & (np.sqrt(ratio) <= omega[-1])]
    if len(second):
        axes.plot(np.sqrt(second), second, color="#333333", ls="--", lw=1)
        axes.annotate(
            "Ω = √K",
            (np.sqrt(second[-1]), second[-1]),
            xytext=(-9, -4),
            textcoords="offset points",
            fontsize=8,
            ha="right",
            va="top",
            path_effects=_HALO,
        )


def _points(axes: Axes, points: Sequence[MapPoint], own: float) -> None:
    for i, point in enumerate(points):
        axes.plot(point.speed_ratio, own, marker=_MARKS.get(point.state, "D"), ms=9, mfc="white", mec="black", ls="")
        axes.annotate(
            f"{point.name} · {point.state}",
            (point.speed_ratio, own),
            xytext=(0, 9 if i % 2 == 0 else -17),
            ha="center",
            textcoords="offset points",
            fontsize=9,
            fontweight="bold",
            parse_math=False,
            path_effects=_HALO,
        )
