"""`rig demo`: the main job on the virtual rig, with the verbs and drivers that run a real one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.acquisition.session import Session
from daq.errors import OperatorStop
from daq.guided_tests.controls import Controls
from daq.guided_tests.procedure import Procedures, TestDone
from daq.guided_tests.test_inputs import possible_tests
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli.console import StepProgress, notify, print_json
from rig_cli.foxglove import Foxglove, follow_session, foxglove_of_session
from rig_cli.guided_test import ending_words, run_test
from rig_cli.live import Live, LiveHost, LivePort, follow, page_of_session
from rig_cli.numbers import TimeScale
from rig_cli.options import Json, Settings
from rig_cli.simulated import VirtualRigProcess
from rig_cli.validation_page import whole_lines
from rig_cli.workbench import Workbench
from rig_configs import IdentifiedParameters, RigFileError, load_rig, parse_setting, with_parameters
from rig_configs.load import with_truth
from rig_configs.schema import Rig

if TYPE_CHECKING:
    from live.beside import LivePage
    from live.foxglove.beside import FoxgloveBeside

_BEFORE_POINTS = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
_USUAL_S = {"start": 4.0, "run-up": 6.0, "identify": 6.0, "report": 8.0}  # s, weights of the bar; others 2 or 7


@dataclass(frozen=True)
class Fault:
    """A change of the simulated rig's truth just before a step."""

    key: str
    value: Any
    step: str


def demo(
    *,
    rig: str = "virtual",
    out: Path = Path("out/demo"),
    seed: int | None = None,
    time_scale: TimeScale = 8.0,
    settings: Settings = None,
    fault: Annotated[list[str] | None, Parameter(help="KEY=VALUE@STEP: change the truth just before a step")] = None,
    link: str = "auto",
    lockstep: Annotated[
        bool,
        Parameter(negative="", help="simulated time: repeatable bit for bit by its seed, as fast as it computes"),
    ] = False,
    live: Live = False,
    live_host: LiveHost = "",
    live_port: LivePort = 0,
    foxglove: Foxglove | None = None,
    json: Json = False,
) -> int:
    """A whole campaign on the virtual rig: tests recorded through the real drivers, identified, validated, reported."""
    started = time.monotonic()
    changes = list(settings or []) + ([f"virtual.seed={seed}"] if seed is not None else [])
    loaded = load_rig(rig, settings=changes)
    faults = [_parse_fault(text, loaded) for text in fault or []]
    folder = _fresh(out)
    steps = _steps(loaded)
    progress = StepProgress({s: _USUAL_S.get(s, 7.0 if s.startswith("point") else 2.0) for s in steps})
    workbench = Workbench()
    try:
        rate = 1.0 if lockstep else time_scale
        with (
            progress,
            page_of_session(live, loaded, None, changes, rate, live_host, live_port, json, progress.notify) as page,
            foxglove_of_session(foxglove, loaded, rate, json, progress.notify) as given,
        ):
            far = (
                LockstepRig(loaded)
                if lockstep
                else VirtualRigProcess(rig, changes, time_scale, link, waits=time_scale > 1)
            )
            result = _campaign(rig, changes, loaded, faults, folder, far, progress, workbench, page, given)
    finally:
        workbench.close()
    result["seconds"] = time.monotonic() - started
    _show(result, json)
    return 1 if result["passed"] is False or result["not_reached"] else 0


def _steps(rig: Rig) -> list[str]:
    tests = possible_tests(rig)
    points = [test for test in tests if test.startswith("point-")]
    return ["start", *(test for test in _BEFORE_POINTS if test in tests), "identify", *points, "report"]


def _parse_fault(text: str, rig: Rig) -> Fault:
    setting, sign, step = text.rpartition("@")
    known = _steps(rig)
    names = {s.removeprefix("point-"): s for s in known} | {s: s for s in known}
    if not sign or step not in names:
        raise RigFileError(f"--fault {text!r}: expected KEY=VALUE@STEP with a step of {', '.join(known)}")
    key, value = parse_setting(setting)
    try:
        with_truth(rig, key, value)  # the simulated rig does the same later, after several tests
    except RigFileError as fault:
        raise RigFileError(f"--fault {text}: {fault}") from fault
    return Fault(key.removeprefix("virtual.truth."), value, names[step])


