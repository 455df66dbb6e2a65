"""ODrive: frames against published vectors, the pipeline, the opening, and the rotor's command on simulated time."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.drivers.driver import Driver
from daq.drivers.repeated_command import Mode
from daq.errors import DeviceError, LinkLost
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, FrameDecoder, decode, encode, open_bus
from rig_basics.units import TO_RPM
from rig_drivers.odrive import wire
from rig_drivers.odrive.control import OdriveControl
from rig_drivers.odrive.driver import DRIVER
from rig_drivers.odrive.far_end import SimulatedOdrive
from rig_drivers.odrive.settings import Odrive
from rig_drivers.odrive.stream import OdrivePipeline
from rig_testing.bench import DriverBench
from tests.daq.can_text import rx
from tests.daq.motor_rows import rows

MS = 1_000_000


def axis(**settings: Any) -> Odrive:
    table = {"driver": "odrive", "port": "p", "node_id": 1, "firmware": "0.6", "watchdog_s": 0.5, **settings}
    return Odrive.model_validate(table)


def variant(**settings: Any) -> Driver:
    return replace(DRIVER, example={**DRIVER.example, **settings})


def text(*frames: CanFrame) -> bytes:
    return encode(*(frame for frame in frames))


def sent(records: bytes) -> list[int]:
    return [frame.arbitration_id for frame in decode(records).frames]


def beat(error: int = 0, state: int = wire.IDLE, flags: bytes = bytes(3), node: int = 1) -> CanFrame:
    return CanFrame(node << 5 | 1, struct.pack("<IB", error, state) + flags)


def estimates(position: float, speed: float, node: int = 1) -> CanFrame:
    return CanFrame(node << 5 | 9, struct.pack("<ff", position, speed))


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent) and item.kind != "reply"]


# --- the codec --------------------------------------------------------------------------------------------------


def test_frames_of_the_host_are_those_of_the_documents() -> None:
    """Vectors: set velocity of 25 turns/s to node 1 is published; the others follow from the message table."""
    assert wire.set_velocity(1, 25.0) == CanFrame(0x02D, bytes.fromhex("0000C84100000000"))
    assert encode(wire.set_velocity(1, 25.0)) == rx(b"t02D80000C84100000000\r")
    assert wire.set_velocity_mode(1) == CanFrame(0x02B, bytes.fromhex("0200000001000000"))
    assert wire.set_state(1, wire.CLOSED_LOOP) == CanFrame(0x027, bytes.fromhex("0800000000000000"))
    assert wire.estop(3) == CanFrame(0x062)
    assert wire.clear_errors(1) == CanFrame(0x038, b"\0")
    assert encode(wire.request(1, wire.ESTIMATES)) == rx(b"r0298\r")


def test_frames_of_the_controller_are_those_of_the_documents() -> None:
    """Vectors of a published codec (velocity with feed-forward, heartbeat of firmware 0.5) and of the message table."""
    assert wire.parse_velocity(CanFrame(0x02D, bytes.fromhex("000020C00000803E"))) == -2.5
    found = wire.parse_heartbeat(bytes.fromhex("0100008008000100"))
    assert found == wire.Heartbeat(0x8000_0001, wire.CLOSED_LOOP, bytes.fromhex("000100"))
    assert wire.parse_heartbeat(bytes.fromhex("010000000B000000")) == wire.Heartbeat(1, 11)
    assert wire.parse_estimates(bytes.fromhex("0000803F0000C841")) == (1.0, 25.0)
    version = wire.parse_version(bytes.fromhex("02040438 00060A00"))
    assert version == wire.Version((4, 4, 0x38), (0, 6, 10))
    assert wire.Version((4, 4, 0x38), (0, 6, 10)).series == "0.6"
    assert wire.parse_address(bytes.fromhex("01392B6A4C1E3D00")) == (1, "3D1E4C6A2B39")
    assert wire.pack_address(1, "3D1E4C6A2B39").hex() == "01392b6a4c1e3d00"


@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.integers(0, 62))
def test_a_velocity_survives_its_frame(turns_per_s: float, node: int) -> None:
    frame = wire.set_velocity(node, turns_per_s)
    assert wire.split(frame.arbitration_id) == (node, wire.INPUT_VELOCITY)
    assert wire.parse_velocity(frame) == turns_per_s


@pytest.mark.parametrize("turns_per_s", [math.nan, math.inf, -math.inf, 1e39])
def test_a_velocity_that_is_not_finite_is_not_encoded(turns_per_s: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        wire.set_velocity(1, turns_per_s)


def test_error_codes_depend_on_the_firmware() -> None:
    assert "watchdog" in wire.error_words("0.5", 0x800)
    assert "supply over-current while braking" in wire.error_words("0.6", 0x800)
    assert "watchdog" in wire.error_words("0.6", 0x0100_0000)
    assert "unknown bit 0x80000000" in wire.error_words("0.6", 0x8000_0000)
    event = DeviceEvent("emergency", "drive", "", {"error_code": 0x800, "firmware": "0.5"})
    assert "watchdog" in DRIVER.words(event)
    assert DRIVER.words(DeviceEvent("emergency", "drive", "", {"error_code": 0})) == ""


def test_error_answers_depend_on_the_firmware() -> None:
    assert wire.parse_errors("0.6", 3, bytes.fromhex("0002000000000001")) == {
        "active_errors": 0x200,
        "disarm_reason": 0x0100_0000,
    }
    assert wire.parse_errors("0.5", 3, bytes.fromhex("0000100000000000")) == {"motor_error": 0x10_0000}
    assert wire.parse_errors("0.5", 4, bytes.fromhex("02000000")) == {"encoder_error": 2}
    assert wire.parse_errors("0.6", 4, bytes(8)) == {}, "that is a parameter message of firmware 0.6"
    assert [frame.arbitration_id for frame in wire.error_requests(1, "0.5")] == [0x23, 0x24, 0x3D]
    assert [frame.arbitration_id for frame in wire.error_requests(1, "0.6")] == [0x23]


# --- settings ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"gear_ratio": 0.0}, "0.01 turns"),
        ({"serial": "3D1E4C6A2B39", "firmware": "0.5"}, "serial"),
        ({"watchdog_s": 0.1, "command_ms": 50}, "watchdog_s must be at least"),
        ({"bitrate": 125_000, "estimates_ms": 1}, "raise estimates_ms"),
        ({"node_id": 63}, "less than or equal to 62"),
        ({"firmware": "0.4"}, "0.5"),
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        axis(**wrong)


def test_the_gear_converts_speeds() -> None:
    settings = axis(gear_ratio=-2.0)
    assert settings.turns_per_s(600.0) == -20.0
    assert settings.rpm(-20.0) == 600.0


# --- the pipeline -----------------------------------------------------------------------------------------------


def test_estimates_become_samples_with_set_point_and_state() -> None:
    pipeline = OdrivePipeline("drive", axis(gear_ratio=2.0), {})
    pipeline.feed(TX, text(wire.set_velocity(1, 25.0)), 0)
    pipeline.feed(RX, text(beat(state=wire.CLOSED_LOOP)), MS)
    found = rows(pipeline.feed(RX, text(estimates(0.0, 24.0), estimates(0.2, 24.5)), 2 * MS))
    assert found == [(720.0, 750.0, 8), (735.0, 750.0, 8)]
    pipeline.feed(TX, text(wire.set_state(1, wire.IDLE)), 3 * MS)
    assert rows(pipeline.feed(RX, text(estimates(0.3, 24.0)), 4 * MS)) == [(720.0, 0.0, 8)]


@pytest.mark.parametrize(
    "frame",
    [CanFrame(0x29, bytes(7)), CanFrame(0x29, struct.pack("<ff", 0.0, math.nan)), CanFrame(0x21, bytes(5))],
)
def test_unreadable_reports_are_counted_and_reported(frame: CanFrame) -> None:
    pipeline = OdrivePipeline("drive", axis(), {})
    items = pipeline.feed(RX, text(frame), 0)
    assert kinds(items) == ["damage"]
    assert not rows(items)
    assert pipeline.losses["unreadable_frames"] == 1


def test_error_codes_that_are_sent_periodically_are_an_event_only_when_they_change() -> None:
    """Firmware 0.6 sends them with a period of its own: ten events a second with the same codes filled the log."""

    def codes(active: int, reason: int) -> CanFrame:
        return CanFrame(0x23, struct.pack("<II", active, reason))

    pipeline = OdrivePipeline("drive", axis(), {})
    assert kinds(pipeline.feed(RX, text(*[codes(0, 0)] * 5), 0)) == ["status"]
    assert kinds(pipeline.feed(RX, text(*[codes(0x200, 0x200)] * 5), MS)) == ["status"]
    assert pipeline.errors == {"active_errors": 0x200, "disarm_reason": 0x200}
    pipeline.feed(RX, text(beat(), beat(0x200), beat()), 2 * MS)
    assert kinds(pipeline.feed(RX, text(beat(0x200), codes(0x200, 0x200)), 3 * MS)) == ["drive", "emergency", "status"]


def test_a_command_of_another_node_is_a_fault() -> None:
    pipeline = OdrivePipeline("drive", axis(), {})
    own = wire.set_velocity(1, 2.0)
    pipeline.feed(TX, text(own), 0)
    assert kinds(pipeline.feed(RX, text(own), MS)) == [], "an adapter may echo"
    other = wire.set_velocity(1, 3.0)
    assert kinds(pipeline.feed(RX, text(other), 2 * MS)) == ["fault"]
    assert kinds(pipeline.feed(RX, text(other), 3 * MS)) == [], "once in a second"
    assert kinds(pipeline.feed(RX, text(other), 1100 * MS)) == ["fault"]
    assert rows(pipeline.feed(RX, text(estimates(0.0, 0.0)), 1101 * MS))[0][1] == 120.0, "the set-point is this host's"


def test_a_session_that_only_receives_takes_the_set_point_from_the_bus() -> None:
    pipeline = OdrivePipeline("drive", axis(), {})
    assert kinds(pipeline.feed(RX, text(wire.set_velocity(1, 3.0)), 0)) == []
    assert rows(pipeline.feed(RX, text(estimates(0.0, 0.0)), MS)) == [(0.0, 180.0, 0)]


def test_a_rotor_that_does_not_follow_is_a_fault() -> None:
    pipeline = OdrivePipeline("drive", axis(follow_s=0.1), {})
    pipeline.feed(TX, text(wire.set_velocity(1, 10.0)), 0)
    items = [kind for n in range(30) for kind in kinds(pipeline.feed(RX, text(estimates(0.0, 0.0)), n * 10 * MS))]
    assert items == ["fault"]


# --- the command ------------------------------------------------------------------------------------------------


class Bench(DriverBench):
    """DriverBench with the classes of this driver."""

    @property
    def axis(self) -> SimulatedOdrive:
        return cast("SimulatedOdrive", self.far)

    @property
    def drive(self) -> OdriveControl:
        return cast("OdriveControl", self.control)

    @property
    def rpm(self) -> float:
        return self.motion.speed_rad_s * TO_RPM

    def kinds(self) -> list[str]:
        return kinds(self.items)

    def commands(self) -> list[int]:
        """Commands that the host has sent to the axis."""
        decoder = FrameDecoder()
        sent = [frame for way, data, _ in self.reads if way == TX for frame in decoder.feed(data).frames]
        return [wire.split(frame.arbitration_id)[1] for frame in sent if not frame.remote]

    def runs(self, rpm: float) -> None:
        self.begin()
        self.clock.wait(0.8)
        self.drive.set_ramp(400.0)
        self.drive.enable()
        self.drive.set_speed(rpm)
        self.clock.wait(abs(rpm) / 400.0 + 0.5)
        assert self.rpm == pytest.approx(rpm, rel=0.01)


@pytest.mark.parametrize("gear_ratio", [1.0, -3.0])
@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_it_turns_and_stops_the_rotor(firmware: str, gear_ratio: float) -> None:
    bench = Bench(variant(firmware=firmware, gear_ratio=gear_ratio))
    bench.runs(200.0)
    assert bench.drive.actual_rpm == pytest.approx(bench.rpm, abs=2.0)
    assert bench.drive.stop() is True
    bench.end()
    assert abs(bench.rpm) < 1.0
    bench.clock.wait(1.0)
    assert bench.axis.facts()["drive"] == "FAULT", "the watchdog of an axis without host expires"
    assert "emergency" not in bench.kinds()
    assert wire.ESTOP not in bench.commands()
    assert wire.ADDRESS not in bench.commands()


def test_the_watchdog_removes_the_torque_when_the_host_is_gone() -> None:
    bench = Bench(DRIVER)
    bench.runs(200.0)
    bench.gone = True
    bench.clock.wait(0.45)
    assert bench.rpm > 195.0
    bench.clock.wait(1.0)
    assert bench.axis.emergencies[-1] == wire.WATCHDOG["0.6"]
    assert bench.axis.state == wire.IDLE
    assert bench.rpm < 190.0
    with pytest.raises(LinkLost):
        bench.drive.stop()


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_a_controller_whose_watchdog_is_off_is_not_enabled(firmware: str) -> None:
    bench = Bench(variant(firmware=firmware, proves_watchdog=True))
    bench.far = SimulatedOdrive(axis(firmware=firmware), bench.motion, watchdog_s=0.0)
    bench.begin()
    bench.clock.wait(1.0)
    with pytest.raises(DeviceError, match="watchdog has not expired"):
        bench.drive.enable()
    assert wire.AXIS_STATE not in bench.commands()


def test_an_error_while_it_drives_drops_the_drive_out_and_names_the_cause() -> None:
    bench = Bench(variant(firmware="0.5"))
    bench.runs(200.0)
    bench.far.fail("fault", 0x40)
    bench.clock.wait(0.5)
    assert bench.drive.dropped_out == "FAULT"
    assert not bench.drive.enabled
    assert "motor failed" in bench.drive.why()
    assert "motor_error 0x100000" in bench.drive.why()
    assert bench.drive.fault_code() == 0x40
    assert bench.kinds().count("emergency") == 1
    with pytest.raises(DeviceError, match="motor failed"):
        bench.drive.enable()
    assert bench.drive.mode is Mode.BRAKE
    assert bench.drive.stop() is True


def test_a_restart_while_it_drives_drops_the_drive_out() -> None:
    bench = Bench(variant(firmware="0.5"))
    bench.runs(200.0)
    bench.far.fail("restart", 1)
    bench.clock.wait(0.5)
    assert bench.drive.dropped_out == "RESTARTED"
    assert "restart" in bench.kinds()
    bench.clock.wait(8.0)
    bench.drive.stop()
    bench.clock.wait(1.0)
    bench.drive.start()
    bench.drive.enable()
    assert bench.drive.enabled


def test_power_loss_ends_the_drive_and_its_reports() -> None:
    bench = Bench(DRIVER)
    bench.runs(200.0)
    bench.far.power(False, bench.motion.time_s)
    bench.clock.wait(1.0)
    assert math.isnan(bench.drive.actual_rpm)
    assert bench.drive.state == "UNKNOWN"
    bench.far.power(True, bench.motion.time_s)
    bench.clock.wait(1.0)
    assert bench.axis.state == wire.IDLE
    assert bench.drive.dropped_out == "RESTARTED"
    assert "restart" in bench.kinds()
    assert bench.rpm < 200.0


@pytest.mark.parametrize("fault", ["silent reports", "silent heartbeat"])
def test_reports_that_are_too_old_are_not_used(fault: str) -> None:
    bench = Bench(DRIVER)
    bench.runs(200.0)
    bench.far.fail(fault, 1)
    bench.clock.wait(0.7)
    assert not bench.drive.enabled
    assert math.isnan(bench.drive.actual_rpm) is (fault == "silent reports")
    assert (bench.drive.state == "UNKNOWN") is (fault == "silent heartbeat")


def test_an_axis_without_heartbeat_is_stopped_although_its_estimates_go_on() -> None:
    """Its channel is not silent; its errors and its watchdog are not seen."""
    bench = Bench(DRIVER)
    bench.runs(200.0)
    bench.far.fail("silent heartbeat", 1)
    bench.clock.wait(0.8)
    assert bench.drive.dropped_out is None
    bench.clock.wait(0.5)
    assert bench.drive.dropped_out == "UNKNOWN (no heartbeat for 100 estimates)"
    bench.clock.wait(1.0)
    assert abs(bench.rpm) < 1.0


def test_a_runaway_rotor_loses_its_torque() -> None:
    bench = Bench(DRIVER)
    bench.runs(200.0)
    bench.far.fail("speed", 600.0)
    bench.clock.wait(1.0)
    assert bench.drive.stop() is True
    assert wire.ESTOP in bench.commands()
    assert bench.axis.state == wire.IDLE


def test_a_release_that_no_heartbeat_confirms_is_an_error() -> None:
    bench = Bench(DRIVER)
    bench.runs(100.0)
    bench.drive.quick_stop()
    bench.clock.wait(1.0)
    bench.far.fail("silent heartbeat", 1)
    with pytest.raises(DeviceError, match="not confirmed"):
        bench.drive.disable()


def test_a_second_host_is_a_fault() -> None:
    bench = Bench(DRIVER)
    bench.runs(100.0)
    bench.far.fail("second host", 1)
    bench.clock.wait(0.5)
    assert "fault" in bench.kinds()


# --- opening and playing ----------------------------------------------------------------------------------------


def test_the_identity_contains_the_serial_number() -> None:
    bench = Bench(variant(serial="3D1E4C6A2B39"))
    bench.begin()
    assert bench.identity["serial"] == "3D1E4C6A2B39"
    assert bench.identity["firmware"] == "0.6.10"
    bench = Bench(variant(firmware="0.5"))
    bench.begin()
    assert bench.identity["serial"] == ""


def nothing(bench: Bench) -> None:
    """Leave the controller as it is."""


def fault(name: str) -> Callable[[Bench], None]:
    return lambda bench: bench.far.fail(name, 1)


def other_firmware(bench: Bench) -> None:
    bench.far = SimulatedOdrive(axis(firmware="0.6"), bench.motion)


def test_firmware_0_5_never_gets_a_request_of_the_address() -> None:
    """With firmware 0.5 the command 06h changes the node's number."""
    sent: list[bytes] = []
    bench = Bench(variant(firmware="0.5"))
    receive = bench.far.receive

    def listen(data: bytes, now_s: float) -> bytes:
        sent.append(data)
        return receive(data, now_s)

    bench.far.receive = listen
    bench.runs(100.0)
    frames = decode(b"".join(sent)).frames
    assert CanFrame(0x020, bytes(8), remote=True) in frames, "the request of the version"
    assert 0x026 not in [frame.arbitration_id for frame in frames]


