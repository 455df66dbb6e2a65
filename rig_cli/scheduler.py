"""Engines that compute a study's tiles, with progress on the terminal."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rig_cli.console import notify
from rig_cli.share_progress import share_progress

if TYPE_CHECKING:
    from studies.running import Engine
    from studies.study import Study
    from studies.tile_files import TileFolder

Scheduler = Annotated[
    str | None,
    Parameter(help="local:N processes of this machine, or a dask scheduler as tcp://HOST:PORT or tls://HOST:PORT"),
]


@contextmanager
def lent_engine(scheduler: str | None) -> Generator[Engine]:
    """Yield one engine for several studies in sequence.

    Args:
        scheduler: see `Scheduler`; None: the threads of this process.
    """
    from studies.engines import engine_of
    from studies.engines.threads import Threads
    from studies.running import Lent

    with engine_of(scheduler, notify) if scheduler else Threads() as engine:
        yield Lent(engine)


def worked_out(study: Study, place: Path, scheduler: str | Engine | None, what: str) -> TileFolder:
    """Compute a study with progress. A study that was interrupted continues.

    Args:
        place: folder of its tiles.
        scheduler: an engine, or where to find one; None: this machine.
        what: name of its tiles for the progress bar.
    Returns:
        The folder with every tile.
    Raises:
        StudyError, DynamicsError: a tile cannot be computed.
    """
    from studies.engines import engine_of
    from studies.engines.threads import Threads
    from studies.running import run_study
    from studies.study import kind_named
    from studies.tile_files import TileFolder

    if scheduler is None and not kind_named(study.kind).uses_threads:
        scheduler = f"local:{os.cpu_count() or 1}"
    if isinstance(scheduler, str):
        scheduler = engine_of(scheduler, notify)
    engine = scheduler or Threads()
    folder = TileFolder(place, study)
    there = len(folder.finished())
    if there:
        notify(f"{there} of {study.tiles} {what} are in {place} already and are not computed again")
    try:
        words = f"{study.tiles} {what}, {engine.name}"
        with share_progress(words, study.tiles, what, there / study.tiles) as progress:
            run_study(folder, engine, lambda done, total: progress(done / total))
    except KeyboardInterrupt:
        notify(
            f"{len(folder.finished())} of {study.tiles} {what} are done and kept in {place}; the same command "
            "continues from there"
        )
        raise
    return folder
