"""Effect of a bow at a point: the stable states of the model with the bow against those of the model without it."""

from __future__ import annotations

import cmath
import logging
import math
from dataclasses import replace

import numpy as np

from analysis.stable_states import stable_states
from dynamics import RotorParameters, SteadyState
from dynamics.errors import DynamicsError

_log = logging.getLogger(__name__)

_MAX_RATE_RATIO = 0.7  # rate of approach with the bow over that without it; above, the bow is not reported as a reason


def blamed_on_bow(physics: RotorParameters, speed_rad_s: float, state: SteadyState | None) -> str:
    """Describe in a sentence how a straight shaft would behave differently; empty if it would behave alike.

    Args:
        physics: parameters of the rotor with its bow.
        speed_rad_s: speed of the point.
        state: stable state predicted with the bow; None if the model has no stable state.
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
    if not 0 < own < _MAX_RATE_RATIO * other:
        return ""
    return f"{bow} makes the approach slow: {own:.2g} /s by the model, with a straight shaft {other:.2g} /s"


def _straight(physics: RotorParameters, speed_rad_s: float) -> SteadyState | None:
    """Return a stable state with a straight shaft; None if it does not exist or the shaft has no bow."""
    if physics.bow_m == 0:
        return None
    try:
        states = stable_states(replace(physics, bow_x_m=0.0, bow_y_m=0.0), speed_rad_s)
    except (DynamicsError, np.linalg.LinAlgError) as error:
        _log.info("straight shaft at %.6g rad/s: no state to compare with: %s", speed_rad_s, error)
        return None
    return next(iter(states), None)


def _rate(state: SteadyState, speed_rad_s: float) -> float:
    """Return the rate of the slowest approach to a state, 1/s."""
    return -math.log(state.multiplier_max) * speed_rad_s / (2 * math.pi)
