"""A simulated VESC commanded by the host's side of the driver, in one thread, on a time of their own."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from daq.drivers.contract import RotorGuard, TimeOut
from daq.errors import DeviceError, LinkLost, ProcedureError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports import HostClock
from daq.virtual_rig.motion import SimulatedMotion
from rig_configs import load_rig
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.control import Mode, VescControl
from rig_drivers.vesc.dialogue import identify
from rig_drivers.vesc.driver import DRIVER
from rig_drivers.vesc.far_end import SimulatedVesc
from rig_drivers.vesc.settings import Vesc

PHYSICS = load_rig("virtual").true_physics
SETTINGS = Vesc(
    driver="vesc", port="/dev/x", pole_pairs=7, timeout_s=1.0, brake_A=5.0, min_erpm=700.0, ramp_rpm_per_s=400.0
)
STEP_S = 0.01
QUERY = wire.firmware_version()
SLIP = 0.002


class RigTime(HostClock):
    """A host's clock that is moved by hand."""

    def __init__(self) -> None:
        super().__init__()
        self.rig_s = 1000.0
        self.passes: Callable[[float], None] | None = None

    def now_ns(self) -> int:
        return round(self.rig_s * 1e9)

    def wait(self, seconds: float) -> None:
        assert self.passes is not None
        self.passes(seconds)


class Bench:
    """Controller, pipeline and host; every sleep lets rig time pass.

    Attributes:
        commands: commands to the motor, each with the rig time, s.
        permitted: speeds with which the guard was called.
        refuse: raised by the guard.
    """

    def __init__(self, settings: Vesc = SETTINGS, **far: object) -> None:
        self.settings, self.clock = settings, RigTime()
        self.motion = SimulatedMotion(PHYSICS, SLIP, 0.08)
        self.far = SimulatedVesc(settings, self.motion, **far)
        self.pipeline = DRIVER.pipeline("drive", settings, {})
        self.commands: list[tuple[float, wire.MotorCommand]] = []
        self.permitted: list[float | None] = []
        self.refuse: Exception | None = None
        self.at_permit: Callable[[], None] = lambda: None
        self.gone = self.asleep = False
        self.rows: list[tuple[float, float, int]] = []
        self.events: list[DeviceEvent] = []
        self.log: list[tuple[int, bytes, int]] = []
        self._host = packets.PacketDecoder()
        guard = RotorGuard(self._permit, self._at_rest, lambda: abs(self.control.actual_rpm))
        self.control = DRIVER.speed_source(settings, self.send, self.clock, guard)

    def _permit(self, rpm: float | None) -> None:
        self.permitted.append(rpm)
        self.at_permit()
        if self.refuse is not None:
            raise self.refuse

    def _at_rest(self) -> bool | None:
        rpm = self.control.actual_rpm
        return None if math.isnan(rpm) else abs(rpm) < 1

    def send(self, data: bytes) -> None:
        if self.gone:
            raise LinkLost("gone")
        self._feed(TX, data)
        for payload in self._host.feed(data).payloads:
            if (command := wire.parse_command(payload)) is not None:
                self.commands.append((self.clock.rig_s, command))
        if answer := self.far.receive(data, self.motion.time_s):
            self._feed(RX, answer)
            self.control.notice(self.pipeline)

    def _feed(self, direction: int, data: bytes) -> None:
        self.log.append((direction, data, self.clock.now_ns()))
        for item in self.pipeline.feed(direction, data, self.clock.now_ns()):
            if isinstance(item, Batch):
                columns = [item.columns[name].tolist() for name in ("speed_rpm", "target_rpm", "statusword")]
                self.rows += zip(*columns, strict=True)
            else:
                self.events.append(item)

    def pass_time(self, seconds: float, host: bool = True) -> None:
        """Let rig time pass; the host's thread beats unless it has ended."""
        for _ in range(max(1, round(seconds / STEP_S))):
            self.clock.rig_s += STEP_S
            self.far.step(self.motion.time_s)
            self.motion.advance(self.motion.time_s + STEP_S + 1e-9)
            if host and not self.gone:
                self.control.beat()

    def runs(self, rpm: float) -> None:
        self.pass_time(0.1)
        self.control.enable()
        self.control.set_speed(rpm)
        self.pass_time(abs(rpm) / self.settings.ramp_rpm_per_s + 0.5)
        assert self.rpm == pytest.approx(rpm * (1 - SLIP), rel=0.005)

    @property
    def rpm(self) -> float:
        return self.far.speed_rpm

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]


