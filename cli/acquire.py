"""Commands that talk to devices: check, record, test."""

from __future__ import annotations

import math
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from cli.check_page import look_at, plain_rates, print_checks
from cli.console import StepProgress, print_json, say, wait_for_compilation
from cli.numbers import LookSeconds, PositiveRpm, PositiveSeconds, TimeScale
from cli.options import Json, ParametersPath, Settings, rig_or_log, what_if_words
from cli.recording import RecordingStatus
from daq.acquisition.device_check import common_factor, device_checks, passed
from daq.acquisition.session import Session
from daq.errors import ProcedureError
from daq.guided_tests import test_inputs
from daq.guided_tests.procedure import Procedures, TestDone, zero_counters
from daq.log.file import ReservedName
from daq.log.losses import Losses
from daq.transports import HostClock
from rig_configs import IdentifiedParameters, RigFileError, load_rig
from rig_configs.schema import Rig

_RAMP_S = 40.0


class TerminalOperator:
    """Asks the person at the terminal; the test goes on when the sensors see that it was done."""

    def pluck(self, axis: str) -> None:
        """See daq.guided_tests.hands.Operator."""
        say(f">>> displace the column by 2 to 3 mm along {axis} and let go")

    def flick(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        say(">>> flick both pendulums, slower than two turns a second")

    def lock(self, seen: bool) -> None:
        """See daq.guided_tests.hands.Operator."""
        say(">>> the rotor at rest: lock both pendulums, A at 0° and B at 180°")
        if not seen:
            self._confirm("no encoder sees the pendulums: press Enter when both are locked")

    def release(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        say(">>> release both pendulums, both at once")

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """See daq.guided_tests.hands.Operator."""
        if rpm:
            say(f">>> turn the rotor to {rpm:.0f} rpm, by about {ramp_rpm_per_s:.0f} rpm a second, and hold it there")
        else:
            say(f">>> bring the rotor to rest, by about {ramp_rpm_per_s:.0f} rpm a second")

    @staticmethod
    def _confirm(text: str) -> None:
        """Wait for the person to say that it is done.

        Raises:
            ProcedureError: nobody is there to say it.
        """
        say(f">>> {text}")
        if not sys.stdin.isatty():
            raise ProcedureError(f"{text}: standard input is no terminal, so nobody can. Run the test in a terminal")
        sys.stdin.readline()


def check(
    rig: str,
    *,
    seconds: LookSeconds = 2.0,
    zero: Annotated[
        bool, Parameter(negative="", help="close both locks and zero the node's counters there before looking")
    ] = False,
    time_scale: TimeScale = 1.0,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Validate a rig file, open its devices, hold what they do against it; exit 1 when a device fails a check."""
    loaded = load_rig(rig, settings=settings or [])
    session = Session(loaded, HostClock(time_scale))
    session.lenient = True  # a device that is not what the rig file says is a verdict here
    with session:
        if zero:
            zero_counters(session)
        started = session.clock.now_ns()
        look = look_at(session, seconds)
        devices = device_checks(loaded, look)
        rates = plain_rates(session, started)
    factor = common_factor(look)
    if factor is not None:
        say(f"warning: all clocks run {factor:.3g} times as fast as ours: is --time-scale {time_scale:g} right?")
    good = all(map(passed, devices.values()))
    if json:
        verdicts = {
            name: {
                "verdict": "pass" if passed(checks) else "fail",
                "checks": {what: found.facts() for what, found in checks.items()},
            }
            for name, checks in devices.items()
        }
        print_json({"rig": loaded.name, "verdict": "pass" if good else "fail", "seconds": look.seconds,
                    "devices": verdicts, "identities": session.identities, "rates_Hz": rates,
                    "losses": look.losses})  # fmt: skip
    else:
        print_checks(devices, session.identities, look.seconds)
    return 0 if good else 1


def record(
    rig: Annotated[str, Parameter(help="a rig file, a shipped rig, or a log whose rig and devices are meant")],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    duration: Annotated[PositiveSeconds | None, Parameter(help="seconds of rig time; without it until Ctrl-C")] = None,
    listen: Annotated[
        bool, Parameter(negative="", help="only listen: configure nothing, turn nothing, record from the first byte")
    ] = False,
    until_silent: Annotated[
        PositiveSeconds | None, Parameter(help="end when no device has sent anything for so many wall seconds")
    ] = None,
    note: str = "",
    time_scale: TimeScale = 1.0,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Record every device until Ctrl-C, for --duration, or until all are silent; shows rates, losses and the disk."""
    loaded, identities = rig_or_log(rig, settings or [])
    clock = HostClock(time_scale)
    facts = {"test": "record", "note": note}
    with ReservedName(output) as name:  # before any device is disturbed: another recording may be using them
        session = Session(loaded, clock, identities, say)
        with session.listen(name, facts) if listen else session.open():
            if not listen:
                session.start_recording(name, facts)
            with RecordingStatus(session) as status:
                ended = _record_until(session, status, duration, until_silent)
            losses, disk, rates = session.losses(), session.disk(), session.rates.summary()
            path = session.stop_recording({"ended": ended})
    slow_s = disk.slow_s if disk else 0.0
    if json:
        warnings = [*session.notices, *([f"wrong rates: {rates}"] if rates else [])]
        print_json({"log": str(path), "ended": ended, "losses": losses, "disk_slow_s": slow_s, "warnings": warnings})
    else:
        say(f"{path}: recorded, ended by {ended}; {Losses(losses, 'summary').words()}")
        if rates:
            say(f"warning: {rates}. Is the rig file's rate_Hz right, and --time-scale?")
        if slow_s:
            say(f"warning: the disk was behind for {slow_s:.1f} s in all; nothing was lost by that")
    return 3 if session.notices and not listen else 0  # a rig that someone else runs is theirs to judge


def _record_until(
    session: Session, status: RecordingStatus, duration_s: float | None, until_silent_s: float | None
) -> str:
    """Wait for the end of a recording; says what ended it."""
    end = math.inf if duration_s is None else session.clock.now_ns() + int(duration_s * 1e9)
    heard = False
    try:
        while session.clock.now_ns() < end:
            session.check()
            status.show()
            heard = heard or session.bytes_in > 0
            if until_silent_s is not None and heard and session.silent_s > until_silent_s:
                return "silence"
            time.sleep(0.05)
    except KeyboardInterrupt as stop:
        return str(stop) or "Ctrl-C"
    return "duration"


def test(
    rig: str,
    name: str,
    point: str | None = None,
    *,
    out: Path = Path("out"),
    parameters: ParametersPath = None,
    note: str = "",
    top_rpm: PositiveRpm | None = None,
    duration: PositiveSeconds = _RAMP_S,
    track: Annotated[bool, Parameter(negative="", help="show c3 and c4 while the pendulums swing")] = False,
    time_scale: TimeScale = 1.0,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Run one guided test: ring-down-x, ring-down-y, spin-down, run-up, run-down, or point NAME."""
    loaded = load_rig(rig, parameters, settings or [])
    wanted = name if point is None else f"point-{point}"
    check_test(loaded, wanted, top_rpm, duration)
    tracking = None
    if track:  # compiled before a device is opened
        with wait_for_compilation("tracking"):
            from cli import tracking  # noqa: PLC0415 (numba takes seconds to import)

            tracking.compile_tracker(loaded.physics)
    with ExitStack() as stack:
        session = stack.enter_context(Session(loaded, HostClock(time_scale), say=say))
        progress = stack.enter_context(StepProgress({name: 1.0}))
        progress.step(name)
        following = None
        if tracking is not None:
            following = stack.enter_context(
                tracking.LiveTracking(session, tracking.imbalance_std(parameters, settings or []))
            )

        def tell(text: str, share: float | None) -> None:
            words = following.words() if following is not None else ""
            progress.tell(f"{text}; {words}" if words else text, share)

        tests = Procedures(session, TerminalOperator(), out, tell, note)
        if parameters is not None:
            tests.parameters = IdentifiedParameters.label(parameters) + what_if_words(settings, "; ")
        done = run_test(tests, loaded, wanted, top_rpm, duration)
    warnings = [*session.notices, *done.warnings]
    result: dict[str, Any] = {"test": done.test, "log": str(done.log), **done.summary, "warnings": warnings}
    if following is not None:
        result["tracked"] = following.facts()
    if json:
        print_json(result)
    else:
        for warning in done.warnings:
            say(f"warning: {warning}")
        say(f"{done.log}: {ending_words(done)}")
    return 3 if session.notices else 1 if done.missed else 0


def ending_words(done: TestDone) -> str:
    """How a test ended, as its operator is told."""
    return f"{done.test} did not reach its end: {done.missed}" if done.missed else f"{done.test} done"


def check_test(rig: Rig, name: str, top_rpm: float | None = None, duration_s: float = _RAMP_S) -> None:
    """Refuse a test that this rig does not have or cannot run as asked, before any device is opened.

    Raises:
        RigFileError: no such test or point, a speed or a duration beyond what limits and drive allow.
    """
    top = test_inputs.default_top_rpm(rig) if top_rpm is None else top_rpm
    if why := test_inputs.refusal(rig, name, top, duration_s):
        raise RigFileError(why)


def run_test(
    tests: Procedures, rig: Rig, name: str, top_rpm: float | None = None, duration_s: float = _RAMP_S
) -> TestDone:
    """One guided test by its name; speeds follow from the rig's (identified) k1 and k2.

    Raises:
        RigFileError: as `check_test`.
    """
    check_test(rig, name, top_rpm, duration_s)
    if name in ("ring-down-x", "ring-down-y"):
        return tests.ring_down(name[-1])
    if name == "spin-down":
        return tests.spin_down()
    if name in ("run-up", "run-down"):
        through = tests.run_up if name == "run-up" else tests.run_down
        return through(test_inputs.default_top_rpm(rig) if top_rpm is None else top_rpm, duration_s)
    point = name.removeprefix("point-")
    return tests.point(point, rig.physics.speed_rad_s(rig.points[point].speed_ratio))
