"""Loss of a rig's singular points over speed and over its damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.sheet import sheet
from analysis.figures.style import MEASURED, MODEL, label
from dynamics.equations.parameters import RotorParameters
from dynamics.steady.point_loss import point_losses

_FACTORS = np.geomspace(0.05, 20.0, 160)
_COLOURS = {"II": MODEL, "III": MEASURED}


def draw_point_loss(physics: RotorParameters, title: str) -> Figure:
    """Draw the bands of lost speed ratios over damping; both damping ratios are multiplied by the same number.

    Raises:
        OutsideDomain: as point_losses.
    """
    natural = physics.natural_frequencies_rad_s
    wide = natural[1] / natural[0]
    speeds = np.linspace(0.0, max(2.5, 1.6 * wide), 600)[1:]
    foot = (
        "Coloured: no singular point of the type exists. Line: damping of this rig. Damping ratios along x and y are "
        "multiplied by the same number."
    )
    with sheet(8.6, 3.8, title, (foot,)) as figure:
        axes = figure.subplots()
        rows = [point_losses(replace(physics, zeta1=f * physics.zeta1, zeta2=f * physics.zeta2)) for f in _FACTORS]
        for i, kind in enumerate(("II", "III")):
            lost = np.array([_lost(row[i].speed_ratios, speeds) for row in rows])
            if lost.any():
                axes.contourf(speeds, _FACTORS, lost, levels=(0.5, 1.5), colors=(_COLOURS[kind],), alpha=0.35)
                axes.fill_between([], [], [], color=_COLOURS[kind], alpha=0.35, label=f"Type {kind} lost")
        axes.axhline(1.0, color="black", lw=1.0, label="this rig's damping")
        axes.set_yscale("log")
        axes.set_yticks((0.1, 1, 10), ("0.1", "1", "10"))
        axes.set(xlim=(0, speeds[-1]), ylim=(_FACTORS[0], _FACTORS[-1]))
        label(axes, "speed ratio Ω = ω/ω_n1", "damping over this rig's")
    return figure


def _lost(bands: Sequence[tuple[float, float]], speeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 where a speed ratio is within a band, else 0."""
    found = np.zeros(len(speeds))
    for low, high in bands:
        found[(speeds > low) & (speeds < high)] = 1.0
    return found