@pytest.fixture
def on_rig_time() -> Callable[[Bench], Bench]:
    """Waits of the host's side let rig time pass."""

    def install(bench: Bench) -> Bench:
        bench.clock.passes = bench.pass_time
        return bench

    return install


@pytest.fixture
def bench(on_rig_time: Callable[[Bench], Bench]) -> Bench:
    return on_rig_time(Bench())


def test_before_it_is_enabled_it_is_polled_and_not_commanded(bench: Bench) -> None:
    bench.pass_time(0.5)
    assert bench.commands == []
    assert len(bench.rows) > 15
    assert bench.control.actual_rpm == 0
    assert not bench.control.enabled
    assert bench.control.state == "TIMED OUT"  # it was never commanded


def test_it_goes_up_the_ramp_and_down(bench: Bench) -> None:
    bench.pass_time(0.1)
    bench.control.enable()
    assert bench.control.enabled
    assert bench.control.state == "HOLDS SPEED"
    assert bench.rpm == 0
    bench.control.set_ramp(200.0)
    bench.control.set_speed(500.0)
    bench.pass_time(1.0)
    assert bench.rpm == pytest.approx(100 + 200, abs=25)  # begins where the controller can hold a speed
    bench.pass_time(1.5)
    assert bench.rpm == pytest.approx(500, rel=0.005)
    assert bench.control.actual_rpm == pytest.approx(bench.rpm, abs=0.1)
    assert bench.rows[-1][1] == 500
    bench.control.set_speed(0.0)
    bench.pass_time(3.0)
    assert abs(bench.rpm) < 0.01
    steps = [b.number - a.number for (_, a), (_, b) in pairwise(bench.commands) if a.what == b.what == wire.SET_RPM]
    assert max(map(abs, steps)) <= 7 * 200 * 0.07
    assert {command.number for _, command in bench.commands if command.what == wire.SET_BRAKE} == {5000}
    assert min(abs(c.number) for _, c in bench.commands if c.what == wire.SET_RPM) >= 700
    assert bench.control.dropped_out is None
    assert set(bench.kinds()) == {"drive"}


def test_it_turns_backwards_too(bench: Bench) -> None:
    bench.runs(-300.0)
    assert bench.control.actual_rpm == pytest.approx(-300, rel=0.01)


def test_a_command_is_repeated_well_within_the_time_out(bench: Bench) -> None:
    bench.runs(300.0)
    bench.pass_time(2.0)
    times = [at for at, _ in bench.commands]
    assert max(b - a for a, b in pairwise(times)) < SETTINGS.timeout_s / 4
    assert bench.control.state == "HOLDS SPEED"


def test_every_speed_is_permitted_before_it_is_commanded(bench: Bench) -> None:
    bench.runs(300.0)
    assert bench.permitted[0] is None
    assert bench.permitted[-1] == 300
    bench.refuse = ProcedureError("no")
    with pytest.raises(ProcedureError):
        bench.control.set_speed(400.0)
    bench.pass_time(1.0)
    assert bench.rpm == pytest.approx(300, rel=0.01)
    bench.control.disable()
    with pytest.raises(ProcedureError):
        bench.control.enable()
    assert not bench.control.enabled


@pytest.mark.parametrize("rpm", [99.0, -50.0, 0.1, math.nan, math.inf, 1e10])
def test_a_speed_it_cannot_hold_is_refused_before_the_guard_is_called(bench: Bench, rpm: float) -> None:
    bench.pass_time(0.1)
    bench.control.enable()
    bench.permitted.clear()
    with pytest.raises(DeviceError, match="cannot"):
        bench.control.set_speed(rpm)
    assert bench.permitted == []


def test_a_quick_stop_brakes_at_once(bench: Bench) -> None:
    bench.runs(600.0)
    bench.control.quick_stop()
    assert bench.commands[-1][1] == wire.MotorCommand(wire.SET_BRAKE, 5000)
    assert not bench.control.enabled
    bench.pass_time(1.0)
    assert abs(bench.rpm) < 1
    assert bench.control.state == "BRAKES"
    assert bench.control.dropped_out is None


