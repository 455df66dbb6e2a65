"""A simulated frequency converter commanded by the host's side of the driver, on simulated time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

import rig_testing
from daq.drivers.driver import Driver
from daq.errors import DeviceError, LinkLost
from daq.items import RX, TX, Batch, DeviceEvent
from rig_basics.units import TO_RPM
from rig_drivers.modbus_converter import registers, wire
from rig_drivers.modbus_converter.control import ConverterControl
from rig_drivers.modbus_converter.driver import DRIVER
from rig_drivers.modbus_converter.far_end import SimulatedConverter
from rig_testing.bench import DriverBench
from tests.daq.kit_cases import kit_cases

_INVT = replace(DRIVER, example={"table": "invt", "baud": 38_400, "slip": 0.002})


_MMAX = replace(DRIVER, example={"table": "m-max", "parity": "N", "stop_bits": 2, "watchdog_s": 2.0, "pole_pairs": 3})


_ALTIVAR = replace(DRIVER, example={"table": "altivar", "gear": 2.0, "baud": 38_400})


_OTHERS = replace(
    DRIVER, example={"registers": {"read_function": 4, "write_function": 16, "watchdog": 0x2020}, "address": 9}
)


_SHORT = (_INVT, _ALTIVAR)  # answers of at most 11 bytes: the kit damages longer ones


@pytest.mark.parametrize(
    "case",
    kit_cases(
        (_INVT, _MMAX, _ALTIVAR, _OTHERS),
        without=[*((kind, "damage") for kind in _SHORT), *((kind, "mutations") for kind in (_INVT, _MMAX, _ALTIVAR))],
    ),
)
def test_every_table_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


class Bench(DriverBench):
    """The converter on its line, with names for what the tests need."""

    def __init__(self, driver: Driver = DRIVER) -> None:
        super().__init__(driver)
        assert isinstance(self.far, SimulatedConverter)
        self.converter: SimulatedConverter = self.far

    @property
    def drive(self) -> ConverterControl:
        assert isinstance(self.control, ConverterControl)
        return self.control

    @property
    def rpm(self) -> float:
        """True speed of the rotor."""
        return self.motion.speed_rad_s * TO_RPM

    def turn(self, rpm: float = 200.0) -> None:
        self.drive.set_ramp(400.0)
        self.drive.enable()
        self.drive.set_speed(rpm)
        self.clock.wait(abs(rpm) / 400.0 + 1.0)

    def sent(self) -> list[wire.Request]:
        """Requests of the host since the recording began."""
        found = [wire.parse_request(data) for direction, data, _ in self.reads if direction == TX]
        assert None not in found
        return [request for request in found if request is not None]

    def events(self, kind: str) -> list[str]:
        return [item.text for item in self.items if isinstance(item, DeviceEvent) and item.kind == kind]

    @property
    def lost(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}


def opened(driver: Driver = DRIVER) -> Bench:
    made = Bench(driver)
    made.begin()
    return made


@pytest.fixture
def bench() -> Bench:
    made = opened()
    made.clock.wait(0.3)
    return made


def test_the_line_carries_one_request_at_a_time(bench: Bench) -> None:
    bench.turn()
    bench.drive.stop()
    waits = False
    for direction, data, _ in bench.reads:
        assert direction == (RX if waits else TX)
        waits = not waits
        assert direction == RX or wire.parse_request(data) is not None
    assert bench.converter.collisions == 0
    assert bench.lost == {}


def test_both_directions_and_the_highest_speed(bench: Bench) -> None:
    bench.turn(-200.0)
    assert bench.rpm == pytest.approx(-200, rel=0.01)
    assert bench.drive.actual_rpm == pytest.approx(-200, abs=1)
    with pytest.raises(DeviceError, match="its highest is 1500 rpm"):
        bench.drive.set_speed(1501)
    assert bench.permitted[-1] == -200


def test_a_converter_without_a_reverse_command_is_not_turned_backwards() -> None:
    one_way = replace(DRIVER, example={"registers": {"run_reverse": None}})

    bench = opened(one_way)
    bench.drive.enable()
    with pytest.raises(DeviceError, match="does not turn backwards"):
        bench.drive.set_speed(-100)


def test_the_slip_of_the_motor_is_a_setting() -> None:
    """The converter reports the field: without the setting its speed is above the rotor's by the slip."""
    errors: list[float] = []
    for driver in (DRIVER, _INVT):
        bench = opened(driver)
        bench.turn(1000)
        bench.clock.wait(2.0)
        errors.append(bench.drive.actual_rpm - bench.rpm)
    assert errors == pytest.approx([2.0, 0.0], abs=0.3)


