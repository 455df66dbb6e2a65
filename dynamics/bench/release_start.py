"""The release of a nominal rig that new processes simulate (`fresh_process`). Imports only what its start needs."""

from __future__ import annotations

import math
from typing import Final

from dynamics.arrays import Array
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.motions.locked_motion import locked_state

SPEED_RATIO: Final = 1.6
DURATION_S: Final = 20.0
ACCURACY: Final = 1e-9


def release_start() -> tuple[RotorParameters, float, Array]:
    """Parameters, speed in rad/s, and the state at the release, shape (8,)."""
    pendulum = Pendulum(0.075, 0.054, 0.001)
    k1 = 7.27 * (6 * math.pi) ** 2
    parameters = RotorParameters(7.0, 0.12, 0.02117, pendulum, pendulum, k1, 14.9 * k1, 0.02, 0.02)
    speed = parameters.speed_rad_s(SPEED_RATIO)
    return parameters, speed, locked_state(parameters, speed, 0.0, 2e-3, math.pi - 1e-3)
