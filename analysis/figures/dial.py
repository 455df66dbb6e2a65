"""Pendulum dial: angles of the pendulums on the rotor, held, measured at the end and predicted."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.projections.polar import PolarAxes

from analysis.errors import NoStableState, NotEnoughData
from analysis.figures.angles import ANGLE_FOOT
from analysis.figures.sheet import sheet
from analysis.figures.steady_part import steady_part
from analysis.figures.style import GREY, MEASURED, MODEL
from analysis.prediction import predict_point
from analysis.rig_model import RigModel
from analysis.simulated_run import locked_angles
from analysis.steady_state import measure
from daq.signals.run import Run
from rig_basics.units import TO_RPM

_log = logging.getLogger(__name__)

Angles = tuple[float, float]

_RADII = (1.0, 0.8)  # of A and B: their angles may be equal
_MARKERS = "os"
_TIMES = 1.96
_PADDING_IN = 0.2  # above and below the dial: the layout underestimates the labels of 90° and 270°
_OVER = "#009E73"


@dataclass(frozen=True)
class _Hands:
    """θ3 and θ4 with 95 % half widths (NaN: unknown), rad, and the state's name."""

    theta: Angles
    half_width: Angles
    state: str


def draw_dial(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Draw the rotor from above, imbalance to the right, with the angles as numbers next to it.

    Args:
        run: run with pendulum angles. If it has not settled, the mean of the last revolutions is drawn and labelled.
        model: model; its stable steady state at the measured speed, with a 95 % interval for identified parameters.
        over: another run whose end is drawn on the same rotor.
    Raises:
        NotEnoughData: no pendulum angles, or the rotor did not turn.
    """
    own = _measured(run, model)
    speed = steady_part(run).speed_rad_s
    predicted = None if model is None or not run.releases else _predicted(model, speed, own.theta)
    other = None if over is None else _measured(over, model)
    title = f"Pendulum dial: {Path(run.source).name} ({run.test}), {TO_RPM * speed:.1f} rpm"
    foot = [ANGLE_FOOT, "Circle: pendulum A (θ3), square: pendulum B (θ4). Arcs: 95 % intervals."]
    extra = 1.4 if other is not None and predicted is not None else 0.0
    with sheet(7.2 + extra, 4.2, title, foot) as figure:
        engine = figure.get_layout_engine()
        assert isinstance(engine, ConstrainedLayoutEngine)
        engine.set(h_pad=_PADDING_IN)
        grid = figure.add_gridspec(1, 2, width_ratios=(4.1, 3.1 + extra))
        axes = figure.add_subplot(grid[0], projection="polar")
        _rotor(axes)
        _hands(axes, _Hands(locked_angles(run), (math.nan, math.nan), ""), GREY, "held before release", "held")
        _hands(axes, own, MEASURED, "measured", "measured")
        if other is not None and over is not None:
            _hands(axes, other, _OVER, f"measured, {Path(over.source).name}", "other")
        if predicted is not None and model is not None:
            _hands(axes, predicted, MODEL, f"predicted, {model.name}", "model")
        _numbers(figure.add_subplot(grid[1]), own, predicted, other)
    return figure


def _measured(run: Run, model: RigModel | None) -> _Hands:
    if not len(run.angle_time_s):
        raise NotEnoughData(f"{run.source}: expected pendulum angles for a dial, the log has none")
    part = steady_part(run)
    if model is not None and run.releases:
        try:
            found = measure(run, model.rig)
        except NotEnoughData as error:
            _log.info("%s: dial without a measured state, with mean angles: %s", run.source, error)
        else:
            theta3, theta4 = found.theta_rad
            state = f"{found.state}" if found.state in ("slipping", "not settled") else f"type {found.state}"
            if found.state != "slipping":
                return _Hands((theta3.value, theta4.value), (_TIMES * theta3.std, _TIMES * theta4.std), state)
            return _Hands((theta3.value, theta4.value), (math.nan, math.nan), state)
    _, angles = part.cut(run.angle_time_s, run.angle_rad)
    if not len(angles):
        raise NotEnoughData(f"{run.source}: no pendulum angles in the last {part.to_s - part.from_s:.1f} s at speed")
    theta3, theta4 = np.mod(angles.mean(axis=0), 2 * math.pi).tolist()
    return _Hands((theta3, theta4), (math.nan, math.nan), "" if run.releases else "held")


def _predicted(model: RigModel, speed: float, near: Angles) -> _Hands | None:
    if model.identified is not None and len(model.identified.values):
        try:
            found = predict_point(model.rig, model.identified, speed, near_rad=near)
        except NoStableState as error:
            _log.info("dial at %.6g rad/s without the model's angles: %s", speed, error)
            return None
        theta3, theta4, *_ = found.values.tolist()
        std3, std4, *_ = found.std.tolist()
        return _Hands((theta3, theta4), (_TIMES * std3, _TIMES * std4), f"type {found.state.type}")
    state = model.steady_state(speed, near)
    return None if state is None else _Hands(state.theta_rad, (math.nan, math.nan), f"type {state.type}")


def _rotor(axes: Axes) -> None:
    assert isinstance(axes, PolarAxes)
    axes.set_ylim(0, 1.12)
    axes.set_yticks([])
    axes.set_xticks(np.radians(np.arange(0, 360, 30)))
    axes.tick_params(labelsize=8, pad=1)
    axes.plot([0], [0.4], marker="D", ms=8, color="black", ls="", label="imbalance")


def _hands(axes: Axes, hands: _Hands, colour: str, text: str, kind: str) -> None:
    for theta, half, radius, marker in zip(hands.theta, hands.half_width, _RADII, _MARKERS, strict=True):
        if kind == "held":
            axes.plot(
                [theta],
                [radius],
                marker=marker,
                ms=9,
                mfc="none",
                mec=colour,
                mew=1.0,
                ls="",
                label=f"{'A' if marker == 'o' else 'B'} {text}",
            )
            continue
        filled = kind != "model"
        axes.plot(
            [theta, theta],
            [0, radius],
            color=colour,
            lw=3.0 if kind == "measured" else 1.3,
            alpha=0.6 if kind == "measured" else 1.0,
            ls={"measured": "-", "model": "--", "other": "-."}[kind],
            label=text if marker == "o" else None,
            zorder=3,
        )
        axes.plot(
            [theta],
            [radius],
            marker=marker,
            ms=9 if filled else 13,
            mfc=colour if filled else "none",
            mec=colour,
            mew=1.6,
            ls="",
            zorder=5,
        )
        if math.isfinite(half):
            at = 1.06 if kind == "measured" else 1.09
            axes.plot(np.linspace(theta - half, theta + half, 40), np.full(40, at), color=colour, lw=2.2, zorder=4)


def _numbers(axes: Axes, own: _Hands, predicted: _Hands | None, other: _Hands | None) -> None:
    axes.axis("off")
    columns = [("measured", own), ("predicted", predicted), ("other run", other)]
    shown = [(name, hands) for name, hands in columns if hands is not None]
    rows = [("state", [hands.state or "–" for _, hands in shown])]
    for j, name in enumerate(("θ3", "θ4")):
        rows.append((name, [_with_width(hands.theta[j], hands.half_width[j]) for _, hands in shown]))
    if predicted is not None:
        off = [
            math.degrees(math.remainder(a - b, 2 * math.pi)) for a, b in zip(own.theta, predicted.theta, strict=True)
        ]
        for name, value in zip(("Δθ3", "Δθ4"), off, strict=True):
            rows.append((name, [f"{value:+.2f}°".replace("-", "−"), *[""] * (len(shown) - 1)]))
    step = 0.1
    lefts = [0.2 + k * 0.8 / len(shown) for k in range(len(shown))]
    for left, (name, _) in zip(lefts, shown, strict=True):
        axes.text(left, 0.78, name, fontsize=8.5, fontweight="bold", transform=axes.transAxes)
    for i, (name, cells) in enumerate(rows):
        y = 0.78 - (i + 1) * step
        axes.text(0.0, y, name, fontsize=8.5, transform=axes.transAxes)
        for left, cell in zip(lefts, cells, strict=True):
            axes.text(left, y, cell, fontsize=8.5, transform=axes.transAxes, parse_math=False)
    axes.text(
        0.0,
        0.78 - (len(rows) + 1.2) * step,
        "Δ: measured − predicted;\n± is 95 %",
        fontsize=8,
        color=GREY,
        va="top",
        transform=axes.transAxes,
    )


def _with_width(theta: float, half: float) -> str:
    value = math.degrees(theta) % 360.0
    return f"{value:.2f}° ± {math.degrees(half):.2f}°" if math.isfinite(half) else f"{value:.2f}°"
