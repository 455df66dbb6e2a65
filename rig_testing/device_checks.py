"""Tests of a driver with its device: settings, roles, opening dialogue, stream, stop, the stand-in for playing."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import numpy as np
from pydantic import ValidationError

from daq.drivers.contract import DeviceLine
from daq.drivers.driver import CLAIMS
from daq.drivers.simulated import FarEnd
from daq.errors import DeviceError, LinkLost
from daq.items import RX
from daq.lockstep.clock import START_NS
from rig_basics.texts import number_of
from rig_configs.device import DeviceSettings
from rig_configs.roles import DisplacementSensor, OtherQuantity, PendulumAngles, PendulumLocks, Roles
from rig_testing.bench import NAME, STEP_S, DriverBench, PlayedTalk
from rig_testing.own_waits import own_waits
from rig_testing.report import Failed, need
from rig_testing.subject import Subject, events, together, turn

_SILENT = "falls silent"
_NEAR_S = 1.0  # largest difference of a sample's time from the host's


def check_settings(subject: Subject) -> str:
    """The settings class accepts the example, rejects unknown keys, and survives JSON."""
    driver = subject.driver
    kind: Any = driver.settings  # its type is not checked before
    need(
        isinstance(kind, type) and issubclass(kind, DeviceSettings),
        f"settings: expected a class derived from DeviceSettings, got {kind!r}",
    )
    try:
        settings = subject.settings
    except ValidationError as error:
        raise Failed(f"settings: the attribute `example` ({driver.example}) is not valid: {error}") from error
    table = {"driver": driver.name, "port": "x", **driver.example}
    try:
        driver.settings.model_validate({**table, "no_such_setting": 1})
    except ValidationError:  # usual: the check requires this error
        pass
    else:
        raise Failed("settings: an unknown key is accepted, expected a ValidationError: a typo would not be noticed")
    again = driver.settings.model_validate_json(settings.model_dump_json())
    need(again == settings, f"settings: {settings!r} became {again!r} through JSON, the format of a log")
    line: Any = driver.line(settings)
    need(isinstance(line, DeviceLine), f"line: expected a Line, got {line!r}")
    need(driver.pause_s > 0, f"pause_s: expected a time above 0 s, got {driver.pause_s}")
    unknown = driver.claims - set(CLAIMS)
    need(not unknown, f"claims: {', '.join(sorted(unknown))} unknown, expected some of {', '.join(CLAIMS)}")
    return ""


def check_roles(subject: Subject) -> str:
    """Every role has its channel, every channel its role, with the fields that the role needs."""
    need(bool(subject.roles), "roles: none, expected at least one; an OtherQuantity accepts any channel")
    for role in subject.roles:
        need(role.device == NAME, f"roles: {role.role} names the device {role.device!r}, expected {NAME!r} as given")
    Roles.of(subject.roles)
    measured = subject.measured()
    need(
        set(measured) == set(subject.channels),
        f"channels: {sorted(subject.channels)}, the roles' topics: {sorted(measured)}: expected the same",
    )
    for topic, fields in measured.items():
        missing = set(fields) - set(subject.channels[topic].names)
        need(not missing, f"channel {topic}: no field {', '.join(sorted(missing))}, which its role needs")
    for clock in subject.clocks:
        need(clock.topic in subject.channels, f"clocks: no channel {clock.topic!r}")
        names = subject.channels[clock.topic].names
        need(clock.field in names, f"clocks: channel {clock.topic} has no field {clock.field!r}, only {names}")
        need(clock.rate_Hz > 0 and clock.tick_ns > 0 and clock.count_wrap > 1, f"clocks: {clock} is not valid")
    return ", ".join(sorted({role.role for role in subject.roles}))


def check_opening(subject: Subject) -> str:
    """The opening dialogue with the far end returns an identity of plain words and numbers."""
    bench = DriverBench(subject.driver)
    try:
        bench.begin()
    except (DeviceError, LinkLost) as error:
        raise Failed(f"open: its own far end is rejected: {error}") from error
    identity: Any = bench.identity
    need(isinstance(identity, dict), f"open: expected a dict as identity, got {type(identity).__name__}")
    try:
        again = json.loads(json.dumps(identity, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise Failed(f"open: the identity is not JSON ({error}): {identity!r}") from error
    need(again == identity, f"open: the identity {identity!r} became {again!r} through JSON, the format of a log")
    subject.driver.pipeline(NAME, subject.settings, again)
    return f"in {bench.clock.now_s():.1f} s of its time: {', '.join(identity)}"


def check_silence(subject: Subject) -> str:
    """A device that does not answer causes an error in finite time, unless the driver sends it no request."""
    bench = DriverBench(subject.driver)
    bench.far = FarEnd()  # never answers
    try:
        bench.begin()
    except (DeviceError, LinkLost) as error:
        waited_s = bench.clock.now_s()
        need(waited_s < 60.0, f"open: waited {waited_s:.0f} s for an answer, expected a minute at most")
        return f"after {waited_s:.1f} s of its time: {error}"
    return "it sends no request"


def check_waits(subject: Subject) -> str:
    """Dialogues and commands wait on the clock that they are given, read no other one, and start no thread."""
    _ = subject.tape  # everything is loaded and compiled, which may wait
    bench, silent = DriverBench(subject.driver), DriverBench(subject.driver)
    silent.far = FarEnd()
    with own_waits() as calls:
        bench.begin()
        if bench.control is not None:
            turn(bench)
            bench.control.stop()
        if bench.locks is not None:
            bench.locks.command("release both", lambda: None)
        bench.clock.wait(0.3)
        bench.end()
        with contextlib.suppress(DeviceError, LinkLost):  # usual: it does not answer
            silent.begin()
    if calls:
        raise Failed(
            f"{calls[0]}: expected the clock that it is given (`wait`, `now_s`, `every` in place of a thread): its "
            "dialogues and commands take no time of their own"
        )
    return ""


def check_streaming(subject: Subject) -> str:
    """Every channel fills, at its rate, in order, at times near the host's, without losses on an undisturbed line."""
    tape = subject.tape
    seen: list[str] = []
    for topic in subject.constant:
        need(together(tape.items, topic) is not None, f"channel {topic}: no samples after the opening dialogue")
    wrong = events(tape.items, "gap", "damage", "restart", "fault", "emergency")
    need(not wrong, f"on an undisturbed line: {wrong[0].kind}: {wrong[0].text}" if wrong else "")
    counted = {kind: count for kind, count in tape.losses.items() if count}
    need(not counted, f"on an undisturbed line, losses were counted: {counted}")
    hosts = [host_ns for _, _, host_ns in tape.reads]
    rates = {clock.topic: clock.rate_Hz for clock in subject.clocks} | {
        role.topic: role.rate_Hz for role in subject.roles if isinstance(role, DisplacementSensor | PendulumAngles)
    }
    for topic in subject.channels:
        whole = together(tape.items, topic)
        if whole is None:
            need(
                topic in subject.constant or not isinstance(_role(subject, topic), OtherQuantity),
                f"channel {topic}: no samples",
            )
            seen.append(f"{topic} empty")
            continue
        need(whole.channel == subject.channels[topic], f"channel {topic}: its batches are of another channel")
        _check_batch(whole.columns, topic, subject)
        steps = np.diff(whole.time_ns)
        least = 1 if topic in rates else 0
        need(bool(np.all(steps >= least)), f"channel {topic}: times step back, by {-int(steps.min(initial=0))} ns")
        off = max(int(whole.time_ns.max()) - hosts[-1], START_NS - int(whole.time_ns.min())) * 1e-9
        need(off < _NEAR_S, f"channel {topic}: times are {off:.3g} s away from the host's, expected the common clock")
        span = float(whole.time_ns[-1] - whole.time_ns[0]) * 1e-9
        rate = (len(whole.time_ns) - 1) / span if span else 0.0
        if topic in rates:
            need(
                abs(rate / rates[topic] - 1) < 0.01,
                f"channel {topic}: {rate:.4g} samples a second, expected {rates[topic]:g}",
            )
        seen.append(f"{topic} {rate:.4g} Hz")
    for clock in subject.clocks:
        whole = together(tape.items, clock.topic)
        assert whole is not None
        counts = np.diff(whole.sequence.astype(np.int64)) % clock.count_wrap
        skips = np.flatnonzero(counts != 1)
        need(
            not len(skips),
            f"channel {clock.topic}: {number_of(len(skips), 'time')} a sample's number does not follow the one before, "
            "and no loss was counted",
        )
    return ", ".join(seen)


