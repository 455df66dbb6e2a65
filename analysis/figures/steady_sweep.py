# pyright: strict
"""The model's steady states along the speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.rig_model import RigModel
from dynamics import SteadyState, steady_states
from dynamics.errors import DynamicsError

Array = NDArray[np.float64]

_ACCURACY = 1e-6


@dataclass(frozen=True)
class SweptState:
    """One steady state at one speed."""

    speed_rad_s: float
    state: SteadyState


def steady_sweep(model: RigModel, speeds_rad_s: Array, tell: Callable[[float], None] | None = None) -> list[SweptState]:
    """All steady states at each speed; a speed at which the search fails has none.

    Args:
        speeds_rad_s: shape (n,).
        tell: told the share done.
    """
    found: list[SweptState] = []
    for i, speed in enumerate(speeds_rad_s.tolist()):
        try:
            found += [SweptState(speed, state) for state in steady_states(model.physics, speed, _ACCURACY)]
        except (DynamicsError, np.linalg.LinAlgError):
            continue
        if tell is not None:
            tell((i + 1) / len(speeds_rad_s))
    return found
