"""`rig demo`: the main job on the virtual rig, with the verbs and drivers that run a real one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from daq.acquisition.session import Session
from daq.guided_test_kinds import point_of
from daq.guided_tests.controls import Controls
from daq.guided_tests.procedure import Procedures, TestDone
from daq.guided_tests.test_inputs import possible_tests
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli.console import StepProgress, notify, print_json
from rig_cli.foxglove import follow_session, foxglove_of_session
from rig_cli.guided_test import ending_words, run_test
from rig_cli.live import TERMINAL_ONLY, Displays, follow, page_of_session
from rig_cli.option_groups import OUTPUT, SIMULATION
from rig_cli.options import Json, RigFile, Settings
from rig_cli.simulated import VirtualRigProcess
from rig_cli.validation_page import whole_lines
from rig_cli.workbench import Workbench
from rig_configs import IdentifiedParameters, RigFileError, load_rig, parse_setting, with_parameters
from rig_configs.load import with_truth
from rig_configs.schema import Rig

if TYPE_CHECKING:
    from live.foxglove.session_connection import FoxgloveConnection
    from live.session_page import LivePage

_BEFORE_POINTS = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
_FITTED_TOGETHER = (("ring-down-x", "ring-down-y"), ("run-up",), ("spin-down",))
"""Groups of these tests, in the order of their fits: that of the spin-down uses the run-up."""
_USUAL_S = {"start": 4.0, "run-up": 6.0, "identify": 6.0, "report": 8.0}  # s, weights of the bar; others 2 or 7


@dataclass(frozen=True)
class TruthChange:
    """A change of the simulated rig's truth just before a step."""

    key: str
    value: Any
    step: str


@Parameter(name="*", group=SIMULATION)
@dataclass(frozen=True)
class Simulation:
    """How the virtual rig is run.

    Attributes:
        seed: of its noise, clocks and calibration errors; None: the rig file's.
        fault: "KEY=VALUE@STEP" texts.
        real_time: whether it runs in a process of its own behind ports; otherwise on simulated time, in this thread.
        link: wires of these ports: pty, tcp or auto.
    """

    seed: int | None = None
    fault: Annotated[list[str] | None, Parameter(help="KEY=VALUE@STEP: change the truth just before a step")] = None
    real_time: Annotated[
        bool,
        Parameter(
            negative="",
            help="over ports, as long as on a real rig; without it as fast as the machine, the same bytes each time",
        ),
    ] = False
    link: Annotated[Literal["auto", "pty", "tcp"], Parameter(help="wires of --real-time")] = "auto"


_DEFAULT = Simulation()


def demo(
    *,
    rig: RigFile = "virtual",
    out: Annotated[Path, Parameter(group=OUTPUT, help="folder of logs and report; a new one each time")] = Path(
        "out/demo"
    ),
    simulation: Simulation = _DEFAULT,
    settings: Settings = None,
    displays: Displays = TERMINAL_ONLY,
    json: Json = False,
) -> int:
    """Record, identify, validate and report a whole campaign on the virtual rig.

    The tests run through the real drivers.

    Example: `rig demo`
    """
    started = time.monotonic()
    seed = simulation.seed
    changes = list(settings or []) + ([f"virtual.seed={seed}"] if seed is not None else [])
    loaded = load_rig(rig, settings=changes)
    if simulation.link != "auto" and not simulation.real_time:
        raise RigFileError(f"--link {simulation.link}: expected --real-time too; simulated time has no wires")
    faults = [_parse_fault(text, loaded) for text in simulation.fault or []]
    folder = _fresh(out)
    steps = _steps(loaded)
    progress = StepProgress({s: _USUAL_S.get(s, 7.0 if point_of(s) else 2.0) for s in steps})
    workbench = Workbench()
    try:
        with (
            progress,
            page_of_session(displays.page, loaded, None, changes, json, progress.notify) as page,
            foxglove_of_session(displays.foxglove, loaded, json, progress.notify) as connection,
        ):
            far = _far_end(rig, loaded, changes, simulation)
            setup = _Setup(rig, changes, loaded, faults, folder, far, page, connection)
            result = _Campaign(setup, progress, workbench).run()
    finally:
        workbench.close()
    result["seconds"] = time.monotonic() - started
    _show(result, json)
    return 1 if result["passed"] is False or result["not_reached"] else 0


