"""`rig test`: one guided test, its plan without a device, or which tests of a campaign are missing."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.acquisition.session import Session
from daq.guided_test_kinds import GuidedTestRefused, GuidedTestRequest
from daq.guided_tests.controls import Controls
from daq.guided_tests.plan import plan as plan_of
from daq.guided_tests.procedure import Procedures, TestDone
from daq.guided_tests.runner import NotReached
from daq.guided_tests.test_inputs import requested_test
from daq.transports import HostClock
from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, show, wait_for_compilation
from rig_cli.foxglove import follow_session, foxglove_of_session
from rig_cli.guided_plan_page import campaign, print_campaign, print_plan
from rig_cli.guided_test_page import TestPage
from rig_cli.guided_test_result import result_sentence
from rig_cli.keyboard import Keyboard, Keys, TerminalOperator
from rig_cli.live import TERMINAL_ONLY, Displays, follow, page_of_session
from rig_cli.numbers import PositiveRpm, PositiveSeconds, SecondsOrNone
from rig_cli.option_groups import TEST_NUMBERS
from rig_cli.options import (
    Json,
    ParametersPath,
    RigFile,
    Settings,
    warn_of_filled,
    warn_of_unusual_settings,
    what_if_words,
)
from rig_configs import IdentifiedParameters, RigFileError, load_rig
from rig_configs.schema import Rig

if TYPE_CHECKING:
    from live.foxglove.session_connection import FoxgloveConnection
    from live.session_page import LivePage
    from rig_cli.tracking import LiveTracking


@Parameter(name="*", group=TEST_NUMBERS)
@dataclass(frozen=True)
class TestNumbers:
    """Numbers of a test. None: the test's own default.

    Attributes:
        top_rpm: top speed of a run-up or run-down.
        duration: its duration, s.
        speed_rpm: speed of a point or of start-ups.
        count: number of start-ups.
        pre_trigger: duration of the log before the motion, s.
        number: "NAME=VALUE" texts.
    """

    __test__ = False  # not a pytest class

    top_rpm: Annotated[PositiveRpm | None, Parameter(help="of a run-up or run-down")] = None
    duration: Annotated[PositiveSeconds | None, Parameter(help="of a run-up or run-down, s")] = None
    speed_rpm: Annotated[PositiveRpm | None, Parameter(help="of a point or start-ups, instead of the point's own")] = (
        None
    )
    count: Annotated[int | None, Parameter(help="how many start-ups")] = None
    pre_trigger: Annotated[
        SecondsOrNone | None, Parameter(help="s of a ring-down's or spin-down's log before the motion")
    ] = None
    number: Annotated[list[str] | None, Parameter(help="NAME=VALUE: any number of a test; its plan lists them")] = None

    def by_name(self) -> dict[str, float]:
        """Return the given numbers by their names in a test.

        Raises:
            RigFileError: a text is not NAME=VALUE.
        """
        named = {
            "top_rpm": self.top_rpm,
            "duration_s": self.duration,
            "speed_rpm": self.speed_rpm,
            "count": self.count,
            "pre_trigger_s": self.pre_trigger,
        }
        return {name: float(value) for name, value in named.items() if value is not None} | _numbers(self.number or [])


@Parameter(name="*")
@dataclass(frozen=True)
class TestRun:
    """How a test is run.

    Attributes:
        plan: whether only its plan is shown.
        out: folder of the logs.
        note: the operator's note.
        parameters: parameters.toml over the rig file
        track: whether c3 and c4 are tracked.
    """

    __test__ = False  # not a pytest class

    plan: Annotated[bool, Parameter(negative="", help="show the states, open no device")] = False
    out: Path = Path("out")
    parameters: ParametersPath = None
    note: str = ""
    track: Annotated[bool, Parameter(negative="", help="show c3 and c4 while the pendulums swing")] = False


_DEFAULT_NUMBERS, _DEFAULT_RUN = TestNumbers(), TestRun()


def test(
    rig: RigFile,
    name: Annotated[str | None, Parameter(help="a test; without one: tests of the rig, and which are missing")] = None,
    point: Annotated[str | None, Parameter(help="name of a point of the rig file, of tests that need one")] = None,
    *,
    options: TestRun = _DEFAULT_RUN,
    numbers: TestNumbers = _DEFAULT_NUMBERS,
    displays: Displays = TERMINAL_ONLY,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Run one guided test, show its plan, or list the tests that a rig still needs.

    Without a name it lists what the rig can do and what is missing. The tests are ring-down-x, ring-down-y,
    spin-down, run-up, run-down, point NAME, start-ups NAME, and those of installed packages. While one runs in a
    terminal, p pauses it where the rig may wait, r resumes, a aborts it (the log is kept, the rotor comes to rest,
    exit code 1), n begins a note that Enter writes to the log.

    Example: `rig test my.toml ring-down-x`
    """
    parameters = options.parameters
    known = None if parameters is None else IdentifiedParameters.load(parameters)
    loaded = load_rig(rig, known, settings or [])
    warn_of_filled(known, loaded, settings)
    if name is None:
        found = campaign(loaded, options.out)
        print_json(found) if json else print_campaign(found)
        return 0
    warn_of_unusual_settings(loaded)
    wanted = _asked(loaded, name, numbers.by_name(), point or "")
    if options.plan:
        planned = plan_of(wanted)
        print_json(planned.facts()) if json else print_plan(planned)
        return 0
    label = IdentifiedParameters.label(parameters) if parameters is not None else ""
    label = label + what_if_words(settings, "; ") if label else ""
    contexts = _Displays(
        _tracking(wanted, parameters, settings) if options.track else None,
        page_of_session(displays.page, loaded, parameters, settings or [], json),
        foxglove_of_session(displays.foxglove, loaded, json),
    )
    return _run(wanted, options, label, contexts, json)


