"""Order map: amplitude over order and speed (time at one speed), measured and simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from analysis.errors import NotEnoughData
from analysis.figures.passages import Passage, PassageSignal, passages
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import label
from analysis.quantities.order_maps import OrderMap, order_map
from analysis.rig_model import RigModel
from daq.signals.run import Run
from rig_basics.arrays import Array

_HIGHEST = 4.0
_REVOLUTIONS = 8
_DECADES = 3.5  # range of the colours below the largest amplitude


def draw_orders(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Rows x and y; columns measured, other run, simulated run; one colour scale per row.

    Args:
        run: run with index marks; at one speed the map is over time.
        model: model; its motion with the same speed history.
        over: another run, in a column of its own.
    Raises:
        NotEnoughData: no index marks, no displacement, or fewer revolutions than a window has.
    """
    columns = passages(run, model, over)
    names = [name for name in "xy" if name in columns[0].signals]
    foot = [
        f"Windows of {_REVOLUTIONS} revolutions by angle (Hann): orders nearer than {2 / _REVOLUTIONS:g} are one. "
        "Dotted: natural frequencies of the column by the model. Amplitudes are 0–peak."
    ]
    width = WIDTH_IN if len(columns) < 3 else 1.3 * WIDTH_IN
    with sheet(width, 2.9 * len(names), f"Order map: {Path(run.source).name} ({run.test})", foot) as figure:
        grid = figure.subplots(len(names), len(columns), squeeze=False, sharex=True, sharey=True)
        for row, name in zip(grid, names, strict=True):
            maps = [_map(passage, passage.signals[name]) for passage in columns]
            top = 1e3 * max(float(np.max(found.amplitude_m)) for found in maps)
            norm = LogNorm(top / 10**_DECADES, top)
            for axes, passage, found in zip(row, columns, maps, strict=True):
                level = _rising(passage.level(found.time_s))
                shown = np.clip(1e3 * found.amplitude_m, norm.vmin, None)
                picture = axes.pcolormesh(
                    level, found.order, shown.T, norm=norm, cmap="cividis", shading="nearest", rasterized=True
                )
                _naturals(axes, passage, model, level)
                axes.grid(False)
                axes.set_ylim(0, _HIGHEST)
                axes.set_yticks(np.arange(_HIGHEST + 1))
                label(axes, title=f"{name}, {passage.title}")
                if axes is row[-1]:
                    bar = figure.colorbar(picture, ax=list(row), pad=0.01, aspect=18)
                    bar.set_label(f"{name} amplitude, mm")
            label(row[0], y="order")
        for axes, passage in zip(grid[-1], columns, strict=True):
            label(axes, passage.level_label)
    return figure


def _rising(level: Array) -> Array:
    """Return rising levels; on a plateau the speed varies slightly up and down."""
    if level[-1] < level[0]:
        return -_rising(-level)
    least = 1e-6 * max(float(np.ptp(level)), 1e-9) * np.arange(len(level))
    return np.asarray(np.maximum.accumulate(level) + least, np.float64)


def _map(passage: Passage, signal: PassageSignal) -> OrderMap:
    try:
        return order_map(
            signal.time_s, signal.value_m, signal.phase_rad, revolutions=_REVOLUTIONS, highest=_HIGHEST + 0.5
        )
    except ValueError as error:
        raise NotEnoughData(f"{passage.run.source}: {error}") from error


def _naturals(axes: Axes, passage: Passage, model: RigModel | None, level: Array) -> None:
    """Draw the orders of the column's natural frequencies."""
    if model is None:
        return
    marks = passage.run.mark_time_s
    time = np.linspace(float(marks[1]), float(marks[-2]), 400)
    along, speed = passage.level(time), 2 * np.pi * passage.orders_Hz(time)
    for natural in model.speeds_rad_s:
        axes.plot(along, natural / speed, color="white", lw=1.0, ls=":")
    axes.set_xlim(float(np.min(level)), float(np.max(level)))
