"""Computation of tiles in processes of this machine by the standard library, without ports and installations."""

from __future__ import annotations

import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Self

from rig_basics.lifeline import end_with_parent
from rig_basics.log_output import show_log_as_parent
from rig_basics.texts import number_of
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
        self._lifeline: Connection | None = None

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
            context = multiprocessing.get_context("spawn")
            ours, self._lifeline = context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(self._count, context, _begin, (ours,))
        return self._pool

    def _end(self) -> None:
        if self._lifeline is not None:
            self._lifeline.close()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = self._lifeline = None


def _begin(lifeline: Connection) -> None:
    """Prepare a process before its first tile: it ignores Ctrl-C and ends with its parent."""
    show_log_as_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(lifeline)
