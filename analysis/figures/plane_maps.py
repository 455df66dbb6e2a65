"""Figure of `rig map`: the map or a family of borders, with the stable share over a number below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withTickedStroke
from matplotlib.ticker import StrMethodFormatter

from analysis.figures.map_frames import frame_of, what_if
from analysis.figures.readout import Readout
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import MapGrid, draw_grid, set_plane
from analysis.figures.style import GREY, MODEL, label
from analysis.maps.answers import FamilyMember, MapAnswer
from analysis.maps.axes import name_of, symbol_of
from analysis.maps.families import BestValue, SearchRange
from daq.version import software_version
from rig_basics.units import TO_RPM

_HEIGHT_IN, _BELOW_IN = 4.4, 2.0
_MAX_READOUT = 400  # points per side in a page's readout


def draw_map(found: MapAnswer) -> tuple[Figure, Readout | None]:
    """Draw a map, and return the values that a page displays at the pointer (None for one row or column)."""
    question, rig, frame = found.question, found.question.loaded(), frame_of(found.question)
    varied = f", for values of {symbol_of(question.family.keys)[0]}" if question.family else ""
    turns = question.x.is_speed or question.y.is_speed
    speed = f" at {question.speed_rad_s * TO_RPM:.4g} rpm" if question.speed_rad_s and not turns else ""
    title = f"{rig.name}: where the balanced state is stable{speed}{varied}{what_if(question)}"
    height = _HEIGHT_IN + (_BELOW_IN if found.best else 0.0)
    with sheet(WIDTH_IN, height, title, _foot(found, frame.own is not None)) as figure:
        ratios = [_HEIGHT_IN, _BELOW_IN] if found.best else [1.0]
        rows: list[Axes] = figure.subplots(len(ratios), 1, height_ratios=ratios, squeeze=False)[:, 0].tolist()
        as_rate = question.quantity == "decay-rate"
        grid = found.grid
        if found.family:
            _draw_family(rows[0], found)
            set_plane(rows[0], (grid.x, grid.y), frame)
        else:
            values = grid.decay_rate_per_s if as_rate else grid.multiplier_max
            shown = MapGrid(grid.x, grid.y, values, as_rate)
            draw_grid(rows[0], shown, frame, found.borders)
        if found.best is not None and question.best is not None:
            same = question.family is not None and question.family.keys == question.best.keys
            _draw_shares(rows[1], found.best, question.best, found.family if same else ())
    return figure, _readout(found, rows[0]) if min(len(grid.x), len(grid.y)) > 1 else None


def _draw_family(axes: Axes, found: MapAnswer) -> None:
    """Draw the borders of each value, with ticks on the unstable side, darker for smaller values."""
    family = found.question.family
    assert family is not None
    symbol, unit = symbol_of(family.keys)
    axes.grid(False)
    shades = colormaps["viridis"](np.linspace(0.0, 0.82, len(found.family)))
    styles = ("-", (0, (6, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (2.5, 1.2)), (0, (1, 1)))
    for i, (member, shade) in enumerate(zip(found.family, shades, strict=True)):
        named = f"{symbol} = {member.value:.4g}{unit}: {100 * member.borders.stable_share:.1f} % stable"
        for branch in member.borders.branches:
            axes.plot(branch.x, branch.y, color=shade, lw=1.5, ls=styles[i % len(styles)], label=named)
            axes.plot(branch.x, branch.y, color=shade, lw=0.7, alpha=0.6, ls="-", path_effects=_HATCHED)
        if not member.borders.branches:
            axes.plot([], [], color=shade, lw=1.5, ls=styles[i % len(styles)], label=named)
    for branch in found.borders.branches if found.borders else ():
        axes.plot(branch.x, branch.y, color="black", lw=2.2, label="the rig as it is")


_HATCHED = [withTickedStroke(spacing=9, angle=-90, length=0.45)]  # for a line with the stable side on its left


def _draw_shares(axes: Axes, best: BestValue, within: SearchRange, members: Sequence[FamilyMember]) -> None:
    """Draw the stable share over the number, the best value with its interval, and the members of a family."""
    axes.plot(
        best.values, 100 * best.shares, color=MODEL, lw=1.2, marker="o", ms=2.5, label="stable share of the plane"
    )
    if best.unresolved.any():
        shares_at_most = 100 * np.minimum(best.shares + best.unresolved, 1.0)
        look: dict[str, Any] = {"color": MODEL, "alpha": 0.18, "lw": 0, "label": "not resolved: may be stable"}
        axes.fill_between(best.values, 100 * best.shares, shares_at_most, **look)
    if members:
        shares = [100 * member.borders.stable_share for member in members]
        squares: dict[str, Any] = {"ls": "", "marker": "s", "ms": 5, "mfc": "none", "mec": "black", "clip_on": False}
        axes.plot([member.value for member in members], shares, **squares, label="the values above")
    axes.axvspan(*best.interval, color=GREY, alpha=0.25, lw=0)
    axes.axvline(best.value, color="black", lw=0.9)
    symbol, unit = symbol_of(within.keys)
    if within.logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlim(within.low, within.high)
    low, high = 100 * float(best.shares.min()), min(100.0, 100 * float((best.shares + best.unresolved).max()))
    axes.set_ylim(max(0.0, low - 0.15 * (high - low)), high + 0.3 * (high - low) + 0.1)
    right = (axes.transData + axes.transAxes.inverted()).transform((best.value, 0.0))[0] > 0.6
    end = " (end of the range)" if best.at_end else ""
    axes.annotate(
        f"{symbol} = {best.value:.4g}{unit}{end}: {100 * best.share:.2f} %",
        (best.value, 100 * best.share),
        xytext=(-7 if right else 7, 6),
        textcoords="offset points",
        ha="right" if right else "left",
        fontsize=9,
        fontweight="bold",
        parse_math=False,
    )
    label(axes, name_of(within.keys), "stable share, %")


def _foot(found: MapAnswer, usual: bool) -> list[str]:
    question, notes = found.question, list[str]()
    sides = "The balanced state is stable where the map is blue; a lighter blue is more stable."
    kinds = {kind for branch in (found.borders.branches if found.borders else ()) for kind in branch.kind}
    if found.family:
        notes.append("Lines: borders of stability; the balanced state is unstable on the side with the ticks.")
    elif kinds:
        lines = {"flutter": "solid", "divergence": "dashed", "period doubling": "dotted"}
        named = ", ".join(f"{lines[kind]}: {kind}" for kind in sorted(kinds))
        notes.append(f"Thick line: border of stability ({named}). {sides}")
    else:
        notes.append(f"Thick line: border of stability. {sides}")
    if not found.family and np.isnan(found.grid.multiplier_max).any():
        notes.append("White: no balanced state exists.")
    if usual:
        notes.append(
            "Thin dashed: resonances. Dotted: the rig's stiffness ratio, with its points and the state expected there; "
            "circle type I (balanced), square type II, triangle type III."
        )
    if found.computed is not None and not found.family:
        share = 100 * found.computed.mean()
        notes.append(f"{share:.1f} % of the points are computed, along borders; values between them are interpolated.")
    if found.best is not None:
        notes.append("Grey band: values whose stable share does not differ significantly from the largest one.")
    known = "" if question.parameters is None else f", {question.parameters.source} {question.parameters.digest[:19]}"
    notes.append(
        f"Made by pendulum-balancer-rig {software_version()} of {question.rig.source} {question.rig.digest[:19]}{known}"
        f"; multipliers good to {question.accuracy:g}."
    )
    return notes


def _readout(found: MapAnswer, axes: Axes) -> Readout:
    """Return the values at the pointer, with at most 400 points per side."""
    grid = found.grid
    columns, rows = (
        np.unique(np.linspace(0, n - 1, min(n, _MAX_READOUT)).astype(int)) for n in (len(grid.x), len(grid.y))
    )
    place = np.ix_(rows, columns)
    own = " of the rig as it is" if found.family else ""
    layers = {f"|multiplier|{own}": grid.multiplier_max[place], f"decay rate{own}, 1/s": grid.decay_rate_per_s[place]}
    return Readout.over(axes, found.question.axes, grid.x[columns], grid.y[rows], layers)
