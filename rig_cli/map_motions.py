"""`rig map` of whole motions: the end of a release at every point, or which stable motions coexist."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from analysis.figures.coexistence import draw_coexistence
from analysis.figures.page import write_figure
from analysis.figures.state_maps import draw_states
from analysis.maps.answers import borders_of
from analysis.maps.coexistence import MOTIONS, CoexistenceMap
from analysis.maps.files import write_map
from analysis.maps.question import MapQuestion
from analysis.maps.records import motion_record
from analysis.maps.states import STATES, StateMap
from rig_basics.texts import number_of
from rig_cli.console import notify, plain, print_json
from rig_cli.map_page import borders_json
from rig_cli.options import what_if_words
from rig_cli.scheduler import lent_engine, worked_out
from rig_cli.share_progress import share_progress
from rig_configs import RigFileError
from studies import coexistence, releases
from studies.study import Study
from studies.tile_files import TileFolder


def map_motions(
    question: MapQuestion, output: Path | None, plot: Path | None, scheduler: str | None, as_json: bool
) -> int:
    """Compute the map; write, draw and print it."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="rig-map-") as passing:
        place = Path(passing) if output is None else Path(f"{output}.tiles")
        found, studies = _refined(question, place, scheduler) if question.refine else _whole(question, place, scheduler)
        seconds = time.perf_counter() - started
        borders = None
        if question.borders:
            with share_progress("borders") as progress:
                borders = borders_of(question, question.plane(), progress)
        result = _json(found, seconds) | {"borders": None if borders is None else borders_json(borders)}
        written = [] if output is None else write_map(output, motion_record(found, borders, plain(result)))
        for study in studies:
            TileFolder(place, study).remove()
    if plot is not None:
        draw = draw_states(found, borders) if isinstance(found, StateMap) else draw_coexistence(found, borders)
        write_figure(plot, draw[0], f"Motions of {question.loaded().name}", draw[1])
        written.append(plot)
    result["written"] = [str(path) for path in written]
    if as_json:
        print_json(result)
        return 0
    _print(found, seconds)
    for path in written:
        print(f"written to {path}")
    if not written:
        notify("no file written: give -o FILE.npz for the arrays, --plot FILE for the figure")
    return 0


def _whole(question: MapQuestion, place: Path, scheduler: str | None) -> tuple[StateMap | CoexistenceMap, list[Study]]:
    if question.quantity == "coexisting":
        study = coexistence.coexistence_study(question)
        return coexistence.assembled(worked_out(study, place, scheduler, "tiles"), question), [study]
    study = releases.release_study(question)
    return releases.assembled(worked_out(study, place, scheduler, "tiles"), question), [study]


def _refined(question: MapQuestion, place: Path, scheduler: str | None) -> tuple[StateMap, list[Study]]:
    if question.quantity == "coexisting":
        raise RigFileError(
            "rig map: --refine is of states; --quantity coexisting is followed from each point to its neighbours"
        )
    with lent_engine(scheduler) as engine:
        return releases.refined(question, lambda study: worked_out(study, place, engine, "tiles where states change"))


def _json(found: StateMap | CoexistenceMap, seconds: float) -> dict[str, Any]:
    question = found.question
    result: dict[str, Any] = {
        "x": question.x.key,
        "y": question.y.key,
        "quantity": question.quantity,
        "points": len(found.x) * len(found.y),
        "seconds": seconds,
        "shares": found.shares,
        "what_if": list(question.settings),
    }
    if isinstance(found, CoexistenceMap):
        return result | {"motions": list(MOTIONS)}
    return result | {
        "followed_s": question.seconds,
        "states": list(STATES),
        "boundary_share": found.unsure_share,
        "computed_share": 1.0 if found.computed is None else float(np.mean(found.computed)),
    }


def _print(found: StateMap | CoexistenceMap, seconds: float) -> None:
    question, count = found.question, len(found.x) * len(found.y)
    counted = number_of(count, "release") if isinstance(found, StateMap) else number_of(count, "point")
    of = f" of {question.seconds:g} s" if isinstance(found, StateMap) else ""
    print(f"{counted}{of} in {seconds:.3g} s")
    for name, share in found.shares.items():
        print(f"{name}: {100 * share:.1f} %")
    if isinstance(found, StateMap):
        print(f"at a boundary: {100 * found.unsure_share:.1f} %")
    if question.settings:
        print(what_if_words(question.settings))