def test_a_ramp_that_its_steps_do_not_allow_is_refused(bench: Bench) -> None:
    with pytest.raises(DeviceError, match=r"multiples of 0\.1 s to 1500 rpm, the nearest ramp is"):
        bench.drive.set_ramp(6100)
    with pytest.raises(DeviceError, match="above 0"):
        bench.drive.set_ramp(math.nan)


# --- stop --------------------------------------------------------------------------------------------------------


def test_a_stop_is_sent_to_a_converter_that_does_not_answer(bench: Bench) -> None:
    """It executes the stop, its speed is unknown, and the stop is reported as not confirmed."""
    bench.turn()
    bench.converter.fail("mute", 1)
    bench.clock.wait(0.7)
    assert math.isnan(bench.drive.actual_rpm)
    assert bench.drive.state == registers.UNKNOWN
    assert not bench.drive.enabled
    messages: list[str] = []
    assert bench.drive.stop(messages.append) is False
    assert abs(bench.rpm) < 1
    assert "the release is not confirmed" in messages[-1]


def test_a_quick_stop_replaces_commands_that_wait(bench: Bench) -> None:
    bench.turn()
    begun = len(bench.sent())
    bench.drive._line.put([bench.drive._write(0x2001, 4000)])
    bench.drive.quick_stop()
    bench.clock.wait(0.5)
    assert [request.values for request in bench.sent()[begun:] if request.values] == [(4,), (0,)]
    assert abs(bench.rpm) < 1


def test_without_a_command_of_its_own_a_quick_stop_is_a_steep_ramp() -> None:
    bench = opened(_INVT)
    bench.turn(400)
    bench.drive.quick_stop()
    bench.clock.wait(0.8)
    assert abs(bench.rpm) < 1
    bench.drive.enable()
    bench.drive.set_speed(400)
    bench.clock.wait(2.0)
    bench.drive.set_speed(0)
    bench.clock.wait(0.5)
    assert bench.rpm == pytest.approx(230, abs=30)  # the ramp is the commanded one again


def test_no_command_follows_a_stop_that_interrupts_it(bench: Bench) -> None:
    bench.turn()
    line = bench.drive._line
    put = line.put

    def put_and_stop(requests: Any, *, urgent: bool = False) -> Any:
        queued = put(requests, urgent=urgent)
        if not urgent:
            bench.clock.wait(0.0)
            bench.drive._armed = False  # as a stop from another thread does
            bench.drive._brake()
        return queued

    line.put = put_and_stop
    begun = len(bench.sent())
    with pytest.raises(DeviceError, match="300 rpm wanted, it is not enabled"):
        bench.drive.set_speed(300)
    bench.clock.wait(0.5)
    assert [request.values for request in bench.sent()[begun:] if request.values] == [(4,), (0,)]
    assert abs(bench.rpm) < 1


def test_a_converter_that_goes_on_running_is_not_released(bench: Bench) -> None:
    bench.drive.enable()
    bench.converter.fail("refuses", 6)
    with pytest.raises(DeviceError, match="commanded to release the rotor, its state is RUNNING"):
        bench.drive.disable()
    assert bench.events("refused")


# --- watchdog ----------------------------------------------------------------------------------------------------


def test_the_converter_stops_when_requests_stay_away(bench: Bench) -> None:
    """Its fault is reset once by the next `enable`, with a text for the operator."""
    bench.turn()
    assert bench.converter.watchdog_ms == 1000
    stopped = bench.clock.now_s()
    bench.converter.fail("deaf", 1)
    while abs(bench.rpm) > 1:
        bench.clock.wait(0.02)
    assert 1.0 < bench.clock.now_s() - stopped < 2.0
    bench.clock.wait(0.5)
    bench.converter.fail("deaf", 0)
    bench.clock.wait(0.5)
    assert bench.drive.dropped_out == registers.FAULT
    assert bench.drive.fault_code() == 18
    bench.drive.enable()
    assert "missing host (code 18)" in bench.drive.was_reset
    assert bench.drive.enabled


