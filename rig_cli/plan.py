"""`rig plan`: what to record for a wanted uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from rig_cli.console import STDERR, print_json
from rig_cli.log_places import logs_of, readable_runs
from rig_cli.options import Json, ParametersPath, Settings, warn_of_filled, what_if_words
from rig_configs import IdentifiedParameters, RigFileError, load_rig

if TYPE_CHECKING:
    from identification.plan.experiment import Experiment
    from identification.plan.planning import ExperimentPlan, PlanAnswer


def plan(
    rig: str,
    *,
    want: Annotated[list[str] | None, Parameter(help="NAME=VALUE: zeta1=1%, k1=5N/m; again for more")] = None,
    parameters: ParametersPath = None,
    log: Annotated[
        list[Path] | None, Parameter(help="a log of these sensors, or a folder of logs, to measure their noise in")
    ] = None,
    mass_std: Annotated[str, Parameter(help="relative standard uncertainty of the masses, e.g. 0.05%")] = "0%",
    settings: Settings = None,
    json: Json = False,
) -> int:
    """List the experiments that reach a wanted uncertainty: duration, amplitude, sample rate.

    The exit code is 1 if no experiment reaches it.

    Example: `rig plan my.toml --want zeta1=1%`

    Args:
        rig: a rig file, or the name of a shipped one; its parameters are the prior estimates.
    """
    from identification.plan.planning import plan_experiments as find  # numba takes seconds to import
    from identification.plan.requirements import parse_requirement
    from identification.plan.sensors import SensorProperties

    if not want:
        raise RigFileError("rig plan: give what is to be identified, for example --want zeta1=1% --want c3=2%")
    wants = [parse_requirement(text) for text in want]
    mass = share(mass_std, "rig plan: --mass-std")
    known = None if parameters is None else IdentifiedParameters.load(parameters)
    loaded = load_rig(rig, known, settings or [])
    warn_of_filled(known, loaded, settings)
    sensors = SensorProperties.of(loaded)
    if log:
        from daq.log.rig_of_logs import RigUse, rig_of_logs

        runs, _ = readable_runs(logs_of("rig plan --log", log))
        rig_of_logs([run.source for run in runs], RigUse("rig plan --log", facts=False), rig, settings=settings or [])
        sensors = sensors.as_in(runs)
    found = find(loaded, wants, sensors, mass, lambda text: STDERR.print(f"trying {text}"))
    if json:
        print_json({"rig": loaded.name, **plan_json(found), "what_if": list(settings or [])})
    else:
        from rig_cli.plan_page import print_plan

        print_plan(loaded.name, found)
        if settings:
            print(what_if_words(settings))
    return 0 if found.possible else 1


def share(text: str, where: str) -> float:
    """Read a relative standard uncertainty written as 0.1% or 0.001.

    Raises:
        RigFileError: the text has another form, or the value is not from 0 to below 1.
    """
    number, percent, after = text.strip().partition("%")
    try:
        value = float(number) / (100.0 if percent else 1.0)
    except ValueError:  # usual: reported below
        value = float("nan")
    if after or not 0 <= value < 1:
        raise RigFileError(f"{where} expected a share such as 0.1% or 0.001, got {text!r}")
    return value


def plan_json(found: ExperimentPlan) -> dict[str, Any]:
    """Return the numbers of `rig plan --json`."""
    sensors = found.sensors
    return {
        "possible": found.possible,
        "record_s": found.record_s,
        "steps": [
            {**_experiment_json(s.experiment), "runs": s.runs, "wanted_for": list(s.wanted_for)} for s in found.steps
        ],
        "wants": {a.want.name: _answer_json(a) for a in found.answers},
        "sensors": {
            "laser_noise_m": list(sensors.laser_noise_m),
            "laser_rate_Hz": list(sensors.laser_rate_Hz),
            "gain_std": list(sensors.gain_std),
            "encoder_noise_rad": sensors.encoder_noise_rad,
            "encoder_rate_Hz": sensors.encoder_rate_Hz,
            "measured": sensors.measured,
        },
        "remarks": found.remarks,
    }


def _experiment_json(experiment: Experiment) -> dict[str, Any]:
    return {
        "test": experiment.test,
        "settings": dict(experiment.settings),
        "relative_std": {n: experiment.relative_std(n) for n in experiment.expected.names},
        "relative_floor": {n: experiment.floor(n) for n in experiment.expected.names},
    }


def _answer_json(answer: PlanAnswer) -> dict[str, Any]:
    return {
        "believed": answer.believed,
        "wanted_relative_std": answer.wanted,
        "reached_relative_std": answer.reached,
        "possible": answer.possible,
        "floor_relative_std": answer.floor,
        "limited_by": answer.limited_by,
        "best_single_run": [{**_experiment_json(e), "reaches": std} for e, std in answer.best],
    }
