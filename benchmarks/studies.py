"""A map in tiles by dask's workers against the same by processes of this machine, and what the client does per tile.

    uv run python -m benchmarks.studies [--points 1000000] [--rounds 3] [--out FILE.json]

Two processes each, begun and warm before the clock; the rounds take turns. The client's own share is measured with
tiles that are there already: read from memory, sent through the scheduler, kept on the disk. From both follows what a
thousand cores would take for 10⁹ points.
"""

from __future__ import annotations

import argparse
import json
import math
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import distributed
import numpy as np

from analysis.maps.axes import MapAxis
from analysis.maps.question import MapQuestion, rig_source
from dynamics.compiled_code import keep_compiled_code
from studies.engines.dask_workers import DaskWorkers
from studies.engines.processes import Processes
from studies.maps import map_study
from studies.running import Engine
from studies.study import Study
from studies.tile_files import TileFolder

_WORKERS = 2
_LARGE_POINTS, _MANY_CORES = 1e9, 1000


def study_of(points: int, accuracy: float = 1e-8) -> Study:
    """A map of about so many points, four wide to three high."""
    rows = math.isqrt(round(points * 3 / 4))
    x = MapAxis(("speed_ratio",), 0.3, 7.0, round(points / rows))
    return map_study(
        MapQuestion(rig_source("virtual"), x, MapAxis(("stiffness_ratio",), 1.0, 16.0, rows), accuracy=accuracy)
    )


@contextmanager
def dask_workers() -> Iterator[str]:
    """The address of a scheduler with two workers of one thread, each a process."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = int(one.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"

    def begin(*arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard", "--host", "127.0.0.1"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    started = [begin("scheduler", "--port", str(port))]
    started += [begin("worker", address, "--nthreads", "1") for _ in range(_WORKERS)]
    try:
        with distributed.Client(address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(_WORKERS, timeout=60)
        yield address
    finally:
        for process in started:
            process.kill()
            process.wait()


def seconds_of(engine: Engine, study: Study, place: Path) -> tuple[float, dict[str, bytes]]:
    """Wall time of a study by an engine that is warm, and its files."""
    folder = TileFolder(place, study)
    started = time.perf_counter()
    for tile, content in engine.answers(study, list(range(study.tiles))):
        folder.keep(tile, content)
    seconds = time.perf_counter() - started
    files = {path.name: path.read_bytes() for path in place.glob("*.npz")}
    folder.remove()
    return seconds, files


def client_seconds_per_tile(address: str, content: bytes, tiles: int) -> float:
    """Client time of a tile, s: through the scheduler and onto the disk, without the work itself."""
    with tempfile.TemporaryDirectory() as place, distributed.Client(address, set_as_default=False) as client:
        folder = TileFolder(Path(place), study_of(10_000_000))
        held = client.scatter(content, broadcast=True)
        futures = [client.submit(_same, held, number, pure=False) for number in range(tiles)]
        started = time.perf_counter()
        for number, future in enumerate(futures):
            folder.keep(number, future.result())
            future.release()
        return (time.perf_counter() - started) / tiles


def largest_memory_bytes(address: str) -> list[int]:
    """What each worker of a scheduler has held at most since it began (Linux)."""
    with distributed.Client(address, set_as_default=False) as client:
        return sorted(client.run(_peak).values())


def _peak() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])


def _same(content: bytes, number: int) -> bytes:
    return content + bytes([number % 256])


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    keep_compiled_code()
    study = study_of(given.points)
    seconds: dict[str, list[float]] = {"processes": [], "dask": []}
    files: list[dict[str, bytes]] = []
    with (
        dask_workers() as address,
        tempfile.TemporaryDirectory() as place,
        Processes(_WORKERS, print) as processes,
        DaskWorkers(address, print) as workers,
    ):
        engines: dict[str, Engine] = {"processes": processes, "dask": workers}
        for engine in engines.values():  # both processes compile, or load what is compiled
            for accuracy in np.geomspace(1e-7, 1e-6, 4):
                seconds_of(engine, study_of(20_000, float(accuracy)), Path(place))
            seconds_of(engine, study, Path(place))
        for _ in range(given.rounds):
            for name, engine in engines.items():
                taken, found = seconds_of(engine, study, Path(place))
                seconds[name].append(taken)
                files.append(found)
        memory = largest_memory_bytes(address)
        per_tile = client_seconds_per_tile(address, next(iter(files[0].values())), 50)
    ratio = statistics.median(b / a for a, b in zip(seconds["processes"], seconds["dask"], strict=True))
    result = _result(study, seconds, ratio, per_tile, files)
    result["largest_memory_of_workers_MB"] = [round(bytes_ / 1e6) for bytes_ in memory]
    for name, value in result.items():
        print(f"{name}: {value}")
    if given.out:
        given.out.write_text(json.dumps(result, indent=1))


def _result(
    study: Study, seconds: dict[str, list[float]], ratio: float, per_tile: float, files: list[dict[str, bytes]]
) -> dict[str, Any]:
    asked = json.loads(study.text)
    points = asked["x"]["count"] * asked["y"]["count"]
    core_seconds = _WORKERS * statistics.median(seconds["dask"]) / points
    size = sum(map(len, files[0].values())) / points
    many = _LARGE_POINTS * study.tiles / points
    return {
        "points": points,
        "tiles": study.tiles,
        "processes_s": [round(s, 3) for s in seconds["processes"]],
        "dask_s": [round(s, 3) for s in seconds["dask"]],
        "dask_over_processes": round(ratio, 4),
        "same_bytes": all(found == files[0] for found in files),
        "core_microseconds_per_point": round(1e6 * core_seconds, 3),
        "bytes_per_point": round(size, 2),
        "client_ms_per_tile": round(1e3 * per_tile, 2),
        "1e9_points_on_1000_cores": {
            "tiles": round(many),
            "work_s": round(_LARGE_POINTS * core_seconds / _MANY_CORES, 1),
            "client_s": round(many * per_tile, 1),
            "gigabytes": round(_LARGE_POINTS * size / 1e9, 1),
        },
    }


if __name__ == "__main__":
    main()
