"""`rig bench`: work against precision."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rig_basics.texts import number_of
from rig_basics.whole_file import write_whole_text
from rig_cli.console import StepProgress, plain, print_json, wait_for_compilation
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Json
from rig_configs import load_rig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dynamics.bench.tables import BenchmarkPage

_Row = TypeVar("_Row")
_RIG = "virtual"
_WIDTH = 118  # columns of a table that is written to a file
_DYNAMICS_S = {"multipliers": 40, "motion": 45, "map": 12, "batch": 10, "steady states": 5, "processes": 75}
_IDENTIFICATION_S = {
    "ring-down": 120,
    "damaged ring-down": 90,
    "two axes": 100,
    "run-up": 60,
    "spin-down": 5,
    "release": 60,
    "tracking": 20,
}


@dataclass(frozen=True)
class _Run:
    """Result of a benchmark: rows under their field names, the page, and the figure, drawn on request."""

    measurements: list[dict[str, Any]]
    page: BenchmarkPage
    figure: Callable[[], Figure]
    file_stem: str


def bench(
    what: Annotated[Literal["dynamics", "identification"], Parameter(help="what to measure")],
    /,
    *,
    quick: Annotated[
        bool, Parameter(negative="", help="few settings and records, no extremes, no whole processes")
    ] = False,
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"], group=OUTPUT, help="write table (.md, .json) and figure (.svg) into a directory"
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Measure time against true error for every method, with peers in the same run.

    Example: `rig bench dynamics`
    """
    started = time.monotonic()
    found = _dynamics(quick) if what == "dynamics" else _identification(quick)
    files: list[str] = []
    result: dict[str, Any] = {
        "what": what,
        "machine": found.page.machine,
        "seconds": time.monotonic() - started,
        "recommendations": [r.as_json() for r in found.page.recommendations],
        "notes": found.page.notes,
        "targets": [t.as_json() for t in found.page.targets],
        "measurements": found.measurements,
        "files": files,
    }
    if output is not None:
        result["files"] = files = _write(output, found, result)
    if json:
        print_json(result)
    else:
        _print(found.page, files)
    return 0


def _dynamics(quick: bool) -> _Run:
    with wait_for_compilation("dynamics"):
        from dynamics.bench import heyoka_runs, tables, work_precision
        from dynamics.bench.records import compared, worth_showing

        rig = load_rig(_RIG)
        work_precision.warm_up(rig.physics)
    size = work_precision.QUICK if quick else work_precision.FULL
    points = {name: point.speed_ratio for name, point in rig.points.items()}
    machine = work_precision.machine()
    notes = (
        []
        if heyoka_runs.available()
        else ["heyoka is not installed (Linux only): true errors of the multipliers only, by mpmath"]
    )
    if quick:
        notes += [
            f"--quick: no whole processes, no stiff and slow cases; a map of "
            f"{number_of(math.prod(size.map_shape), 'point')} and a "
            f"batch of {number_of(size.runs, 'run')} are too small to be judged by the targets"
        ]
    rows = compared(_measured(work_precision.stages(rig.physics, points, size), _DYNAMICS_S))
    page = tables.page(worth_showing(rows), work_precision.targets(rows), machine, notes)

    def figure() -> Figure:
        from analysis.figures.work_precision import draw_work_precision  # only if a file is written

        line = tables.machine_line(machine)
        return draw_work_precision(rows, work_precision.ALL_POINTS, work_precision.RELEASE, line)

    return _Run([r.as_json() for r in rows], page, figure, "work_precision")


def _identification(quick: bool) -> _Run:
    with wait_for_compilation("identification"):
        from dynamics.bench.records import compared
        from dynamics.bench.tables import machine_line
        from dynamics.bench.work_precision import machine
        from identification.bench import library_peers, precision, tables, trials
    size, where = precision.QUICK if quick else precision.FULL, machine()
    notes = [f"seed {precision.SEED}; every case draws its records from it and its own name"]
    notes += [f"{name} is not installed: {library_peers.INSTALL}" for name in library_peers.missing()]
    if quick:
        notes.append(
            f"--quick: fewer cases, and {number_of(size.runs, 'record')} or fewer are too few to be judged "
            f"by the targets"
        )
    stages = precision.stages(load_rig(_RIG).physics, size)
    rows = compared(_measured(stages, _IDENTIFICATION_S), trials.AT_THE_BOUND)
    page = tables.page(rows, precision.targets(rows), where, notes)

    def figure() -> Figure:
        from analysis.figures.identification_precision import Mark, draw_identification_precision

        marks = [
            Mark(
                f"{r.service}: {r.case}",
                r.method,
                r.setting,
                max(r.rms.values()),
                r.seconds,
                peer=r.peer,
                fails=r.gross > 0,
                front=r.front,
                front_of_all=r.front_of_all,
            )
            for r in rows
            if r.rms
        ]
        return draw_identification_precision(marks, trials.AT_THE_BOUND, machine_line(where))

    return _Run([r.as_json() for r in rows], page, figure, "identification_precision")


def _measured(stages: dict[str, Callable[[], list[_Row]]], usual_s: dict[str, int]) -> list[_Row]:
    """Run all stages with progress and return their rows."""
    rows: list[_Row] = []
    with StepProgress(usual_s) as progress:
        for name, stage in stages.items():
            progress.step(name)
            rows += stage()
    return rows


def _write(directory: Path, found: _Run, result: dict[str, Any]) -> list[str]:
    """Write table, figure and numbers into a directory; return the paths."""
    from analysis.figures.style import save
    from dynamics.bench.tables import markdown

    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{found.file_stem}{suffix}" for suffix in (".md", ".json", ".svg")]
    files = [str(path) for path in paths]
    write_whole_text(paths[0], markdown(found.page))
    write_whole_text(paths[1], dumps(plain(result | {"files": files}), ensure_ascii=False, indent=1))
    save(paths[2], found.figure())
    return files


def _print(page: BenchmarkPage, files: Sequence[str]) -> None:
    from dynamics.bench import tables

    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = _WIDTH
    if page.recommendations:
        console.print(tables.RECOMMENDED)
        for recommendation in page.recommendations:
            console.print(f"- {recommendation.text}")
    console.print(tables.machine_line(page.machine))
    for note in page.notes:
        console.print(note)
    for case, body in page.blocks:
        table = Table(*page.header, title=case, title_justify="left", box=SIMPLE_HEAD)
        for cells in body:
            table.add_row(*map(Text, cells))
        console.print(table)
    console.print(page.legend)
    table = Table("figure", "target", "measured", "", box=SIMPLE_HEAD)
    for target in page.targets:
        table.add_row(*map(Text, tables.target_line(target)))
    console.print(table)
    for path in files:
        console.print(f"wrote {path}")
