"""What is on the rig in one run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.speed_history import SpeedHistory


@dataclass(frozen=True)
class Scene:
    """One run: how the rotor turns, which pendulums are free, where everything starts.

    Attributes:
        history: the rotor's phase over time.
        released: whether pendulum A, B swings freely; a locked one is a fixed mass at its start angle.
        start: state at the first instant, shape (8,): x, y (m), θ3, θ4 (rad, relative to the rotor), and
            their rates (m/s, rad/s). None: locked orbit at the start speed with the pendulums at 0 and π.
    """

    history: SpeedHistory
    released: tuple[bool, bool] = (True, True)
    start: np.ndarray | None = None