@pytest.mark.parametrize(
    ("settings", "spoil", "message"),
    [
        ({"serial": "000000000001"}, nothing, "serial number 000000000001, it is 3D1E4C6A2B39"),
        ({}, fault("silent heartbeat"), "expected heartbeats of node 1"),
        ({}, fault("silent reports"), "no encoder estimates"),
        ({}, fault("deaf"), "does not report its version"),
        ({"firmware": "0.5"}, other_firmware, "expected firmware 0.5, it has 0.6"),
    ],
)
def test_an_opening_that_fails_names_the_cause(
    settings: dict[str, Any], spoil: Callable[[Bench], None], message: str
) -> None:
    bench = Bench(variant(**settings))
    spoil(bench)
    with pytest.raises(DeviceError, match=message):
        bench.begin()


@pytest.mark.parametrize("identity", [{}, {"firmware": "?", "hardware": "1.2.3", "serial": "xyz"}])
def test_the_stand_in_for_playing_accepts_any_identity(identity: dict[str, Any]) -> None:
    played = DRIVER.played(axis(), identity)
    assert not played.sending
    assert 0x021 in sent(played.hear(open_bus(250_000)))
    assert played.sending
    answer = played.hear(text(wire.request(1, wire.VERSION), wire.request(1, wire.ADDRESS)))
    assert 0x000 not in sent(answer)
    assert 0x020 in sent(answer)
    assert 0x026 in sent(answer)
    played.hear(text(wire.set_state(1, wire.CLOSED_LOOP), wire.set_state(2, wire.CLOSED_LOOP)))
    assert played.unfollowed == 1


