# pyright: strict
"""The rungs of the model ladders: what a fit takes beside its smallest model where the data ask for it.

Every fit climbs by itself. A rung that is held back is never taken: what it would have explained stays in the
residuals, widens the intervals or refuses the fit.
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
    "lines": "steady lines, as of the mains, and what else rings, beside a ring-down",
    "spectrum": "noise weighed by its spectrum in a ring-down",
    "wander": "drift of a sensor beyond a straight line; a ring-down cut short for it",
    "amplitude": "stiffness and damping of the suspension that depend on the amplitude",
    "second-mode": "a second mode in a lone sensor",
    "slow-roll": "run-out of the measured surface and a bent shaft in run-ups",
    "ripple": "speed ripple between the index marks of a run-up",
    "clocks": "sensors whose clocks are apart from the phase's, where all were recorded by one",
    "friction": "dry friction of the pendulums in spin-downs and releases",
    "drag": "a torque on the pendulums that goes with the square of the speed",
    "open-masses": "the pendulums' masses and lengths in releases, within their stated uncertainty",
}
"""Rung → what it holds, for help and docs."""


def held_back(names: Collection[str]) -> frozenset[Rung]:
    """The rungs of these names.

    Raises:
        ValueError: there is no such rung.
    """
    found: frozenset[Rung] = frozenset(rung for rung in get_args(Rung) if rung in names)
    if unknown := sorted(set(names) - set(RUNGS)):
        raise ValueError(f"rungs: expected some of {', '.join(RUNGS)}, got {', '.join(unknown)}")
    return found
