"""Computation of tiles in the threads of this process, without start-up and transfer."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any, Self

from rig_basics.thread_pool import ThreadPool
from studies.study import Study, kind_named
from studies.worker import answer_tile

_LOOK_S = 0.5
"""A Ctrl-C that comes just before a wait does not end it, so no wait is longer."""


class Threads:
    """One tile per processor at a time; a single tile uses all processors."""

    name = "this process"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *ending: Any) -> None:
        """Do nothing: the engine holds no resources."""

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """Compute tiles; see Engine."""
        processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        at_once = min(len(tiles), processors) if kind_named(study.kind).uses_threads else 1
        waiting = iter(tiles)
        with ThreadPool(at_once) as pool:
            running: dict[Future[bytes], int] = {}
            while True:
                while len(running) < at_once and (tile := next(waiting, None)) is not None:
                    threads = max(1, processors // at_once)
                    future = pool.submit(answer_tile, study.kind, study.text, study.software, tile, threads)
                    running[future] = tile
                if not running:
                    return
                for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
