"""Time to the first result of a new process, imports and compilation included.

The processes are `dynamics.bench.first_release` and `first_release_heyoka`, which print θ3 and θ4 at the end of a 20 s
release of a nominal rig, and `rig predict`.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from dynamics.bench.records import Measurement

_ROOT = Path(__file__).parents[2]
PREDICT: Final = "predict"
"""Case of a whole `rig predict`."""
WARM: Final = "compiled before"
"""Setting of processes that find their compiled code."""
_CASES = {
    "release: simulate": ("-m", "dynamics.bench.first_release"),
    PREDICT: ("-m", "rig_cli.entry", "predict", "virtual", "--point", "B", "--json"),
}
_PEER = ("-m", "dynamics.bench.first_release_heyoka")
_TIMEOUT_S = 300


def process_rows(with_heyoka: bool, repeats: int) -> list[Measurement]:
    """Wall time of whole processes without and with a compilation cache, and of heyoka, which has no cache."""
    rows: list[Measurement] = []
    for case, arguments in _CASES.items():
        with tempfile.TemporaryDirectory() as empty:
            first = _seconds(arguments, empty)
            warm = statistics.median(_seconds(arguments, empty) for _ in range(repeats))
        rows.append(Measurement("process", case, "rig", "empty compilation cache", first, "process"))
        rows.append(Measurement("process", case, "rig", WARM, warm, "process", automatic=True))
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
