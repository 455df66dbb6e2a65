# pyright: strict
"""A map in tiles beside its file: what is done is kept until the file is written."""

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
    """How a map's grid is worked out where it is more than a tile, or others work.

    Tiles lie in OUTPUT.tiles, and are removed at the end of the `with` statement, when the file has all of them; where
    it ends with an error they stay, and the same command goes on. Without a file they are in a temporary folder.

    Yields:
        What works the grid out; None where it is one tile of this process.
    """
    from studies.maps import assembled, map_study  # noqa: PLC0415 (loads numba)
    from studies.tile_files import TileFolder  # noqa: PLC0415

    if question.refine and scheduler is not None:
        raise RigFileError(
            "rig map: multipliers that are refined are this process's work, microseconds a point; leave --scheduler "
            "out, or ask for the whole fine grid"
        )
    study = map_study(question)
    if question.refine or (study.tiles == 1 and scheduler is None):
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="rig-map-") as passing:
        place = Path(passing) if output is None else Path(f"{output}.tiles")
        yield lambda: assembled(worked_out(study, place, scheduler, "tiles"))[1]
        TileFolder(place, study).forget()
