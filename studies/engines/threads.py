# pyright: strict
"""Tiles in the threads of this process: nothing to start and nothing to send."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, Self

from studies.study import Study, kind_named
from studies.worker import answer_tile


class Threads:
    """One tile per processor at a time; a single tile gets them all."""

    name = "this process"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *ending: Any) -> None:
        """Nothing is left open."""

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """See Engine."""
        processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        beside = min(len(tiles), processors) if kind_named(study.kind).uses_threads else 1
        waiting = iter(tiles)
        with ThreadPoolExecutor(beside) as pool:
            running: dict[Future[bytes], int] = {}
            try:
                while True:
                    while len(running) < beside and (tile := next(waiting, None)) is not None:
                        threads = max(1, processors // beside)
                        future = pool.submit(answer_tile, study.kind, study.text, study.software, tile, threads)
                        running[future] = tile
                    if not running:
                        return
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        yield running.pop(future), future.result()
            finally:
                for future in running:
                    future.cancel()