def test_its_watchdog_is_ended_at_rest_only(bench: Bench) -> None:
    bench.turn()
    assert bench.drive.stop() is True
    assert bench.converter.watchdog_ms == 0
    assert bench.sent()[-1] == wire.Request(1, 6, 0x2012, 1, (0,))


@pytest.mark.parametrize("found", [0, 11, 600])
def test_a_converter_without_its_watchdog_is_not_enabled(bench: Bench, found: int) -> None:
    bench.converter._server.words[0x2012] = found
    with pytest.raises(DeviceError, match=rf"communication timeout \(register 8210\) is {found}, expected 10"):
        bench.drive.enable()
    assert bench.converter.state == "off"


def test_a_converter_that_started_again_is_not_enabled(bench: Bench) -> None:
    bench.turn()
    bench.converter.power(False, bench.clock.now_s())
    bench.clock.wait(0.7)
    bench.converter.power(True, bench.clock.now_s())
    bench.clock.wait(8.0)
    assert bench.drive.dropped_out == registers.READY
    with pytest.raises(DeviceError, match="it started again"):
        bench.drive.enable()


# --- faults ------------------------------------------------------------------------------------------------------


def test_a_fault_is_not_reset(bench: Bench) -> None:
    """The rotor runs down without torque: its speed is unknown, not 0."""
    bench.turn()
    bench.converter.fail("fault", 3)
    bench.clock.wait(0.3)
    assert bench.drive.dropped_out == registers.FAULT
    assert bench.drive.why() == "; fault 3, see its manual"
    assert bench.rpm > 150
    assert math.isnan(bench.drive.actual_rpm)
    assert bench.events("emergency") == ["fault 3, see its manual"]
    with pytest.raises(DeviceError, match="it has a fault; fault 3"):
        bench.drive.enable()
    with pytest.raises(DeviceError, match=r"200 rpm wanted, it is not enabled \(FAULT"):
        bench.drive.set_speed(200)
    checks = DRIVER.checks(
        bench.settings, bench.pipeline, bench.drive, [i for i in bench.items if isinstance(i, DeviceEvent)]
    )
    assert [name for name, check in checks.items() if not check.passed] == ["state", "emergencies"]


def test_an_output_that_is_off_is_not_switched_on_while_the_rotor_turns(bench: Bench) -> None:
    bench.turn()
    bench.converter.fail("fault", 18)
    bench.clock.wait(0.3)
    with pytest.raises(DeviceError, match="its output is off and the rotor turns"):
        bench.drive.enable()


def test_a_refused_command_is_an_error_with_its_reason(bench: Bench) -> None:
    bench.turn()
    bench.converter.fail("refuses", 7)
    with pytest.raises(DeviceError, match="refuses writing 1000 to register 8193: exception 7: it does not execute"):
        bench.drive.set_speed(300)
    assert bench.lost == {"refused": 2}


def test_damaged_answers_are_counted_and_the_command_is_repeated(bench: Bench) -> None:
    bench.turn()
    bench.converter.fail("damage", 1)
    bench.clock.wait(0.25)
    bench.converter.fail("damage", 0)
    bench.clock.wait(0.3)
    assert bench.drive.dropped_out is None
    assert bench.lost["damaged_answers"] == 2
    assert bench.events("damage")
    assert bench.drive.actual_rpm == pytest.approx(200, abs=2)


@pytest.mark.parametrize("late_s", [0.12, 0.2, 0.26])
def test_a_late_answer_is_not_taken_for_another_requests(bench: Bench, late_s: float) -> None:
    """Each report contains the number of the request to which the converter made it."""
    converter = bench.converter

    def received() -> int:
        return converter._server.requests + converter.collisions

    measure, known = converter._measure, received() - len(bench.sent())

    def number() -> None:
        measure()
        converter._server.words[0x2102] = received() + 1

    converter._measure = number
    begun = len(bench.reads)
    for late in (late_s, 0.0, late_s, 0.0):
        converter.fail("late", late)
        bench.clock.wait(0.06 if late else 0.5)
    pipeline = DRIVER.pipeline("drive", bench.settings, {})
    sent = reports = 0
    for place, (direction, data, host_ns) in enumerate(bench.reads):
        sent += direction == TX
        for item in pipeline.feed(direction, data, host_ns):
            words = item.text.split() if isinstance(item, DeviceEvent) and item.kind == "reply" else []
            if place >= begun and len(words) == 4:
                assert int(words[2]) == known + sent
                reports += 1
    assert reports > 10
    assert pipeline.losses["unanswered"] >= 1


