"""One release in a new process: `python -m dynamics.bench.first_release`. Imports only what the release needs."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array
from dynamics.bench.release_start import ACCURACY, DURATION_S, release_start
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import simulate


def first_release() -> Array:
    """θ3 and θ4 at the end of the release, shape (2,)."""
    parameters, speed, start = release_start()
    scene = Scene(SpeedHistory.constant(speed), start=start)
    return simulate(parameters, scene, np.array([0.0, DURATION_S]), ACCURACY).state[-1, 2:4]


if __name__ == "__main__":
    print(*first_release())
