"""Commands from logs to parameters and verdicts: identify, validate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from rig_cli.console import STDERR, notify, print_json, show
from rig_cli.last_sentence import identify_sentence, validation_sentence
from rig_cli.log_places import logs_of, readable_runs
from rig_cli.option_groups import AXIS_ANGLE, OUTPUT
from rig_cli.options import (
    WHOLE_LOG,
    Force,
    Json,
    LogSpan,
    ParametersPath,
    RigFile,
    Settings,
    check_outputs,
    what_if_words,
)
from rig_cli.setting_costs import SETTING_HELP, WITHOUT_HELP
from rig_cli.validation_page import whole_lines
from rig_configs import IdentifiedParameters, RigFileError, overridden

if TYPE_CHECKING:
    from analysis.validation import Validation
    from daq.signals.run import Run
    from identification.rungs import Rung
    from rig_configs.schema import Rig

_MAX_AXIS_STD_DEG = 90.0  # the direction of an axis is unknown


def identify(
    *logs: Annotated[Path, Parameter(help="logs, and folders of them")],
    rig: Annotated[str | None, Parameter(help="a rig file instead of the logs' own, of the same rig")] = None,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], group=OUTPUT, help="file of the identified parameters")
    ] = Path("parameters.toml"),
    setting: Annotated[
        Literal["fast", "balanced", "reference"],
        Parameter(help=SETTING_HELP),
    ] = "balanced",
    without: Annotated[list[str] | None, Parameter(help=WITHOUT_HELP, negative="")] = None,
    span: LogSpan = WHOLE_LOG,
    settings: Settings = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Identify k1, k2, ζ1, ζ2, c3, c4, S_P with covariance from logs.

    The result is written to parameters.toml. A folder means its logs, and those one level below. Masses, lengths and
    calibration are those of the rig file in the logs. Logs of different rigs are refused. With --from and --to the fits
    take the same part of each log.

    Example: `rig identify out -o after.toml`
    """
    check_outputs("rig identify: -o", output, force=force)
    from daq.guided_test_kinds import point_of
    from daq.log.rig_of_logs import RigUse, rig_of_logs
    from daq.log.time_span import TimeSpan
    from identification import identify as find
    from identification.joint.limits import limits
    from rig_cli import results  # scipy and numba take seconds to import
    from rig_cli.parameters import limit_json

    held = _held_back(without or [])
    places = logs_of("rig identify", logs)
    part = TimeSpan(span.from_s, span.to_s)
    runs, unused = readable_runs(places, part)
    loaded = rig_of_logs([run.source for run in runs], RigUse("rig identify"), rig, settings=settings or [])
    found = find(runs, loaded, STDERR.print, setting=setting, without=held)
    parameters = results.with_version(found.parameters, settings or [], part)
    parameters.save(output)
    limited = limits(found) or []
    if json:
        limited_by = {limit.name: limit_json(limit) for limit in limited}
        facts = results.identification_json(found)
        facts["warnings"] = [*unused, *found.warnings]
        print_json({**facts, "limited_by": limited_by, "file": str(output)})
        return 0
    from rig_cli.parameters_page import limit_lines

    for line in [*results.parameter_lines(parameters), *limit_lines(limited)]:
        print(line)
    for warning in found.warnings:
        notify(f"warning: {warning}")
    notify(f"written to {output}")
    used = {source for estimate in found.estimates for source in estimate.sources}
    recorded = any(point_of(run.test) for run in runs)
    show(identify_sentence(parameters, len(used), found.to_record, output, with_points=recorded))
    return 0


def _held_back(names: list[str]) -> frozenset[Rung]:
    """Return the rungs that --without names.

    Raises:
        RigFileError: a rung of that name does not exist.
    """
    from identification.rungs import held_back  # scipy and numba take seconds to import

    try:
        return held_back(names)
    except ValueError as error:
        raise RigFileError(f"rig identify: --without: {error}") from error


@Parameter(name="*", group=AXIS_ANGLE)
@dataclass(frozen=True)
class AxisAngle:
    """Angle between sensor and stiffness axes, instead of the identified one.

    Attributes:
        axis_angle_deg, axis_angle_std_deg: value and standard uncertainty, °; both or none are given.
    """

    axis_angle_deg: Annotated[float | None, Parameter(help="instead of the identified one, with its std")] = None
    axis_angle_std_deg: Annotated[float | None, Parameter(help="standard uncertainty of --axis-angle-deg")] = None

    def checked(self) -> tuple[float, float] | None:
        """Return value and standard uncertainty, °; None if they were not given.

        Raises:
            RigFileError: only one was given, or one is out of range.
        """
        value_deg, std_deg = self.axis_angle_deg, self.axis_angle_std_deg
        if value_deg is None and std_deg is None:
            return None
        if (
            value_deg is None
            or std_deg is None
            or not math.isfinite(value_deg)
            or not 0 <= std_deg <= _MAX_AXIS_STD_DEG
        ):
            raise RigFileError(
                "rig validate: expected --axis-angle-deg and --axis-angle-std-deg together, finite, the latter 0 to "
                f"{_MAX_AXIS_STD_DEG:g}, got {value_deg} and {std_deg}"
            )
        return value_deg, std_deg