def _role(subject: Subject, topic: str) -> Any:
    return next(r for r in subject.roles if not isinstance(r, PendulumLocks) and r.topic == topic)


def _check_batch(columns: Any, topic: str, subject: Subject) -> None:
    try:
        subject.channels[topic].pack(columns)
    except ValueError as error:
        raise Failed(f"channel {topic}: its samples cannot be stored: {error}") from error


def check_stop(subject: Subject) -> str:
    """The stream can be stopped twice, and the device opened again."""
    bench = DriverBench(subject.driver)
    bench.begin()
    bench.clock.wait(0.3)
    for _ in range(2):
        if bench.control is not None:
            need(bench.control.stop() is True, "stop of the speed source: expected True at rest")
        bench.end()
    bench.clock.wait(STEP_S)  # bytes that were sent before the stop arrived
    came = bench.bytes_in
    bench.clock.wait(0.3)
    silent = bench.bytes_in == came
    bench.begin()
    bench.clock.wait(0.5)
    for topic in subject.constant:
        need(together(bench.items, topic) is not None, f"opened again after its stop: no samples in {topic}")
    if silent:
        return "it is silent then"
    need(not subject.claims(_SILENT), f"it continues to send, and the driver claims that it {_SILENT}")
    return f"it continues to send; if it should not, claim {_SILENT!r} to make this a failure"


