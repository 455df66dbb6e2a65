"""Tests of the commands of a device: a speed source and pendulum locks."""

from __future__ import annotations

from daq.channels import LOCKS_CLOSED
from daq.drivers.contract import SpeedControl
from daq.errors import DeviceError, LinkLost, ProcedureError
from rig_basics.units import TO_RPM
from rig_configs.roles import PendulumAngles, PendulumLocks, SpeedSource as SpeedRole
from rig_testing.bench import DriverBench
from rig_testing.report import Failed, NotTried, need
from rig_testing.subject import RAMP_RPM_S, SPEED_RPM, Subject, together, turn

_LATE_S = 1.0


def check_speed_source(subject: Subject) -> str:
    """It enables, follows a ramp and stops quickly; it requests permission; its silence is not taken for off."""
    _need_role(subject, SpeedRole, "speed source", "speed_source")
    bench = DriverBench(subject.driver)
    bench.begin()
    control = _control(bench)
    bench.clock.wait(0.3)
    _refuses(bench, control)
    control.set_ramp(RAMP_RPM_S)
    control.enable()
    bench.clock.wait(0.2)
    need(control.enabled, f"enabled is False after enable(); its state is {control.state!r}")
    bench.refuse = ProcedureError("not permitted")
    try:
        control.set_speed(SPEED_RPM)
    except ProcedureError:  # usual: the check requires this error
        pass
    else:
        raise Failed("set_speed: expected what RotorGuard.permit raises, it raised nothing")
    bench.clock.wait(0.5)
    need(abs(_rpm(bench)) < 1.0, f"the rotor turns at {_rpm(bench):.0f} rpm though that was not permitted")
    bench.refuse = None
    control.set_speed(SPEED_RPM)
    need(SPEED_RPM in bench.permitted, "set_speed: RotorGuard.permit was not called")
    bench.clock.wait(0.5 * SPEED_RPM / RAMP_RPM_S)
    half = _rpm(bench)
    bench.clock.wait(0.5 * SPEED_RPM / RAMP_RPM_S + _LATE_S)
    need(half < 0.9 * SPEED_RPM, f"{half:.0f} rpm in the middle of a ramp to {SPEED_RPM:g} rpm: no ramp")
    need(
        abs(_rpm(bench) / SPEED_RPM - 1) < 0.03,
        f"commanded {SPEED_RPM:g} rpm, the rotor turns at {_rpm(bench):.1f}",
    )
    reported = control.actual_rpm
    need(abs(reported - _rpm(bench)) < 5.0, f"actual_rpm {reported:.1f}, the rotor turns at {_rpm(bench):.1f} rpm")
    need(control.dropped_out is None, f"dropped_out is {control.dropped_out!r} while it runs as commanded")
    control.quick_stop()
    stopped_s = _time_to_rest(bench)
    need(not control.enabled, "enabled is True after quick_stop()")
    _rejects_silence(bench, control)
    control.enable()
    control.set_speed(0.75 * SPEED_RPM)
    bench.clock.wait(1.0)
    need(control.stop() is True, f"stop: expected True, the rotor turns at {_rpm(bench):.1f} rpm")
    need(abs(_rpm(bench)) < 1.0, f"stop returned True, the rotor turns at {_rpm(bench):.1f} rpm")
    bench.end()
    return f"quick stop in {stopped_s:.2f} s"


def check_stops_by_itself(subject: Subject) -> str:
    """A speed source whose host is disconnected stops the rotor by itself."""
    _need_role(subject, SpeedRole, "speed source", "speed_source")
    bench = DriverBench(subject.driver)
    bench.begin()
    turn(bench)
    bench.clock.wait(SPEED_RPM / RAMP_RPM_S + _LATE_S)
    before = _rpm(bench)
    bench.gone = True
    return f"in {_time_to_rest(bench, 10.0):.2f} s, from {before:.0f} rpm"