_IDENTIFIED_ANGLE = AxisAngle()


def validate(
    rig: RigFile,
    *logs: Annotated[Path, Parameter(help="logs, and folders of them")],
    parameters: ParametersPath = None,
    axis: AxisAngle = _IDENTIFIED_ANGLE,
    report: Annotated[Path | None, Parameter(group=OUTPUT, help="HTML file of the report")] = None,
    settings: Settings = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Compare steady states and releases at points with the model.

    The exit code is 1 if a point does not pass. With --set it answers a what-if: the settings override rig file and
    parameters, and no verdict is kept.

    Example: `rig validate my.toml out --parameters parameters.toml`
    """
    from daq.log.rig_of_logs import RigUse, rig_of_logs
    from studies.runs import load_runs
    from studies.validated_runs import keep_verdicts, validated

    _check_validation(report, force)
    if parameters is None:
        raise RigFileError("rig validate: give --parameters parameters.toml, as `rig identify` wrote it")
    places = logs_of("rig validate", logs, "RIG LOG|FOLDER…")
    identified = IdentifiedParameters.load(parameters)
    changed = overridden(identified, settings or [])
    known = identified.without(changed)
    use = RigUse.relying_on_estimates("rig validate", identified)
    runs = load_runs(places.logs)  # all of them: a verdict without a log of its folder would not show what is missing
    loaded = rig_of_logs([run.source for run in runs], use, rig, identified, settings or [])
    angle = axis.checked()
    what_if = list(settings or [])
    if angle is not None and known.axis_angle_deg is not None:
        what_if.append(f"axis angle {angle[0]:g} ± {angle[1]:g}°")
    found = validated(runs, loaded, known, STDERR.print, angle, changed)
    warnings = _validation_warnings(runs, found)
    if angle is None and known.axis_angle_deg is None:
        warnings.append(_assumed_angle(parameters, known, loaded))
    if not what_if:
        warnings += keep_verdicts(found, runs, IdentifiedParameters.label(parameters))
    for warning in warnings:
        notify(f"warning: {warning}")
    if report is not None:
        _write_report(report, _Validated(loaded, runs, known, found, angle, what_if, warnings))
    if json:
        more = {"passed": found.passed, "what_if": what_if, "warnings": warnings}
        print_json({**found.to_json(), **more, "report": str(report) if report else None})
    else:
        _print_validation(found, what_if)
    return 0 if found.passed else 1


@dataclass(frozen=True)
class _Validated:
    """A validation with its inputs, for the report."""

    rig: Rig
    runs: list[Run]
    known: IdentifiedParameters
    found: Validation
    angle_deg: tuple[float, float] | None
    what_if: list[str]
    warnings: list[str]


def _check_validation(report: Path | None, force: bool) -> None:
    """Check the report before the work.

    Raises:
        RigFileError, AnalysisError: the report cannot be written.
    """
    numbers = None if report is None else report.with_suffix(".json")
    check_outputs("rig validate: --report", report, numbers, force=force)
    if report is not None:
        from analysis.report.twin import need_free_twin  # matplotlib

        need_free_twin(report)


def _validation_warnings(runs: list[Run], found: Validation) -> list[str]:
    from daq.signals.completeness import missing_warnings
    from daq.signals.run import disagreements

    own = [f"{run.source}: {text}" for run in runs for text in disagreements(run)]
    return [*missing_warnings(runs), *own, *found.warnings]


def _assumed_angle(parameters: Path, known: IdentifiedParameters, rig: Rig) -> str:
    """Return the warning about an assumed angle between sensor and stiffness axes."""
    from analysis.prediction import known_axis_angle

    value, std = known_axis_angle(known, rig)
    return (
        f"{parameters} has no angle between sensor and stiffness axes: {value:g} ± {std:g}° is assumed; identify "
        "again, or give --axis-angle-deg and --axis-angle-std-deg"
    )


def _write_report(path: Path, done: _Validated) -> None:
    from analysis.report.campaign import Campaign, IdentificationResult  # matplotlib
    from analysis.report.write import write_report
    from rig_cli.parameters_budget import all_budgets

    title = f"{'What if: validation' if done.what_if else 'Validation'} of {done.rig.name}"
    campaign = Campaign(
        title,
        done.rig,
        done.runs,
        IdentificationResult(done.known, warnings=done.warnings),
        done.found,
        axis_angle_deg=done.angle_deg,
        what_if=done.what_if,
        budgets=all_budgets(done.rig, done.known),
    )
    write_report(path, campaign)


def _print_validation(found: Validation, what_if: list[str]) -> None:
    if what_if:
        print(f"{what_if_words(what_if)}: not the rig's verdict, and not kept")
    result = found.to_json()
    for line in whole_lines(result):
        show(line)
    print_points(result["points"])
    show(validation_sentence(result["points"], found.passed))


def print_points(points: dict[str, Any]) -> None:
    """Print a line per point with its verdict and reason."""
    for name, point in points.items():
        show(f"{name}: {point['verdict']:14} {point['state']:10} {point['why']}")
