"""Steady states at one speed: pendulum poses, orbits of the disk centre, multipliers on the unit circle."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from analysis.figures.style import GOOD, GREY, MODEL, drawing, label
from dynamics import RotorParameters, SteadyState
from dynamics.steady.outcome import ReleaseOutcome

Array = NDArray[np.floating]

_STYLES = ("-", "--", ":", "-.")
_COLOURS = {"stable": GOOD, "unstable": MODEL, "undecided": GREY}


def draw_steady_states(
    physics: RotorParameters, states: Sequence[SteadyState], title: str, outcome: ReleaseOutcome | None = None
) -> Figure:
    """Draw all steady states at a speed.

    Args:
        physics: parameters of the rig.
        states: result of dynamics.steady_states.
        title: title of the figure.
        outcome: end of a release; its state is marked.
    Returns:
        Above: pose of each state from above in the rotor's frame (imbalance to the right). Below left: orbits of the
        disk centre in the space-fixed frame. Below right: multipliers over one revolution and the unit circle.
    """
    shown = _without_mirror_images(states, None if outcome is None else outcome.reached)
    with drawing(10.4, 7.2) as figure:
        outer = figure.add_gridspec(
            2, 2, height_ratios=(0.75, 1), left=0.07, right=0.98, top=0.86, bottom=0.08, hspace=0.22, wspace=0.2
        )
        poses = outer[0, :].subgridspec(1, max(len(shown), 1), wspace=0.05)
        for i, state in enumerate(shown):
            _pose(figure.add_subplot(poses[i]), physics, state, reached=_is_reached(state, outcome))
        _orbits(figure.add_subplot(outer[1, 0]), shown)
        _multipliers(figure.add_subplot(outer[1, 1]), shown)
        figure.suptitle(title, x=0.03, y=0.975, ha="left", fontsize=11, parse_math=False)
        if not shown:
            figure.text(0.5, 0.7, "no steady motion at this speed", ha="center")
        return figure


def _is_reached(state: SteadyState, outcome: ReleaseOutcome | None) -> bool:
    """Whether a release ends in this state, not in its mirror image."""
    return outcome is not None and outcome.reached is state


def _without_mirror_images(states: Sequence[SteadyState], reached: SteadyState | None) -> list[SteadyState]:
    """Return one of each pair of balanced mirror images, preferably the reached one, and all other states."""
    shown: list[SteadyState] = []
    for state in sorted(states, key=lambda s: s is not reached):
        if state.type == "I" and any(s.type == "I" for s in shown):
            continue
        shown.append(state)
    return shown


def _pose(axes: Axes, physics: RotorParameters, state: SteadyState, *, reached: bool) -> None:
    """Draw imbalance (black, right) and pendulums A, B in the rotor's frame."""
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_xlim(-1.35, 1.35)
    axes.set_ylim(-1.35, 1.35)
    axes.add_patch(Circle((0, 0), 1.0, fill=False, ec="#bbbbbb", lw=1))
    axes.plot([0.75], [0.0], marker="s", ms=6, color="black")
    largest = max(physics.a.first_moment_kg_m, physics.b.first_moment_kg_m) or 1.0
    pair = zip("AB", state.theta_rad, (physics.a, physics.b), ("#0072B2", "#56B4E9"), strict=True)
    for name, theta, pendulum, colour in pair:
        if not pendulum.present:
            continue
        reach = 1.0 if name == "A" else 0.86  # keeps both visible if their angles are equal
        x, y = reach * math.cos(theta), reach * math.sin(theta)
        axes.plot([0, x], [0, y], color=colour, lw=1.5)
        size = 5 + 5 * math.sqrt(pendulum.first_moment_kg_m / largest)
        axes.plot([x], [y], marker="o", ms=size, color=colour)
        at = 1.26 if name == "A" else 0.55
        axes.text(at * math.cos(theta), at * math.sin(theta), name, fontsize=8, ha="center", va="center")
    axes.set_title(
        f"{state.type}, {state.stability}\nθ3 {math.degrees(state.theta_rad[0]):.1f}°, "
        f"θ4 {math.degrees(state.theta_rad[1]):.1f}°\n{1e3 * state.amplitude_m:.3g} mm",
        fontsize=8,
        color=_COLOURS[state.stability],
        loc="center",
        parse_math=False,
    )

    if reached:
        axes.text(0, -1.45, "a release ends here", fontsize=8, ha="center", va="top", color=_COLOURS[state.stability])


def _smooth(values: Array) -> Array:
    """Return the trigonometric interpolant of a closed curve at 361 phases."""
    n = len(values)
    spectrum = np.fft.rfft(values) / n
    spectrum[1:] *= 2
    turn = np.exp(2j * np.pi * np.outer(np.linspace(0, 1, 361), np.arange(len(spectrum))))
    return (turn @ spectrum).real


def _orbits(axes: Axes, states: Sequence[SteadyState]) -> None:
    for i, state in enumerate(states):
        x, y = (1e3 * _smooth(state.states[:, c]) for c in (0, 1))
        name = f"{state.type} at {math.degrees(state.theta_rad[0]):.0f}°"
        still = state.amplitude_m < 1e-9
        axes.plot(
            x,
            y,
            marker="o" if still else "",
            markevery=400,
            ls="" if still else _STYLES[i % 4],
            color=_COLOURS[state.stability],
            label=name,
        )
    axes.set_aspect("equal", adjustable="datalim")
    label(axes, "x, mm", "y, mm", "orbit of the disk centre")
    if states:
        axes.legend(fontsize=7.5, loc="upper left")


def _multipliers(axes: Axes, states: Sequence[SteadyState]) -> None:
    turn = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(turn), np.sin(turn), color="#333333", lw=0.9)
    for i, state in enumerate(states):
        axes.plot(
            state.multipliers.real,
            state.multipliers.imag,
            ls="",
            marker="osD^v<>p"[i % 8],
            ms=5,
            mfc="none",
            mec=_COLOURS[state.stability],
            label=f"{state.type}: largest {state.multiplier_max:.4g}",
        )
    axes.set_aspect("equal", adjustable="datalim")
    label(axes, "real part", "imaginary part", "multipliers over one revolution")
    if states:
        axes.legend(fontsize=7.5, loc="lower left")
