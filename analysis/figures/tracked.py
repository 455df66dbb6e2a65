"""A tracked run over time: measured points with the estimate and its 95 % band, and both dampings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.log_marks import drawable
from analysis.figures.style import GOOD, GREY, MEASURED, MODEL, band, bins_for, drawing, label, outline
from rig_basics.arrays import Array

_TIMES = 1.96  # standard deviations of a 95 % interval
_MAX_POINTS = 4000  # of a measured signal drawn as points; more are drawn as a band
_UNTRUSTED = "#CC3311"


@dataclass(frozen=True)
class TrackedState:
    """One panel of the motion.

    Attributes:
        text: label of the axis with its unit.
        time_s, value, std: estimate, shape (n,), in the label's unit.
        measured_time_s, measured: readings, shape (m,), in the label's unit; empty without readings.
        turning_Hz: highest frequency of the signal, for the bins of its envelope.
    """

    text: str
    time_s: Array
    value: Array
    std: Array
    measured_time_s: Array
    measured: Array
    turning_Hz: float = 0.0


@dataclass(frozen=True)
class TrackedDamping:
    """One estimate of a damping over time: shapes (n,), N m s/rad; low and high are its 95 % interval."""

    name: str
    time_s: Array
    value: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class TrackedPicture:
    """Contents of the figure.

    Attributes:
        title: title of the figure.
        states: panels of the motion, in order.
        dampings: "c3", "c4" → estimates, the last one drawn on top.
        known: "c3", "c4" → value and 95 % interval for comparison; empty without.
        known_text: origin of these values.
        time_s, trusted: times, and whether the filter followed the readings, shape (n,).
    """

    title: str
    states: Sequence[TrackedState]
    dampings: Mapping[str, Sequence[TrackedDamping]]
    time_s: Array
    trusted: NDArray[np.bool_]
    known: Mapping[str, tuple[float, float, float]] = field(default_factory=dict[str, tuple[float, float, float]])
    known_text: str = ""


def draw_tracked(picture: TrackedPicture) -> Figure:
    """Draw one panel for each state and each damping over a common time axis."""
    rows = len(picture.states) + len(picture.dampings)
    with drawing(8.6, 1.4 + 1.3 * rows) as figure:
        height = figure.get_figheight()
        figure.subplots_adjust(left=0.105, right=0.985, top=1 - 0.85 / height, bottom=0.48 / height, hspace=0.18)
        panels: list[Axes] = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
        for axes, state in zip(panels, picture.states, strict=False):
            _draw_state(axes, state)
        for axes, (name, estimates) in zip(panels[len(picture.states) :], picture.dampings.items(), strict=True):
            _draw_damping(axes, name, estimates, picture)
        for axes in panels:
            _shade(axes, picture)
        panels[-1].set_xlim(float(picture.time_s[0]), float(picture.time_s[-1]))
        label(panels[-1], "time since the start of the run, s")
        shown = {
            text: handle for axes in panels for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(
            list(shown.values()),
            list(shown),
            loc="upper right",
            bbox_to_anchor=(0.99, 1 - 0.2 / height),
            ncols=3,
            fontsize=8,
        )
        figure.text(0.012, 1 - 0.14 / height, drawable(picture.title), fontsize=9.5, va="center", parse_math=False)
        figure.align_ylabels(panels)
        return figure


def _draw_state(axes: Axes, state: TrackedState) -> None:
    time, span = state.time_s, float(state.time_s[-1] - state.time_s[0])
    inside = (state.measured_time_s >= time[0]) & (state.measured_time_s <= time[-1]) & np.isfinite(state.measured)
    own_time, own = state.measured_time_s[inside], state.measured[inside]
    bins = bins_for(span * state.turning_Hz)
    if 0 < len(own) <= _MAX_POINTS:
        axes.plot(own_time, own, ".", color=MEASURED, ms=1.6, alpha=0.6, label="measured", rasterized=False)
    elif len(own):
        band(axes, own_time, own, MEASURED, "measured", bins=bins)
    reach = _TIMES * state.std
    axes.fill_between(
        time, state.value - reach, state.value + reach, color=MODEL, alpha=0.22, lw=0, label="95 % of the estimate"
    )
    outline(axes, time, state.value, MODEL, "estimated", bins=bins)
    everything = np.concatenate([state.value, own])
    low, high = float(np.min(everything)), float(np.max(everything))
    room = 0.08 * (high - low) or 1e-3
    axes.set_ylim(low - room, high + room)
    label(axes, y=state.text)


def _draw_damping(axes: Axes, name: str, estimates: Sequence[TrackedDamping], picture: TrackedPicture) -> None:
    colours = (MODEL, GOOD)
    for estimate, colour in zip(estimates, colours, strict=False):
        axes.fill_between(estimate.time_s, estimate.low, estimate.high, color=colour, alpha=0.2, lw=0)
        axes.plot(estimate.time_s, estimate.value, color=colour, label=estimate.name)
    limits = [np.array([e.value.min(), e.value.max(), e.low[-1], e.high[-1]]) for e in estimates]
    if name in picture.known:
        value, low, high = picture.known[name]
        axes.axhspan(low, high, color=GREY, alpha=0.2, lw=0)
        axes.axhline(value, color=GREY, lw=0.9, ls="--", label=picture.known_text)
        limits.append(np.array([low, high]))
    everything = np.concatenate(limits)
    axes.set_yscale("log")
    axes.set_ylim(float(everything.min()) / 1.6, float(everything.max()) * 1.6)
    label(axes, y=f"{name}, N m s/rad")


def _shade(axes: Axes, picture: TrackedPicture) -> None:
    """Shade times at which the filter does not follow the readings."""
    if np.all(picture.trusted):
        return
    low, high = axes.get_ylim()
    axes.fill_between(
        picture.time_s,
        low,
        high,
        where=(~picture.trusted).tolist(),
        step="post",
        color=_UNTRUSTED,
        alpha=0.07,
        lw=0,
        label="not to be trusted",
    )
    axes.set_ylim(low, high)
