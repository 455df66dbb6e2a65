"""The life of a speed source's command, with a device that consists of a few variables."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.host_command import UNCONFIRMED, HostCommand, Steps
from daq.errors import DeviceError, ProcedureError
from daq.transports.host_clock import HostClock, Repeated


@dataclass(frozen=True)
class Settings:
    ramp_rpm_per_s: float = 100.0
    rest_rpm: float = 1.0


class Ended:
    """A repeated action that never runs."""

    def stop(self, seconds: float | None = 2.0) -> None:
        """Nothing runs."""


class HandClock(HostClock):
    """A clock that each wait moves; `passes` is called with the new time, s."""

    def __init__(self) -> None:
        super().__init__()
        self.at_s = 1000.0
        self.passes: Callable[[float], None] = lambda at_s: None

    def now_ns(self) -> int:
        return round(self.at_s * 1e9)

    def wait(self, seconds: float) -> None:
        self.at_s += seconds
        self.passes(self.at_s)

    def every(
        self, seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        return Ended()


class Motor(HostCommand):
    """A motor that obeys at once, unless a test sets it otherwise."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.sent: list[str] = []
        self.refused: Exception | None = None
        self.rpm, self.obeys, self.brakes, self.releases = 0.0, True, True, True
        self.last_step: Callable[[], None] = lambda: None
        guard = RotorGuard(self._permit, lambda: abs(self.rpm) < 1, lambda: abs(self.rpm))
        super().__init__(Settings(), lambda data: None, self.clock, guard)

    def _permit(self, rpm: float | None) -> None:
        if self.refused is not None:
            raise self.refused

    def notice(self, pipeline: Pipeline) -> None:
        raise NotImplementedError

    def reports(self, rpm: float, state: str = "") -> None:
        self._take_speed(rpm)
        if state:
            with self._deciding:
                self._fall(state)

    @property
    def state(self) -> str:
        return "RUNS" if self.enabled else "OFF"

    def fault_code(self) -> int | None:
        return None

    def why(self) -> str:
        return "; why"

    def start(self) -> None:
        self._repeat(1.0, self.beat, "command")

    def _enabling(self) -> Steps:
        self._ordered = True
        self.sent.append("run")
        try:
            while not self.obeys:
                yield "it does not obey"
            self.last_step()
        except BaseException:
            self.sent.append("abandoned")
            raise

    def _set_ramp(self, rpm_per_s: float) -> None:
        self.sent.append(f"ramp {rpm_per_s:g}")

    def set_speed(self, rpm: float) -> None:
        self._check_armed(rpm)
        self.rpm = rpm

    def _brake(self) -> None:
        self.sent.append("brake")
        self.rpm = 0.0 if self.brakes and self.rpm < 50 else self.rpm - 50.0 * self.brakes

    def _switch_off(self) -> str:
        def order() -> Callable[[], bool]:
            self.sent.append("release")
            return lambda: self.releases

        return "" if self._confirm(order) else UNCONFIRMED

    def _finish(self) -> str:
        return self._switch_off()

    def measure(self, reported: Callable[[], bool], stated_s: float) -> TimeOut:
        return self._await_time_out(reported, self.clock.now_s(), stated_s, 0.0)


@pytest.fixture
def motor() -> Motor:
    made = Motor()
    made.start()
    return made


def turning(motor: Motor, rpm: float = 120.0) -> Motor:
    motor.enable()
    motor.set_speed(rpm)
    motor.sent.clear()
    return motor


def test_a_reported_speed_has_an_age(motor: Motor) -> None:
    assert math.isnan(motor.actual_rpm)
    motor.reports(30.0)
    assert motor.actual_rpm == 30.0
    motor.clock.at_s += 1.0
    assert math.isnan(motor.actual_rpm)


def test_a_speed_needs_an_enabled_device(motor: Motor) -> None:
    with pytest.raises(DeviceError, match=r"20 rpm wanted, it is not enabled \(OFF; why\)"):
        motor.set_speed(20)
    assert turning(motor, 20).rpm == 20


