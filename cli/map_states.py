# pyright: strict
"""`rig map --quantity state|amplitude|settling-time`: what a release comes to over two numbers of a rig."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from analysis.figures.page import write_figure
from analysis.figures.state_maps import draw_states
from analysis.maps.answers import borders_of
from analysis.maps.files import write_map
from analysis.maps.question import MapQuestion
from analysis.maps.records import state_record
from analysis.maps.states import STATES, StateMap, refined_states
from cli.console import plain, print_json, say
from cli.map_page import borders_json
from cli.options import what_if_words
from cli.scheduler import worked_out
from cli.share_progress import share_progress
from rig_configs import RigFileError
from studies.releases import assembled, release_study
from studies.tile_files import TileFolder


def map_states(
    question: MapQuestion, output: Path | None, plot: Path | None, scheduler: str | None, as_json: bool
) -> int:
    """Follow a release at every point; write, draw and say what it came to."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="rig-map-") as passing:
        place = Path(passing) if output is None else Path(f"{output}.tiles")
        found = _found(question, place, scheduler)
        seconds = time.perf_counter() - started
        borders = None
        if question.borders:
            with share_progress("borders") as told:
                borders = borders_of(question, question.plane(), told)
        result = _json(found, seconds) | {"borders": None if borders is None else borders_json(borders)}
        written = [] if output is None else write_map(output, state_record(found, borders, plain(result)))
        if not question.refine:
            TileFolder(place, release_study(question)).forget()
    if plot is not None:
        figure, readout = draw_states(found, borders)
        write_figure(plot, figure, f"Releases of {question.loaded().name}", readout)
        written.append(plot)
    result["written"] = [str(path) for path in written]
    if as_json:
        print_json(result)
        return 0
    print(f"{found.state.size} releases of {question.seconds:g} s in {seconds:.3g} s")
    for name, share in found.shares.items():
        print(f"{name}: {100 * share:.1f} %")
    print(f"at a boundary: {100 * found.unsure_share:.1f} %")
    if question.settings:
        print(what_if_words(question.settings))
    for path in written:
        print(f"written to {path}")
    if not written:
        say("nothing kept: give -o FILE.npz for the arrays, --plot FILE for the figure")
    return 0


def _found(question: MapQuestion, place: Path, scheduler: str | None) -> StateMap:
    if not question.refine:
        return assembled(worked_out(release_study(question), place, scheduler, "tiles"), question)
    if scheduler is not None:
        raise RigFileError(
            "rig map: --refine works in this process, cell by cell after what it has found; leave --scheduler out, or "
            "ask for the whole fine grid"
        )
    with share_progress(f"{question.x.count * question.y.count} releases and more where the state changes") as told:
        return refined_states(question, told)


def _json(found: StateMap, seconds: float) -> dict[str, Any]:
    question = found.question
    return {
        "x": question.x.key,
        "y": question.y.key,
        "quantity": question.quantity,
        "points": int(found.state.size),
        "seconds": seconds,
        "followed_s": question.seconds,
        "states": list(STATES),
        "shares": found.shares,
        "boundary_share": found.unsure_share,
        "computed_share": 1.0 if found.computed is None else float(np.mean(found.computed)),
        "what_if": list(question.settings),
    }
