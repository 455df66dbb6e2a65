# pyright: strict
"""The command that writes a campaign's report from its logs, at any time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from rig_cli.console import print_json, say, step_told
from rig_cli.options import Json, ParametersPath, need_place
from rig_configs import IdentifiedParameters, RigFileError, load_rig

if TYPE_CHECKING:
    from daq.signals.run import Run
    from identification import Identification
    from rig_configs.schema import Rig


def report(
    *places: Path,
    rig: Annotated[str | None, Parameter(help="a rig file instead of the logs' own")] = None,
    parameters: ParametersPath = None,
    since: Annotated[Path | None, Parameter(help="an earlier parameters.toml: what changed since then")] = None,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="the HTML file; by default report.html in the first folder"),
    ] = None,
    force: Annotated[bool, Parameter(negative="", help="replace a report that is there")] = False,
    json: Json = False,
) -> int:
    """Write the report of a campaign's logs, at any time; exit 1 when a point fails.

    The tests are identified anew, and points are validated with what was found without them; with --parameters nothing
    is identified. The numbers stand beside the page, in a file of the same name that ends in .json.

    Args:
        places: folders of a campaign, and logs.
    """
    from rig_cli.offline import print_points  # noqa: PLC0415 (matplotlib and numba take seconds to import)
    from rig_cli.reporting import reported  # noqa: PLC0415
    from daq.signals.run import point_of  # noqa: PLC0415
    from studies.runs import load_runs, validated  # noqa: PLC0415

    logs = _logs(places)
    page = _page(output, places, force)
    earlier = None if since is None else (since.name, IdentifiedParameters.load(since))
    given = None if parameters is None else IdentifiedParameters.load(parameters)
    with step_told(f"reading {len(logs)} logs") as tell:
        runs = sorted(load_runs(logs), key=lambda run: run.start_s)
        loaded = _rig(rig, runs)
        points = [run for run in runs if point_of(run.test)]
        before, joint = _identified(runs, points, loaded, given, tell)
        validation = validated(runs, loaded, before, tell) if points else None
        tell("drawing")
        reported(page, loaded, runs, before, joint, validation, since=earlier)
    numbers = page.with_suffix(".json")
    passed = validation is None or validation.passed
    if json:
        told: dict[str, Any] = {"report": str(page), "numbers": str(numbers), "logs": [str(log) for log in logs]}
        told["points"] = {} if validation is None else {n: p.verdict for n, p in validation.points.items()}
        print_json({**told, "passed": passed})
        return 0 if passed else 1
    if validation is not None:
        print_points(validation.to_json()["points"])
    say(f"written to {page}, its numbers to {numbers.name}")
    return 0 if passed else 1


def _logs(places: Sequence[Path]) -> list[Path]:
    """Every log that was named, and those of folders that were, at most one folder further down."""
    if not places:
        raise RigFileError("no log given; usage: rig report DIR|LOG…")
    logs: list[Path] = []
    for place in places:
        if place.is_dir():
            found = sorted([*place.glob("*.mcap"), *place.glob("*/*.mcap")])
            if not found:
                raise RigFileError(f"rig report: {place}: expected logs (*.mcap) in this folder, found none")
            logs += found
        elif place.exists():
            logs.append(place)
        else:
            raise RigFileError(f"rig report: {place}: expected a folder or a log, there is nothing of this name")
    return list(dict.fromkeys(logs))


def _page(output: Path | None, places: Sequence[Path], force: bool) -> Path:
    """Where the page goes; a name that is taken is refused before the work."""
    folder = next((place for place in places if place.is_dir()), Path())
    page = folder / "report.html" if output is None else output
    if page.suffix.lower() not in (".html", ".htm"):
        raise RigFileError(f"rig report: -o {page}: expected a name ending in .html")
    need_place("rig report: -o", page)
    for taken in (page, page.with_suffix(".json")):
        if taken.exists() and not force:
            raise RigFileError(f"rig report: {taken} is there already; give --force to replace it, or another -o")
    return page


def _rig(name: str | None, runs: Sequence[Run]) -> Rig:
    """The rig file given, or the one that the newest log holds."""
    from daq.log import open_log  # noqa: PLC0415 (numba takes a third of a second to import)
    from daq.log.snapshot import rig_of  # noqa: PLC0415

    if name is not None:
        return load_rig(name)
    with open_log(runs[-1].source) as log:
        return rig_of(log)


def _identified(
    runs: Sequence[Run],
    points: Sequence[Run],
    rig: Rig,
    given: IdentifiedParameters | None,
    tell: Callable[[str], None],
) -> tuple[IdentifiedParameters, Identification | None]:
    """What the points are validated with, and what all logs together say; None where parameters were given."""
    from identification import identify  # noqa: PLC0415 (numba takes seconds to import)

    if given is not None:
        return given, None
    tests = [run for run in runs if run not in points]
    if not tests:
        raise RigFileError(
            "rig report: expected tests to identify from (ring-down, run-up, spin-down) beside the points, found none; "
            "add their logs, or give --parameters parameters.toml"
        )
    first = identify(tests, rig, tell)
    return first.parameters, identify(list(runs), rig, tell, earlier=first) if points else first
