"""Plane of the pendulums' first mass moments with its balancing regions, and rings of the centre of gravity in it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Wedge

from analysis.figures.sheet import sheet
from analysis.figures.style import GOOD, GREY, MODEL, label
from dynamics.equations.balancing import (
    IMPROPERLY_OVERSIZED,
    PROPERLY_OVERSIZED,
    UNDERSIZED,
    balanced_angles,
    balancing_region,
)
from dynamics.equations.parameters import RotorParameters

SHADES = {PROPERLY_OVERSIZED: "#cfe8df", UNDERSIZED: "#dbe6f2", IMPROPERLY_OVERSIZED: "#f8e3d4"}
_GRAMS = 1e3


def draw_regions(axes: Axes, imbalance_kg_m: float, upto_kg_m: float) -> None:
    """Draw the regions of the plane for one imbalance, their borders and the line of equal moments; axes in g m."""
    s, most = _GRAMS * imbalance_kg_m, _GRAMS * upto_kg_m
    corners = {
        UNDERSIZED: [[(0, 0), (s, 0), (0, s)]],
        PROPERLY_OVERSIZED: [[(0, s), (s, 0), (most, most - s), (most, most), (most - s, most)]],
        IMPROPERLY_OVERSIZED: [[(0, s), (most - s, most), (0, most)], [(s, 0), (most, most - s), (most, 0)]],
    }
    axes.grid(False)
    for region, parts in corners.items():
        for i, part in enumerate(parts):
            axes.add_patch(Polygon(part, closed=True, fc=SHADES[region], ec="none", label=region if i == 0 else None))
    axes.plot((0, s), (s, 0), color="black", lw=1.2)
    for x, y in (((0, most - s), (s, most)), ((s, most), (0, most - s))):
        axes.plot(x, y, color="black", lw=1.2)
    axes.plot((0, most), (0, most), color=GREY, lw=0.9, ls=(0, (6, 3)), label="S_A = S_B")
    axes.set(xlim=(0, most), ylim=(0, most), aspect="equal")
    label(axes, "S_A, g m", "S_B, g m")


def name_corners(axes: Axes, imbalance_kg_m: float, upto_kg_m: float) -> None:
    """Write the source's letters at the corners of its rectangle."""
    s, most = _GRAMS * imbalance_kg_m, _GRAMS * upto_kg_m
    away = 0.03 * most
    for letter, x, y in (("A", 0, s), ("B", s, 0), ("C", most, most - s), ("D", most - s, most), ("O", 0, 0)):
        at = (min(max(x, away), most - away), min(max(y, away), most - away))
        axes.text(*at, letter, ha="center", va="center", fontsize=10, fontweight="bold", clip_on=False)


def draw_ring(axes: Axes, moments_kg_m: tuple[float, float, float], scale: float) -> None:
    """Draw a ring of the centre of gravity whose rotor axis is at its moments' point of the plane.

    Args:
        axes: plane in g m.
        moments_kg_m: S_A, S_B, S_P.
        scale: g m of the plane per g m of the ring; the ring is M_S times the positions of the centre of gravity.
    """
    a, b, s = (_GRAMS * moment for moment in moments_kg_m)
    holds = balancing_region(*moments_kg_m) == PROPERLY_OVERSIZED
    colour, outer, inner = (GOOD if holds else MODEL), scale * (a + b), scale * abs(a - b)
    middle = (a + scale * s, b)
    axes.add_patch(Wedge(middle, outer, 0, 360, width=outer - inner, fc=colour, ec="none", alpha=0.45))
    for radius in (outer, inner):
        axes.add_patch(Circle(middle, radius, fill=False, ec=colour, lw=0.9))
    axes.plot(a, b, "+", color="black", ms=6, mew=1.3, zorder=3)


def draw_balancing(
    physics: RotorParameters, title: str, std_kg_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Figure:
    """Draw a rig's point in the plane of first mass moments, and the ring of its centre of gravity.

    Args:
        physics: parameters of the rig.
        title: title of the figure.
        std_kg_m: standard uncertainties of S_A, S_B, S_P; crosses and bands show two of them.
    Returns:
        Left: the plane with the rig's point. Right: the ring about the rotor axis, with a balanced pose if one exists.
    """
    a, b = physics.a.first_moment_kg_m, physics.b.first_moment_kg_m
    s = physics.imbalance_moment_kg_m
    upto = 1.25 * max(a, b, 1.2 * s, 1e-9)
    with sheet(8.6, 4.3, title, _foot(std_kg_m)) as figure:
        left, right = figure.subplots(1, 2).tolist()
        draw_regions(left, s, upto)
        if std_kg_m[2] > 0:
            _draw_uncertainty(left, s, std_kg_m[2], upto)
        wide = [2 * _GRAMS * u for u in std_kg_m]
        left.errorbar(
            [_GRAMS * a],
            [_GRAMS * b],
            xerr=[wide[0]],
            yerr=[wide[1]],
            fmt="o",
            color="black",
            ms=5,
            capsize=2,
            label="this rig",
        )
        _draw_own_ring(right, physics)
    return figure


def _foot(std_kg_m: tuple[float, float, float]) -> list[str]:
    about = (
        "Right: where the pendulums can put the centre of gravity; full balance exists when the ring holds the axis."
    )
    return [about, *(["Crosses and dotted borders: ± 2 standard uncertainties."] if any(std_kg_m) else [])]


def _draw_uncertainty(axes: Axes, s: float, std: float, upto: float) -> None:
    most = _GRAMS * upto
    for value in (_GRAMS * (s - 2 * std), _GRAMS * (s + 2 * std)):
        axes.plot((0, value), (value, 0), color="black", lw=0.7, ls=":")
        axes.plot((0, most - value), (value, most), color="black", lw=0.7, ls=":")
        axes.plot((value, most), (0, most - value), color="black", lw=0.7, ls=":")


def _draw_own_ring(axes: Axes, physics: RotorParameters) -> None:
    """Draw the ring in millimetres about the rotor axis, with both pendulums' contributions as connected vectors."""
    per = 1e3 / physics.total_mass_kg
    a, b, s = (
        per * m for m in (physics.a.first_moment_kg_m, physics.b.first_moment_kg_m, physics.imbalance_moment_kg_m)
    )
    poses = balanced_angles(physics)
    colour = GOOD if poses else MODEL
    if a + b > 0:
        axes.add_patch(
            Wedge(
                (s, 0),
                a + b,
                0,
                360,
                width=a + b - abs(a - b),
                fc=colour,
                ec=colour,
                alpha=0.35,
                label="centre of gravity can be here",
            )
        )
    axes.plot(0, 0, "+", color="black", ms=11, mew=1.8, label="rotor axis")
    axes.plot(s, 0, "s", color="black", ms=5, label="S_P/M_S, pendulums left out")
    if poses:
        path = s + np.cumsum([0, a * np.exp(1j * poses[0][0]), b * np.exp(1j * poses[0][1])])
        axes.plot(path.real, path.imag, ".-", color="black", lw=1.0, label="balanced: S_A/M_S, then S_B/M_S")
    reach = max(1.15 * (a + b) + s, 1.2 * s, 1e-9)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    label(axes, "along the imbalance, mm", "across it, mm")
