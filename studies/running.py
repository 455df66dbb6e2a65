# pyright: strict
"""Work a study out: what its folder lacks, by an engine, each tile kept as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol, Self

from studies.study import Study
from studies.tile_files import TileFolder

Progress = Callable[[int, int], None]
"""Called with tiles done and tiles in all."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Works tiles out; used in a `with` statement."""

    name: str

    def __enter__(self) -> Self: ...

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """Tiles with the contents of their files, in the order in which they are done.

        Raises:
            EngineLost: nobody works any more.
            TileFailed: a tile cannot be worked out.
            OtherSoftware: a worker's sources are others.
        """
        ...


class Lent:
    """An engine for several studies, begun and ended by whoever lends it."""

    def __init__(self, engine: Engine) -> None:
        self.name, self._engine = engine.name, engine

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *ending: object) -> None:
        """It goes on."""

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """See Engine."""
        return self._engine.answers(study, tiles)


def run_study(folder: TileFolder, engine: Engine, progress: Progress | None = None) -> int:
    """Work out every tile that the folder does not have.

    Whatever ends it early, each tile that was done is in the folder, and the next call goes on from there.

    Returns:
        How many tiles were there already.
    Raises:
        StudyError: see studies.errors.
    """
    study, there = folder.study, folder.finished()
    done, tell = len(there), progress or _tell_nobody
    tell(done, study.tiles)
    left = [tile for tile in range(study.tiles) if tile not in there]
    if left:
        with engine:
            for tile, content in engine.answers(study, left):
                folder.keep(tile, content)
                done += 1
                tell(done, study.tiles)
    return len(there)


def _tell_nobody(done: int, total: int) -> None:
    del done, total