def _numbers(texts: list[str]) -> dict[str, float]:
    found: dict[str, float] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:  # usual: reported below
            sign = ""
        if not sign:
            raise RigFileError(f"--number {text!r}: expected NAME=VALUE, for example top_rpm=900")
    return found


def _asked(rig: Rig, name: str, given: dict[str, float], point: str = "") -> GuidedTestRequest:
    """Return a test with all its numbers.

    Raises:
        RigFileError: the test cannot be run with these numbers.
    """
    try:
        return requested_test(rig, name, given, point)
    except GuidedTestRefused as why:
        raise RigFileError(str(why)) from why


@dataclass(frozen=True)
class _Displays:
    """Displays of a running test.

    Attributes:
        tracking: starts tracking of an open session; None without --track.
        page: context of the live page.
        foxglove: context of the connection for Foxglove.
    """

    tracking: Callable[[Session], LiveTracking] | None
    page: AbstractContextManager[LivePage | None]
    foxglove: AbstractContextManager[FoxgloveConnection | None]


def _tracking(
    wanted: GuidedTestRequest, parameters: Path | None, settings: list[str] | None
) -> Callable[[Session], LiveTracking]:
    """Return a function that starts tracking of a session. The tracker is compiled before a device is opened."""
    with wait_for_compilation("tracking"):
        from rig_cli import tracking  # numba takes seconds to import

        tracking.compile_tracker(wanted.rig.physics)
    std = tracking.imbalance_std(parameters, settings or [])
    return lambda session: tracking.LiveTracking(session, std, parameters)


@contextmanager
def stop_stated() -> Generator[list[Session]]:
    """State after Ctrl-C, when the session is closed, whether the rotor is at rest and where the log is."""
    opened: list[Session] = []
    try:
        yield opened
    except KeyboardInterrupt:
        for session in opened:
            log = session.recording.path
            kept = "no log had begun" if log is None else f"the log is kept: {log}"
            notify(f"the test was stopped; {session.rotor_warning or 'the rotor is at rest'}; {kept}")
        raise