def test_permission_is_needed_before_each_step_and_the_steps_are_ended(motor: Motor) -> None:
    motor.refused = ProcedureError("not permitted")
    with pytest.raises(ProcedureError):
        motor.enable()
    assert motor.sent == []
    motor.refused, motor.obeys = None, False
    motor.clock.passes = lambda at_s: setattr(motor, "refused", ProcedureError("not permitted any more"))
    with pytest.raises(ProcedureError, match="any more"):
        motor.enable()
    assert motor.sent == ["run", "abandoned"]


def test_a_stop_ends_the_enabling_also_if_the_device_has_obeyed(motor: Motor) -> None:
    motor.obeys = False

    def stop_and_obey(at_s: float) -> None:
        motor.quick_stop()
        motor.obeys = True

    motor.clock.passes = stop_and_obey
    with pytest.raises(DeviceError, match="a stop was commanded while it was being enabled"):
        motor.enable()
    assert not motor.enabled
    motor.clock.passes, motor.last_step = lambda at_s: None, motor.quick_stop
    with pytest.raises(DeviceError, match="a stop was commanded while it was being enabled"):
        motor.enable()
    motor.last_step = lambda: None
    motor.enable()
    motor.reports(0.0)
    assert motor.enabled


def test_what_is_awaited_is_the_error_of_a_device_that_does_not_obey(motor: Motor) -> None:
    motor.obeys, begun_s = False, motor.clock.at_s
    with pytest.raises(DeviceError, match="drive: it does not obey"):
        motor.enable()
    assert motor.clock.at_s - begun_s == pytest.approx(motor.enable_s, abs=0.02)
    assert motor.sent == ["run", "abandoned"]


def test_a_device_that_falls_is_stopped_and_its_first_state_stands(motor: Motor) -> None:
    turning(motor).reports(120.0, "FAULT")
    motor.reports(100.0, "OFF")
    assert (motor.dropped_out, motor.enabled, motor.sent) == ("FAULT", False, ["brake", "brake"])
    motor.enable()
    assert motor.dropped_out is None


def test_a_stop_is_repeated_until_rest_and_the_release_follows(motor: Motor) -> None:
    assert turning(motor).stop() is True
    assert motor.sent == ["brake", "brake", "brake", "release"]
    motor.sent.clear()
    assert motor.stop() is True
    assert motor.sent == []  # nothing was commanded since


def test_a_device_that_was_never_commanded_gets_no_command() -> None:
    motor = Motor()
    assert motor.stop() is True
    assert motor.sent == []


def test_a_rotor_that_does_not_stop_is_not_released(motor: Motor) -> None:
    turning(motor).brakes = False
    assert motor.stop() is False
    assert set(motor.sent) == {"brake"}


def test_a_release_that_is_not_confirmed_is_repeated_and_reported(motor: Motor) -> None:
    motor.enable()
    motor.releases = False
    motor.sent.clear()
    with pytest.raises(DeviceError, match="commanded to release the rotor, it does not answer"):
        motor.disable()
    assert motor.sent == ["release"] * len(motor.sent)
    assert len(motor.sent) > 2
    messages: list[str] = []
    assert motor.stop(messages.append) is False
    assert "the release is not confirmed" in messages[-1]
    motor.releases = True
    assert motor.stop() is True


@pytest.mark.parametrize("rate", [0.0, -1.0, math.inf, math.nan])
def test_a_ramp_is_positive_and_finite(motor: Motor, rate: float) -> None:
    with pytest.raises(DeviceError, match="expected a ramp above 0 rpm/s"):
        motor.set_ramp(rate)
    assert motor.sent == []


def test_a_time_out_is_measured_or_awaited_in_vain(motor: Motor) -> None:
    end_s = motor.clock.at_s + 0.7
    found = motor.measure(lambda: motor.clock.at_s >= end_s, 0.5)
    assert found.measured_s == pytest.approx(0.7, abs=found.resolution_s)
    begun_s = motor.clock.at_s
    assert motor.measure(lambda: False, 0.5).measured_s is None
    assert motor.clock.at_s - begun_s > 4 * 0.5
    assert motor.measure_time_out() is None  # a device without such a report
