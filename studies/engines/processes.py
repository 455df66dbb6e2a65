# pyright: strict
"""Tiles in processes of this machine, by the standard library: no port is opened and nothing is installed."""

from __future__ import annotations

import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Self

from studies.engines.lifeline import end_with_parent
from studies.errors import TileFailed
from studies.study import Study
from studies.worker import answer_tile

_AHEAD = 2  # tiles that are given out for each process, one to work at and one to go on with
_DEATHS = 4  # of processes with a tile in hand, before it is given up


class Processes:
    """So many processes, each a tile at a time.

    Args:
        count: of processes.
        tell: told when a process has died.
    """

    def __init__(self, count: int, tell: Callable[[str], None]) -> None:
        self.name, self._count, self._tell = f"{count} processes", count, tell
        self._pool: ProcessPoolExecutor | None = None
        self._lifeline: Connection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *ending: Any) -> None:
        """End the processes, whatever they are at."""
        self._end()

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """See Engine."""
        left, running = list(reversed(tiles)), dict[Future[bytes], int]()
        deaths = Counter[int]()
        while left or running:
            try:
                while left and len(running) < _AHEAD * self._count:
                    tile = left[-1]
                    future = self._open().submit(answer_tile, study.kind, study.text, study.software, tile)
                    running[future] = left.pop()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    content = future.result()
                    yield running.pop(future), content
            except BrokenProcessPool:
                lost = sorted(running.values(), reverse=True)
                deaths.update(lost)
                self._tell(f"a worker process has died; tiles given out anew: {len(lost)}")
                if worst := [tile for tile in lost if deaths[tile] >= _DEATHS]:
                    raise TileFailed(
                        f"processes died {_DEATHS} times with tile {worst[0]} in hand, or beside it; is the memory "
                        "full, or does the system kill them? What is done is kept"
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
    """In a process, before its first tile: Ctrl-C is for the one who asks, at whose end this process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(lifeline)
