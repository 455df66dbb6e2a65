"""Final angles of repeated start-ups, and the remaining vibration of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GOOD, GREY, MEASURED, label
from analysis.settled_scatter import SettledScatter
from rig_basics.arrays import Array

SYMBOLS = "osD^v<>pPX*hH8d"
"""Markers of the start-ups, one each; repeated after the last."""
_LEVELS = ((0, (6, 1.5, 1, 1.5)), (0, (1, 1.5)), (0, (4, 1.2)))


def draw_start_ups(
    found: SettledScatter,
    title: str,
    levels: Mapping[str, float],
    foot: Sequence[str] = (),
    std: tuple[Array, Array] | None = None,
    zoom: bool = False,
) -> Figure:
    """Draw final angles (x) and amplitude (y); the two angles of a start-up have one marker and are joined.

    Args:
        found: scatter of the start-ups.
        title: title of the figure.
        levels: name to amplitude of vibration, 0–peak, m; drawn as horizontal lines.
        foot: sentences below the figure.
        std: standard uncertainties of the angles, rad, (n, 2), and of the amplitudes, m, (n,).
        zoom: whether to draw one plot around each of the two angles instead of one of all angles.
    """
    with sheet(WIDTH_IN, 4.4, title, foot) as figure:
        if zoom:
            row: list[Axes] = figure.subplots(1, 2, sharey=True).tolist()
        else:
            row = [figure.subplots()]
        for axes in row:
            _points(axes, found, std, joined=not zoom)
            for (name, level), dashes in zip(levels.items(), _LEVELS, strict=False):
                axes.axhline(2e3 * level, color=GREY, ls=dashes, lw=1.2, label=name)
            _balanced(axes, found)
        if zoom:
            for side, axes in enumerate(row):
                _around(axes, np.r_[found.places_rad[:, side], found.balanced_rad[side]])
        else:
            row[0].set(xlim=(-182, 182), xticks=range(-180, 181, 30))
        label(row[0], None, "amplitude of x, mm (peak to peak)")
        for axes in row:
            label(axes, "place, ° from the far side of the imbalance")
        low, high = row[0].get_ylim()
        row[0].set_ylim(min(0.0, low) if not zoom else low, high + 0.05 * (high - low))
    return figure


def _points(axes: Axes, found: SettledScatter, std: tuple[Array, Array] | None, joined: bool) -> None:
    for i, (places, amplitude) in enumerate(zip(np.degrees(found.places_rad), found.amplitude_m, strict=True)):
        height = np.full(2, 2e3 * amplitude)
        marker = SYMBOLS[i % len(SYMBOLS)]
        if joined:
            axes.plot(places, height, ls=(0, (4, 3)), lw=0.8, color=MEASURED, alpha=0.6)
        errors = {} if std is None else {"xerr": np.degrees(std[0][i]), "yerr": 2e3 * std[1][i]}
        axes.errorbar(
            places,
            height,
            ls="none",
            marker=marker,
            ms=6.5,
            mfc="white",
            mec=MEASURED,
            mew=1.3,
            ecolor=MEASURED,
            elinewidth=0.9,
            capsize=2.0,
            label="start-ups, a symbol each" if i == 0 else None,
            **errors,
        )


def _balanced(axes: Axes, found: SettledScatter) -> None:
    for place in np.degrees(found.balanced_rad[np.isfinite(found.balanced_rad)]).tolist():
        axes.axvline(place, color=GOOD, lw=1.0, label="where they balance")


def _around(axes: Axes, places: Array) -> None:
    low, high = math.degrees(float(np.nanmin(places))), math.degrees(float(np.nanmax(places)))
    room = max(0.25 * (high - low), 0.05)
    axes.set_xlim(low - room, high + room)