def _far_end(name: str, rig: Rig, changes: list[str], simulation: Simulation) -> VirtualRigProcess | LockstepRig:
    if simulation.real_time:
        return VirtualRigProcess(name, changes, simulation.link)
    return LockstepRig(rig)


def _steps(rig: Rig) -> list[str]:
    tests = possible_tests(rig)
    points = [test for test in tests if point_of(test)]
    before = [test for test in _BEFORE_POINTS if test in tests]
    return ["start", *before, "identify", *points, "report"]


def _parse_fault(text: str, rig: Rig) -> TruthChange:
    setting, sign, step = text.rpartition("@")
    known = _steps(rig)
    names = {point_of(s) or s: s for s in known} | {s: s for s in known}
    if not sign or step not in names:
        raise RigFileError(f"--fault {text!r}: expected KEY=VALUE@STEP with a step of {', '.join(known)}")
    key, value = parse_setting(setting)
    try:
        with_truth(rig, key, value)  # the simulated rig does the same later, after several tests
    except RigFileError as fault:
        raise RigFileError(f"--fault {text}: {fault}") from fault
    return TruthChange(key.removeprefix("virtual.truth."), value, names[step])


def _fresh(out: Path) -> Path:
    """Return the folder for this campaign. Logs of an earlier one are never overwritten."""
    folder, number = out, 1
    while folder.exists() and any(folder.iterdir()):
        number += 1
        folder = out.with_name(f"{out.name}-{number}")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@dataclass(frozen=True)
class _Setup:
    """Rig, folder and displays of a campaign.

    Attributes:
        name: path or name of the rig file.
        changes: "key=value" texts over it.
        rig: the rig file with these changes.
        faults: in any order.
        folder: of logs, parameters and report.
        far: the simulated rig, not running yet.
        page: the live page; None without one.
        connection: the connection for Foxglove; None without one.
    """

    name: str
    changes: list[str]
    rig: Rig
    faults: list[TruthChange]
    folder: Path
    far: VirtualRigProcess | LockstepRig
    page: LivePage | None
    connection: FoxgloveConnection | None


