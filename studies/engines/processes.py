"""Computation of tiles in processes of this machine by the standard library, without ports and installations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from typing import Any, Self

from rig_basics.texts import number_of
from rig_basics.worker_processes import worker_pool
from studies.errors import TileFailed
from studies.study import Study
from studies.worker import answer_tile

_TILES_PER_PROCESS = 2  # submitted tiles per process: one in work and one waiting
_MAX_DEATHS = 4  # of processes with the same tile, before the tile fails


class Processes:
    """Several processes, each with one tile at a time.

    Args:
        count: number of processes.
        notify: called with a sentence when a process has died.
    """

    def __init__(self, count: int, notify: Callable[[str], None]) -> None:
        self.name: str = number_of(count, "process", "processes")
        self._count, self._notify = count, notify
        self._pool: ProcessPoolExecutor | None = None
        self._ending = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *ending: Any) -> None:
        """End the processes at once."""
        self._end()

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """Compute tiles; see Engine."""
        left, running = list(reversed(tiles)), dict[Future[bytes], int]()
        deaths = Counter[int]()
        while left or running:
            try:
                while left and len(running) < _TILES_PER_PROCESS * self._count:
                    tile = left[-1]
                    future = self._open().submit(answer_tile, study.kind, study.text, study.software, tile)
                    running[future] = left.pop()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    content = future.result()
                    yield running.pop(future), content
            except BrokenProcessPool:
                lost = sorted(running.values(), reverse=True)
                deaths.update(lost)
                self._notify(f"a worker process has died; tiles submitted again: {len(lost)}")
                if worst := [tile for tile in lost if deaths[tile] >= _MAX_DEATHS]:
                    raise TileFailed(
                        f"processes died {_MAX_DEATHS} times while tile {worst[0]} was in work; is the memory full, "
                        "or does the system kill them? What is done is kept"
                    ) from None
                left, running = [*left, *lost], {}
                self._end()

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = self._ending.enter_context(worker_pool(self._count))
        return self._pool

    def _end(self) -> None:
        self._pool = None
        self._ending.close()
