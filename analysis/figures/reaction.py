"""Figure of `rig react`: vibration and pendulums after a sudden change."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GREY, MEASURED, MODEL, label
from dynamics.steady.reaction import Reaction


def draw_reaction(found: Reaction, title: str, share: float) -> Figure:
    """Draw rms vibration and mean pendulum angles of each revolution over the time since the change.

    Args:
        found: reaction.
        title: title of the figure.
        share: share of the largest deviation at which the reaction is over.
    """
    foot = ["Each point is a revolution: rms distance of the disk's centre from its mean, means of the angles."]
    with sheet(WIDTH_IN, 4.0, title, foot) as figure:
        rows: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        rows[0].plot(found.time_s, 1e3 * found.amplitude_m, color=MEASURED, label="vibration")
        if found.after is not None:
            rows[0].axhline(
                1e3 * found.after.amplitude_m, color=GREY, ls=":", label=f"state reached: {found.after.type}"
            )
        if np.isfinite(found.reaction_s):
            for axes in rows:
                axes.axvline(
                    found.reaction_s,
                    color="black",
                    lw=0.8,
                    ls="--",
                    label=f"within {100 * share:g} % after {found.reaction_s:.2f} s",
                )
        for i, (name, colour) in enumerate((("θ3", MEASURED), ("θ4", MODEL))):
            rows[1].plot(found.time_s, np.degrees(found.theta_rad[:, i]), color=colour, label=name)
        label(rows[0], None, "rms vibration, mm")
        label(rows[1], "time after the change, s", "θ3, θ4, °")
    return figure
