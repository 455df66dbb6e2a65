"""Stream health of a log over time: rates, gaps, ages of samples, counted losses, backlog of the disk."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.errors import NotEnoughData
from analysis.figures.sheet import WIDTH_IN, Look, sheet
from analysis.figures.style import label
from daq.errors import LogError
from daq.items import LOSS_KINDS
from daq.log import Log
from daq.log.content import seconds, stretches
from daq.log.samples import Samples
from daq.log.snapshot import rig_of
from rig_basics.arrays import Array
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_MAX_BINS = 240
_MIN_BIN_S = 0.5
_LOOKS: tuple[Look, ...] = (
    {"color": "#0072B2", "ls": "-"},
    {"color": "#D55E00", "ls": "--"},
    {"color": "#009E73", "ls": "-."},
    {"color": "#444444", "ls": ":"},
    {"color": "#CC79A7", "ls": (0, (6, 1.5, 1, 1.5))},
    {"color": "#8C6D1F", "ls": (0, (1, 2.5))},
)
_MIN_COUNT = 20
_GAPS = (*LOSS_KINDS, "silence")
_UNUSABLE = ("invalid", "suspect")
_FOOT = (
    "Rate: samples in each stretch over the stream's median stretch. Age: from a sample's own time on the common clock "
    "until the host had it, largest of each stretch; slightly below 0 until the clock map has settled. Lost: counted "
    "while recording."
)


@dataclass
class _Stream:
    """One channel by bins: number of samples, and their largest age in s (NaN without samples)."""

    count: Array
    age_s: Array


@dataclass
class _Gathered:
    """Health of a log, accumulated part by part."""

    edges_s: Array
    streams: dict[str, _Stream] = field(default_factory=dict[str, _Stream])
    gaps: dict[str, list[tuple[float, float]]] = field(
        default_factory=lambda: defaultdict[str, list[tuple[float, float]]](list)
    )
    reports: list[Mapping[str, Any]] = field(default_factory=list[Mapping[str, Any]])
    device_of: Mapping[str, str] = field(default_factory=dict[str, str])

    def channels(self, device: str) -> list[str]:
        """Return the channels of a device; empty if no role contains them."""
        return [topic for topic in self.streams if self.device_of.get(topic) == device]

    def name(self, device: str) -> str:
        """Return the name of a device by its channels, as in the other panels."""
        return ", ".join(self.channels(device)) or device

    def look(self, device: str, spare: int) -> Look:
        """Return the style of the device's first channel; without one a style beyond those of the channels."""
        own = self.channels(device)
        at = list(self.streams).index(own[0]) if own else len(self.streams) + spare
        return _LOOKS[at % len(_LOOKS)]

    def add(self, part: Log, origin_ns: int) -> None:
        """Add a part of the log."""
        for topic in part:
            self._count(topic, part[topic], origin_ns)
        for event in part.events:
            if event["kind"] in _GAPS:
                end = (event["time_ns"] - origin_ns) * 1e-9
                device = str(event.get("of", event.get("device", "?")))
                self.gaps[device].append((end - seconds(event, "span_s"), end))
        self.reports += part.health

    def _count(self, topic: str, samples: Samples, origin_ns: int) -> None:
        bins = len(self.edges_s) - 1
        stream = self.streams.setdefault(topic, _Stream(np.zeros(bins), np.full(bins, np.nan)))
        time = (samples.time_ns - origin_ns) * 1e-9
        at = np.clip(np.searchsorted(self.edges_s, time, "right") - 1, 0, bins - 1)
        np.add.at(stream.count, at, 1.0)
        np.fmax.at(stream.age_s, at, (samples.log_time_ns - samples.time_ns) * 1e-9)


def draw_health(log: Log) -> Figure:
    """Draw rates, ages, losses and the disk's backlog over a log, with gaps shaded.

    Args:
        log: log of any length, complete or damaged; it is read part by part.
    Raises:
        NotEnoughData: the log has no samples.
    """
    found = _gathered(log)
    if not any(stream.count.any() for stream in found.streams.values()):
        raise NotEnoughData(f"{log.path}: expected samples, the log has none; give a log with samples")
    width = float(found.edges_s[1] - found.edges_s[0])
    title = f"Stream health: {Path(log.path).name}"
    with sheet(WIDTH_IN, 5.6, title, [f"{_FOOT} Stretches of {width:.2g} s."]) as figure:
        grid: list[Axes] = list(figure.subplots(5, 1, sharex=True, height_ratios=(1.4, 0.9, 1.4, 1.2, 0.9)))
        _rates(grid[0], found)
        _gaps(grid[1], found)
        _ages(grid[2], found)
        _losses(grid[3], found, log.start_ns)
        _disk(grid[4], found, log.start_ns)
        grid[-1].set_xlim(float(found.edges_s[0]), float(found.edges_s[-1]))
        label(grid[-1], "time since the start of the log, s")
        figure.align_ylabels(grid)
    return figure


