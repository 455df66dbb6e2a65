"""The stability map: where the balanced state holds, with the points that were run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.sheet import LEAST_FONT_PT
from analysis.figures.style import GREY, MODEL, drawing, label, to_svg
from dynamics import RotorParameters
from dynamics.stability.stability_map import StabilityMap, stability_map

_LEVELS = (0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.4, 1.8, 2.5)
_MARKS = {"I": "o", "II": "s", "III": "^", "slipping": "X", "not settled": "P"}


_COLOURS = (  # of the levels' bands, each darker than the one before: stable stays light in grey print
    "#fbfcff", "#f0f3fb", "#e4e9f6", "#d7def1", "#c9d3ec",
    "#f3c08a", "#e8ab6b", "#da9650", "#c67f38", "#a96724", "#7f4a15", "#4f2c0a",
)  # fmt: skip
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


def draw_stability_map(physics: RotorParameters, points: Sequence[MapPoint], name: str = "map") -> str:
    """SVG of the largest Type I multiplier over Ω × K around the line of the points, for a report.

    Raises:
        NoBalancedState: the rig has no balanced state.
    """
    figure = draw_points_on_map(physics, points)
    return to_svg(figure, name, "Stability map of the balanced state over speed ratio and stiffness ratio")


def draw_points_on_map(physics: RotorParameters, points: Sequence[MapPoint], title: str = "") -> Figure:
    """The same as a figure of its own.

    Args:
        title: stands above.
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
        figure.text(0.012, 0.06 / figure.get_figheight(), _FOOT, va="bottom", fontsize=LEAST_FONT_PT, color=GREY,
                    parse_math=False)  # fmt: skip
        figure.text(0.012, 1 - 0.08 / figure.get_figheight(), title, va="top", fontsize=10, parse_math=False)
    return figure


def stability_map_figure(physics: RotorParameters, found: StabilityMap, points: Sequence[MapPoint]) -> Figure:
    """The largest Type I multiplier as filled contours, with both resonance lines and the points on the rig's line."""
    own = physics.k2_N_per_m / physics.k1_N_per_m
    omega, ratio = found.speed_ratio, found.stiffness_ratio
    with drawing(8.6, 4.4) as figure:
        axes = figure.add_subplot()
        figure.subplots_adjust(left=0.075, right=1.04, top=0.97, bottom=0.12)
        axes.grid(False)
        if min(len(omega), len(ratio)) < 2:
            _one_line(axes, found)
            return figure
        filled = axes.contourf(
            omega, ratio, found.multiplier_max, levels=_LEVELS, extend="both", colors=_COLOURS,
        )  # fmt: skip
        axes.contour(omega, ratio, found.multiplier_max, levels=[1.0], colors="black", linewidths=1.6)
        _resonances(axes, omega, ratio)
        axes.set_xlim(omega[0], omega[-1])
        axes.set_ylim(ratio[0], ratio[-1])
        if ratio[0] <= own <= ratio[-1]:
            axes.axhline(own, color="#333333", lw=0.6, ls=":")
            _points(axes, [p for p in points if omega[0] <= p.speed_ratio <= omega[-1]], own)
        label(axes, "speed ratio Ω = ω/ω_n1", "stiffness ratio K = k2/k1")
        bar = figure.colorbar(filled, ax=axes, ticks=_LEVELS, pad=0.01)
        bar.set_label("largest |multiplier| over one revolution")
        return figure


def _one_line(axes: Axes, found: StabilityMap) -> None:
    """A map of one row or one column is a curve."""
    along_speed = len(found.speed_ratio) > 1 or len(found.stiffness_ratio) == 1
    x = found.speed_ratio if along_speed else found.stiffness_ratio
    axes.figure.subplots_adjust(right=0.97)
    axes.grid(True)
    axes.plot(x, found.multiplier_max.ravel(), color=MODEL, marker="o" if len(x) == 1 else "")
    axes.axhline(1.0, color="black", lw=0.9)
    fixed = f"K = {found.stiffness_ratio[0]:g}" if along_speed else f"Ω = {found.speed_ratio[0]:g}"
    name = "speed ratio Ω = ω/ω_n1" if along_speed else "stiffness ratio K = k2/k1"
    label(axes, name, f"largest |multiplier| at {fixed}")


def _resonances(axes: Axes, omega: np.ndarray, ratio: np.ndarray) -> None:
    """Ω = 1 and Ω = √K."""
    if omega[0] <= 1 <= omega[-1]:
        axes.plot([1, 1], [ratio[0], ratio[-1]], color="#333333", ls="--", lw=1)
        axes.annotate("Ω = 1", (1.0, ratio[0]), xytext=(-30, 5), textcoords="offset points", fontsize=8)
    second = ratio[(np.sqrt(ratio) >= omega[0]) & (np.sqrt(ratio) <= omega[-1])]
    if len(second):
        axes.plot(np.sqrt(second), second, color="#333333", ls="--", lw=1)
        axes.annotate(
            "Ω = √K", (np.sqrt(second[-1]), second[-1]), xytext=(-9, -4), textcoords="offset points", fontsize=8,
            ha="right", va="top",
        )  # fmt: skip


def _points(axes: Axes, points: Sequence[MapPoint], own: float) -> None:
    for i, point in enumerate(points):
        axes.plot(point.speed_ratio, own, marker=_MARKS.get(point.state, "D"), ms=9, mfc="white", mec="black", ls="")
        axes.annotate(
            f"{point.name} · {point.state}", (point.speed_ratio, own), xytext=(0, 9 if i % 2 == 0 else -17),
            ha="center", textcoords="offset points", fontsize=9, fontweight="bold", parse_math=False,
        )  # fmt: skip
