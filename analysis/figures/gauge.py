"""Residuals of a sensor's calibration: deviation from the line at every position, in the order of the readings."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from analysis.figures.style import GREY, MEASURED, MODEL, drawing, label
from daq.calibration.line import GaugeLine


def gauge_residuals(line: GaugeLine, title: str) -> Figure:
    """Draw positions less the line, µm, over the position, mm; rising and falling readings have their own marks."""
    p = 1e3 * np.array([r.position_m for r in line.readings])
    off = 1e6 * line.residuals_m
    std = 1e6 * np.array([np.hypot(r.position_std_m, line.gain * r.reading_std_m) for r in line.readings])
    falling = np.concatenate([[False], np.diff(p) < 0])
    turned = np.concatenate([[False], np.diff(p) == 0])
    falling |= turned & np.concatenate([falling[1:], [False]])
    with drawing(7.0, 3.4) as figure:
        axes = figure.add_subplot()
        axes.axhline(0.0, color=MODEL)
        for chosen, marker, words in ((~falling, "^", "rising"), (falling, "v", "falling")):
            if np.any(chosen):
                axes.errorbar(
                    p[chosen], off[chosen], 1.96 * std[chosen], fmt=marker, color=MEASURED, ecolor=GREY, label=words
                )
        axes.legend(loc="best")
        label(axes, "position, mm", "position less the line, µm", f"{title}: stated uncertainties at 95 %")
        figure.tight_layout()
        return figure