def _fresh(out: Path) -> Path:
    """Return the folder for this campaign. Logs of an earlier one are never overwritten."""
    folder, number = out, 1
    while folder.exists() and any(folder.iterdir()):
        number += 1
        folder = out.with_name(f"{out.name}-{number}")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _campaign(
    name: str,
    changes: list[str],
    rig: Rig,
    faults: list[Fault],
    folder: Path,
    far: VirtualRigProcess | LockstepRig,
    progress: StepProgress,
    workbench: Workbench,
    page: LivePage | None,
    given: FoxgloveBeside | None,
) -> dict[str, Any]:
    progress.step("start")
    steps = _steps(rig)
    if left_out := [test for test in (*_BEFORE_POINTS, *(f"point-{name}" for name in rig.points)) if test not in steps]:
        progress.notify(f"no device for: {', '.join(left_out)}")
    tests_done: list[TestDone] = []
    refinements: list[Future[None]] = []
    with far as simulated:
        truth = simulated.ask("truth")["truth"]
        plugged = load_rig(name, settings=[*changes, *simulated.port_settings()])

        def begin(step: str) -> None:
            progress.step(step)
            for fault in [f for f in faults if f.step == step]:
                simulated.ask("set", key=fault.key, value=fault.value)
                progress.notify(f"fault: {fault.key} = {fault.value} before {step}")

        with Session(plugged, simulated.clock, edge=simulated.edge) as session:
            controls = Controls()
            tests = Procedures(session, SimulatedOperator(simulated), folder / "logs", progress.update, "", controls)
            follow(page, session, _stop_of(session, far), {"log": str(folder)}, controls)
            follow_session(given, session)

            def record(rig: Rig, test: str) -> Path:
                done = run_test(tests, rig, test)
                tests_done.append(done)
                if done.missed:
                    progress.notify(ending_words(done))
                return done.log

            logs: list[Path] = []
            for test in (step for step in steps if step in _BEFORE_POINTS):
                begin(test)
                logs.append(record(plugged, test))
            begin("identify")
            parameters = folder / "parameters-before-points.toml"
            workbench.wait(workbench.identify(plugged, logs, parameters), progress.update)
            known = IdentifiedParameters.load(parameters)
            tests.parameters = IdentifiedParameters.label(parameters)
            identified = with_parameters(plugged, known)
            for point in (step for step in steps if step.startswith("point-")):
                begin(point)
                logs.append(record(identified, point))
                refinements.append(workbench.refine(plugged, logs[-1]))
        radio = simulated.ask("state")
    progress.step("report")
    assert rig.virtual is not None
    facts = {
        "truth": truth,
        "seed": rig.virtual.seed,
        "validated_with": tests.parameters,
        "notes": [f"Before {f.step} the simulated rig's {f.key} was changed to {f.value}." for f in faults],
    }
    report = folder / "report.html"
    for refinement in refinements:
        workbench.wait(refinement, progress.update)
    progress.update("writing the report")
    result = workbench.wait(workbench.conclude(plugged, folder / "parameters.toml", report, facts), progress.update)
    result["truth"] = truth
    result["radio"] = _radio_checks(logs, radio)
    result["logs"] = [str(path) for path in logs]
    result["not_reached"] = {done.test: done.missed for done in tests_done if done.missed}
    result["warnings"] += [f"{done.test}: {warning}" for done in tests_done for warning in done.warnings]
    result["warnings"] += [session.left] if session.left else []
    result["report"] = str(report)
    return result


def _stop_of(session: Session, far: VirtualRigProcess | LockstepRig) -> Callable[[str], None]:
    """Return the function of the page's stop. On simulated time only the thread that advances it may send."""
    if not isinstance(far, LockstepRig):
        return session.stop

    def stop(reason: str) -> None:
        session.trouble = session.trouble or OperatorStop(reason)

    return stop


def _radio_checks(logs: list[Path], radio: Mapping[str, Any]) -> list[dict[str, Any]]:
    """See `_radio_check`, log by log in the order of recording: a log has its frame numbers modulo 65536 only."""
    checks: list[dict[str, Any]] = []
    last = 0
    for path in logs:
        checked, last = _radio_check(path, radio, last)
        checks.append(checked)
    return checks


def _radio_check(path: Path, radio: Mapping[str, Any], since: int = 0) -> tuple[dict[str, Any], int]:
    """Compare the frames that this log counted as lost with those that the simulated radio dropped meanwhile.

    Args:
        since: number of a frame before the log's first, fewer than 65536 frames earlier.

    Returns:
        The comparison, and the number of the log's last frame.
    """
    from daq.drivers.contract import CountsFrames
    from daq.replay.stream import decoded, pipelines_of

    with open_log(path) as log:
        pipelines = pipelines_of(log)
        radios = {name: pipeline for name, pipeline in pipelines.items() if isinstance(pipeline, CountsFrames)}
        for _ in decoded(log, radios):
            pass
        losses = loads(log.metadata["summary"]["losses"])
    counted = sum(int(losses[name]["radio_frames"]) for name in radios)
    heard = next((p.heard_frames for p in radios.values() if p.heard_frames is not None), None)
    if heard is None:
        return {"log": path.name, "counted": counted, "dropped": 0}, since
    first = since + (heard[0] - since) % 65536
    last = first + (heard[1] - heard[0]) % 65536
    dropped = sum(first < number <= last for number in radio.get("dropped", ()))
    return {"log": path.name, "counted": counted, "dropped": dropped}, last


def _show(result: Mapping[str, Any], as_json: bool) -> None:
    if as_json:
        print_json({k: v for k, v in result.items() if k != "lines"})
        return
    print("Identified parameters against the simulated truth:")
    for line in result["lines"]:
        print(f"  {line}")
    print("Points:")
    for line in whole_lines(result):
        print(f"  {line}")
    for name, point in result["points"].items():
        print(f"  {name}: {point['verdict']:14} {point['state']:10} {point['why']}")
    for test, missed in result["not_reached"].items():
        print(f"  {test} did not reach its end: {missed}")
    for warning in result["warnings"]:
        notify(f"warning: {warning}")
    lost = sum(row["counted"] for row in result["radio"])
    dropped = sum(row["dropped"] for row in result["radio"])
    print(f"Radio frames lost: {lost} counted, {dropped} dropped by the simulated radio")
    print(f"Report: {result['report']}   ({result['seconds']:.0f} s)")