def _refuses(bench: DriverBench, control: SpeedControl) -> None:
    bench.refuse = ProcedureError("not permitted")
    try:
        control.enable()
    except ProcedureError:  # usual: the check requires this error
        pass
    else:
        raise Failed("enable: expected what RotorGuard.permit raises, it raised nothing")
    bench.clock.wait(0.2)
    need(not control.enabled, "enabled is True though that was not permitted")
    bench.refuse = None


def _rejects_silence(bench: DriverBench, control: SpeedControl) -> None:
    """Check that `disable` raises if the device does not answer: it may still drive the rotor."""
    control.enable()
    step, receive = bench.far.step, bench.far.receive
    bench.far.step = lambda now_s: step(now_s)[:0]
    bench.far.receive = lambda data, now_s: receive(data, now_s)[:0]
    try:
        control.disable()
    except (DeviceError, LinkLost):  # usual: the check requires this error
        pass
    else:
        raise Failed("disable: the device does not answer, expected DeviceError, it raised nothing")
    finally:
        bench.far.step, bench.far.receive = step, receive
    bench.clock.wait(_LATE_S)


def _time_to_rest(bench: DriverBench, longest_s: float = 5.0) -> float:
    begun = bench.clock.now_s()
    while abs(_rpm(bench)) > 1.0:
        bench.clock.wait(0.02)
        need(
            bench.clock.now_s() - begun < longest_s,
            f"after {longest_s:g} s the rotor turns at {_rpm(bench):.0f} rpm",
        )
    return bench.clock.now_s() - begun


def _control(bench: DriverBench) -> SpeedControl:
    assert bench.control is not None
    return bench.control


def _rpm(bench: DriverBench) -> float:
    return bench.motion.speed_rad_s * TO_RPM


def check_locks(subject: Subject) -> str:
    """Locks release and close as commanded, acknowledge, show it in the flags, and stop waiting on request."""
    _need_role(subject, PendulumLocks, "pendulum locks", "locks")
    bench = DriverBench(subject.driver)
    bench.begin()
    assert bench.locks is not None
    bench.clock.wait(1.0)
    for action, closed in (("release both", 0), ("lock both", LOCKS_CLOSED)):
        bench.locks.command(action, lambda: None)
        bench.clock.wait(1.0)
        if (flags := _lock_flags(subject, bench)) is not None:
            need(flags == closed, f"{action!r} was acknowledged, the flags are {flags:#x}, expected {closed:#x}")
    try:
        bench.far.receive = lambda data, now_s: b""  # never answers
        bench.locks.command("release both", _give_up)
    except ProcedureError:  # usual: the check requires this error
        pass
    else:
        raise Failed("command: expected what `check` raises while it waits, it raised nothing")
    bench.gone = True
    try:
        bench.locks.command("release both", lambda: None)
    except (LinkLost, DeviceError):  # usual: the check requires this error
        return ""
    raise Failed("command to a disconnected device: expected LinkLost or DeviceError, it raised nothing")


def _give_up() -> None:
    raise ProcedureError("given up")


def _lock_flags(subject: Subject, bench: DriverBench) -> int | None:
    """Return the lock flags of the newest pendulum sample; None if the device measures no angles."""
    for role in subject.roles:
        if isinstance(role, PendulumAngles):
            whole = together(bench.items, role.topic)
            return None if whole is None else int(whole.columns["flags"][-1]) & LOCKS_CLOSED
    return None


def _need_role(subject: Subject, role: type, name: str, function: str) -> None:
    """Raise `NotTried` if the driver has no such role; a role without its function is a failure."""
    offers = getattr(subject.driver, function) is not None
    plays = any(isinstance(each, role) for each in subject.roles)
    if not plays and not offers:
        raise NotTried(f"it is not a {name}" if name.endswith("source") else f"it has no {name}")
    need(plays == offers, f"the role {name!r} and the function `{function}` go together")
