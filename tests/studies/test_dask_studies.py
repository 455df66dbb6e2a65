"""The same map on dask with workers, scheduler and client killed in turn: nothing is lost but what was in hand."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import distributed
import numpy as np
import pytest

from studies.engines.dask_workers import DaskWorkers
from studies.engines.threads import Threads
from studies.errors import EngineLost, OtherSoftware
from studies.running import run_study
from studies.study import Study
from studies.tile_files import TileFolder
from tests.effort import thorough
from tests.studies.small_maps import DaskProcesses, X, Y, dask_processes, small_map

pytestmark = pytest.mark.xdist_group("dask")


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The tiles as this process works them out."""
    folder = TileFolder(tmp_path_factory.mktemp("local"), small_map())
    run_study(folder, Threads())
    return {path.name: path.read_bytes() for path in folder.path.glob("*.npz")}


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    """A scheduler and two workers; a test that kills one starts another."""
    with dask_processes(tmp_path_factory.mktemp("output"), free_port()) as started:
        yield started


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Counted(DaskWorkers):
    """Which tiles were given out, each time."""

    given: list[int]

    def _submit(self, study: Study, tile: int, deaths: int):
        self.given = [*getattr(self, "given", []), tile]
        return super()._submit(study, tile, deaths)


def contents(folder: TileFolder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.path.glob("*.npz")}


def run_and(
    processes: DaskProcesses, folder: TileFolder, deed: Callable[[], None], messages: list[str]
) -> tuple[Counted, set[int]]:
    """Work a study out, and do something when two tiles are done; the engine, and the tiles done by then."""
    engine, done_then = Counted(processes.address, messages.append), set[int]()

    def progress(done: int, total: int) -> None:
        if done == 2:
            done_then.update(folder.finished())
            deed()

    run_study(folder, engine, progress)
    return engine, done_then


def test_dask_gives_the_bytes_of_this_process(
    processes: DaskProcesses, expected: dict[str, bytes], tmp_path: Path
) -> None:
    folder, messages = TileFolder(tmp_path / "tiles", small_map()), list[str]()
    engine, _ = run_and(processes, folder, lambda: None, messages)
    assert contents(folder) == expected
    assert sorted(engine.given) == list(range(6))
    assert messages == []


def test_a_killed_worker_costs_its_tiles_in_hand(
    processes: DaskProcesses, expected: dict[str, bytes], tmp_path: Path
) -> None:
    folder = TileFolder(tmp_path / "tiles", small_map())
    engine, _ = run_and(processes, folder, processes.replace_worker, [])
    assert contents(folder) == expected
    assert sorted(engine.given) == list(range(6)), "dask itself gives a dead worker's tiles to others"


def test_a_killed_scheduler_costs_the_tiles_in_hand(
    processes: DaskProcesses, expected: dict[str, bytes], tmp_path: Path
) -> None:
    folder, messages = TileFolder(tmp_path / "tiles", small_map()), list[str]()
    engine, done_then = run_and(processes, folder, processes.restart_scheduler, messages)
    assert contents(folder) == expected
    assert all(engine.given.count(tile) == 1 for tile in done_then)
    assert "is gone; what is done is kept" in messages[0]


