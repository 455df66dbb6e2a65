"""Commands that use devices: check, record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from daq.acquisition.device_check import common_factor, device_checks, passed
from daq.acquisition.life import COMMANDING, LISTENING, Policy
from daq.acquisition.observation import observe, plain_rates
from daq.acquisition.session import Session
from daq.acquisition.tap import NoTap, tap_test
from daq.drivers.checks import Checks, DeviceCheck
from daq.guided_tests.procedure import zero_counters
from daq.log.file import ReservedName
from daq.log.losses import Losses
from daq.transports import HostClock
from rig_basics.texts import number_of
from rig_cli.check_page import print_checks
from rig_cli.console import notify, print_json, show
from rig_cli.foxglove import follow_session, foxglove_of_session
from rig_cli.last_sentence import check_sentence
from rig_cli.live import TERMINAL_ONLY, Displays, follow, page_of_session
from rig_cli.numbers import LookSeconds, PositiveSeconds
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Json, RigFile, Settings, load_rig_or_log, warn_of_unusual_settings
from rig_cli.recording import RecordingStatus
from rig_cli.share_progress import share_progress
from rig_configs import load_rig


def check(
    rig: RigFile,
    *,
    seconds: Annotated[LookSeconds, Parameter(help="how long the devices are observed")] = 10.0,
    tap: Annotated[
        bool, Parameter(negative="", help="then tap the disk by hand along +x and +y: are the lasers in their places?")
    ] = False,
    zero: Annotated[
        bool, Parameter(negative="", help="first close both locks and zero the node's counters there")
    ] = False,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Compare the devices of a rig with its rig file: identities, rates, faults.

    The exit code is 3 if a device fails a check. "Not resolved" (–) is not a failure: the check needs more --seconds.

    Every device: it opens, identity, losses and restarts (a small share only by radio). With a clock: rate, clock
    against the host's (0.1 % resolved in 2 s, 50 ppm in 30 s), uncertainty of its times. Laser: position in range,
    invalid samples, repeated values, noise, steady lines such as mains hum. Node: battery, fault flags, radio signal;
    counters and noise in closed locks. Drive: state, emergencies, report rate; time-out of the host's heartbeat, with
    the drive off (not for a Modbus converter without a fault); turned by hand, five turns or more: speed against the
    index marks.

    Example: `rig check my.toml`
    """
    loaded = load_rig(rig, settings=settings or [])
    warnings = warn_of_unusual_settings(loaded)
    # a device that differs from the rig file is a failed check here, not an error
    session = Session(loaded, HostClock(), policy=Policy(lenient=True))
    with session:
        if zero:
            zero_counters(session)
        started = session.clock.now_ns()
        with share_progress(f"{loaded.name} is observed", seconds, "s") as progress:
            look = observe(session, seconds, progress)
        rates = plain_rates(session, started)
        devices = device_checks(loaded, look)
        if tap:
            devices = _with_taps(session, devices)
    if session.rotor_warning:
        warnings.append(session.rotor_warning)
        notify(f"warning: {session.rotor_warning}")
    factor = common_factor(look)
    if factor is not None:
        warnings.append(f"all clocks run {factor:.3g} times as fast as the host's: is the host's right?")
        notify(f"warning: {warnings[-1]}")
    good = all(map(passed, devices.values()))
    if json:
        print_json(
            {
                "rig": loaded.name,
                "verdict": "pass" if good else "fail",
                "seconds": look.seconds,
                "devices": {name: _verdict(checks) for name, checks in devices.items()},
                "identities": session.identities,
                "rates_Hz": rates,
                "losses": look.losses,
                "warnings": warnings,
            }
        )
    else:
        print_checks(devices, session.identities, look.seconds)
        show(check_sentence(devices, session.rotor_warning))
    return 0 if good and not session.rotor_warning else 3


def _verdict(checks: Checks) -> dict[str, Any]:
    facts = {what: found.facts() for what, found in checks.items()}
    return {"verdict": "pass" if passed(checks) else "fail", "checks": facts}


def _with_taps(session: Session, devices: dict[str, Checks]) -> dict[str, Checks]:
    """Return the checks with those of the tap test added."""
    try:
        found = tap_test(session, lambda text: notify(f"now {text}"))
    except NoTap as error:
        lasers = {sensor.device for sensor in session.rig.roles.displacements}
        found = {name: {"direction_deg": DeviceCheck(None, "a tap", False, str(error))} for name in lasers}
    return {name: checks | found.get(name, {}) for name, checks in devices.items()}


