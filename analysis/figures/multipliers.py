"""Multipliers over one revolution: in the complex plane at the runs' speeds, and the largest ones over the speed."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from analysis.figures.sheet import WIDTH_IN, Look, sheet
from analysis.figures.steady_part import steady_part
from analysis.figures.steady_sweep import SweptState, steady_sweep
from analysis.figures.style import GREY, label
from analysis.rig_model import RigModel
from daq.guided_test_kinds import point_of
from daq.signals.run import Run
from dynamics import SteadyState, steady_states
from dynamics.errors import DynamicsError
from rig_basics.units import TO_RPM

_log = logging.getLogger(__name__)

_SPEEDS = 90
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#444444")
_MARKERS = "os^DvPX"
_STYLES = {
    "I": ("black", "-", "balanced (I)"),
    "II": (GREY, ":", "opposed (II)"),
    "III": ("#D55E00", "--", "together (III)"),
}
_MAX_MULTIPLIER = 3.0  # upper limit of the axis


@dataclass(frozen=True)
class SpeedPoint:
    """A speed at which multipliers are drawn; `near_rad`: measured θ3, θ4, or None."""

    name: str
    speed_rad_s: float
    near_rad: tuple[float, float] | None = None


def speed_point(run: Run) -> SpeedPoint:
    """Return the speed at the end of a run, and its mean pendulum angles.

    Raises:
        NotEnoughData: the rotor did not turn.
    """
    part = steady_part(run)
    _, angles = part.cut(run.angle_time_s, run.angle_rad)
    name = point_of(run.test) or run.test
    if not run.releases or not len(angles):
        return SpeedPoint(name, part.speed_rad_s)
    theta3, theta4 = np.angle(np.mean(np.exp(1j * angles), axis=0)).tolist()
    return SpeedPoint(name, part.speed_rad_s, (theta3, theta4))


def draw_multipliers(points: Sequence[SpeedPoint], model: RigModel) -> Figure:
    """Left: all multipliers of each point's state and the unit circle. Right: the largest modulus over the speed.

    Args:
        points: speeds with measured pendulum angles; without angles the stable state is drawn.
        model: model whose motions are evaluated.
    """
    first = model.speeds_rad_s[0]
    top = max([1.1 * p.speed_rad_s for p in points] + [1.5 * model.speeds_rad_s[1]])
    swept = steady_sweep(model, np.linspace(0.35 * first, top, _SPEEDS))
    shown = [(point, state) for point in points if (state := _state(model, point)) is not None]
    foot = ["Over one revolution. Inside the unit circle (modulus below 1) a motion is stable. Crosses: resonances."]
    with sheet(WIDTH_IN, 3.9, f"Multipliers: {model.rig.name}, {model.name}", foot) as figure:
        grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.35))
        plane, along = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
        _along(along, swept, model, top)
        plane.add_patch(Circle((0, 0), 1.0, fill=False, ec="#333333", lw=1.2))
        for i, (point, state) in enumerate(shown):
            look: Look = {
                "marker": _MARKERS[i % 7],
                "ls": "",
                "mfc": "none",
                "mec": _COLOURS[i % 7],
                "mew": 1.5,
                "ms": 6.5,
            }
            text = f"{point.name}: {state.type}, {TO_RPM * point.speed_rad_s:.0f} rpm, |μ| {state.multiplier_max:.3f}"
            plane.plot(state.multipliers.real, state.multipliers.imag, label=text, **look)
            along.plot([TO_RPM * point.speed_rad_s], [state.multiplier_max], zorder=5, **look)
        plane.set_aspect("equal", adjustable="datalim")
        plane.margins(0.08)
        label(plane, "real part", "imaginary part")
    return figure


def _state(model: RigModel, point: SpeedPoint) -> SteadyState | None:
    """Return the state nearest to the measured angles, else the stable one, else the balanced one."""
    try:
        states = steady_states(model.physics, point.speed_rad_s, 1e-6)
    except (DynamicsError, np.linalg.LinAlgError) as error:
        _log.info("multipliers at %.6g rad/s are left out: %s", point.speed_rad_s, error)
        return None
    if not states or point.near_rad is None:
        return states[0] if states else None
    near = np.exp(1j * np.array(point.near_rad))
    return min(states, key=lambda s: float(np.sum(np.abs(np.exp(1j * np.array(s.theta_rad)) - near))))


def _along(axes: Axes, swept: Sequence[SweptState], model: RigModel, top: float) -> None:
    """Draw one curve per branch: states of one type at one speed are ordered by their largest multiplier."""
    speeds = sorted({s.speed_rad_s for s in swept})
    for kind, (colour, dashes, text) in _STYLES.items():
        for rank in range(2):
            values = np.full(len(speeds), np.nan)
            for i, speed in enumerate(speeds):
                moduli = sorted(
                    {round(s.state.multiplier_max, 6) for s in swept if s.speed_rad_s == speed and s.state.type == kind}
                )
                if rank < len(moduli):
                    values[i] = moduli[rank]
            if np.isfinite(values).any():
                axes.plot(TO_RPM * np.array(speeds), values, color=colour, ls=dashes, lw=1.5, label=text)
    axes.axhline(1.0, color="#333333", lw=0.9)
    for natural in model.speeds_rad_s:
        axes.plot([TO_RPM * natural], [0.62], marker="x", color="#333333", ms=6, ls="")
    axes.set_xlim(0, TO_RPM * top)
    axes.set_ylim(0.6, _least_top(swept))
    label(axes, "speed, rpm", "largest |multiplier|")


def _least_top(swept: Sequence[SweptState]) -> float:
    largest = max((s.state.multiplier_max for s in swept if s.state.type == "I"), default=1.5)
    return min(max(1.6, math.ceil(10 * largest) / 10), _MAX_MULTIPLIER)
