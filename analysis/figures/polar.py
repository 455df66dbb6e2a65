"""Polar plot: 1× vectors of x and y in the plane, with speeds along the curve, measured and simulated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from scipy.interpolate import CubicSpline

from analysis.figures.intervals import TIMES_IN_PLANE, area, interval_words
from analysis.figures.order_vectors import OrderVectors, cut_words, passed_vectors
from analysis.figures.sheet import (
    LEAST_FONT_PT,
    MEASURED_LOOK,
    MODEL_LOOK,
    OVER_LOOK,
    PHASE_FOOT,
    STEADY_LOOK,
    WIDTH_IN,
    Look,
    sheet,
)
from analysis.figures.stamp_lag import correction_words, lag_words
from analysis.figures.style import label
from analysis.rig_model import RigModel
from daq.signals.run import Run
from rig_basics.arrays import Complex
from rig_basics.units import TO_RPM

_RAYS = tuple(22.5 + 45.0 * k for k in range(8))
_MAX_VECTORS, _BETWEEN, _CURVE_POINTS = 1200, 8, 200
_NICE_RPM = np.array([5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0])
_MIN_DISTANCE = 0.17  # between two written speeds, relative to the radius
_TEXT_DISTANCE = 0.085  # from the curve to its speed's number, relative to the radius

_HEADROOM = 1.12  # radius over the largest measured amplitude; a steady resonance may exceed it
_MIN_CIRCLE = 0.011  # relative to the radius: half the width of the measured curve
_CIRCLES = "Light areas: 95 % areas of the vectors, drawn where they are wider than the line."


def draw_polar(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Draw the vectors of x (left) and y (right): radius 0–peak amplitude in mm, angle phase, counterclockwise lead.

    Args:
        run: run-up or run-down.
        model: model; its simulation of the run, and its steady response, which may leave the figure at resonance.
        over: another run, drawn over the first.
    Raises:
        NotEnoughData: the run stays at one speed, or has no index marks.
    """
    own = passed_vectors(run, model)
    other = None if over is None else passed_vectors(over, model)
    foot = [
        "Radius: 1× amplitude, mm (0–peak). Angle: phase, °, counterclockwise lead. Dots: speed in rpm.",
        PHASE_FOOT,
    ]
    tops = {name: _HEADROOM * float(np.max(np.abs(seen.amplitude_m))) for name, seen in own.measured.items()}
    drawn = own.corrected
    foot += cut_words(own, tops) + interval_words(drawn) + [_CIRCLES] + lag_words(own) + correction_words(own)
    named = "" if model is None else model.name
    with sheet(WIDTH_IN, 4.3, f"Polar plot, 1×: {Path(run.source).name} ({run.test})", foot) as figure:
        for column, (name, measured) in enumerate(drawn.items()):
            axes = figure.add_subplot(1, len(drawn), column + 1, projection="polar")
            top = 1e3 * tops[name]
            _curve(axes, measured, MEASURED_LOOK, "measured", top)
            _circles(axes, measured, top, MEASURED_LOOK["color"])
            if own.simulated:
                _curve(axes, own.simulated[name], MODEL_LOOK, f"same run simulated, {named}", top)
            if own.steady:
                _curve(axes, own.steady[name], STEADY_LOOK, f"steady response, {named}", top)
            if other is not None and over is not None and name in other.measured:
                _circles(axes, other.corrected[name], top, OVER_LOOK["color"])
                _curve(axes, other.corrected[name], OVER_LOOK, f"measured, {Path(over.source).name}", top)
            _scales(axes, top, _speeds(axes, measured, top))
            label(axes, title=f"{name}, mm")
    return figure


def _curve(axes: Axes, found: OrderVectors, look: Look, text: str, top: float) -> None:
    vectors = _smooth(found.amplitude_m)
    radius = 1e3 * np.abs(vectors)
    axes.plot(np.unwrap(np.angle(vectors)), np.where(radius <= top, radius, np.nan), label=text, **look)


