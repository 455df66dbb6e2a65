"""One point over time: displacements and pendulum angles, measured and simulated, with a close view of the end."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.style import MEASURED, MODEL, band, bins_for, drawing, label, outline, pin, to_svg
from analysis.prediction import Prediction
from analysis.steady_state import SteadyMeasurement
from daq.signals.run import Run
from dynamics import RotorParameters, Scene, SpeedHistory, simulate
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import locked_state

_log = logging.getLogger(__name__)

Array = NDArray[np.floating]

_BEFORE_S = 3.0
_SAMPLES_PER_TURN = 24
_TURNS_SHOWN = 4


@dataclass(frozen=True)
class Simulated:
    """Motion of the model after a release in sensor axes: shapes (n,), (n,), (n,), (n, 2); s, m, rad."""

    time_s: Array
    x_m: Array
    y_m: Array
    angle_rad: Array


def simulate_release(
    run: Run, measured: SteadyMeasurement, physics: RotorParameters, axis_angle_rad: float
) -> Simulated | None:
    """Simulate the motion from the measured lock angles at release, with the measured speed history.

    Returns:
        None if the marks or the motion do not allow it.
    """
    inside = (run.mark_time_s > measured.release_s - 2.0) & (run.mark_time_s <= measured.to_s + 1.0)
    try:
        history = SpeedHistory.from_phases(run.mark_time_s[inside], run.mark_phase_rad[inside])
        psi, speed, _ = history.phase(measured.release_s)[0]
        start = locked_state(physics, speed, psi, *(float(a) for a in measured.locked_rad))
        rate = _SAMPLES_PER_TURN * measured.speed_rad_s.value / (2 * np.pi)
        time = np.arange(measured.release_s, measured.to_s, 1 / rate)
        motion = simulate(physics, Scene(history, (True, True), start), time, 1e-3)
    except DynamicsError as error:
        _log.info("%s: figure without the simulated motion: %s", run.source, error)
        return None
    x, y = motion.displacement_m.T
    c, s = math.cos(axis_angle_rad), math.sin(axis_angle_rad)
    return Simulated(time, x * c + y * s, -x * s + y * c, motion.angles_rad)


def draw_point(
    run: Run, measured: SteadyMeasurement, prediction: Prediction | None, simulated: Simulated | None, name: str
) -> str:
    """Return the SVG of `point_figure`."""
    figure = point_figure(run, measured, prediction, simulated)
    return to_svg(figure, name, "Displacements and pendulum angles over time, measured and simulated")


def point_figure(
    run: Run, measured: SteadyMeasurement, prediction: Prediction | None, simulated: Simulated | None
) -> Figure:
    """Draw x, y, θ3, θ4 from 3 s before release (left) and at the end (right)."""
    zero, end = measured.release_s, measured.to_s
    close = end - 2 * np.pi * _TURNS_SHOWN / measured.speed_rad_s.value
    with drawing(8.6, 4.7) as figure:
        grid = figure.subplots(4, 2, width_ratios=(2.6, 1), sharex="col")
        figure.subplots_adjust(left=0.1, right=0.975, top=0.89, bottom=0.1, wspace=0.16, hspace=0.14)
        bins = bins_for((end - zero) * measured.speed_rad_s.value / (2 * np.pi))
        for row, (time, values, model, text) in enumerate(_displacements(run, measured, simulated)):
            for axes, start in zip(grid[row], (zero - _BEFORE_S, close), strict=True):
                _pair(axes, time - zero, values, simulated, model, (start - zero, end - zero), bins)
            label(grid[row, 0], y=text)
        for j, text in enumerate(("θ3, °", "θ4, °")):
            _angle_row(grid[2 + j], run, measured, prediction, simulated, j, (zero, close, end))
            label(grid[2 + j, 0], y=text)
        for column in (0, 1):
            label(grid[3, column], "time after release, s")
        for axes in grid[:, 0]:
            axes.axvline(0.0, color="#444444", lw=0.8, ls=":")
        label(grid[0, 0], title="from 3 s before release (dotted line: release)")
        label(grid[0, 1], title=f"last {_TURNS_SHOWN} revolutions")
        handles, names = grid[0, 0].get_legend_handles_labels()
        handles2, names2 = grid[2, 1].get_legend_handles_labels()
        extra = [(h, n) for h, n in zip(handles2, names2, strict=True) if n not in names]
        figure.legend(
            handles + [h for h, _ in extra], names + [n for _, n in extra], loc="upper right", ncols=4, fontsize=8.5
        )
        pin(figure, grid, 0.028, 0.05)
    return figure


def _displacements(
    run: Run, measured: SteadyMeasurement, simulated: Simulated | None
) -> list[tuple[Array, Array, Array | None, str]]:
    """Return times, mm about the mean, and simulated mm, for x and y."""
    rows: list[tuple[Array, Array, Array | None, str]] = []
    for time, values, model, text in (
        (run.x_time_s, run.x_m, simulated and simulated.x_m, "x, mm"),
        (run.y_time_s, run.y_m, simulated and simulated.y_m, "y, mm"),
    ):
        late = values[(time >= measured.from_s) & (time <= measured.to_s)]
        shown: Array = 1e3 * (values - float(np.nanmean(late)))
        rows.append((time, shown, None if model is None else 1e3 * model, text))
    return rows


def _pair(
    axes: Axes,
    time: Array,
    values: Array,
    simulated: Simulated | None,
    model: Array | None,
    span: tuple[float, float],
    bins: int,
) -> None:
    """Draw measured and simulated values in an interval of time after release."""
    part = (time >= span[0]) & (time <= span[1])
    if part.sum() > 1:
        step = max(1, int(part.sum() // 600)) if span[1] - span[0] < 3 else 1
        band(axes, time[part][::step], values[part][::step], MEASURED, "measured", bins=bins)
    if simulated is not None and model is not None:
        own = simulated.time_s - (simulated.time_s[0])
        inside = (own >= span[0]) & (own <= span[1])
        if inside.sum() > 1:
            outline(axes, own[inside], model[inside], MODEL, "simulated, identified parameters", bins=bins)


def _angle_row(
    axes: NDArray[Any],
    run: Run,
    measured: SteadyMeasurement,
    prediction: Prediction | None,
    simulated: Simulated | None,
    j: int,
    times: tuple[float, float, float],
) -> None:
    """Draw one pendulum's angle in both columns, with the predicted steady value ± 2 deviations on the right."""
    zero, close, end = times
    settled = run.angle_rad[(run.angle_time_s >= measured.from_s) & (run.angle_time_s <= end), j]
    base = 2 * np.pi * np.floor(np.nanmean(settled) / (2 * np.pi))  # both end between 0 and 360°
    angle = np.degrees(run.angle_rad[:, j] - base)
    model = None if simulated is None else np.degrees(simulated.angle_rad[:, j] - base)
    for axis, start in zip(cast("list[Axes]", axes.tolist()), (zero - _BEFORE_S, close), strict=True):
        _pair(axis, run.angle_time_s - zero, angle, simulated, model, (start - zero, end - zero), 400)
    if prediction is None or measured.state not in ("I", "II", "III"):
        return
    late: Array = angle[(run.angle_time_s >= measured.from_s) & (run.angle_time_s <= end)]
    value = math.degrees(prediction.values[j])
    value += 360 * round((float(np.nanmean(late)) - value) / 360)
    std = math.degrees(prediction.std[j])
    axes[1].axhspan(value - 2 * std, value + 2 * std, color=MODEL, alpha=0.15, lw=0, label="predicted mean ± 2 σ")
    axes[1].axhline(value, color=MODEL, lw=0.8, ls="--")