@pytest.mark.lengthy
def test_a_killed_client_loses_nothing_that_is_done(
    processes: DaskProcesses, expected: dict[str, bytes], tmp_path: Path
) -> None:
    output = tmp_path / "map.npz"
    command = [
        sys.executable,
        "-m",
        "rig_cli.main",
        "map",
        "virtual",
        "--x",
        X,
        "--y",
        Y,
        "--scheduler",
        processes.address,
        "-o",
        str(output),
    ]
    tiles = Path(f"{output}.tiles")
    client = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    until(lambda: len(list(tiles.glob("*.npz"))) >= 2, client)
    client.send_signal(signal.SIGKILL)
    client.communicate()
    before = {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in tiles.glob("*.npz")}
    assert 2 <= len(before) < 6
    assert {path.name: path.read_bytes() for path in before}.items() <= expected.items()
    again = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    until(lambda: len(list(tiles.glob("*.npz"))) >= 5 or output.exists(), again)
    untouched = {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in before if path.exists()}
    assert untouched.items() <= before.items()
    _, printed = again.communicate(timeout=120)
    assert again.returncode == 0
    assert f"{len(before)} of 6 tiles are in" in printed.decode()
    alone = tmp_path / "alone.npz"
    subprocess.run([*command[:-3], "local:1", "-o", str(alone)], check=True, capture_output=True)
    with np.load(output) as found, np.load(alone) as here:
        for name in ("multiplier_max", "error_estimate", "decay_rate_per_s"):
            np.testing.assert_array_equal(found[name], here[name])
    assert not tiles.exists()


def until(happened: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    """Wait for something that a process does."""
    began = time.monotonic()
    while not happened():
        assert process.poll() is None or happened(), process.communicate()[1].decode()
        assert time.monotonic() - began < 180
        time.sleep(0.02)


@thorough
def test_workers_that_all_begin_cold_compile_once(expected: dict[str, bytes], tmp_path: Path) -> None:
    cold = tmp_path / "cache"
    cold.mkdir()
    (tmp_path / "output").mkdir()
    with dask_processes(tmp_path / "output", free_port(), {"NUMBA_CACHE_DIR": str(cold)}) as processes:
        folder, messages = TileFolder(tmp_path / "tiles", small_map()), list[str]()
        run_study(folder, DaskWorkers(processes.address, messages.append))
        with distributed.Client(processes.address, set_as_default=False) as client:
            counts = list(client.run(compilations).values())
    assert contents(folder) == expected
    assert sorted(sum(misses for misses, _ in [one]) > 0 for one in counts) == [False, True], counts


def compilations() -> tuple[int, int]:
    """How often the map's kernel was compiled here, and how often it was found compiled."""
    from dynamics.stability.floquet.lanes import half_turn_matrices

    stats = half_turn_matrices.stats
    return sum(stats.cache_misses.values()), sum(stats.cache_hits.values())


def test_workers_with_other_sources_are_refused(processes: DaskProcesses, tmp_path: Path) -> None:
    study = small_map()
    folder = TileFolder(tmp_path / "tiles", Study(study.kind, study.text, "0" * 16))
    with pytest.raises(OtherSoftware, match="start the workers again"):
        run_study(folder, DaskWorkers(processes.address, lambda text: None))


def test_a_missing_scheduler_is_reported_with_what_to_do(tmp_path: Path) -> None:
    folder, messages = TileFolder(tmp_path / "tiles", small_map()), list[str]()
    engine = DaskWorkers(f"tcp://127.0.0.1:{free_port()}", messages.append, patience_s=1.0)
    with pytest.raises(EngineLost, match="start one with `dask scheduler` and give the same command again"):
        run_study(folder, engine)
    assert "waiting for a scheduler" in messages[0]


def test_a_scheduler_without_workers_is_waited_for_only_so_long(tmp_path: Path) -> None:
    (tmp_path / "output").mkdir()
    with dask_processes(tmp_path / "output", free_port()) as processes:
        for worker in processes.workers:
            worker.kill()
            worker.wait()
        folder = TileFolder(tmp_path / "tiles", small_map())
        with pytest.raises(EngineLost, match="start some with `dask worker"):
            run_study(folder, DaskWorkers(processes.address, lambda text: None, patience_s=5.0))


@pytest.mark.parametrize(("address", "warned"), [("tcp://127.0.0.1:9", False), ("tcp://10.1.2.3:9", True)])
def test_an_open_port_elsewhere_is_warned_of(address: str, warned: bool) -> None:
    messages = list[str]()
    DaskWorkers(address, messages.append)
    assert [("not encrypted" in text) for text in messages] == [True] * warned