def test_a_stop_while_a_speed_is_being_permitted_wins(bench: Bench) -> None:
    bench.runs(300.0)
    bench.at_permit = bench.control.quick_stop
    with pytest.raises(DeviceError, match="not enabled"):
        bench.control.set_speed(600.0)
    bench.pass_time(1.0)
    assert bench.rpm < 1


def test_a_rotor_found_turning_is_led_down_the_ramp(bench: Bench) -> None:
    """A host before this one was killed."""
    bench.runs(600.0)
    bench.control = DRIVER.speed_source(
        SETTINGS, bench.send, bench.clock, RotorGuard(lambda rpm: None, lambda: abs(bench.rpm) < 1, lambda: bench.rpm)
    )
    bench.pass_time(0.3)
    bench.control.enable()
    assert bench.rpm > 500
    bench.pass_time(0.5)
    assert 300 < bench.rpm < 500
    bench.pass_time(2.0)
    assert bench.rpm < 1


# --- how it ends ----------------------------------------------------------------------------------------------


def test_stop_brakes_and_then_releases(bench: Bench) -> None:
    bench.runs(600.0)
    bench.commands.clear()
    assert bench.control.stop() is True
    assert abs(bench.rpm) < 1
    assert {command.what for _, command in bench.commands[:-1]} == {wire.SET_BRAKE}
    assert bench.commands[-1][1] == wire.MotorCommand(wire.SET_CURRENT, 0)
    count = len(bench.log)
    bench.control.quick_stop()  # a late one of another thread
    assert bench.commands[-1][1].what == wire.SET_BRAKE
    assert len(bench.log) > count


def test_a_silent_one_is_commanded_and_its_release_is_not_confirmed(bench: Bench) -> None:
    bench.runs(300.0)
    bench.control._guarded = replace(bench.control._guarded, at_rest=lambda: abs(bench.rpm) < 1)  # by the index marks
    bench.far.fail("silent reports", 1)
    bench.commands.clear()
    with pytest.raises(DeviceError, match="it does not answer: the release is not confirmed"):
        bench.control.disable()
    assert {command.what for _, command in bench.commands} == {wire.SET_CURRENT}
    messages: list[str] = []
    assert bench.control.stop(messages.append) is False
    assert abs(bench.rpm) < 1
    assert bench.commands[-1][1] == wire.MotorCommand(wire.SET_CURRENT, 0)
    assert "the release is not confirmed" in messages[-1]


def test_an_answer_to_an_earlier_question_shows_nothing(bench: Bench) -> None:
    bench.runs(0.0)
    bench.control._guarded = replace(bench.control._guarded, at_rest=lambda: True)
    answers = [payload for direction, payload, _ in bench.log if direction == RX]
    bench.far.fail("silent reports", 1)
    bench.pass_time(0.05)  # a question is under way; its answer comes after the command, and is all that comes
    heard, send = [answers[-1]], bench.send

    def late(data: bytes) -> None:
        send(data)
        if heard and data == wire.release() + wire.get_values():
            bench._feed(RX, heard.pop())
            bench.control.notice(bench.pipeline)

    bench.control._send = late
    with pytest.raises(DeviceError, match="not confirmed"):
        bench.control.disable()


def test_a_line_that_is_gone_is_released(bench: Bench) -> None:
    bench.runs(300.0)
    bench.gone = True
    with pytest.raises(LinkLost):
        bench.control.stop()
    assert bench.control.mode is Mode.NOTHING


def test_a_line_that_goes_while_it_stops_ends_the_wait(bench: Bench) -> None:
    bench.runs(600.0)
    begun = bench.clock.rig_s
    bench._at_rest = lambda: None

    def unplug(text: str) -> None:
        bench.gone = True

    bench.far.fail("deaf", 1)
    bench.far._timeout_s = math.inf
    with pytest.raises(LinkLost):
        bench.control.stop(unplug)
    assert bench.clock.rig_s - begun < 3


def test_after_disable_it_runs_as_it_likes(bench: Bench) -> None:
    bench.runs(300.0)
    bench.control.disable()
    bench.pass_time(1.0)
    assert 200 < bench.rpm < 300
    assert bench.control.state == "RELEASED"
    assert not bench.control.enabled


def test_when_the_host_dies_the_controllers_own_time_out_stops_the_rotor(bench: Bench) -> None:
    bench.runs(600.0)
    bench.pass_time(SETTINGS.timeout_s - 0.2, host=False)
    assert bench.rpm > 590
    bench.pass_time(2.0, host=False)
    assert bench.rpm < 1


