"""The rig's motion: parameters, compiled equations, steady states, stability. Knows no files and no devices."""

from dynamics.integrate import Motion, locked_orbit, simulate
from dynamics.parameters import Pendulum, RotorParameters
from dynamics.scene import Scene
from dynamics.speed_history import SpeedHistory
from dynamics.steady_states import SteadyState, multipliers, steady_states

__all__ = [
    "Motion",
    "Pendulum",
    "RotorParameters",
    "Scene",
    "SpeedHistory",
    "SteadyState",
    "locked_orbit",
    "multipliers",
    "simulate",
    "steady_states",
]