@pytest.mark.parametrize("case", rig_testing.cases(variant(firmware="0.5", gear_ratio=-2.5, node_id=0)), ids=str)
def test_the_kit_passes_with_firmware_0_5_and_a_gear(case: rig_testing.ContractCase) -> None:
    if case.name not in ("mutations", "memory"):  # the same decoder as with the example
        case()


@pytest.mark.parametrize("ratio", [1.0, 3.0, 0.4])
def test_its_time_out_is_measured_at_rest(ratio: float) -> None:
    bench = Bench(variant(firmware="0.5"))
    bench.begin()
    bench.axis.fail("time-out", ratio)
    bench.clock.wait(0.3)
    found = bench.drive.measure_time_out()
    assert found.measured_s is not None
    assert abs(found.measured_s - 0.5 * ratio) <= found.resolution_s
    assert found.resolution_s < 0.2
    assert found.stated_s == 0.5
    assert wire.AXIS_STATE not in bench.commands()


def test_a_watchdog_that_is_off_has_no_time_out() -> None:
    bench = Bench(variant(firmware="0.5"))
    bench.far = SimulatedOdrive(axis(firmware="0.5"), bench.motion, watchdog_s=0.0)
    bench.begin()
    bench.clock.wait(0.3)
    assert bench.drive.measure_time_out().measured_s is None


def test_its_time_out_is_not_measured_while_it_drives_or_has_a_fault_or_is_not_known_to_watch() -> None:
    bench = Bench(variant(firmware="0.5"))
    bench.runs(100.0)
    with pytest.raises(DeviceError, match="must stand"):
        bench.drive.measure_time_out()
    bench.drive.stop()
    bench.axis.fail("fault", 0x40)
    bench.clock.wait(0.3)
    with pytest.raises(DeviceError, match="without a fault"):
        bench.drive.measure_time_out()
    assert bench.axis.error & 0x40, "a fault is not cleared"
    bench = Bench(DRIVER)
    bench.begin()
    bench.clock.wait(0.3)
    with pytest.raises(DeviceError, match="proves_watchdog"):
        bench.drive.measure_time_out()