class _Campaign:
    """Recording, identification and validation of all tests of a rig."""

    def __init__(self, setup: _Setup, progress: StepProgress, workbench: Workbench) -> None:
        self._setup, self._progress, self._workbench = setup, progress, workbench
        self._steps = _steps(setup.rig)
        self._logs: list[Path] = []
        self._done: list[TestDone] = []
        self._refinements: list[Future[None]] = []

    def run(self) -> dict[str, Any]:
        """Run the campaign and return its result."""
        setup = self._setup
        self._progress.step("start")
        wanted = (*_BEFORE_POINTS, *(f"point-{name}" for name in setup.rig.points))
        if left_out := [test for test in wanted if test not in self._steps]:
            self._progress.notify(f"no device for: {', '.join(left_out)}")
        with setup.far as simulated:
            truth = simulated.ask("truth")["truth"]
            plugged = load_rig(setup.name, settings=[*setup.changes, *simulated.port_settings()])
            with Session(plugged, simulated.clock, edge=simulated.edge) as session:
                controls = Controls()
                operator, folder = SimulatedOperator(simulated), setup.folder
                tests = Procedures(session, operator, folder / "logs", self._progress.update, "", controls)
                follow(setup.page, session, _stop_of(session, setup.far), {"log": str(folder)}, controls)
                follow_session(setup.connection, session)
                label = self._record_all(tests, plugged)
            radio = simulated.ask("state")
        result = self._conclude(plugged, truth, label, radio)
        result["warnings"] += [session.rotor_warning] if session.rotor_warning else []
        return result

    def _record_all(self, tests: Procedures, plugged: Rig) -> str:
        """Record the tests before the points, identify from them, record the points; return the parameters' name."""
        workbench, refinements = self._workbench, self._refinements
        groups = [[test for test in group if test in self._steps] for group in _FITTED_TOGETHER]
        logs = dict[str, Path]()
        for test in (step for step in self._steps if step in _BEFORE_POINTS):
            logs[test] = self._record(tests, plugged, test)
            while groups and logs.keys() >= set(groups[0]):
                if group := groups.pop(0):
                    refinements.append(workbench.refine(plugged, [logs[fitted] for fitted in group]))
        self._begin("identify")
        parameters = self._setup.folder / "parameters-before-points.toml"
        workbench.wait(workbench.identify(plugged, parameters), self._progress.update)
        label = IdentifiedParameters.label(parameters)
        identified = with_parameters(plugged, IdentifiedParameters.load(parameters))
        for point in (step for step in self._steps if point_of(step)):
            refinements.append(workbench.refine(plugged, [self._record(tests, identified, point, label)]))
        return label

    def _record(self, tests: Procedures, rig: Rig, test: str, parameters: str = "") -> Path:
        """Record a test and return its log."""
        self._begin(test)
        done = run_test(tests, rig, test, parameters)
        self._done.append(done)
        if done.missed:
            self._progress.notify(ending_words(done))
        self._logs.append(done.log)
        return done.log

    def _begin(self, step: str) -> None:
        """Start a step and place its faults."""
        self._progress.step(step)
        for fault in [f for f in self._setup.faults if f.step == step]:
            self._setup.far.ask("set", key=fault.key, value=fault.value)
            self._progress.notify(f"fault: {fault.key} = {fault.value} before {step}")

    def _conclude(
        self, plugged: Rig, truth: dict[str, Any], parameters: str, radio: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Validate, write parameters and report, compare the radio's counts meanwhile, and return the result."""
        setup, progress, workbench = self._setup, self._progress, self._workbench
        progress.step("report")
        assert setup.rig.virtual is not None
        facts = {
            "truth": truth,
            "seed": setup.rig.virtual.seed,
            "validated_with": parameters,
            "notes": [f"Before {f.step} the simulated rig's {f.key} was changed to {f.value}." for f in setup.faults],
        }
        report = setup.folder / "report.html"
        for refinement in self._refinements:
            workbench.wait(refinement, progress.update)
        progress.update("writing the report")
        job = workbench.conclude(plugged, setup.folder / "parameters.toml", report, facts)
        checks = _radio_checks(self._logs, radio)
        result = workbench.wait(job, progress.update)
        result["radio"], result["truth"] = checks, truth
        result["logs"] = [str(path) for path in self._logs]
        result["not_reached"] = {done.test: done.missed for done in self._done if done.missed}
        result["warnings"] += [f"{done.test}: {warning}" for done in self._done for warning in done.warnings]
        result["report"] = str(report)
        return result


def _stop_of(session: Session, far: VirtualRigProcess | LockstepRig) -> Callable[[str], None]:
    """Return the function of the page's stop. On simulated time only the thread that advances it may send."""
    return session.request_stop if isinstance(far, LockstepRig) else session.stop


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
    from daq.replay.stream import decoded, pipelines_of

    with open_log(path) as log:
        numbered = {name: each for name, each in pipelines_of(log).items() if "radio_frames" in each.losses}
        for _ in decoded(log, numbered):
            pass
        losses = loads(log.metadata["summary"]["losses"])
    counted = sum(int(losses[name]["radio_frames"]) for name in numbered)
    found = (each.pipeline.status.heard_frames for each in numbered.values())
    heard = next((numbers for numbers in found if numbers is not None), None)
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
