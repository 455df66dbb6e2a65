"""A map that is a few tiles, for tests of studies."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import distributed

from analysis.maps.axes import MapAxis
from analysis.maps.question import MapQuestion, rig_source
from studies.maps import map_study
from studies.study import Study

X, Y = "speed_ratio=0.3:7:1000", "stiffness_ratio=1:16:420"


def small_map() -> Study:
    """Six tiles of half a second each."""
    x = MapAxis(("speed_ratio",), 0.3, 7.0, 1000)
    return map_study(MapQuestion(rig_source("virtual"), x, MapAxis(("stiffness_ratio",), 1.0, 16.0, 420)))


class DaskProcesses:
    """A scheduler and workers, each a process of its own that can be killed.

    Args:
        folder: folder of their output.
        port: of the scheduler, on the loopback interface.
        environment: environment of the workers, in addition to this process's.
    """

    def __init__(self, folder: Path, port: int, environment: dict[str, str] | None = None) -> None:
        self.address = f"tcp://127.0.0.1:{port}"
        self._folder, self._port = folder, port
        self._environment = {**os.environ, **(environment or {})}
        self._started = 0
        self.scheduler = self._begin("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        self.workers = [self.worker(), self.worker()]

    def _begin(self, *arguments: str) -> subprocess.Popen[bytes]:
        self._started += 1
        with (self._folder / f"{self._started}-{arguments[0]}.txt").open("wb") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments], stdout=output, stderr=output, env=self._environment
            )

    def worker(self) -> subprocess.Popen[bytes]:
        """One more worker of one thread."""
        return self._begin(
            "worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"
        )

    def restart_scheduler(self) -> None:
        """Kill it, and start it and the workers again at the same address."""
        self._kill(self.scheduler)
        for worker in self.workers:
            self._kill(worker)
        self.scheduler = self._begin("scheduler", "--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")
        self.workers = [self.worker(), self.worker()]

    def replace_worker(self) -> None:
        """Kill one and begin another."""
        self._kill(self.workers[0])
        self.workers[0] = self.worker()

    def close(self) -> None:
        """Kill all."""
        for process in (*self.workers, self.scheduler):
            self._kill(process)

    @staticmethod
    def _kill(process: subprocess.Popen[bytes]) -> None:
        process.kill()
        process.wait()


@contextmanager
def dask_processes(folder: Path, port: int, environment: dict[str, str] | None = None) -> Iterator[DaskProcesses]:
    """A scheduler and two workers, killed at the end."""
    processes = DaskProcesses(folder, port, environment)
    try:
        with distributed.Client(processes.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield processes
    finally:
        processes.close()
