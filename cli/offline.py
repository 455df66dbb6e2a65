"""Commands from logs to numbers: identify, validate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from cli.console import STDERR, print_json, say, show
from cli.options import Json, ParametersPath, Settings, need_folder
from rig_configs import IdentifiedParameters, RigFileError, load_rig


def identify(
    *logs: Path,
    rig: str = "virtual",
    output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("parameters.toml"),
    setting: Annotated[
        Literal["fast", "balanced", "reference"],
        Parameter(help="cheapest with honest intervals, near the bound, or as exact as the data allow"),
    ] = "balanced",
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Identify k1, k2, ζ1, ζ2, c3, c4, S_P with covariance from logs; writes parameters.toml."""
    from cli import results  # noqa: PLC0415 (scipy and numba take seconds to import)
    from cli.parameters import limit_json  # noqa: PLC0415
    from identification import identify as find  # noqa: PLC0415
    from identification.joint.limits import limits  # noqa: PLC0415

    _need(logs, "rig identify LOG…")
    need_folder(output, "rig identify: -o")
    loaded = load_rig(rig, settings=settings or [])
    runs = results.load_runs(logs)
    found = find(runs, loaded, STDERR.print, setting=setting)
    parameters = results.with_version(found.parameters)
    parameters.save(output)
    limited = limits(found) or []
    if json:
        limited_by = {limit.name: limit_json(limit) for limit in limited}
        print_json({**results.identification_json(found), "limited_by": limited_by, "file": str(output)})
        return 0
    from cli.parameters_page import limit_lines  # noqa: PLC0415

    for line in [*results.parameter_lines(parameters), *limit_lines(limited)]:
        print(line)
    for warning in found.warnings:
        say(f"warning: {warning}")
    say(f"written to {output}")
    return 0


def validate(
    rig: str,
    *logs: Path,
    parameters: ParametersPath = None,
    axis_angle_deg: float = 0.0,
    axis_angle_std_deg: float = 3.0,
    report: Path | None = None,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Compare measured steady states at the points with the model; exit 1 when a point does not pass."""
    from analysis.report.campaign import Campaign, IdentificationResult  # noqa: PLC0415
    from analysis.report.write import write_report  # noqa: PLC0415
    from analysis.validation import validate as compare  # noqa: PLC0415
    from cli import results  # noqa: PLC0415
    from identification.identify import missing_warnings  # noqa: PLC0415

    _need(logs, "rig validate RIG LOG…")
    loaded = load_rig(rig, settings=settings or [])
    if parameters is None:
        raise RigFileError("rig validate: give --parameters parameters.toml, as `rig identify` wrote it")
    known = IdentifiedParameters.load(parameters)
    runs = results.load_runs(logs)
    angle = (axis_angle_deg, axis_angle_std_deg)
    found = compare(runs, loaded, known, angle)
    warnings = missing_warnings(runs)
    for warning in warnings:
        say(f"warning: {warning}")
    for fault in results.keep_verdicts(found, runs, IdentifiedParameters.label(parameters)):
        say(f"warning: {fault}")
    if report is not None:
        identified = IdentificationResult(known, warnings=warnings)
        title = f"Validation of {loaded.name}"
        write_report(report, Campaign(title, loaded, runs, identified, found, axis_angle_deg=angle))
    if json:
        print_json({**found.to_json(), "passed": found.passed, "warnings": warnings,
                    "report": str(report) if report else None})  # fmt: skip
    else:
        print_points(found.to_json()["points"])
    return 0 if found.passed else 1


def print_points(points: dict[str, Any]) -> None:
    """A line per point with its verdict and reason."""
    for name, point in points.items():
        show(f"{name}: {point['verdict']:14} {point['state']:10} {point['why']}")


def _need(logs: tuple[Path, ...], usage: str) -> None:
    if not logs:
        raise RigFileError(f"no log given; usage: {usage}")
