"""Profile velocity mode of CiA 402 drives: objects, bytes, ramps, halt, and the tests of drivers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.driver import DRIVER
from daq.drivers.cia402.far_end import SimulatedDrive
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.wire import VELOCITY, profile_of
from daq.errors import DeviceError
from daq.items import RX, TX, Batch
from daq.transports.can_frames import CanFrame, encode
from rig_basics.units import TO_RPM
from rig_testing.bench import DriverBench

UNITS = 10_000 * 512 / 1875
"""Units of a drive with an encoder of 10 000 counts: rpm · 512 · resolution / 1875."""


def drive(**given_: Any) -> MotorDrive:
    return MotorDrive.model_validate({"driver": "cia402", "port": "p", "mode": "profile velocity", **given_})


_PROFILE = replace(
    DRIVER,
    example={
        "node_id": 5,
        "mode": "profile velocity",
        "units_per_rpm": UNITS,
        "ramp_units_per_rpm_per_s": 17.5,
    },
)


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=str(case)) for case in rig_testing.cases(_PROFILE) if str(case) != "mutations"]
)
def test_it_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


def test_its_objects_are_those_of_the_standard() -> None:
    profile = profile_of(drive())
    assert (profile.mode, profile.target, profile.actual, profile.size) == (3, 0x60FF, 0x606C, 6)
    assert profile.mapping(0x6040, profile.target) == (0x60400010, 0x60FF0020)
    assert profile.mapping(0x6041, profile.actual) == (0x60410010, 0x606C0020)
    assert profile.pack(0x000F, -300) == bytes.fromhex("0f00 d4fe ffff")
    assert profile_of(drive(units_per_rpm=10.0)).pack(0x000F, 300.5) == bytes.fromhex("0f00 bd0b 0000")


def test_velocity_mode_has_the_same_bytes_as_before() -> None:
    velocity = profile_of(MotorDrive(driver="cia402", port="p"))
    assert velocity is VELOCITY
    assert velocity.pack(0x000F, -300) == cia402.VELOCITY.pack(0x000F, -300)
    assert velocity.mapping(0x6040, velocity.target) == (cia301.mapped_word(0x6040), cia301.mapped_word(0x6042))


@given(st.integers(0, 65535), st.floats(-4000, 4000), st.sampled_from([1.0, 10.0, UNITS]))
def test_speeds_round_trip_to_half_a_unit(word: int, rpm: float, units: float) -> None:
    profile = profile_of(drive(units_per_rpm=units))
    data = profile.pack(word, rpm)
    found, speed = profile.unpack(data + b"\x01\x02")
    assert (found, speed) == (word, pytest.approx(rpm, abs=0.51 / units))
    assert profile.rpm(int.from_bytes(data[2:], "little")) == speed


@given(st.floats(-1e9, 1e9))
def test_a_speed_beyond_the_range_keeps_its_sign(rpm: float) -> None:
    _, speed = VELOCITY.unpack(VELOCITY.pack(0, rpm))
    assert abs(speed) <= 0x7FFF
    assert speed * rpm >= 0


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"mode": "velocity", "units_per_rpm": 10.0}, "belong to mode"),
        ({"mode": "velocity", "ramp_units_per_rpm_per_s": 10.0}, "belong to mode"),
        ({"ramp_bits": True}, "ramp_bits belongs"),
        ({"units_per_rpm": 0.0}, "units_per_rpm"),
        ({"mode": "torque"}, "mode"),
    ],
)
def test_settings_of_the_other_mode_are_refused(given_: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        drive(**given_)


def test_a_drive_is_commanded_through_its_own_objects() -> None:
    """The mapping of velocity mode is replaced, the ramps are set, the speed is followed; halt stops along the ramp."""
    bench = DriverBench(_PROFILE)
    far = bench.far
    assert isinstance(far, SimulatedDrive)
    objects = far._objects
    objects[cia301.RPDO1_MAPPING, 2] = (cia301.mapped_word(cia402.TARGET_VELOCITY), "<I")
    objects[cia301.TPDO1_MAPPING, 2] = (cia301.mapped_word(cia402.ACTUAL_VELOCITY), "<I")
    bench.begin()
    control = bench.control
    assert control is not None
    assert objects[cia402.MODE_OF_OPERATION, 0][0] == 3
    assert objects[cia301.RPDO1_MAPPING, 2][0] == 0x60FF0020
    assert objects[cia301.TPDO1_MAPPING, 2][0] == 0x606C0020
    control.set_ramp(400.0)
    assert (objects[0x6083, 0][0], objects[0x6084, 0][0]) == (7000, 7000)
    control.enable()
    control.set_speed(-200.5)
    bench.clock.wait(1.5)
    sent = [data for direction, data, _ in bench.reads if direction == TX]
    assert encode(CanFrame(0x205, profile_of(drive(units_per_rpm=UNITS)).pack(0x0F, -200.5))) in sent
    assert bench.motion.speed_rad_s * TO_RPM == pytest.approx(-200.5, rel=0.01)
    batch = [item for item in bench.items if isinstance(item, Batch)][-1]
    assert batch.columns["target_rpm"][-1] == pytest.approx(-200.5, abs=1e-3)
    assert batch.columns["speed_rpm"][-1] == pytest.approx(-200.5, rel=0.01)
    assert int(batch.columns["statusword"][-1]) & 0x1400 == 0x0400  # target reached, not at rest
    far._control(cia402.ENABLE_OPERATION | cia402.HALT)
    bench.clock.wait(1.0)
    assert abs(bench.motion.speed_rad_s) * TO_RPM < 1
    assert control.state == cia402.OPERATION_ENABLED
    assert control.stop() is True


def test_a_ramp_below_the_drives_unit_is_refused() -> None:
    coarse = replace(
        DRIVER, example={"mode": "profile velocity", "ramp_units_per_rpm_per_s": 0.01, "ramp_rpm_per_s": 500.0}
    )

    bench = DriverBench(coarse)
    bench.begin()
    assert bench.control is not None
    with pytest.raises(DeviceError, match="the nearest ramp is 100 rpm/s"):
        bench.control.set_ramp(130.0)


def test_a_report_of_velocity_mode_is_too_short() -> None:
    pipeline = DRIVER.pipeline("drive", drive(), {})
    data = encode(CanFrame(0x185, cia402.VELOCITY.pack(0x0237, 300)))
    (event,) = pipeline.feed(RX, data, 0)
    assert not isinstance(event, Batch)
    assert event.text.startswith("its reports (TPDO1) have 4 bytes; statusword and actual speed are 6.")