def _run(wanted: GuidedTestRequest, options: TestRun, label: str, displays: _Displays, as_json: bool) -> int:
    controls = Controls()
    keys = Keys(controls)
    early: NotReached | None = None
    done: TestDone | None = None
    with stop_stated() as opened, ExitStack() as stack:
        live_page, connection = stack.enter_context(displays.page), stack.enter_context(displays.foxglove)
        session = stack.enter_context(Session(wanted.rig, HostClock(), notify=notify))
        opened.append(session)
        following = stack.enter_context(displays.tracking(session)) if displays.tracking is not None else None
        keyboard = stack.enter_context(Keyboard(keys))
        words = following.words if following is not None else str
        page = stack.enter_context(TestPage(session, controls, keys if keyboard.there else None, words))
        prompted = follow(live_page, session, session.stop, {"note": options.note}, controls, keys.confirmed.set)
        follow_session(connection, session)
        operator = TerminalOperator(keyboard, prompted, live_page is not None)
        tests = Procedures(session, operator, options.out, page.update, options.note, controls)
        try:
            done = tests.carry_out(wanted, label)
        except NotReached as why:
            early = why
    tracked = {"tracked": following.facts()} if following is not None else {}
    if early is not None:
        return _show_early(wanted.test, early, session.notices, tracked, as_json)
    assert done is not None
    return _show(done, session.notices, tracked, as_json)


def _show_early(test: str, early: NotReached, notices: list[str], tracked: dict[str, Any], as_json: bool) -> int:
    """Report a test that ended before its log began."""
    if as_json:
        ended = {"reached": False, "ended": f"not reached: {early}", "aborted": early.aborted}
        print_json({"test": test, "log": None, **ended, **tracked, "warnings": notices})
    else:
        notify(f"{test} did not reach its end: {early}. No log had begun")
    return 3 if notices else 1


def _show(done: TestDone, notices: list[str], tracked: dict[str, Any], as_json: bool) -> int:
    if as_json:
        repeated: dict[str, Any] = {
            "runs": [{"log": str(run.log), **run.summary} for run in done.runs],
            "reached": not done.missed,
            "ended": f"not reached: {done.missed}" if done.missed else "done",
        }
        more = {"aborted": done.aborted, **tracked, "warnings": [*notices, *done.warnings]}
        print_json({"test": done.test, "log": str(done.log), **done.summary, **(repeated if done.runs else {}), **more})
    else:
        for warning in done.warnings:
            notify(f"warning: {warning}")
        for line in _counts(done):
            notify(line)
        notify(f"{done.log}: {ending_words(done)}")
        show(result_sentence(done))
    return 3 if notices else 1 if done.missed else 0


def _counts(done: TestDone) -> list[str]:
    """Return the result lines of a repeated test; an empty list for other tests."""
    counted = done.summary.get("classes")
    if not done.runs or counted is None:
        return []
    lines = [
        f"{number_of(done.summary['start_ups'], 'start-up')}: {', '.join(f'{n} {name}' for name, n in counted.items())}"
    ]
    for state, measured in done.summary["measured"].items():
        figures = (f"{key} {v['mean']:.5g} ({v['least']:.5g} … {v['largest']:.5g})" for key, v in measured.items())
        lines.append(f"  {state}, {done.summary['states'][state]}: {', '.join(figures) or 'nothing measured'}")
    return lines


def ending_words(done: TestDone) -> str:
    """Return how a test ended, for its operator."""
    return f"{done.test} did not reach its end: {done.missed}" if done.missed else f"{done.test} done"


def run_test(tests: Procedures, rig: Rig, name: str, parameters: str = "") -> TestDone:
    """Run one guided test by its name; its speeds follow from the rig's k1 and k2.

    Args:
        tests: runs it.
        rig: the rig, with the identified parameters if there are any.
        name: name of the test.
        parameters: name of the identified parameters, for the log; empty without them.

    Raises:
        RigFileError: the rig cannot run it.
    """
    return tests.carry_out(_asked(rig, name, {}), parameters)
