# pyright: strict
"""Whether a bow is the reason for what happens at a point: the model with the bow beside the model without it."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np

from analysis.stable_states import stable_states
from dynamics import RotorParameters, SteadyState
from dynamics.errors import DynamicsError

_SLOWER = 0.7  # of a straight shaft's rate of approach: above, the bow does not count as a reason


def blamed_on_bow(physics: RotorParameters, speed_rad_s: float, state: SteadyState | None) -> str:
    """What a straight shaft would do otherwise, a sentence; empty where it would do the same.

    Args:
        physics: with the bow.
        speed_rad_s: of the point.
        state: the stable state that is predicted with the bow; None where there is none.
    """
    stable = _straight(physics, speed_rad_s)
    if stable is None:
        return ""
    bow = f"the bow of {1e6 * abs(physics.bow_m):.3g} µm at {math.degrees(cmath.phase(physics.bow_m)):.0f}°"
    if state is None:
        return f"{bow} is the reason: with a straight shaft state {stable.type} is stable here"
    if stable.type != state.type:
        return f"{bow} is the reason: with a straight shaft the stable state is {stable.type}"
    own, other = _rate(state, speed_rad_s), _rate(stable, speed_rad_s)
    if not 0 < own < _SLOWER * other:
        return ""
    return f"{bow} makes the approach slow: {own:.2g} /s by the model, with a straight shaft {other:.2g} /s"


def _straight(physics: RotorParameters, speed_rad_s: float) -> SteadyState | None:
    """A stable state of the rig with its shaft straight; None where it has none, or is straight."""
    if physics.bow_m == 0:
        return None
    try:
        states = stable_states(replace(physics, bow_x_m=0.0, bow_y_m=0.0), speed_rad_s)
    except (DynamicsError, np.linalg.LinAlgError):
        return None
    return next(iter(states), None)


def _rate(state: SteadyState, speed_rad_s: float) -> float:
    """Of the slowest approach to a state, 1/s."""
    return -math.log(state.multiplier_max) * speed_rad_s / (2 * math.pi)
