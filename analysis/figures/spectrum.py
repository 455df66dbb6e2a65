"""Spectra of a run's end: full spectrum, forward and backward, and power densities of x and y."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.errors import NotEnoughData
from analysis.figures.order_vectors import changes_speed, speed_range
from analysis.figures.recorded import LEAST_MARKS
from analysis.figures.sheet import MODEL_LOOK, OVER_LOOK, WIDTH_IN, Look, sheet
from analysis.figures.steady_part import SteadyPart, held_part, steady_part
from analysis.figures.style import MEASURED, MODEL, label
from analysis.quantities.orbits import orbit_ellipse
from analysis.quantities.spectra import Spectrum, full_spectrum, power_density
from analysis.rig_model import RigModel
from analysis.simulated_run import NOT_FOLLOWED, SimulatedRun, simulate_run
from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM

_AVERAGES = 4  # half-overlapping windows in the interval
_MIN_RANGE_Hz = 15.0
_ORDERS_SHOWN = 3.5
_LOG_POINTS = 700


@dataclass(frozen=True)
class _Part:
    """Interval of the spectra: times and samples of x and y, 1× in Hz (NaN: at rest or changing)."""

    x: tuple[Array, Array]
    y: tuple[Array, Array]
    turns_Hz: float
    words: str
    steady: SteadyPart | None
    passing: bool = False  # whether the run passes through speeds outside the interval


_MODEL_FOOT = "Simulated: without the sensors' noise, so that it is below the measured floor and leaves the axis."


def draw_spectrum(run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
    """Draw full spectrum (above) and power densities (below).

    Args:
        run: run with both displacements. The interval is its last seconds at one speed; for a run-up its longest
            interval at one speed; for a standing rotor the whole run.
        model: model; the spectra of its simulation, 1× amplitudes of its steady state, natural frequencies.
        over: another run, drawn over the first.
    Raises:
        NotEnoughData: a displacement is missing, or no interval at one speed is long enough.
    """
    part = _part(run)
    other = None if over is None else _part(over)
    foot = [
        "Full spectrum: amplitudes (0–peak) of x + iy; positive frequencies turn with the rotor (forward, x to y). "
        f"Power density: one-sided, its integral is the variance. Of {part.words}."
    ]
    simulated = None if model is None else simulate_run(run, model)
    if model is not None and part.steady is not None:
        foot.append(_MODEL_FOOT if simulated is not None else NOT_FOLLOWED)
    title = f"Spectra: {Path(run.source).name} ({run.test})"
    with sheet(WIDTH_IN, 5.4, title, foot) as figure:
        upper, lower = figure.subplots(2, 1)
        around = max(_MIN_RANGE_Hz, _ORDERS_SHOWN * part.turns_Hz if math.isfinite(part.turns_Hz) else 0.0)
        if model is not None:
            around = max(around, 1.3 * model.speeds_rad_s[1] / (2 * math.pi))
        _full(upper, part, around, MEASURED, "full spectrum, measured")
        _densities(lower, part, ("x measured", "y measured"))
        if other is not None and over is not None:
            _full(upper, other, around, OVER_LOOK["color"], f"full spectrum, {Path(over.source).name}")
            _densities(lower, other, (f"x {Path(over.source).name}", f"y {Path(over.source).name}"), over=True)
        if model is not None:
            if simulated is not None:
                _simulated((upper, lower), part, simulated, around, f"same run simulated, {model.name}")
            if not part.passing:
                _model(upper, part, model, run)
            for natural in model.speeds_rad_s:
                lower.axvline(natural / (2 * math.pi), color="#555555", lw=0.9, ls=":")
        _orders(upper, part.turns_Hz, around)
        label(upper, "frequency, Hz (positive: forward)", "amplitude, mm (0–peak)")
        label(lower, "frequency, Hz (dotted: natural frequencies by the model)", "power density, mm²/Hz")
    return figure


def _part(run: Run) -> _Part:
    if not (np.isfinite(run.x_m).any() and np.isfinite(run.y_m).any()):
        raise NotEnoughData(f"{run.source}: expected both displacements for a full spectrum, x or y has no sample")
    steady: SteadyPart | None = None
    passing = len(run.mark_time_s) >= LEAST_MARKS and changes_speed(run)
    if len(run.mark_time_s) >= LEAST_MARKS:
        steady = held_part(run) if passing else steady_part(run)
        start, end, turns = steady.from_s, steady.to_s, steady.speed_rad_s / (2 * math.pi)
        words = f"the last {end - start:.1f} s at speed"
        if passing:
            low, high = speed_range(run)
            words = (
                f"the longest stretch at one speed, {end - start:.1f} s at {TO_RPM * steady.speed_rad_s:.1f} rpm from "
                f"{start:.1f} s; the run goes through {TO_RPM * low:.0f}…{TO_RPM * high:.0f} rpm, as its waterfall "
                "shows"
            )
    else:
        start, end, turns = float(run.x_time_s[0]), float(run.x_time_s[-1]), math.nan
        words = f"the whole run, {end - start:.1f} s; no index mark, so no orders"
    x, y = (_within(t, v, start, end) for t, v in ((run.x_time_s, run.x_m), (run.y_time_s, run.y_m)))
    return _Part(x, y, turns, words, steady, passing)


def _within(time: Array, values: Array, start: float, end: float) -> tuple[Array, Array]:
    inside = (time >= start) & (time <= end)
    return time[inside], values[inside]


def _window_s(part: _Part) -> float:
    return 2 * float(part.x[0][-1] - part.x[0][0]) / (_AVERAGES + 1)


def _full(axes: Axes, part: _Part, around: float, colour: str, text: str) -> None:
    time, x = part.x  # linear interpolation of y at the times of x is accurate far beyond the displayed range
    try:
        found = full_spectrum(time, x, np.interp(time, *part.y), window_s=_window_s(part))
    except ValueError as error:
        raise NotEnoughData(f"full spectrum of {part.words}: {error}") from error
    shown = np.abs(found.frequency_Hz) <= around
    axes.plot(
        found.frequency_Hz[shown],
        1e3 * found.values[shown],
        color=colour,
        lw=1.4,
        label=text,
        ls="-" if colour == MEASURED else OVER_LOOK["ls"],
    )
    axes.set_yscale("log")
    axes.set_xlim(-around, around)


def _densities(axes: Axes, part: _Part, names: tuple[str, str], *, over: bool = False) -> None:
    looks: tuple[Look, Look] = (
        ({"color": OVER_LOOK["color"], "ls": "-."}, {"color": "#8C6D1F", "ls": ":"})
        if over
        else ({"color": MEASURED, "ls": "-"}, {"color": "#444444", "ls": "--"})
    )
    for (time, values), name, look in zip((part.x, part.y), names, looks, strict=True):
        found = power_density(time, values, window_s=_window_s(part))
        axes.plot(*_by_octaves(found), lw=1.1, label=f"power density, {name}", **look)
    axes.set_xscale("log")
    axes.set_yscale("log")


def _by_octaves(found: Spectrum) -> tuple[Array, Array]:
    """Return frequencies and mm²/Hz, averaged where many lines share a pixel of the logarithmic axis."""
    frequency, values = found.frequency_Hz[1:], 1e6 * found.values[1:]
    wanted = np.geomspace(float(frequency[0]), float(frequency[-1]), _LOG_POINTS)
    edges: NDArray[np.int64] = np.asarray(np.unique(np.searchsorted(frequency, wanted)), np.int64)
    count = np.diff(np.append(edges, len(frequency)))
    return np.add.reduceat(frequency, edges) / count, np.add.reduceat(values, edges) / count


def _simulated(panels: tuple[Axes, Axes], part: _Part, simulated: SimulatedRun, around: float, name: str) -> None:
    """Draw both spectra of the simulated run in the same interval; the limits of the axes do not change."""
    assert part.steady is not None
    limits = [axes.get_ylim() for axes in panels]
    time, x = part.steady.cut(simulated.time_s, simulated.x_m)
    _, y = part.steady.cut(simulated.time_s, simulated.y_m)
    window_s = min(_window_s(part), float(time[-1] - time[0]))
    found = full_spectrum(time, x, y, window_s=window_s)
    shown = np.abs(found.frequency_Hz) <= around
    panels[0].plot(found.frequency_Hz[shown], 1e3 * found.values[shown], label=f"full spectrum, {name}", **MODEL_LOOK)
    looks: tuple[Look, Look] = (MODEL_LOOK, {"color": "#8C6D1F", "ls": (0, (1, 1.5)), "lw": 1.6})
    for which, values, look in zip("xy", (x, y), looks, strict=True):
        density = power_density(time, values, window_s=window_s)
        panels[1].plot(*_by_octaves(density), label=f"power density, {which} simulated", **look)
    for axes, limit in zip(panels, limits, strict=True):
        axes.set_ylim(*limit)


def _model(axes: Axes, part: _Part, model: RigModel, run: Run) -> None:
    """Draw forward and backward 1× amplitudes of the model's steady state, if the run is steady."""
    if part.steady is None:
        return
    if run.releases:
        _, angles = part.steady.cut(run.angle_time_s, run.angle_rad)
        near = angles.mean(axis=0).tolist() if len(angles) else None
        state = model.steady_state(part.steady.speed_rad_s, near)
        if state is None:
            return
        x, y = model.shown_orders(state.x_m, -1j * state.y_m)
    else:
        held_x, held_y = model.locked(np.array([part.steady.speed_rad_s]))
        x, y = complex(held_x[0]), complex(held_y[0])
    orbit = orbit_ellipse(x, y)
    low, high = axes.get_ylim()
    values = 1e3 * np.array([abs(orbit.backward_m), abs(orbit.forward_m)])
    axes.plot(
        [-part.turns_Hz, part.turns_Hz],
        np.where(values > low, values, np.nan),
        ls="",
        marker="s",
        ms=9,
        mfc="none",
        mec=MODEL,
        mew=1.8,
        label=f"1× backward and forward, {model.name}",
    )
    axes.set_ylim(low, high)


def _orders(axes: Axes, turns_Hz: float, around: float) -> None:
    """Draw a second axis with orders above the plot."""
    if not math.isfinite(turns_Hz):
        return
    orders = np.arange(-math.floor(around / turns_Hz), math.floor(around / turns_Hz) + 1)
    orders = orders[:: max(1, len(orders) // 14)]
    above = axes.secondary_xaxis("top")
    above.set_xticks(orders * turns_Hz, [f"{k}×".replace("-", "−") for k in orders.tolist()], fontsize=8)
