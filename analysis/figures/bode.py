"""Bode plot: 1× amplitude and phase of x and y over speed, with the model's run-up and its steady response."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.intervals import TIMES, band, interval_words, phase_half_deg
from analysis.figures.order_vectors import OrderVectors, amplification_words, cut_words, passed_vectors
from analysis.figures.sheet import (
    AMPLITUDE,
    MEASURED_LOOK,
    MODEL_LOOK,
    OVER_LOOK,
    PHASE,
    PHASE_FOOT,
    STEADY_LOOK,
    WIDTH_IN,
    Look,
    sheet,
)
from analysis.figures.stamp_lag import correction_words, lag_words
from analysis.figures.style import label
from analysis.rig_model import RigModel
from analysis.simulated_run import NOT_FOLLOWED
from daq.signals.run import Run
from rig_basics.units import TO_RPM

_HEADROOM = 1.35  # upper limit over the largest measured amplitude; a steady resonance may exceed it


def draw_bode(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Draw phase (above) and amplitude (below) of x (left) and y (right) over speed.

    Args:
        run: run-up or run-down.
        model: model; its simulation of the run is tracked in the same way, and its steady response is drawn too.
        over: another run, drawn over the first.
    Raises:
        NotEnoughData: a run that stays at one speed, or has no index marks.
    """
    own = passed_vectors(run, model)
    other = passed_vectors(over, model) if over is not None else None  # its lag is another one
    foot = [PHASE_FOOT]
    if own.steady:
        foot.append("Steady response: steady vibration of the model at each speed; a run-up's peak is lower and later.")
    if model is not None and not own.simulated:
        foot.append(NOT_FOLLOWED)
    tops = {name: _HEADROOM * float(np.max(np.abs(seen.amplitude_m))) for name, seen in own.measured.items()}
    drawn = own.corrected
    foot += cut_words(own, tops) + interval_words(drawn) + lag_words(own) + correction_words(own)
    foot += amplification_words(run)
    with sheet(WIDTH_IN, 4.3, f"Bode plot, 1×: {Path(run.source).name} ({run.test})", foot) as figure:
        grid = figure.subplots(2, len(drawn), sharex=True, height_ratios=(1, 1.5), squeeze=False)
        for (upper, lower), (name, measured) in zip(grid.T, drawn.items(), strict=True):
            level = own.steady.get(name, measured)
            _draw(upper, lower, measured, level, MEASURED_LOOK, "measured")
            if own.simulated:
                _draw(upper, lower, own.simulated[name], level, MODEL_LOOK, f"same run simulated, {_of(model)}")
            if own.steady:
                _draw(upper, lower, own.steady[name], level, STEADY_LOOK, f"steady response, {_of(model)}")
            if other is not None and over is not None and name in other.measured:
                _draw(upper, lower, other.corrected[name], level, OVER_LOOK, f"measured, {Path(over.source).name}")
            lower.set_ylim(0, 1e3 * tops[name])
            lower.set_xlim(left=0)
            label(upper, y=f"{name} {PHASE}")
            label(lower, "speed, rpm", f"{name} {AMPLITUDE}")
        _degrees(list(grid[0]))
        figure.align_ylabels(grid)
    return figure


def _of(model: RigModel | None) -> str:
    return "" if model is None else model.name


def _draw(upper: Axes, lower: Axes, found: OrderVectors, level: OrderVectors, look: Look, text: str) -> None:
    speed, phase, size = TO_RPM * found.speed_rad_s, found.phase_deg(level), 1e3 * np.abs(found.amplitude_m)
    upper.plot(speed, phase, **look)
    lower.plot(speed, size, label=text, **look)
    if np.any(found.std_m > 0) or found.lag_std_s > 0:
        half, turn = 1e3 * TIMES * found.std_m, phase_half_deg(found)
        band(lower, speed, np.maximum(size - half, 0.0), size + half, look["color"])
        band(upper, speed, phase - turn, phase + turn, look["color"])


def _degrees(panels: Sequence[Axes]) -> None:
    """Set ticks at multiples of 180°, 90° or 45° by the widest range; equal steps make the panels comparable."""
    widest = max(high - low for low, high in (axes.get_ylim() for axes in panels))
    step = 180.0 if widest > 500 else 90.0 if widest > 150 else 45.0
    for axes in panels:
        low, high = axes.get_ylim()
        low, high = step * np.floor(low / step), step * np.ceil(high / step)
        axes.set_yticks(np.arange(low, high + 1, step))
        axes.set_ylim(low - 5, high + 5)
