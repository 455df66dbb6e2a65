"""Steady states of the model over the speed."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.rig_model import RigModel
from dynamics import SteadyState, steady_states
from dynamics.errors import DynamicsError
from rig_basics.arrays import Array

_log = logging.getLogger(__name__)

_ACCURACY = 1e-6


@dataclass(frozen=True)
class SweptState:
    """One steady state at one speed."""

    speed_rad_s: float
    state: SteadyState


def steady_sweep(
    model: RigModel, speeds_rad_s: Array, progress: Callable[[float], None] | None = None
) -> list[SweptState]:
    """Return all steady states at each speed; speeds at which the search fails are left out.

    Args:
        model: model.
        speeds_rad_s: speeds, shape (n,).
        progress: called with the completed share.
    """
    found: list[SweptState] = []
    for i, speed in enumerate(speeds_rad_s.tolist()):
        try:
            found += [SweptState(speed, state) for state in steady_states(model.physics, speed, _ACCURACY)]
        except (DynamicsError, np.linalg.LinAlgError) as error:
            _log.info("sweep at %.6g rad/s: no states: %s", speed, error)
            continue
        if progress is not None:
            progress((i + 1) / len(speeds_rad_s))
    return found