def test_a_silent_converter_cannot_be_opened() -> None:
    bench = Bench()
    bench.converter.fail("mute", 1)
    with pytest.raises(DeviceError, match="no answer to a read of 4 registers from 8448"):
        bench.begin()


def test_a_converter_with_other_registers_cannot_be_opened_and_its_refusal_is_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench()
    monkeypatch.setattr(bench.converter._server, "_answer", lambda request: wire.Answer(request, exception=2))
    reason = 'refuses reading register 8448: exception 2: no such register, .* Is the register table "generic" right'
    with pytest.raises(DeviceError, match=reason):
        bench.begin()


def test_a_line_that_is_lost_is_reported(bench: Bench) -> None:
    bench.turn()
    bench.gone = True
    with pytest.raises(LinkLost):
        bench.drive.stop()


# --- bad days ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("off_s", [0.5, 2.0, 6.0])
def test_a_supply_that_failed_while_it_turned_is_a_restart_with_unknown_speed(bench: Bench, off_s: float) -> None:
    """The rotor runs down without torque, and the converter that returns reports 0 and no fault."""
    bench.turn(600)
    bench.converter.power(False, bench.clock.now_s())
    bench.clock.wait(off_s)
    begun = len(bench.items)
    bench.converter.power(True, bench.clock.now_s())
    bench.clock.wait(0.5)
    assert bench.rpm > 100
    speeds = [row.columns["speed_rpm"][0] for row in bench.items[begun:] if isinstance(row, Batch)]
    assert speeds
    assert all(math.isnan(speed) for speed in speeds)
    assert len(bench.events("restart")) == 1
    assert "it was switched off and on" in bench.events("restart")[0]


def test_a_supply_that_failed_at_rest_is_a_warning_and_ends_nothing(bench: Bench) -> None:
    bench.converter.power(False, bench.clock.now_s())
    bench.clock.wait(2.0)
    bench.converter.power(True, bench.clock.now_s())
    bench.clock.wait(0.5)
    found = [item for item in bench.items if isinstance(item, DeviceEvent) and item.kind in ("emergency", "restart")]
    assert [event.kind for event in found] == ["emergency"]
    assert "it was switched off and on" in DRIVER.words(found[0])
    assert not DRIVER.checks(bench.settings, bench.pipeline, bench.drive, found)["emergencies"].passed
    assert bench.drive.actual_rpm == 0
    bench.drive.start()
    bench.turn()
    assert bench.rpm == pytest.approx(200, rel=0.01)
    assert len(bench.events("emergency")) == 1


def test_a_silence_without_a_restart_causes_no_event(bench: Bench) -> None:
    bench.turn()
    bench.converter.fail("mute", 1)
    bench.clock.wait(0.8)
    bench.converter.fail("mute", 0)
    bench.clock.wait(0.5)
    assert bench.events("restart") == []
    assert bench.drive.actual_rpm == pytest.approx(200, abs=2)


@pytest.mark.parametrize("exception", [5, 6])
def test_a_command_to_a_busy_converter_is_repeated(bench: Bench, exception: int) -> None:
    bench.turn()
    busy, server = [exception] * 2, bench.converter._server
    written = server._written
    server._written = lambda register, value: busy.pop() if busy else written(register, value)
    bench.drive.set_speed(300)
    bench.clock.wait(1.0)
    assert bench.rpm == pytest.approx(300, abs=2)
    assert bench.lost == {"refused": 2}


def test_reports_go_on_while_a_command_waits_for_a_busy_converter(bench: Bench) -> None:
    bench.turn()
    bench.converter.fail("refuses", 6)
    begun = len(bench.items)
    with pytest.raises(DeviceError, match="exception 6: it is busy"):
        bench.drive.set_speed(300)
    assert sum(isinstance(item, Batch) for item in bench.items[begun:]) >= 3
    bench.drive.quick_stop()  # is not delayed by the commands before it
    bench.converter.fail("refuses", 0)
    bench.clock.wait(0.4)
    assert abs(bench.rpm) < 1


