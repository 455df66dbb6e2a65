"""Overview of one log: displacements, pendulum angles and speed, with losses and events.

A log of any length is drawn in bounded memory. It is read part by part. For a channel with more samples than the figure
has columns, only the least and the largest value of each column are kept.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from analysis.figures.log_marks import Marks, drawable
from analysis.figures.style import GREY, MEASURED, MODEL, drawing, label, save
from daq.errors import LogError
from daq.log import Log
from daq.log.content import stretches
from daq.log.samples import Samples
from daq.log.snapshot import rig_of

_log = logging.getLogger(__name__)

COLUMNS = 900
_LOST = "#CC3311"
_BREAK_RATIO = 8.0  # gap over the mean distance of samples above which the line is interrupted
_DRIVE_BREAK_S = 0.5  # the drive's samples have host time and arrive in groups
_MAX_MARK_S = 3.0  # between two marks of a turning rotor

Progress = Callable[[float], None]


class Trace:
    """One signal over the figure's time, s: few samples are kept, many are reduced to columns.

    Args:
        span: first and last instant of the figure, s.
        least_break_s: shortest time without a sample that interrupts the line, s.
    """

    def __init__(self, span: tuple[float, float], least_break_s: float = 0.1) -> None:
        self._start, self._width = span[0], (span[1] - span[0]) / COLUMNS
        self._least_break_s = least_break_s
        self._few: list[tuple[NDArray[np.floating], NDArray[np.floating]]] = []
        self._count = 0
        self._low, self._high = np.full(COLUMNS, np.nan), np.full(COLUMNS, np.nan)

    def add(self, time: NDArray[np.floating], values: NDArray[np.floating]) -> None:
        """Add samples; values that are not finite, or lie outside the figure, are ignored."""
        shown = np.isfinite(values) & (time >= self._start) & (time <= self._start + COLUMNS * self._width)
        time, values = time[shown], values[shown]
        self._count += len(time)
        self._few.append((time, values))
        if self._are_many:
            for part in self._few:
                self._gather(*part)
            self._few = []

    @property
    def _are_many(self) -> bool:
        return self._count > 2 * COLUMNS

    def _gather(self, time: NDArray[np.floating], values: NDArray[np.floating]) -> None:
        column = np.minimum((time - self._start) / self._width, COLUMNS - 1).astype(np.intp)
        np.fmin.at(self._low, column, values)
        np.fmax.at(self._high, column, values)

    @property
    def is_empty(self) -> bool:
        """Whether the trace has no samples."""
        return self._count == 0

    def band(self) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
        """Return times with least and largest value at each; NaN at interruptions of the line."""
        if self._are_many:
            filled = np.flatnonzero(np.isfinite(self._low))
            time, low, high = self._start + (filled + 0.5) * self._width, self._low[filled], self._high[filled]
        else:
            time = np.concatenate([part[0] for part in self._few] or [np.empty(0)])
            low = np.concatenate([part[1] for part in self._few] or [np.empty(0)])
            order = np.argsort(time, kind="stable")
            time, low = time[order], low[order]
            high = low
        if len(time) == 0:
            return time, low, high
        usual = (time[-1] - time[0]) / self._count
        longest = max(_BREAK_RATIO * usual, self._least_break_s, 1.5 * self._width)
        after = np.flatnonzero(np.diff(time) > longest) + 1
        return np.insert(time, after, time[after]), np.insert(low, after, np.nan), np.insert(high, after, np.nan)


@dataclass
class _Tacho:
    """Speed from the marks of the rotor, across parts of the log.

    The marks are timed by the node's own clock, because the map to the common clock settles in a log's first second.
    """

    trace: Trace
    last: tuple[float, float, float] | None = None

    def add(self, time: NDArray[np.floating], clock: NDArray[np.floating], turns: NDArray[np.floating]) -> None:
        marks = np.column_stack([time, clock, turns])
        if self.last is not None:
            marks = np.vstack([self.last, marks])
        if len(marks):
            self.last = tuple(marks[-1].tolist())
        steps = np.diff(marks, axis=0)
        good = (steps[:, 1] > 0) & (steps[:, 1] < _MAX_MARK_S)
        middle = marks[:-1, 0] + steps[:, 0] / 2
        self.trace.add(middle[good], 60 * steps[good, 2] / steps[good, 1])


def draw_log_overview(log: Log, path: Path, title: str = "", progress: Progress | None = None) -> None:
    """Draw a log into a .svg, .png or .pdf file.

    Args:
        log: log, complete or damaged; parts known to be missing are shaded.
        path: file of the figure.
        title: title of the figure.
        progress: called with the share that has been read, 0 … 1.

    Raises:
        BadFigureName: an unsupported suffix.
        LogError: a channel does not match its schema.
    """
    origin_ns = log.start_ns
    span = (0.0, max((log.end_ns - origin_ns) * 1e-9, 1e-3))
    traces = {name: Trace(span) for name in ("x", "y", "theta3", "theta4")}
    traces["motor"] = Trace(span, _DRIVE_BREAK_S)
    traces["tacho"] = Trace(span, _MAX_MARK_S)
    marks = Marks(span, COLUMNS)
    tacho = _Tacho(trace=traces["tacho"])
    for share, part in stretches(log):
        _gather(part, origin_ns, traces, tacho)
        for event in part.events:
            marks.add(event, (event["time_ns"] - origin_ns) * 1e-9)
        if progress is not None:
            progress(share)
    for missing in log.missing:
        if missing.start_ns is not None:
            end_s = None if missing.end_ns is None else (missing.end_ns - origin_ns) * 1e-9
            marks.add_missing((missing.start_ns - origin_ns) * 1e-9, end_s)
    _draw(path, traces, marks, span, title, _devices(log))


def _gather(part: Log, origin_ns: int, traces: dict[str, Trace], tacho: _Tacho) -> None:
    for topic, field_name, name, scale in (
        ("laser/x", "displacement_m", "x", 1e3),
        ("laser/y", "displacement_m", "y", 1e3),
        ("pendulums", "theta3_rad", "theta3", 180 / np.pi),
        ("pendulums", "theta4_rad", "theta4", 180 / np.pi),
        ("motor", "speed_rpm", "motor", 1.0),
    ):
        samples = part.get(topic)
        if samples is not None and field_name in samples.columns:
            traces[name].add(_seconds(samples, origin_ns), scale * samples[field_name].astype(float))
    marks = part.get("tacho")
    for field_name, scale in (("revolutions", 1.0), ("phase_rad", 0.5 / np.pi)):
        if marks is not None and field_name in marks.columns:
            time = _seconds(marks, origin_ns)
            clock = 1e-6 * marks["node_time_us"].astype(float) if "node_time_us" in marks.columns else time
            tacho.add(time, clock, scale * marks[field_name].astype(float))


def _seconds(samples: Samples, origin_ns: int) -> NDArray[np.floating]:
    return (samples.time_ns - origin_ns) * 1e-9


def _devices(log: Log) -> dict[str, str]:
    """Return the device of each channel; empty if the log does not contain it."""
    try:
        return rig_of(log).roles.device_of
    except LogError as error:
        _log.info("%s: devices are shown by their own names: %s", log.path, error)
        return {}


def _draw(
    path: Path, traces: dict[str, Trace], marks: Marks, span: tuple[float, float], title: str, devices: dict[str, str]
) -> None:
    rows = [
        (("x",), "x, mm", devices.get("laser/x")),
        (("y",), "y, mm", devices.get("laser/y")),
        (("theta3", "theta4"), "pendulums, °", devices.get("pendulums")),
        (("motor", "tacho"), "speed, rpm", devices.get("motor", devices.get("tacho"))),
    ]
    rows = [row for row in rows if not all(traces[name].is_empty for name in row[0])]
    with drawing(8.6, 1.1 + 1.35 * max(1, len(rows))) as figure:
        height = figure.get_figheight()
        figure.subplots_adjust(left=0.095, right=0.985, top=1 - 0.62 / height, bottom=0.48 / height, hspace=0.16)
        figure.text(0.012, 1 - 0.2 / height, drawable(title), fontsize=9.5, va="center", parse_math=False)
        grid = figure.subplots(max(1, len(rows)), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (names, text, device) in zip(grid, rows, strict=False):
            marks.shade(axes, device, _LOST)
            for name in names:
                if not traces[name].is_empty:
                    _DRAWN[name](axes, traces[name])
            label(axes, y=text)
            if len(names) > 1:
                axes.legend(loc="lower right", bbox_to_anchor=(1.01, 0.93), ncols=2, fontsize=8)
        if not rows:
            grid[0].text(
                0.5,
                0.5,
                "no samples of lasers, pendulums or speed in this log",
                transform=grid[0].transAxes,
                ha="center",
                color=GREY,
            )
            grid[0].set_yticks([])
        grid[-1].set_xlim(*span)
        label(grid[-1], "time since the start of the log, s")
        marks.draw(list(grid))
        if marks.has_losses:
            handle = Patch(color=_LOST, alpha=0.25, lw=0, label="lost or missing")
            figure.legend(handles=[handle], loc="upper right", bbox_to_anchor=(0.99, 1 - 0.06 / height), fontsize=8)
        figure.align_ylabels(grid)
        save(path, figure)


def _plain(colour: str, name: str) -> Callable[[Axes, Trace], None]:
    def draw(axes: Axes, trace: Trace) -> None:
        time, low, high = trace.band()
        axes.fill_between(time, low, high, color=colour, alpha=0.75, lw=0.9, label=name)

    return draw


def _speed(colour: str, name: str) -> Callable[[Axes, Trace], None]:
    """As `_plain`, with limits that show a constant speed as constant."""
    draw_plain = _plain(colour, name)

    def draw(axes: Axes, trace: Trace) -> None:
        draw_plain(axes, trace)
        low, high = axes.dataLim.intervaly
        room = max(0.03 * max(abs(low), abs(high)), 2.0, 0.05 * (high - low))
        axes.set_ylim(low - room, high + room)

    return draw


def _turning(colour: str, name: str) -> Callable[[Axes, Trace], None]:
    """Draw an angle on a circle: a curve that leaves the axes at 180° continues at −180°."""

    def draw(axes: Axes, trace: Trace) -> None:
        time, low, high = trace.band()
        around = high - low >= 360.0
        low, high = np.where(around, -180.0, low), np.where(around, 180.0, high)
        turns = np.unique(np.rint(np.concatenate([low, high])[np.isfinite(np.concatenate([low, high]))] / 360.0))
        first = True
        for turn in turns:
            below, above = low - 360.0 * turn, high - 360.0 * turn
            seen = (above >= -190.0) & (below <= 190.0)
            seen[1:] |= seen[:-1].copy()
            seen[:-1] |= seen[1:].copy()
            axes.fill_between(
                time, below, above, where=seen.tolist(), color=colour, alpha=0.75, lw=0.9, label=name if first else None
            )
            first = False
        axes.set_ylim(-190, 190)
        axes.set_yticks([-180, -90, 0, 90, 180])

    return draw


_DRAWN = {
    "x": _plain(MEASURED, "x"),
    "y": _plain(MEASURED, "y"),
    "theta3": _turning(MEASURED, "θ3"),
    "theta4": _turning(MODEL, "θ4"),
    "motor": _speed(GREY, "motor"),
    "tacho": _speed(MEASURED, "tachometer"),
}
