"""The rig's motion: parameters, compiled equations, steady states, stability. Knows no files and no devices."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynamics.balancing import GravityDisk, balanced_angles, balancing_region, gravity_disk
    from dynamics.batch import BatchMotion, simulate_batch
    from dynamics.integrate import Motion, locked_orbit, simulate
    from dynamics.model import Model, choose_model
    from dynamics.outcome import ReleaseOutcome, release_outcome
    from dynamics.parameters import Pendulum, RotorParameters
    from dynamics.scene import Scene
    from dynamics.speed_history import SpeedHistory
    from dynamics.steady_motions import multipliers, steady_states
    from dynamics.steady_state import SteadyState

_HOME = {  # loaded when first used: a rig file can be read without waiting for the compiler
    "BatchMotion": "dynamics.batch",
    "GravityDisk": "dynamics.balancing",
    "Model": "dynamics.model",
    "Motion": "dynamics.integrate",
    "Pendulum": "dynamics.parameters",
    "ReleaseOutcome": "dynamics.outcome",
    "RotorParameters": "dynamics.parameters",
    "Scene": "dynamics.scene",
    "SpeedHistory": "dynamics.speed_history",
    "SteadyState": "dynamics.steady_state",
    "balanced_angles": "dynamics.balancing",
    "balancing_region": "dynamics.balancing",
    "choose_model": "dynamics.model",
    "gravity_disk": "dynamics.balancing",
    "locked_orbit": "dynamics.integrate",
    "multipliers": "dynamics.steady_motions",
    "release_outcome": "dynamics.outcome",
    "simulate": "dynamics.integrate",
    "simulate_batch": "dynamics.batch",
    "steady_states": "dynamics.steady_motions",
}

__all__ = [
    "BatchMotion",
    "GravityDisk",
    "Model",
    "Motion",
    "Pendulum",
    "ReleaseOutcome",
    "RotorParameters",
    "Scene",
    "SpeedHistory",
    "SteadyState",
    "balanced_angles",
    "balancing_region",
    "choose_model",
    "gravity_disk",
    "locked_orbit",
    "multipliers",
    "release_outcome",
    "simulate",
    "simulate_batch",
    "steady_states",
]


def __getattr__(name: str) -> Any:
    """A public name from its room."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
