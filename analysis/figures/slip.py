"""Pendulum angles and slip order over speed: ends of runs, and the model's steady states over the speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.errors import NotEnoughData
from analysis.figures.order_vectors import changes_speed, speed_range
from analysis.figures.sheet import MODEL_LOOK, WIDTH_IN, Look, sheet
from analysis.figures.steady_part import steady_part
from analysis.figures.steady_sweep import SweptState, steady_sweep
from analysis.figures.style import GREY, MEASURED, label
from analysis.quantities.rotor_phase import phase_at
from analysis.quantities.slip import SlipTrack, slip_track
from analysis.rig_model import RigModel
from daq.guided_test_kinds import point_of
from daq.signals.run import Run
from rig_basics.units import TO_RPM

_SPEEDS = 48
_STILL_RAD = 0.05
_BELOW, _ABOVE = 0.6, 1.12  # range of the model's curves relative to the runs' speeds
_FOOT = (
    "Slip order: a pendulum's speed against the rotor, turns a revolution; 0 is at rest on the rotor, −1 is at rest "
    "in the laboratory. Angles: 0° at the imbalance, both within 0…360°. Bars: swing in the last seconds."
)


@dataclass(frozen=True)
class _End:
    """End of a run at one speed: mean angles ([0, 2π)) and their swing, rad, and slip orders of the last seconds."""

    name: str
    speed_rad_s: float
    theta: tuple[float, float]
    spread: tuple[float, float]
    slip: tuple[float, float]


def draw_slip(runs: Sequence[Run], model: RigModel | None = None) -> Figure:
    """Draw θ3, θ4 (above, middle) and slip orders (below) over speed.

    Args:
        runs: runs with pendulum angles; runs at one speed yield a point each, runs through speeds a curve.
        model: model; its stable and unstable steady states over the speed.
    Raises:
        NotEnoughData: a run without pendulum angles or index marks.
    """
    for run in runs:
        need_slip(run)
    speeds = [speed_range(run) for run in runs]
    low, high = _BELOW * min(s[0] for s in speeds), _ABOVE * max(s[1] for s in speeds)
    ends = [_end(run) for run in runs if not changes_speed(run)]
    title = f"Pendulum angles and slip: {', '.join(Path(run.source).name for run in runs)}"
    locked = [Path(run.source).name for run in runs if _locked(run)]
    foot = [f"Pendulums locked throughout: {', '.join(locked)}; the model's states are of free ones.", _FOOT]
    with sheet(WIDTH_IN, 5.4, title, foot if locked else [_FOOT]) as figure:
        grid = list(figure.subplots(3, 1, sharex=True, height_ratios=(1.3, 1.3, 1)))
        if model is not None:
            found = steady_sweep(model, np.linspace(max(low, 0.25 * model.speeds_rad_s[0]), high, _SPEEDS))
            _branches(grid, found, model.name)
        for end in ends:
            _point(grid, end)
        for run in runs:
            if changes_speed(run):
                _curve(grid, run)
        _axes(grid, ends, (low * TO_RPM, high * TO_RPM), model)
        figure.align_ylabels(grid)
    return figure


def need_slip(run: Run) -> None:
    """Check that slip can be drawn of a run.

    Raises:
        NotEnoughData: the run has no pendulum angles or no index marks, or not at speed.
    """
    if not len(run.angle_time_s):
        raise NotEnoughData(f"{run.source}: expected pendulum angles for slip, the log has none")
    speed_range(run)
    if changes_speed(run):
        slips_of(run)
    else:
        _end(run)


def slips_of(run: Run) -> SlipTrack:
    """Return angles and slip orders in rows of whole revolutions.

    Raises:
        NotEnoughData: too few readings, or readings without a phase.
    """
    try:
        return slip_track(run.angle_time_s, run.angle_rad, phase_at(run, run.angle_time_s))
    except ValueError as error:
        raise NotEnoughData(f"{run.source}: {error}") from error


def _locked(run: Run) -> bool:
    """Whether no pendulum was released or moved on the rotor."""
    moved = np.nanmax(run.angle_rad, axis=0) - np.nanmin(run.angle_rad, axis=0)
    return not run.releases and bool(np.all(moved < _STILL_RAD))


def _end(run: Run) -> _End:
    part = steady_part(run)
    track = slips_of(run)
    late = (track.time_s >= part.from_s) & (track.time_s <= part.to_s)
    if not late.any():
        raise NotEnoughData(f"{run.source}: no pendulum angles in the last seconds at speed")
    means = np.angle(np.mean(np.exp(1j * track.angle_rad[late]), axis=0)) % (2 * math.pi)
    _, own = part.cut(run.angle_time_s, run.angle_rad)
    spread = np.minimum(0.5 * np.ptp(own, axis=0), math.pi)
    slip = np.mean(track.slip_order[late], axis=0)
    return _End(
        point_of(run.test) or run.test,
        part.speed_rad_s,
        (float(means[0]), float(means[1])),
        (float(spread[0]), float(spread[1])),
        (float(slip[0]), float(slip[1])),
    )


def _branches(grid: Sequence[Axes], found: Sequence[SweptState], name: str) -> None:
    """Draw a dot for every steady state: filled if stable, open if unstable."""
    for j in range(2):
        for stable, text in ((True, f"stable, {name}"), (False, f"unstable, {name}")):
            chosen = [s for s in found if s.state.stable == stable]
            grid[j].plot(
                [TO_RPM * s.speed_rad_s for s in chosen],
                [math.degrees(s.state.theta_rad[j]) % 360.0 for s in chosen],
                ls="",
                marker="o" if stable else "x",
                ms=3.2 if stable else 3.6,
                color=MODEL_LOOK["color"] if stable else GREY,
                mew=0.7,
                label=text,
                alpha=1.0 if stable else 0.7,
            )
    grid[2].axhline(0.0, label=f"every steady state, {name}: slip 0", **MODEL_LOOK)


def _point(grid: Sequence[Axes], end: _End) -> None:
    speed = TO_RPM * end.speed_rad_s
    look: Look = {
        "marker": "D",
        "ms": 8,
        "mfc": "none",
        "mew": 1.8,
        "color": MEASURED,
        "ls": "",
        "label": "measured, end of run",
    }
    for j in range(2):
        theta = math.degrees(end.theta[j])
        grid[j].errorbar([speed], [theta], [math.degrees(end.spread[j])], capsize=3, zorder=5, **look)
        grid[2].plot(
            [speed],
            [end.slip[j]],
            marker="os"[j],
            ms=8 - 3 * j,
            mfc="none",
            mew=1.6,
            color=MEASURED if j == 0 else "black",
            ls="",
            label=("A", "B")[j] + " measured",
        )


def _curve(grid: Sequence[Axes], run: Run) -> None:
    held = ", locked" if _locked(run) else ""
    track = slips_of(run)
    speed = TO_RPM * track.speed_rad_s
    for j in range(2):
        degrees = (np.degrees(track.angle_rad[:, j]) + 5.0) % 360.0 - 5.0
        degrees[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
        grid[j].plot(
            speed,
            degrees,
            color=MEASURED if j == 0 else "black",
            lw=2.2 - j,
            alpha=0.6,
            ls="-" if j == 0 else "--",
            label="AB"[j] + " measured" + held,
        )
        grid[2].plot(
            speed,
            track.slip_order[:, j],
            color=MEASURED if j == 0 else "black",
            lw=2.2 - j,
            alpha=0.6,
            ls="-" if j == 0 else "--",
            label="AB"[j] + " measured" + held,
        )


def _axes(grid: Sequence[Axes], ends: Sequence[_End], span: tuple[float, float], model: RigModel | None) -> None:
    for j, name in enumerate(("θ3, °", "θ4, °")):
        label(grid[j], y=name)
        grid[j].set_ylim(-12, 372)
        grid[j].set_yticks(np.arange(0, 361, 90))
    label(grid[2], "speed, rpm", "slip order")
    slips = [abs(s) for end in ends for s in end.slip]
    reach = max(1.25 * max(slips, default=0.0), 0.01)
    grid[2].set_ylim(-reach, reach)
    grid[2].set_xlim(0, span[1])
    top = grid[0].secondary_xaxis("top")
    top.set_xticks([TO_RPM * end.speed_rad_s for end in ends], [end.name for end in ends], fontsize=8.5)
    if model is not None:
        for axes in grid:
            for natural in model.speeds_rad_s:
                if natural * TO_RPM < span[1]:
                    axes.axvline(natural * TO_RPM, color="#777777", lw=0.8, ls=":")
