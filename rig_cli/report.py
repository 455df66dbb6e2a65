"""`rig report`: a campaign's report from its logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, show, status_line
from rig_cli.last_sentence import validation_sentence
from rig_cli.log_places import logs_of
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Force, Json, ParametersPath, check_outputs
from rig_configs import IdentifiedParameters, RigFileError

if TYPE_CHECKING:
    from daq.signals.run import Run
    from identification import Identification
    from rig_configs.schema import Rig


def report(
    *places: Path,
    rig: Annotated[str | None, Parameter(help="a rig file instead of the logs' own, of the same rig")] = None,
    parameters: ParametersPath = None,
    since: Annotated[Path | None, Parameter(help="an earlier parameters.toml: what changed since then")] = None,
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"], group=OUTPUT, help="the HTML file; by default report.html in the first folder"
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Write the report of a campaign from its logs.

    It can be written at any time. The exit code is 1 if a point fails. The tests are identified again, and points
    are validated with the result of the tests alone; with --parameters nothing is identified. The numbers are
    written next to the page, in a file of the same name that ends in .json.

    Example: `rig report out`

    Args:
        places: folders of a campaign, and logs.
    """
    from daq.guided_test_kinds import point_of
    from daq.log.rig_of_logs import RigUse, rig_of_logs
    from rig_cli.offline import print_points  # matplotlib and numba take seconds to import
    from rig_cli.reporting import reported
    from studies.runs import load_runs
    from studies.validated_runs import validated

    logs = logs_of("rig report", places, "FOLDER|LOG…")
    page = _page(output, places, force)
    earlier = None if since is None else (since.name, IdentifiedParameters.load(since))
    given = None if parameters is None else IdentifiedParameters.load(parameters)
    use = RigUse("rig report") if given is None else RigUse.relying_on_estimates("rig report", given)
    with status_line(f"reading {number_of(len(logs.logs), 'log')}") as notify_status:
        # a verdict without a log of its folder would not show what is missing: a log that cannot be read is refused
        runs = sorted(load_runs(logs.logs), key=lambda run: run.start_s)
        loaded = rig_of_logs([run.source for run in runs], use, rig)
        points = [run for run in runs if point_of(run.test)]
        before, joint = _identified(runs, points, loaded, given, notify_status)
        validation = validated(runs, loaded, before, notify_status) if points else None
        notify_status("drawing")
        reported(page, loaded, runs, before, joint, validation, since=earlier)
    numbers = page.with_suffix(".json")
    passed = validation is None or validation.passed
    if json:
        result: dict[str, Any] = {"report": str(page), "numbers": str(numbers), "logs": [str(log) for log in logs.logs]}
        result["points"] = {} if validation is None else {n: p.verdict for n, p in validation.points.items()}
        print_json({**result, "passed": passed})
        return 0 if passed else 1
    if validation is not None:
        print_points(validation.to_json()["points"])
    notify(f"written to {page}, its numbers to {numbers.name}")
    if validation is not None:
        show(validation_sentence(validation.to_json()["points"], passed))
    return 0 if passed else 1


def _page(output: Path | None, places: Sequence[Path], force: bool) -> Path:
    """Return the file of the page. An existing file is rejected before the work."""
    folder = next((place for place in places if place.is_dir()), Path())
    page = folder / "report.html" if output is None else output
    if page.suffix.lower() not in (".html", ".htm"):
        raise RigFileError(f"rig report: -o {page}: expected a name ending in .html")
    check_outputs("rig report: -o", page, page.with_suffix(".json"), force=force)
    return page


def _identified(
    runs: Sequence[Run],
    points: Sequence[Run],
    rig: Rig,
    given: IdentifiedParameters | None,
    notify_status: Callable[[str], None],
) -> tuple[IdentifiedParameters, Identification | None]:
    """Return the parameters for the validation, and the joint identification of all logs; None if they were given."""
    from identification import identify  # numba takes seconds to import

    if given is not None:
        return given, None
    tests = [run for run in runs if run not in points]
    if not tests:
        raise RigFileError(
            "rig report: expected tests to identify from (ring-down, run-up, spin-down) besides the points, found "
            "none; add their logs, or give --parameters parameters.toml"
        )
    first = identify(tests, rig, notify_status)
    return first.parameters, identify(list(runs), rig, notify_status, earlier=first) if points else first