def test_without_a_brake_at_its_time_out_the_rotor_runs_down(on_rig_time: Callable[[Bench], Bench]) -> None:
    bench = on_rig_time(Bench(timeout_brake_A=0.0))
    bench.runs(600.0)
    bench.pass_time(3.0, host=False)
    assert 400 < bench.rpm < 590


def test_polls_do_not_keep_it_commanded(bench: Bench) -> None:
    bench.runs(300.0)
    for _ in range(200):
        bench.pass_time(STEP_S, host=False)
        bench.send(wire.get_values())
    assert bench.far.timed_out
    assert bench.rpm < 1


# --- the timeout, at rest --------------------------------------------------------------------------------------


def time_out(bench: Bench) -> TimeOut:
    found = bench.control.measure_time_out()
    assert found is not None
    return found


def mode(bench: Bench) -> Mode:
    assert isinstance(bench.control, VescControl)
    return bench.control.mode


@pytest.mark.parametrize("timeout_s", [0.5, 1.0, 2.5])
def test_its_timeout_is_measured_at_rest(on_rig_time: Callable[[Bench], Bench], timeout_s: float) -> None:
    bench = on_rig_time(Bench(timeout_s=timeout_s))
    bench.pass_time(0.3)
    found = time_out(bench)
    assert found.measured_s == pytest.approx(timeout_s, abs=found.resolution_s)
    assert found.resolution_s < 0.15
    assert found.stated_s == SETTINGS.timeout_s
    assert [command.what for _, command in bench.commands] == [wire.SET_CURRENT]


def test_a_timeout_that_is_off_is_not_measured_and_the_rotor_is_not_turned(
    on_rig_time: Callable[[Bench], Bench],
) -> None:
    bench = on_rig_time(Bench(timeout_s=math.inf))
    bench.send(wire.release())
    bench.pass_time(0.3)
    assert time_out(bench).measured_s is None
    with pytest.raises(DeviceError, match="its timeout has not expired although it received no command"):
        bench.control.enable()
    assert {command.what for _, command in bench.commands} == {wire.SET_CURRENT}


def test_what_cannot_show_its_timeout_is_not_measured(on_rig_time: Callable[[Bench], Bench]) -> None:
    old, deaf, turning = on_rig_time(Bench(has_status=False)), on_rig_time(Bench()), on_rig_time(Bench())
    old.pass_time(0.3)
    with pytest.raises(DeviceError, match=r"firmware before 5\.3"):
        time_out(old)
    deaf.far.fail("deaf", 1)
    deaf.pass_time(0.3)
    with pytest.raises(DeviceError, match="do commands reach it"):
        time_out(deaf)
    turning.runs(300.0)
    with pytest.raises(DeviceError, match="must stand"):
        time_out(turning)


def test_a_noisy_reading_of_a_standing_rotor_is_named(on_rig_time: Callable[[Bench], Bench]) -> None:
    """Without a sensor the speed of a standing rotor is noise, and beyond `rest_rpm` nothing shows that it stands."""
    bench = on_rig_time(Bench())
    bench.pass_time(0.3)
    bench.pipeline.answers = [wire.Values(erpm=-28, status=wire.TIMED_OUT)]
    bench.control.notice(bench.pipeline)
    with pytest.raises(DeviceError, match=r"reports -4\.0 rpm, a standing rotor at most 1 rpm \(rest_rpm\)"):
        time_out(bench)


@pytest.mark.parametrize(("status", "obeys"), [(0x00, True), (0xF0, True), (0x01, False), (0x02, False), (0xF1, False)])
def test_unknown_bits_of_the_status_byte_are_no_obstacle(status: int, obeys: bool) -> None:
    bench = Bench()
    control = bench.control
    assert isinstance(control, VescControl)
    bench.clock.rig_s += 1.0
    bench.pipeline.answers = [wire.Values(status=status)]
    control.notice(bench.pipeline)
    assert control._obeys() is obeys


