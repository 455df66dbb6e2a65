"""Ends of many releases, and slip rates of pendulums that do not settle."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dynamics import ReleaseOutcome, release_outcome, steady_states
from dynamics.equations.parameters import RotorParameters
from reproduction.items.pendulum_sets import FROM_RAD
from reproduction.results import Verdict
from rig_basics.arrays import Array
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool

SLIPPING, TURNING, SWINGING = "slipping", "turning, no regular slip", "swinging"
MOST_REVOLUTIONS = 8000
_TURNED = 6.0  # turns against the rotor from which unsettled pendulums count as turning
MARKS = {
    "I": ("o", "#00604a", 4.0),
    "II": ("^", "#8a3b00", 4.0),
    "III": ("s", "#003d66", 4.0),
    SLIPPING: ("*", "white", 9.0),
    TURNING: ("P", "#ffd54d", 6.5),
    SWINGING: ("D", "#ffd54d", 5.0),
    "not settled": ("X", "#e05050", 6.0),
}


@dataclass(frozen=True)
class Ends:
    """Ends of releases.

    Attributes:
        name: type reached, SLIPPING (a stable slipping motion), TURNING (continues to turn without a regular slip),
            SWINGING (if no state is stable) or "not settled"; shape (n,).
        turns: of A and B against the rotor, per revolution, shape (n, 2).
    """

    name: NDArray[np.str_]
    turns: Array


def released(rigs: Sequence[RotorParameters], speeds_rad_s: Sequence[float], progress: Callable[[float], None]) -> Ends:
    """Follow releases from 0° and 180° within the play until their end is known or for MOST_REVOLUTIONS."""

    def one(i: int) -> tuple[ReleaseOutcome, bool]:
        states = steady_states(rigs[i], speeds_rad_s[i], 1e-6)
        end = release_outcome(rigs[i], speeds_rad_s[i], FROM_RAD, states=states, most_revolutions=MOST_REVOLUTIONS)
        return end, any(state.stable for state in states)

    found, names = list[ReleaseOutcome](), list[str]()
    with ThreadPool(os.cpu_count() or 1) as pool:
        for outcome, has_stable_state in pool.map(one, range(len(rigs))):
            found.append(outcome)
            names.append(_name(outcome, has_stable_state))
            progress(len(found) / len(rigs))
    turns = np.array(
        [o.slipping.turns_per_revolution if o.slipping else np.array(o.slip_turns) / o.revolutions for o in found],
        np.float64,
    )
    return Ends(np.array(names), turns)


def _name(outcome: ReleaseOutcome, has_stable_state: bool) -> str:
    if outcome.state != "not settled":
        return outcome.state
    if max(abs(turns) for turns in outcome.slip_turns) > _TURNED:
        return TURNING
    return outcome.state if has_stable_state else SWINGING


def slip_verdict(ends: Ends, bare: NDArray[np.bool_]) -> Verdict:
    """Return whether all releases without a stable state slip: in part if the others swing."""
    rest = bare & ~turning(ends)
    return "holds" if not rest.any() else "holds in part" if np.all(ends.name[rest] == SWINGING) else "does not hold"


def ends_counted(ends: Ends, bare: NDArray[np.bool_]) -> str:
    """Return the ends of releases without a stable state as text."""
    slip, turn, swing = (int(np.sum(bare & (ends.name == name))) for name in (SLIPPING, TURNING, SWINGING))
    text = f"{slip} of {number_of(int(bare.sum()), 'release')} there come to a stable slipping motion"
    text += f", {turn} turn on without a regular slip" if turn else ""
    return text + (f", {swing} go on swinging, for {MOST_REVOLUTIONS} revolutions at least" if swing else "")


def draw_ends(axes: Axes, x: Array, y: Array, ends: Ends) -> None:
    """Draw a mark for each release."""
    for name, (marker, colour, size) in MARKS.items():
        own = ends.name == name
        if own.any():
            axes.plot(
                x[own],
                y[own],
                marker,
                color=colour,
                mec="black",
                mew=0.5,
                ms=size,
                ls="",
                label=f"release: {name if len(name) > 3 else 'ends in ' + name}",
            )


def turning(ends: Ends) -> NDArray[np.bool_]:
    """Return which releases end without settling at a place."""
    return (ends.name == SLIPPING) | (ends.name == TURNING)


def slip_rates_text(ends: Ends, among: NDArray[np.bool_], speed_ratio: Array) -> str:
    """Return the slip rates of some releases as text."""
    own = among & turning(ends)
    if not own.any():
        return "none slips"
    fastest = np.max(np.abs(ends.turns[own]), axis=1)
    space = (speed_ratio[own][:, None] * (1 + ends.turns[own])).min(axis=1)
    alone = int(np.sum(np.min(np.abs(ends.turns[own]), axis=1) < 1e-4))
    return (
        f"the faster pendulum makes {fastest.min():.4f} … {fastest.max():.3f} turns per revolution against the rotor "
        f"(in space it turns at {space.min():.2f} … {space.max():.2f} ω_n)"
        + (f"; at {alone} only one slips" if alone else "")
    )