_WHILE_LISTENING = (
    ". A device that answers only on request sends nothing to a program that only receives: record without --listen"
)


@Parameter(name="*")
@dataclass(frozen=True)
class RecordingOptions:
    """What is recorded, and for how long.

    Attributes:
        output: the log.
        duration: s; None: until Ctrl-C.
        listen: whether the session only receives.
        until_silent: time without data after which the recording ends; None: never.
        note: the operator's note.
    """

    output: Annotated[Path, Parameter(name=["--output", "-o"], group=OUTPUT)]
    duration: Annotated[PositiveSeconds | None, Parameter(help="seconds; without it until Ctrl-C")] = None
    listen: Annotated[
        bool, Parameter(negative="", help="receive only: configure nothing, turn nothing, record from the first byte")
    ] = False
    until_silent: Annotated[
        PositiveSeconds | None, Parameter(help="end when no device has sent data for so many seconds")
    ] = None
    note: str = ""


def record(
    rig: Annotated[str, Parameter(help="a rig file, a shipped rig, or a log whose rig and devices are used")],
    *,
    recording: RecordingOptions,
    displays: Displays = TERMINAL_ONLY,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Record every device of a rig, and show rates, losses and the disk.

    The recording ends with Ctrl-C, after --duration, or with --until-silent when no device sends data.

    Example: `rig record my.toml -o run.mcap --duration 60`
    """
    output, listen, note = recording.output, recording.listen, recording.note
    loaded, identities = load_rig_or_log(rig, settings or [])
    warn_of_unusual_settings(loaded)
    clock = HostClock()
    facts = {"test": "record", "note": note}
    with (
        ReservedName(output) as name,  # before any device is disturbed: another recording may use them
        page_of_session(displays.page, loaded, None, settings or [], json) as page,
        foxglove_of_session(displays.foxglove, loaded, json) as connection,
    ):
        policy = LISTENING if listen else COMMANDING
        session = Session(loaded, clock, identities, notify, policy=policy)
        with session.listen(name, facts) if listen else session.open():
            if not listen:
                session.start_recording(name, facts)
            shown = {"words": "recording", "note": note, "log": str(output)}
            follow(page, session, None if listen else session.stop, shown)
            follow_session(connection, session)
            with RecordingStatus(session) as status:
                ended = _record_until(session, status, recording.duration, recording.until_silent)
            if not listen:
                session.warn_of_obstacles()
            losses, disk, rates = session.recording.losses(), session.recording.disk(), session.channels.rates.summary()
            unheard = [
                f"{device}: no byte was received{_WHILE_LISTENING * listen}" for device in session.devices.unheard
            ]
            path = session.stop_recording({"ended": ended})
    slow_s = disk.slow_s if disk else 0.0
    if json:
        warnings = [*session.notices, *unheard, *([f"wrong rates: {rates}"] if rates else [])]
        print_json({"log": str(path), "ended": ended, "losses": losses, "disk_slow_s": slow_s, "warnings": warnings})
    else:
        warned = warning_words(len(session.notices), listen)
        notify(f"{path}: recorded, ended by {ended}; {Losses(losses, 'summary').words()}{warned}")
        for text in unheard:
            notify(f"warning: {text}")
        if rates:
            notify(f"warning: {rates}. Is the rig file's rate_Hz right?")
        if slow_s:
            notify(f"warning: the disk was behind for {slow_s:.1f} s in all; no data were lost")
    return 3 if session.notices and not listen else 0  # without control of the rig its notices are no error here


def warning_words(number: int, listen: bool) -> str:
    """Return the last words of a recording: how many warnings it had, and what follows from them."""
    if not number:
        return ""
    return f"; {number_of(number, 'warning')} (above)" + ("" if listen else ": the run is not clean")


def _record_until(
    session: Session, status: RecordingStatus, duration_s: float | None, until_silent_s: float | None
) -> str:
    """Wait for the end of a recording and return its cause."""
    end = math.inf if duration_s is None else session.clock.now_ns() + int(duration_s * 1e9)
    heard = False
    try:
        while session.clock.now_ns() < end:
            session.check()
            status.show()
            heard = heard or session.devices.bytes_in > 0
            if until_silent_s is not None and heard and session.devices.silent_s > until_silent_s:
                return "silence"
            session.clock.wait(0.1)
    except KeyboardInterrupt as stop:
        return str(stop) or "Ctrl-C"
    return "duration"
