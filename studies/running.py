"""Execution of a study: an engine computes the tiles that are missing in a folder, and each is stored at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol, Self

from studies.study import Study
from studies.tile_files import TileFolder

Progress = Callable[[int, int], None]
"""Called with the number of finished tiles and of all tiles."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Computes tiles; used in a `with` statement."""

    name: str

    def __enter__(self) -> Self: ...

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """Yield tiles with the contents of their files, in the order of completion.

        Raises:
            EngineLost: no worker is available any more.
            TileFailed: a tile cannot be computed.
            OtherSoftware: a worker has other sources.
        """
        ...


class Lent:
    """An engine for several studies; its owner enters and exits it."""

    def __init__(self, engine: Engine) -> None:
        self.name: str = engine.name
        self._engine = engine

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *ending: object) -> None:
        """Do nothing: the owner exits the engine."""

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """Compute tiles; see Engine."""
        return self._engine.answers(study, tiles)


def run_study(folder: TileFolder, engine: Engine, progress: Progress | None = None) -> int:
    """Compute every tile that is missing in the folder.

    If it ends early for any reason, the folder contains each finished tile, and the next call continues there.

    Args:
        folder: folder of the study.
        engine: engine that computes the tiles.
        progress: called with (finished tiles, all tiles).
    Returns:
        Number of tiles that already existed.
    Raises:
        StudyError: see studies.errors.
    """
    study, there = folder.study, folder.finished()
    done, notify = len(there), progress or _ignore
    notify(done, study.tiles)
    left = [tile for tile in range(study.tiles) if tile not in there]
    if left:
        with engine:
            for tile, content in engine.answers(study, left):
                folder.keep(tile, content)
                done += 1
                notify(done, study.tiles)
    return len(there)


def _ignore(done: int, total: int) -> None:
    del done, total
