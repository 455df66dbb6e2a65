"""Fit residuals: signals fitted by the identification in each test, measured and fitted, with residuals and units."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.errors import NotEnoughData
from analysis.figures.fit import FitCurve
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GREY, MEASURED, MODEL, band, bins_for, label, outline
from rig_basics.arrays import Array

_CLOSE_CYCLES = 8
_CLOSE_SAMPLES = 900
_HEIGHT_IN = 2.6
_MAX_LABEL = 14  # letters


def draw_residuals(curves: Sequence[FitCurve]) -> Figure:
    """One block per curve: whole record (left) and some cycles (right), residuals below in their own unit.

    Args:
        curves: `fit_curves(found.fits)` of an identification.
    Raises:
        NotEnoughData: `curves` is empty.
    """
    if not curves:
        raise NotEnoughData("expected logs of tests that identification fits (ring-down, spin-down, run-up), got none")
    foot = [
        "A band is the least and the largest value of each stretch. rms: of all values that were fitted; where samples "
        "are many, each of these is a mean of several."
    ]
    with sheet(WIDTH_IN, _HEIGHT_IN * len(curves), "Fit residuals", foot) as figure:
        outer = figure.add_gridspec(len(curves), 2, width_ratios=(1.8, 1))
        lefts: list[Axes] = []
        for i, curve in enumerate(curves):
            for column in range(2):
                inner = outer[i, column].subgridspec(2, 1, height_ratios=(1.9, 1), hspace=0.04)
                upper = figure.add_subplot(inner[0])
                lower = figure.add_subplot(inner[1], sharex=upper)
                upper.tick_params(labelbottom=False)
                _block(upper, lower, curve, close=column == 1)
                if column == 0:
                    lefts += [upper, lower]
            if i == len(curves) - 1:
                for axes in figure.axes[-1:-4:-2]:
                    label(axes, "time since the run's start, s")
        figure.align_ylabels(lefts)
    return figure


def _block(upper: Axes, lower: Axes, curve: FitCurve, *, close: bool) -> None:
    time = np.asarray(curve.time_s, np.float64)
    measured, fitted = np.asarray(curve.measured, np.float64), np.asarray(curve.fitted, np.float64)
    rest = measured - fitted
    crossings = np.flatnonzero(np.diff(np.signbit(np.nan_to_num(fitted - np.nanmean(fitted)))))
    part = _close(fitted, crossings) if close else slice(None)
    bins = _CLOSE_SAMPLES if close else bins_for(len(crossings) / 2)
    unit, scale = curve.residual_unit
    if len(time[part]) <= 2 * bins:
        upper.plot(time[part], measured[part], color=MEASURED, lw=3.0, alpha=0.5, label="measured")
    else:
        band(upper, time[part], measured[part], MEASURED, "measured", bins=bins)
    outline(upper, time[part], fitted[part], MODEL, "fitted", bins=bins)
    band(lower, time[part], scale * rest[part], GREY, "rest: measured − fitted", bins=bins)
    lower.axhline(0.0, color="black", lw=0.7)
    reach = 1.15 * scale * float(np.nanmax(np.abs(rest))) or 1.0
    lower.set_ylim(-reach, reach)
    if not close:
        label(upper, y=f"{curve.y_label[:_MAX_LABEL]}, {curve.unit}", title=curve.title)
        label(lower, y=f"rest, {unit}")
    else:
        label(upper, title=f"rms {scale * curve.residual_rms:.3g} {unit}")


def _close(fitted: Array, crossings: NDArray[np.intp]) -> slice:
    """Return some cycles about the fit's largest swing, or an eighth of the record."""
    n = len(fitted)
    if len(crossings) < 3 * _CLOSE_CYCLES:
        return slice(0, max(16, n // 8))
    at = int(np.nanargmax(np.abs(fitted - np.nanmean(fitted))))
    first = max(0, int(np.searchsorted(crossings, at)) - _CLOSE_CYCLES)
    last = min(len(crossings) - 1, first + 2 * _CLOSE_CYCLES)
    return slice(int(crossings[first]), int(crossings[last]) + 1)
