"""What the reference setting of tracking costs and what its smoother gains, on recorded logs.

uv run python -m benchmarks.tracking_settings LOG...
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import numpy as np

from daq.log import open_log
from daq.log.snapshot import rig_of
from daq.signals.run import Run, load_run
from dynamics.compiled_code import keep_compiled_code
from dynamics.equations.parameters import RotorParameters
from identification.tracking.replay import TrackedRun, track

_REPEATS = 3


def _timed(run: Run, physics: RotorParameters, setting: str) -> tuple[float, TrackedRun]:
    began = time.process_time()
    found = track(run, physics, setting="reference" if setting == "reference" else "fast")
    return time.process_time() - began, found


def print_costs(logs: Sequence[str]) -> None:
    """Processor time a second of record, medians of interleaved repeats; standard deviations smoothed / filtered."""
    for path in logs:
        with open_log(path) as log:
            physics = rig_of(log).physics
        run = load_run(path)
        _timed(run, physics, "fast")
        _timed(run, physics, "reference")
        pairs = [(_timed(run, physics, "fast"), _timed(run, physics, "reference")) for _ in range(_REPEATS)]
        fast, slow = (float(np.median([pair[i][0] for pair in pairs])) for i in (0, 1))
        found = pairs[0][1][1]
        smoothed = found.smoothed
        if smoothed is None:
            raise RuntimeError("the reference setting has no smoother")
        span = found.time_s[-1] - found.time_s[0]
        apart = np.max(np.abs(found.states - pairs[0][0][1].states) / found.state_std)
        rates = np.median(smoothed.state_std[:, 4:] / found.state_std[:, 4:])
        damping = np.median((smoothed.std / smoothed.values) / (found.std / found.values))
        print(
            f"{path}: {run.test}, {span:.1f} s: fast {1e3 * fast / span:.0f} ms a second of record, reference "
            f"{slow / span:.2f} s, {slow / fast:.0f} times; filtered states at most {apart:.0e} std apart; smoothed / "
            f"filtered std, median: rates {rates:.2f}, ln c {damping:.2f}"
        )


if __name__ == "__main__":
    keep_compiled_code()
    print_costs(sys.argv[1:])
