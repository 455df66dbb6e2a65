"""Simulation of the rig: parameters, compiled equations of motion, steady states and stability.

The package reads no files and opens no devices.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynamics.equations.balancing import GravityDisk, balanced_angles, balancing_region, gravity_disk
    from dynamics.equations.model import ChosenModel, choose_model
    from dynamics.equations.parameters import Pendulum, RotorParameters
    from dynamics.equations.scene import Scene
    from dynamics.equations.speed_history import SpeedHistory
    from dynamics.motions.batch import BatchMotion, simulate_batch
    from dynamics.motions.integrate import Motion, locked_orbit, simulate
    from dynamics.stability.stability_map import StabilityMap, stability_map
    from dynamics.steady.branches import SteadyBranches, steady_branches
    from dynamics.steady.outcome import ReleaseOutcome, release_outcome
    from dynamics.steady.steady_motions import multipliers, steady_states
    from dynamics.steady.steady_state import SteadyState

_MODULE_OF = {  # imported at the first access, so that reading a rig file does not load the compiler
    "BatchMotion": "dynamics.motions.batch",
    "GravityDisk": "dynamics.equations.balancing",
    "Model": "dynamics.equations.model",
    "Motion": "dynamics.motions.integrate",
    "Pendulum": "dynamics.equations.parameters",
    "ReleaseOutcome": "dynamics.steady.outcome",
    "RotorParameters": "dynamics.equations.parameters",
    "Scene": "dynamics.equations.scene",
    "SpeedHistory": "dynamics.equations.speed_history",
    "StabilityMap": "dynamics.stability.stability_map",
    "SteadyBranches": "dynamics.steady.branches",
    "SteadyState": "dynamics.steady.steady_state",
    "balanced_angles": "dynamics.equations.balancing",
    "balancing_region": "dynamics.equations.balancing",
    "choose_model": "dynamics.equations.model",
    "gravity_disk": "dynamics.equations.balancing",
    "locked_orbit": "dynamics.motions.integrate",
    "multipliers": "dynamics.steady.steady_motions",
    "release_outcome": "dynamics.steady.outcome",
    "simulate": "dynamics.motions.integrate",
    "simulate_batch": "dynamics.motions.batch",
    "stability_map": "dynamics.stability.stability_map",
    "steady_branches": "dynamics.steady.branches",
    "steady_states": "dynamics.steady.steady_motions",
}

__all__ = [
    "BatchMotion",
    "ChosenModel",
    "GravityDisk",
    "Motion",
    "Pendulum",
    "ReleaseOutcome",
    "RotorParameters",
    "Scene",
    "SpeedHistory",
    "StabilityMap",
    "SteadyBranches",
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
    "stability_map",
    "steady_branches",
    "steady_states",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its module at the first access."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    """Return the public names, also those that are not loaded yet."""
    return sorted(__all__)
