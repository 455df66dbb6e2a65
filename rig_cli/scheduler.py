# pyright: strict
"""Who works a study's tiles out, and how the person at the terminal sees it."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rig_cli.console import say
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
    """Who works at several studies one after the other, begun once.

    Args:
        scheduler: see `Scheduler`; None: the threads of this process.
    """
    from studies.engines import engine_of  # noqa: PLC0415
    from studies.engines.threads import Threads  # noqa: PLC0415
    from studies.running import Lent  # noqa: PLC0415

    with engine_of(scheduler, say) if scheduler else Threads() as engine:
        yield Lent(engine)


def worked_out(study: Study, place: Path, scheduler: str | Engine | None, what: str) -> TileFolder:
    """Work a study out, with progress; a study that was begun goes on.

    Args:
        place: folder of its tiles.
        scheduler: who works, or where; None: this machine.
        what: its tiles, in a word for the progress bar.
    Returns:
        The folder, every tile in it.
    Raises:
        StudyError, DynamicsError: it cannot be worked out.
    """
    from studies.engines import engine_of  # noqa: PLC0415
    from studies.engines.threads import Threads  # noqa: PLC0415
    from studies.running import run_study  # noqa: PLC0415
    from studies.study import kind_named  # noqa: PLC0415
    from studies.tile_files import TileFolder  # noqa: PLC0415

    if scheduler is None and not kind_named(study.kind).uses_threads:
        scheduler = f"local:{os.cpu_count() or 1}"
    if isinstance(scheduler, str):
        scheduler = engine_of(scheduler, say)
    engine = scheduler or Threads()
    folder = TileFolder(place, study)
    there = len(folder.finished())
    if there:
        say(f"{there} of {study.tiles} {what} are in {place} already and are not worked out again")
    try:
        words = f"{study.tiles} {what}, {engine.name}"
        with share_progress(words, study.tiles, what, there / study.tiles) as progress:
            run_study(folder, engine, lambda done, total: progress(done / total))
    except KeyboardInterrupt:
        say(
            f"{len(folder.finished())} of {study.tiles} {what} are done and kept in {place}; the same command goes on "
            "from there"
        )
        raise
    return folder