def check_link_lost(subject: Subject) -> str:
    """Stopping, and opening, a disconnected device ends without an error or with LinkLost or DeviceError."""
    outcomes: list[str] = []
    bench = DriverBench(subject.driver)
    bench.begin()
    if bench.control is not None:
        turn(bench)
        bench.clock.wait(1.0)
    bench.gone = True
    before_s = bench.clock.now_s()
    for what, act in (("stop", _stop), ("open", _open)):
        try:
            act(bench)
            outcomes.append(f"{what}: no error")
        except (LinkLost, DeviceError) as error:
            outcomes.append(f"{what}: {type(error).__name__}")
        except Exception as error:
            raise Failed(
                f"{what} of a disconnected device: expected LinkLost or DeviceError, got "
                f"{type(error).__name__}: {error}"
            ) from error
    waited_s = bench.clock.now_s() - before_s
    need(waited_s < 120.0, f"stop and open of a disconnected device took {waited_s:.0f} s")
    return ", ".join(outcomes)


def _stop(bench: DriverBench) -> None:
    """Stop as a session does: the driver too, even if the speed source fails."""
    try:
        if bench.control is not None:
            bench.control.stop()
    finally:
        bench.end()


def _open(bench: DriverBench) -> None:
    bench.driver.open(NAME, bench.settings, bench)


def check_played(subject: Subject) -> str:
    """The stand-in for a device of a log answers the opening dialogue, and then plays."""
    tape = subject.tape
    bench = DriverBench(subject.driver)
    stand_in = subject.driver.played(subject.settings, tape.identity)
    talk = PlayedTalk(bench, stand_in)
    try:
        identity = subject.driver.open(NAME, subject.settings, talk)
        if subject.driver.speed_source is not None:
            talk.control = subject.driver.speed_source(subject.settings, talk.send, bench.clock, bench.guard)
            talk.control.start()
    except (DeviceError, LinkLost) as error:
        raise Failed(f"played: the stand-in does not answer as the device did: {error}") from error
    json.dumps(identity)
    need(stand_in.sending, f"played: it does not send after its opening; it expects {stand_in.expects!r}")
    data = b"".join(stand_in.play(direction, data) for direction, data, _ in tape.reads) + stand_in.remainder()
    came = b"".join(data for direction, data, _ in tape.reads if direction == RX)
    need(stand_in.withheld_bytes == 0, f"played: {number_of(stand_in.withheld_bytes, 'byte')} of the log withheld")
    need(len(data) >= len(came), f"played: {number_of(len(data), 'byte')} of {len(came)}")
    different = sorted(key for key in tape.identity if identity.get(key) != tape.identity[key])
    return f"its identity differs in {', '.join(different)}" if different else "with the same identity"