def test_a_converter_that_does_not_obey_a_stop_is_named(bench: Bench) -> None:
    """It answers and goes on running, as one that is set to its keypad."""
    bench.turn()
    bench.converter._server._written = lambda register, value: 0
    with pytest.raises(DeviceError, match=r"it answers, but does not obey\. Look whether it is set to its keypad"):
        bench.drive.disable()
    messages: list[str] = []
    bench.converter.fail("refuses", 4)
    assert bench.drive.stop(messages.append) is False
    assert "commanded to release the rotor, its state is RUNNING: it answers, but does not obey" in messages[-1]


def test_a_timeout_that_cannot_be_ended_stays_and_its_fault_is_reset() -> None:
    bench = opened(_ALTIVAR)
    bench.turn()
    assert bench.drive.stop() is True
    assert bench.converter.watchdog_ms == 1000
    bench.converter.fail("fault", 0x7510)
    bench.drive.start()
    bench.clock.wait(0.3)
    bench.drive.enable()
    assert "missing host (code 29968)" in bench.drive.was_reset


def test_while_it_is_opened_again_only_stops_are_sent(bench: Bench) -> None:
    bench.clock.wait(0.3)
    bench.drive.pause()
    bench.clock.wait(0.2)
    begun = len(bench.sent())
    bench.clock.wait(1.0)
    assert len(bench.sent()) == begun
    bench.drive.quick_stop()
    bench.clock.wait(0.2)
    assert [request.values for request in bench.sent()[begun:]] == [(4,), (0,)]
    bench.drive.start()
    bench.turn()
    assert bench.rpm == pytest.approx(200, rel=0.01)


def test_an_echo_of_the_adapter_is_named_when_nothing_else_comes() -> None:
    bench = Bench()
    receive = bench.converter.receive
    bench.converter.fail("deaf", 1)
    bench.converter.receive = lambda data, now_s: data + receive(data, now_s)
    with pytest.raises(DeviceError, match=r"as many bytes came as were sent \(32\)"):
        bench.begin()


def test_it_is_turned_through_an_adapter_with_an_echo() -> None:
    bench = Bench()
    receive = bench.converter.receive
    bench.converter.receive = lambda data, now_s: data + receive(data, now_s)
    bench.begin()
    bench.turn()
    assert bench.rpm == pytest.approx(200, rel=0.01)
    assert bench.drive.stop() is True
    assert bench.lost == {}
    checks = DRIVER.checks(bench.settings, bench.pipeline, bench.drive, [])
    assert checks["echo"].passed
    assert "returns the host's own bytes" in checks["echo"].note


# --- its time-out, measured ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("ratio", "expected"), [(1.0, 1.025), (1.7, 1.625), (0.5, 0.4), (3.0, 3.0)])
def test_its_time_out_is_measured_by_silence(bench: Bench, ratio: float, expected: float) -> None:
    bench.converter.fail("time-out", ratio)
    found = bench.drive.measure_time_out()
    assert found.measured_s is not None
    assert found.stated_s == pytest.approx(1.0)
    assert found.measured_s == pytest.approx(expected, abs=0.06)
    assert abs(found.measured_s - ratio) <= found.resolution_s + 0.02
    bench.turn()
    assert bench.rpm == pytest.approx(200, rel=0.01), "its fault was reset and polling goes on"


def test_a_converter_that_shows_no_fault_at_rest_is_not_judged(bench: Bench) -> None:
    bench.converter.fail("time-out", 100.0)
    with pytest.raises(DeviceError, match="watch only while they run"):
        bench.drive.measure_time_out()
    bench.turn()
    with pytest.raises(DeviceError, match="must stand"):
        bench.drive.measure_time_out()


def test_without_a_code_of_its_fault_the_time_out_is_not_measured() -> None:
    no_code = replace(DRIVER, example={"registers": {"watchdog_fault": None}})

    bench = opened(no_code)
    with pytest.raises(DeviceError, match="no code of its fault"):
        bench.drive.measure_time_out()
