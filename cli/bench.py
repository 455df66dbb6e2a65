"""The command that measures: work against precision."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cli.console import StepProgress, print_json, wait_for_compilation
from cli.options import Json
from rig_configs import load_rig

if TYPE_CHECKING:
    from dynamics.bench.records import Measurement, Target

_RIG = "virtual"
_WIDTH = 110  # of a table that goes into a file
_USUAL_S = {"multipliers": 40, "motion": 45, "map": 12, "batch": 10, "steady states": 5, "processes": 75}


def bench(
    what: Annotated[Literal["dynamics"], Parameter(help="what to measure")],
    /,
    *,
    quick: Annotated[bool, Parameter(negative="", help="few settings, no extremes, no whole processes")] = False,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="write table (.md, .json) and figure (.svg) into a directory"),
    ] = None,
    json: Json = False,
) -> int:
    """Time against true error for every method on offer, with peers in the same run."""
    with wait_for_compilation("dynamics"):
        from dynamics.bench import heyoka_runs, tables, work_precision  # noqa: PLC0415
        from dynamics.bench.records import compared, worth_showing  # noqa: PLC0415

        rig = load_rig(_RIG)
        work_precision.warm_up(rig.physics)
    size = work_precision.QUICK if quick else work_precision.FULL
    points = {name: point.speed_ratio for name, point in rig.points.items()}
    machine = work_precision.machine()
    notes = (
        []
        if heyoka_runs.available()
        else ["heyoka is not installed (Linux only): true errors of multipliers alone, by mpmath"]
    )
    if quick:
        notes += [
            f"--quick: no whole processes, no stiff and slow cases; a map of {math.prod(size.map_shape)} points and a "
            f"batch of {size.runs} runs are too small to be judged by the targets"
        ]
    started, measured = time.monotonic(), []
    with StepProgress(_USUAL_S) as progress:
        for name, stage in work_precision.stages(rig.physics, points, size).items():
            progress.step(name)
            measured += stage()
    rows = compared(measured)
    targets = work_precision.targets(rows)
    result = {
        "what": what,
        "machine": machine,
        "seconds": time.monotonic() - started,
        "notes": notes,
        "targets": [t.as_json() for t in targets],
        "measurements": [r.as_json() for r in rows],
        "files": [],
    }
    if output is not None:
        page = tables.markdown(worth_showing(rows), targets, machine, notes)
        result["files"] = _write(output, rows, page, result)
    if json:
        print_json(result)
    else:
        _print(result, worth_showing(rows), targets)
    return 0


def _write(directory: Path, rows: Sequence[Measurement], page: str, result: dict[str, Any]) -> list[str]:
    """Table, figure and numbers into a directory; their paths."""
    from analysis.plots.style import save  # noqa: PLC0415
    from analysis.plots.work_precision import draw_work_precision  # noqa: PLC0415
    from dynamics.bench.tables import machine_line  # noqa: PLC0415
    from dynamics.bench.work_precision import ALL_POINTS, RELEASE  # noqa: PLC0415

    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"work_precision{suffix}" for suffix in (".md", ".json", ".svg")]
    files = [str(path) for path in paths]
    paths[0].write_text(page, encoding="utf-8")
    paths[1].write_text(dumps(result | {"files": files}, ensure_ascii=False, indent=1), encoding="utf-8")
    save(paths[2], draw_work_precision(rows, ALL_POINTS, RELEASE, machine_line(result["machine"])))
    return files


def _print(result: dict[str, Any], rows: Sequence[Measurement], targets: Sequence[Target]) -> None:
    from dynamics.bench import tables  # noqa: PLC0415

    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = _WIDTH
    console.print(tables.machine_line(result["machine"]))
    for note in result["notes"]:
        console.print(note)
    for case, body in tables.blocks(rows):
        table = Table(*tables.HEADER, title=case, title_justify="left", box=SIMPLE_HEAD)
        for cells in body:
            table.add_row(*map(Text, cells))
        console.print(table)
    console.print(tables.LEGEND)
    table = Table("figure", "target", "measured", "", box=SIMPLE_HEAD)
    for target in targets:
        table.add_row(*map(Text, tables.target_line(target)))
    console.print(table)
    for path in result["files"]:
        console.print(f"wrote {path}")