def _gathered(log: Log) -> _Gathered:
    span = max((log.end_ns - log.start_ns) * 1e-9, _MIN_BIN_S)
    bins = max(1, min(_MAX_BINS, int(span / _MIN_BIN_S)))
    found = _Gathered(np.linspace(0.0, span, bins + 1))
    with ignoring(_log, "reading the rig of a log, devices are shown by their own names", LogError):
        found.device_of = rig_of(log).roles.device_of
    for _, part in stretches(log):
        found.add(part, log.start_ns)
    for place in log.missing:  # missing in the file itself
        if place.start_ns is not None:
            end_ns = log.end_ns if place.end_ns is None else place.end_ns
            found.gaps["file"].append(((place.start_ns - log.start_ns) * 1e-9, (end_ns - log.start_ns) * 1e-9))
    return found


def _rates(axes: Axes, found: _Gathered) -> None:
    middle = 0.5 * (found.edges_s[1:] + found.edges_s[:-1])
    width = found.edges_s[1] - found.edges_s[0]
    lowest = 90.0
    for look, (topic, stream) in zip(cycle(_LOOKS), found.streams.items(), strict=False):
        usual = float(np.median(stream.count[1:-1])) if len(stream.count) > 2 else float(stream.count.max())
        if usual < _MIN_COUNT:  # for example the rotor's marks: the share of so few samples is not meaningful
            axes.plot([], [], lw=1.4, label=f"{topic}, {usual / width:.4g} a second, age only", **look)
            continue
        share = 100 * stream.count / usual
        axes.plot(middle, share, drawstyle="steps-mid", lw=1.4, label=f"{topic}, {usual / width:.4g} a second", **look)
        lowest = min(lowest, float(np.min(share[1:-1])) - 5 if len(share) > 2 else lowest)
    axes.set_ylim(max(lowest, -5.0), 112)
    label(axes, y="rate, %")


def _gaps(axes: Axes, found: _Gathered) -> None:
    names = sorted(found.gaps)
    for i, name in enumerate(names):
        spans = [(start, max(end - start, 2e-3 * float(found.edges_s[-1]))) for start, end in found.gaps[name]]
        axes.broken_barh(spans, (i - 0.35, 0.7), color="#CC3311")
    if names:
        axes.set_yticks(
            range(len(names)), [f"{found.name(name)} ({len(found.gaps[name])})" for name in names], fontsize=8
        )
        axes.set_ylim(-0.6, len(names) - 0.4)
    else:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no gaps", transform=axes.transAxes, ha="center", va="center", color="#444444")
    label(axes, y="gaps")


def _ages(axes: Axes, found: _Gathered) -> None:
    middle = 0.5 * (found.edges_s[1:] + found.edges_s[:-1])
    largest = 1.0
    for look, stream in zip(cycle(_LOOKS), found.streams.values(), strict=False):
        axes.plot(middle, 1e3 * stream.age_s, lw=1.4, **look)
        if np.isfinite(stream.age_s).any():
            largest = max(largest, 1e3 * float(np.nanmax(stream.age_s)))
    axes.set_ylim(0, 1.1 * largest)
    label(axes, y="age, ms")


def _losses(axes: Axes, found: _Gathered, origin_ns: int) -> None:
    """Draw the counted losses by device; samples that a sensor marked invalid did arrive and are left out."""
    time = np.array([(report["time_ns"] - origin_ns) * 1e-9 for report in found.reports])
    devices = sorted({str(name) for report in found.reports for name in report.get("losses", {})})
    most, whole = 0, list[str]()
    for spare, device in enumerate(devices):
        counts = [
            sum(int(n) for kind, n in report.get("losses", {}).get(device, {}).items() if kind not in _UNUSABLE)
            for report in found.reports
        ]
        most = max([most, *counts])
        if not any(counts):
            whole.append(found.name(device))
            continue
        look = found.look(device, spare)
        axes.step(time, counts, where="post", lw=1.0, marker="o", ms=3, label=f"lost, {found.name(device)}", **look)
    axes.set_ylim(-0.04 * max(most, 1), 1.5 * max(most, 1))
    if not most:
        axes.set_yticks([0])
    if whole:
        axes.text(
            0.006,
            0.96,
            f"nothing lost: {', '.join(whole)}",
            transform=axes.transAxes,
            fontsize=8,
            va="top",
            color="#444444",
            parse_math=False,
        )
    label(axes, y="lost, counts")


def _disk(axes: Axes, found: _Gathered, origin_ns: int) -> None:
    rows = [report for report in found.reports if isinstance(report.get("disk"), Mapping)]
    time = np.array([(report["time_ns"] - origin_ns) * 1e-9 for report in rows])
    waiting = np.array([float(report["disk"].get("backlog_bytes", np.nan)) for report in rows])
    if rows:
        axes.plot(time, 1e-3 * waiting, color="#444444", lw=1.4)
        axes.set_ylim(0, 1.15e-3 * max(float(np.nanmax(waiting)), 1.0))
    else:
        axes.text(
            0.5,
            0.5,
            "no health reports in this log",
            transform=axes.transAxes,
            ha="center",
            va="center",
            color="#444444",
        )
        axes.set_yticks([])
    label(axes, y="for disk, kB")