def test_after_an_earlier_session_the_timeout_is_awaited_before_a_speed(bench: Bench) -> None:
    """A controller that was commanded a moment ago has not shown yet that it stops by itself."""
    bench.send(wire.release())
    bench.pass_time(0.1)
    bench.control.quick_stop()
    bench.pass_time(0.2)
    began_s = bench.clock.rig_s
    bench.control.enable()
    assert 0.9 < bench.clock.rig_s - began_s < 1.3
    assert bench.control.enabled
    bench.control.disable()
    began_s = bench.clock.rig_s
    bench.control.enable()
    assert bench.clock.rig_s - began_s < 0.2, "once is enough"


class NoisyBench(Bench):
    """A standing rotor whose reading is noise beyond `rest_rpm`."""

    def _at_rest(self) -> bool | None:
        return False


@pytest.mark.parametrize("timeout_s", [1.0, math.inf])
def test_noise_of_a_standing_rotor_does_not_replace_the_proof_of_the_timeout(
    on_rig_time: Callable[[Bench], Bench], timeout_s: float
) -> None:
    bench = on_rig_time(NoisyBench(timeout_s=timeout_s))
    bench.send(wire.release())
    bench.pass_time(0.3)
    if timeout_s == 1.0:
        bench.control.enable()
        assert bench.control.enabled
        return
    with pytest.raises(DeviceError, match="its timeout has not expired although it received no command"):
        bench.control.enable()
    assert {command.what for _, command in bench.commands} == {wire.SET_CURRENT}


def test_a_stop_while_the_timeout_is_awaited_wins(bench: Bench) -> None:
    bench.send(wire.release())
    bench.pass_time(0.1)
    stop_s = bench.clock.rig_s + 0.3

    def stop() -> None:
        if bench.clock.rig_s > stop_s and mode(bench) is Mode.NOTHING:
            bench.control.quick_stop()

    bench.at_permit = stop
    with pytest.raises(DeviceError, match="a stop was commanded"):
        bench.control.enable()
    assert mode(bench) is Mode.BRAKE


def test_a_turning_rotor_is_led_down_before_the_timeout_was_seen(bench: Bench) -> None:
    for _ in range(100):
        bench.send(wire.set_rpm(7 * 300))
        bench.pass_time(0.02)
    assert bench.rpm > 290
    bench.control.enable()
    bench.pass_time(0.2)
    assert 100 < bench.rpm < 280
    assert bench.control.enabled


# --- what goes wrong -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("has_status", [True, False])
def test_a_fault_while_it_runs(on_rig_time: Callable[[Bench], Bench], has_status: bool) -> None:
    bench = on_rig_time(Bench(has_status=has_status))
    bench.runs(300.0)
    bench.far.fail("fault", 4)
    bench.pass_time(0.1)
    assert bench.control.dropped_out == "FAULT"
    assert bench.control.why() == "; fault 4, over-current"
    assert bench.control.fault_code() == 4
    assert bench.control.state == "FAULT"
    assert not bench.control.enabled
    (emergency,) = [event for event in bench.events if event.kind == "emergency"]
    assert DRIVER.words(emergency) == "4, over-current"
    bench.pass_time(2.0)  # it passes by itself; the rotor is to stop then, not to go on
    assert bench.control.fault_code() is None
    assert bench.rpm < 1
    bench.control.enable()
    assert (bench.control.dropped_out, bench.control.why()) == (None, "")


def test_a_fault_that_stands_is_no_start(bench: Bench) -> None:
    bench.far.fail("fault", 6)
    bench.far._fault_until_s = math.inf
    bench.pass_time(0.1)
    with pytest.raises(DeviceError, match="over-temperature of the motor"):
        bench.control.enable()
    assert bench.commands == []


def test_one_that_does_not_answer_is_no_start(bench: Bench) -> None:
    bench.far.fail("silent reports", 1)
    with pytest.raises(DeviceError, match="does not answer"):
        bench.control.enable()
    assert bench.commands == []


def test_one_that_no_command_reaches_is_no_start(bench: Bench) -> None:
    bench.far.fail("deaf", 1)
    bench.pass_time(0.1)
    with pytest.raises(DeviceError, match="TIMED OUT"):
        bench.control.enable()
    assert bench.control.mode is Mode.BRAKE


def test_an_answer_from_before_the_command_shows_nothing(on_rig_time: Callable[[Bench], Bench]) -> None:
    bench = on_rig_time(Bench(has_status=False))
    bench.pass_time(0.1)
    bench.far.fail("silent reports", 1)
    with pytest.raises(DeviceError, match="does not answer"):
        bench.control.enable()
    assert not bench.control.enabled