def _circles(axes: Axes, found: OrderVectors, top: float, colour: str) -> None:
    """Draw the 95 % area of each vector that is wider than the curve: a circle, wider along the turn by the lag's."""
    around = np.linspace(0, 2 * np.pi, 73)
    turns = np.minimum(TIMES_IN_PLANE * np.abs(found.speed_rad_s) * found.lag_std_s, np.pi)
    rows = zip(found.amplitude_m.tolist(), found.std_m.tolist(), turns.tolist(), strict=True)
    for amplitude, std, turned in rows:
        half = max(TIMES_IN_PLANE * std, abs(amplitude) * turned)
        if abs(amplitude) > 0 and 1e3 * half > _MIN_CIRCLE * top:
            along = amplitude / abs(amplitude) * np.exp(1j * around)
            edge = 1e3 * (amplitude + TIMES_IN_PLANE * std * along) * np.exp(1j * turned * np.sin(around))
            area(axes, np.unwrap(np.angle(edge)), np.abs(edge), colour)


def _smooth(vectors: Complex) -> Complex:
    """Return the vectors with interpolated ones between them; the tracked envelope is a spline."""
    if not 4 <= len(vectors) <= _MAX_VECTORS:
        return vectors
    at = np.arange(len(vectors))
    between = np.linspace(0, len(vectors) - 1, _BETWEEN * len(vectors))
    return np.asarray(CubicSpline(at, vectors)(between), np.complex128)


def _scales(axes: Axes, top: float, written: Sequence[complex]) -> None:
    """Set radius and angle; the radii are written along the ray that is farthest from numbers and curve."""
    assert isinstance(axes, PolarAxes)
    axes.set_ylim(0, top)
    axes.set_xticks(np.radians(np.arange(0, 360, 45)))
    along = np.array([radius / top for radius in axes.get_yticks() if 0 < radius <= top])  # of the numbers on the ray
    free = {
        ray: min((float(np.min(np.abs(along * np.exp(1j * np.radians(ray)) - at))) for at in written), default=1.0)
        for ray in _RAYS
    }
    axes.set_rlabel_position(max(free, key=lambda ray: free[ray]))
    axes.tick_params(labelsize=8)
    axes.spines["polar"].set_visible(True)


def _speeds(axes: Axes, found: OrderVectors, top: float) -> list[complex]:
    """Write speeds along the curve without overlap; return the positions of numbers and curve, by the radius."""
    vectors = _smooth(found.amplitude_m)
    rows = np.arange(len(found.speed_rad_s))
    speed = TO_RPM * np.interp(np.linspace(0, len(rows) - 1, len(vectors)), rows, found.speed_rad_s)
    if speed[-1] < speed[0]:
        speed, vectors = speed[::-1], vectors[::-1]
    span = float(speed[-1] - speed[0])
    step = float(_NICE_RPM[min(int(np.searchsorted(_NICE_RPM, span / 45)), len(_NICE_RPM) - 1)])
    written: list[complex] = []
    for rpm in np.arange(step * np.ceil(speed[0] / step), speed[-1], step).tolist():
        at = complex(np.interp(rpm, speed, vectors.real), np.interp(rpm, speed, vectors.imag)) * 1e3 / top
        out = at * (1 + _TEXT_DISTANCE / abs(at)) if abs(at) > _MIN_DISTANCE else at + _TEXT_DISTANCE
        if any(abs(out - other) < _MIN_DISTANCE for other in written):
            continue
        written.append(out)
        axes.plot([np.angle(at)], [abs(at) * top], marker="o", ms=3.5, color="black", ls="", zorder=6)
        axes.text(
            float(np.angle(out)),
            abs(out) * top,
            f"{rpm:.0f}",
            fontsize=LEAST_FONT_PT,
            ha="center",
            va="center",
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8},
            zorder=7,
        )
    curve = vectors[:: max(1, len(vectors) // _CURVE_POINTS)] * 1e3 / top
    return [*written, *(complex(at) for at in curve.tolist() if abs(at) > _MIN_DISTANCE)]
