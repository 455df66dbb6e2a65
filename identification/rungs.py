"""Rungs of the model ladders: terms that a fit adds to its smallest model if the data require them.

Every fit decides by itself. A rung that is held back is never added. The part of the data that it would have explained
stays in the residuals, widens the intervals or leads to the rejection of the fit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal, get_args

Rung = Literal[
    "lines",
    "spectrum",
    "wander",
    "amplitude",
    "second-mode",
    "slow-roll",
    "ripple",
    "clocks",
    "friction",
    "drag",
    "open-masses",
]

RUNGS: Mapping[Rung, str] = {
    "lines": "steady lines, such as mains hum, and other decaying oscillations in a ring-down",
    "spectrum": "noise weighed by its spectrum in a ring-down",
    "wander": "drift of a sensor beyond a straight line; shortening of a ring-down because of it",
    "amplitude": "stiffness and damping of the suspension that depend on the amplitude",
    "second-mode": "a second mode in a lone sensor",
    "slow-roll": "run-out, a bent shaft, and a motion that grows with the square of the speed in run-ups",
    "ripple": "speed ripple between the index marks of a run-up",
    "clocks": "a time offset between sensors and rotor phase, for records of a single device",
    "friction": "dry friction of the pendulums in spin-downs and releases",
    "drag": "a torque on the pendulums that is proportional to the square of the speed",
    "open-masses": "the pendulums' masses and lengths in releases, within their stated uncertainty",
}
"""Rung → its description, for help texts and documentation."""


def held_back(names: Collection[str]) -> frozenset[Rung]:
    """Return the rungs with the given names.

    Raises:
        ValueError: a name is not a rung.
    """
    found: frozenset[Rung] = frozenset(rung for rung in get_args(Rung) if rung in names)
    if unknown := sorted(set(names) - set(RUNGS)):
        raise ValueError(f"rungs: expected some of {', '.join(RUNGS)}, got {', '.join(unknown)}")
    return found
