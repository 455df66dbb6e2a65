"""Steady states along one number of a rig: amplitude above, pendulum angles below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GREY, MEASURED, MODEL, label
from dynamics.steady.branches import Branch, SteadyBranches
from rig_basics.arrays import Array

A_COLOUR, B_COLOUR = MEASURED, MODEL


def draw_branches(found: SteadyBranches, name: str, title: str, *, logarithmic: bool = False) -> Figure:
    """Draw amplitude and angles of the stable states over a number, unstable states thin, break points dashed.

    Args:
        found: steady states.
        name: name of the number with its unit.
        title: title of the figure.
        logarithmic: whether the number's axis is logarithmic.
    """
    with sheet(WIDTH_IN, 5.8, title) as figure:
        rows: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        draw_amplitudes(rows[0], found, 1.0)
        draw_angles(rows[1], found, 1.0)
        mark_borders(rows, found, 1.0)
        if logarithmic:
            rows[1].set_xscale("log")
        rows[0].set_xlim(float(found.values[0]), float(found.values[-1]))
        label(rows[0], None, "amplitude, mm")
        label(rows[1], name, "pendulum angle, °")
    return figure


def draw_amplitudes(axes: Axes, found: SteadyBranches, scale: float, *, unstable: bool = True) -> None:
    """Draw amplitudes in mm.

    Args:
        axes: axes over the number.
        found: steady states.
        scale: displayed value over value of the number.
        unstable: whether unstable states are drawn too, thin.
    """
    if unstable:
        for b in found.branches:
            axes.plot(scale * b.values, 1e3 * b.amplitude_m, color="#bbbbbb", lw=0.8, label="unstable states")
    for b in found.stable_branches():
        axes.plot(scale * b.values, 1e3 * b.amplitude_m, color="black", lw=1.6, label="stable state, model")
    top = max((float(np.max(b.amplitude_m)) for b in found.stable_branches()), default=0.0)
    if top > 0:
        axes.set_ylim(-0.04e3 * top, 1.18e3 * top)


def draw_angles(axes: Axes, found: SteadyBranches, scale: float) -> None:
    """Draw θ3 of A and θ4 of B in degrees, 0 … 360, of the stable states; second mirror images thin."""
    drawn = list[Branch]()
    for b in found.stable_branches():
        first = not any(_overlap(b, other) for other in drawn)
        drawn += [b] if first else []
        for column, (colour, which) in enumerate(((A_COLOUR, "A"), (B_COLOUR, "B"))):
            axes.plot(
                scale * b.values,
                wrapped_deg(b.theta_rad[:, column]),
                color=colour,
                lw=(3.2 if column == 0 else 1.3) if first else 0.8,
                ls="-" if first else (0, (1, 2)),
                alpha=0.6 if first and column == 0 else 1.0,
                label=f"{which}, model" if first else "mirror image",
            )
    axes.set(ylim=(0, 360), yticks=(0, 90, 180, 270, 360))


def _overlap(one: Branch, other: Branch) -> bool:
    """Whether two stable branches of one type overlap, as mirror images do."""
    least, most = max(one.values[0], other.values[0]), min(one.values[-1], other.values[-1])
    return one.type == other.type and bool(least < most)


def wrapped_deg(angle_rad: Array) -> Array:
    """Return degrees in [0, 360), NaN where the curve crosses 0° or 360°."""
    degrees = np.degrees(angle_rad) % 360
    return np.where(np.abs(np.diff(degrees, prepend=degrees[:1])) > 180, np.nan, degrees)


def mark_borders(rows: Sequence[Axes], found: SteadyBranches, scale: float) -> None:
    """Draw a dashed line at each break point, and the stable types' names above each interval."""
    edges = [float(found.values[0]), *(b.value for b in found.break_points), float(found.values[-1])]
    types = [found.break_points[0].before, *(b.after for b in found.break_points)] if found.break_points else [()]
    for axes in rows:
        for one in found.break_points:
            axes.axvline(scale * one.value, color=GREY, lw=0.8, ls=(0, (4, 3)))
    if not found.break_points:
        types = [tuple(sorted({b.type for b in found.stable_branches()}))]
    span = edges[-1] - edges[0]
    for low, high, names in zip(edges[:-1], edges[1:], types, strict=True):
        text = " and ".join(names) or "no stable state"
        if high - low > (0.02 + 0.0085 * len(text)) * span:
            rows[0].text(
                0.5 * scale * (low + high),
                0.97,
                text,
                transform=rows[0].get_xaxis_transform(),
                ha="center",
                va="top",
                fontsize=8.5,
                color=GREY,
            )


def stable_line(found: SteadyBranches, type_: str) -> Branch | None:
    """Return the first stable branch of a type."""
    return next((b for b in found.stable_branches() if b.type == type_), None)
