"""Time to the first result of a new process, imports and compilation included.

    python -m dynamics.bench.fresh_process release | release-heyoka

Each prints θ3 and θ4 at the end of a 20 s release of the nominal rig.
"""

from __future__ import annotations

import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dynamics.arrays import Array
from dynamics.bench.records import Measurement

SPEED_RATIO, DURATION_S, ACCURACY = 1.6, 20.0, 1e-9
_ROOT = Path(__file__).parents[2]
_CASES = {
    "release: simulate": ("-m", "dynamics.bench.fresh_process", "release"),
    "predict": ("-m", "rig_cli.entry", "predict", "virtual", "--point", "B", "--json"),
}
_PEER = ("-m", "dynamics.bench.fresh_process", "release-heyoka")
_TIMEOUT_S = 300


def process_rows(with_heyoka: bool, repeats: int) -> list[Measurement]:
    """Wall time of whole processes without and with a compilation cache, and of heyoka, which has no cache."""
    rows: list[Measurement] = []
    for case, arguments in _CASES.items():
        with tempfile.TemporaryDirectory() as empty:
            first = _seconds(arguments, empty)
            warm = statistics.median(_seconds(arguments, empty) for _ in range(repeats))
        rows.append(Measurement("process", case, "rig", "empty compilation cache", first, "process"))
        rows.append(Measurement("process", case, "rig", "compiled before", warm, "process", automatic=True))
    if with_heyoka:
        taken = statistics.median(_seconds(_PEER) for _ in range(repeats))
        name = next(iter(_CASES))
        rows.append(Measurement("process", name, "heyoka", "compiles each time", taken, "process", peer=True))
    return rows


def _seconds(arguments: Sequence[str], cache: str | None = None) -> float:
    """Wall time of a Python process that compiles into its own directory, s.

    Raises:
        subprocess.CalledProcessError: the process failed.
    """
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join([str(_ROOT), *filter(None, [environment.get("PYTHONPATH")])])
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = cache
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], env=environment, check=True, capture_output=True, timeout=_TIMEOUT_S)
    return time.perf_counter() - start


def first_release(*, with_heyoka: bool) -> Array:
    """θ3 and θ4 at the end of the release, shape (2,). The function imports only what the release needs."""
    from dynamics.bench import heyoka_peer  # noqa: PLC0415 (the imports are part of the measured time)
    from dynamics.equations.parameters import Pendulum, RotorParameters  # noqa: PLC0415
    from dynamics.motions.locked_motion import locked_state  # noqa: PLC0415

    pendulum = Pendulum(0.075, 0.054, 0.001)
    k1 = 7.27 * (6 * math.pi) ** 2
    parameters = RotorParameters(7.0, 0.12, 0.02117, pendulum, pendulum, k1, 14.9 * k1, 0.02, 0.02)
    speed = parameters.speed_rad_s(SPEED_RATIO)
    start = locked_state(parameters, speed, 0.0, 2e-3, math.pi - 1e-3)
    if with_heyoka:
        integrator = heyoka_peer.integrator(parameters, speed, start, ACCURACY)
        integrator.propagate_until(DURATION_S)
        return integrator.state[2:4]
    from dynamics.equations.scene import Scene  # noqa: PLC0415
    from dynamics.equations.speed_history import SpeedHistory  # noqa: PLC0415
    from dynamics.motions.integrate import simulate  # noqa: PLC0415

    scene = Scene(SpeedHistory.constant(speed), start=start)
    return simulate(parameters, scene, np.array([0.0, DURATION_S]), ACCURACY).state[-1, 2:4]


if __name__ == "__main__":
    print(*first_release(with_heyoka=sys.argv[1] == "release-heyoka"))