def test_one_that_answers_no_more_is_braked(bench: Bench) -> None:
    """Its status messages on a CAN bus go on, so the channel is not silent; faults and timeout are unknown."""
    bench.runs(600.0)
    bench.far.fail("silent reports", 1)
    bench.pass_time(0.6)
    assert bench.control.dropped_out is None
    bench.pass_time(0.5)
    assert bench.control.dropped_out == "UNKNOWN (no answer to 8 polls)"
    assert bench.commands[-1][1].what == wire.SET_BRAKE
    bench.pass_time(1.0)
    assert bench.rpm < 1
    bench.far.fail("silent reports", 0)
    bench.pass_time(0.2)
    bench.control.enable()
    assert bench.control.enabled


def test_a_wire_that_breaks_shows_in_the_status(bench: Bench) -> None:
    bench.runs(600.0)
    bench.far.fail("deaf", 1)
    bench.pass_time(1.5)
    assert bench.control.dropped_out == "TIMED OUT"


def test_a_wire_that_breaks_shows_in_the_speed_alone_with_older_firmware(on_rig_time: Callable[[Bench], Bench]) -> None:
    bench = on_rig_time(Bench(has_status=False))
    bench.runs(600.0)
    bench.far.fail("deaf", 1)
    bench.pass_time(SETTINGS.timeout_s + 1.0 + SETTINGS.follow_s)
    assert bench.control.dropped_out is None
    (fault,) = [event for event in bench.events if event.kind == "fault"]
    assert "does not follow: the set-point is 600 rpm" in fault.text


@pytest.mark.parametrize("has_status", [True, False])
def test_after_a_restart_the_speed_is_not_commanded_again(
    on_rig_time: Callable[[Bench], Bench], has_status: bool
) -> None:
    bench = on_rig_time(Bench(has_status=has_status))
    bench.runs(600.0)
    bench.far.fail("restart", 1)
    bench.pass_time(0.1)
    assert bench.control.dropped_out == "RESTARTED" or (has_status and bench.control.dropped_out == "TIMED OUT")
    assert "restart" in bench.kinds()
    bench.pass_time(1.0)
    assert bench.rpm < 1


def test_a_word_has_an_age(bench: Bench) -> None:
    bench.runs(300.0)
    bench.far.fail("silent reports", 1)
    bench.pass_time(0.3)
    assert bench.control.actual_rpm == pytest.approx(300, rel=0.01)
    bench.pass_time(0.3)
    assert math.isnan(bench.control.actual_rpm)
    assert bench.control.state == "UNKNOWN"
    assert bench.control.fault_code() is None
    assert not bench.control.enabled
    bench.far.fail("silent reports", 0)
    bench.pass_time(0.2)
    assert bench.control.actual_rpm == pytest.approx(300, rel=0.01)
    assert 0 < bench.pipeline.losses["unanswered"] < 10  # polled less often without answers
    assert "gap" in bench.kinds()


def test_a_wrong_reported_speed_is_detected(bench: Bench) -> None:
    bench.runs(300.0)
    bench.far.fail("reported share", 0.5)
    bench.pass_time(0.1)
    assert bench.control.actual_rpm == pytest.approx(150, rel=0.01)
    bench.pass_time(SETTINGS.follow_s)
    assert "fault" in bench.kinds()


def test_one_that_runs_away_is_braked(bench: Bench) -> None:
    bench.runs(300.0)
    bench.far.fail("speed", 900)
    bench.pass_time(1.0)
    assert bench.rpm > 800
    bench.control.quick_stop()
    bench.pass_time(1.5)
    assert bench.rpm < 1
    with pytest.raises(ValueError, match="has no fault"):
        bench.far.fail("network", 1)


def test_a_host_that_was_asleep_goes_on_where_the_ramp_was(bench: Bench) -> None:
    bench.pass_time(0.1)
    bench.control.enable()
    bench.control.set_speed(1000.0)
    bench.pass_time(0.5)
    before = bench.commands[-1][1].number
    bench.pass_time(0.9, host=False)
    bench.pass_time(STEP_S)
    assert bench.commands[-1][1].number - before <= 7 * 400 * 0.3


# --- log, thread, dialogue ------------------------------------------------------------------------------------


