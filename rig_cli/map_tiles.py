"""Computation of a map in tiles in a folder next to its file: finished tiles are kept until the file is written."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rig_cli.scheduler import worked_out
from rig_configs import RigFileError

if TYPE_CHECKING:
    from analysis.maps.question import MapQuestion
    from dynamics.stability.stability_map import StabilityMap


@contextmanager
def in_tiles(
    question: MapQuestion, output: Path | None, scheduler: str | None
) -> Generator[Callable[[], StabilityMap] | None]:
    """Yield the function that computes a map's grid in tiles.

    Tiles are in OUTPUT.tiles and are removed at the end of the `with` statement, when the file contains them all. After
    an error they stay, and the same command continues with them. Without a file they are in a temporary folder.

    Yields:
        The function; None if the grid is one tile computed by this process.
    """
    from studies.maps import assembled, map_study  # loads numba
    from studies.tile_files import TileFolder

    if question.refine and scheduler is not None:
        raise RigFileError(
            "rig map: multipliers that are refined are computed by this process alone, microseconds a point; leave "
            "--scheduler out, or leave out --refine and give a finer grid"
        )
    study = map_study(question)
    if question.refine or (study.tiles == 1 and scheduler is None):
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="rig-map-") as passing:
        place = Path(passing) if output is None else Path(f"{output}.tiles")
        yield lambda: assembled(worked_out(study, place, scheduler, "tiles"))[1]
        TileFolder(place, study).remove()