def test_its_thread_polls_and_ends() -> None:
    polled, before = threading.Event(), set(threading.enumerate())
    control = VescControl(SETTINGS, lambda data: polled.set(), HostClock())
    control.start()
    control.start()
    polled.clear()
    assert polled.wait(10.0)
    assert [thread.name for thread in set(threading.enumerate()) - before] == ["command"]
    control._end()
    assert set(threading.enumerate()) <= before


def test_its_thread_ends_when_the_line_is_gone() -> None:
    gone, before = threading.Event(), set(threading.enumerate())

    def send(data: bytes) -> None:
        if gone.is_set():
            raise LinkLost("gone")

    control = VescControl(SETTINGS, send, HostClock())
    control.start()
    (thread,) = set(threading.enumerate()) - before
    gone.set()
    thread.join(10.0)
    assert not thread.is_alive()
    assert control.stop() is True


def test_an_older_command_never_follows_a_newer_one() -> None:
    """One thread is in the middle of sending a speed when another one stops the rotor."""
    entered, release = threading.Event(), threading.Event()
    sent: list[int] = []
    decoder = packets.PacketDecoder()

    def send(data: bytes) -> None:
        commands = [wire.parse_command(payload) for payload in decoder.feed(data).payloads]
        if any(command is not None and command.what == wire.SET_RPM for command in commands):
            entered.set()
            assert release.wait(10.0)
        sent.extend(command.what for command in commands if command is not None)

    control = VescControl(SETTINGS, send, HostClock())
    control._ramp.begin(300.0, control._clock.now_s())
    control._begin(Mode.SPEED)
    beat, stop = threading.Thread(target=control.beat), threading.Thread(target=control.quick_stop)
    beat.start()
    assert entered.wait(10.0)
    stop.start()
    stop.join(0.05)  # its chance to overtake
    release.set()
    beat.join(10.0)
    stop.join(10.0)
    assert sent == [wire.SET_RPM, wire.SET_BRAKE]


class Talk:
    """An open controller, answering at once."""

    def __init__(self, answers: list[bytes]) -> None:
        self.clock = HostClock()
        self.replies = self.clock.queue()
        self.bytes_in, self.sent = 0, 0
        self._answers = answers

    def send(self, data: bytes) -> None:
        self.sent += 1
        if self._answers:
            self.replies.put(self._answers.pop(0).hex())

    def restart_decoding(self) -> None: ...


def test_it_is_identified() -> None:
    talk = Talk([wire.pack_firmware(wire.Firmware(6, 5, "60_MK5", "ab" * 12))])
    talk.replies.put("stale")
    known = DRIVER.open("drive", SETTINGS, talk)
    assert known == {
        "firmware": "6.05",
        "hardware": "60_MK5",
        "serial": "ab" * 12,
        "pole_pairs": 7,
        "timeout_s": 1.0,
    }


def test_the_far_end_is_identified() -> None:
    far = Bench().far
    (payload,) = packets.PacketDecoder().feed(far.receive(wire.firmware_version(), 0.0)).payloads
    assert identify("drive", SETTINGS, Talk([payload]), QUERY, "")["hardware"] == "60_MK5"


def test_firmware_of_another_layout_is_refused() -> None:
    with pytest.raises(DeviceError, match=r"firmware 2\.18"):
        identify("drive", SETTINGS, Talk([wire.pack_firmware(wire.Firmware(2, 18, "48", "00" * 12))]), QUERY, "")


def test_old_firmware_that_states_only_its_version_is_named() -> None:
    with pytest.raises(DeviceError, match=r"firmware 2\.18 answers in an unknown layout"):
        identify("drive", SETTINGS, Talk([bytes([wire.FIRMWARE_VERSION, 2, 18])]), QUERY, "")


def test_firmware_without_a_name_of_its_hardware_is_used() -> None:
    found = identify("drive", SETTINGS, Talk([bytes([wire.FIRMWARE_VERSION, 3, 40])]), QUERY, "")
    assert (found["firmware"], found["hardware"], found["serial"]) == ("3.40", "not stated", "")


def test_one_that_is_silent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def none_in_time(timeout: float) -> str:
        raise queue.Empty

    talk = Talk([])
    monkeypatch.setattr(talk.replies, "get", none_in_time)
    with pytest.raises(DeviceError, match="nothing came in 3 tries"):
        identify("drive", SETTINGS, talk, QUERY, "")
    assert talk.sent == 3
