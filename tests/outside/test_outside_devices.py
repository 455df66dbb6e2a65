"""Whole sessions in real time with devices that are not ours: opened, recorded, turned and stopped, their logs read."""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from daq import open_log
from daq.acquisition.session import Session
from daq.log import Log
from daq.replay.checking import check
from daq.transports import HostClock
from rig_configs import load_rig
from rig_configs.schema import Rig
from tests.outside.canopen_devices import OutsideDrive, OutsideEncoder

if sys.platform != "win32":
    from tests.outside.modbus_converter import OutsideConverter


def rig_of(tmp_path: Path, device: str) -> Rig:
    """The rig file `virtual` with one device in place of all."""
    text = (resources.files("rig_configs") / "virtual.toml").read_text()
    file = tmp_path / "rig.toml"
    file.write_text(text[: text.index("[devices.")] + device + text[text.index("[limits]") :])
    return load_rig(file)


def decoded_again(path: Path) -> Log:
    """Return a log after its raw bytes have been decoded to the same samples."""
    assert [row.topic for row in check(path) if row.difference] == []
    return open_log(path)


def test_encoders_of_sixteen_bits_give_every_angle_past_the_end_of_their_range(tmp_path: Path) -> None:
    """A turns by a sixteenth between reports, clockwise, and B stands; both count 65 536 a revolution, clockwise."""
    a = OutsideEncoder("encoders", 11, 65_536, 4096 * 65_536 - 5000, 4096)
    b = OutsideEncoder("encoders", 12, 65_536, 32_768, 0)
    device = """
[devices.angles]
driver = "cia406"
port = "can:virtual:encoders"
a_node = 11
b_node = 12
a_positive = "cw"
counts_per_revolution = 65536
zero_std_deg = 0.05
rate_Hz = 50

"""
    log = tmp_path / "encoders.mcap"
    try:
        with Session(rig_of(tmp_path, device), HostClock()) as session:
            assert session.identities["angles"]["serial"] == "1011/1012"
            session.start_recording(log, {"test": "record"})
            session.clock.wait(2.0)
            session.stop_recording({})
    finally:
        a.close()
        b.close()
    with decoded_again(log) as opened:
        found = opened["pendulums"]
    theta_a, theta_b = np.degrees(found["theta3_rad"]), np.degrees(found["theta4_rad"])
    assert 90 <= len(theta_a) <= 101
    assert np.diff(theta_a) == pytest.approx(22.5)
    begin = np.round(theta_a[0] / 360 * 65_536) % 65_536
    assert begin in [position % 65_536 for position in a.reported[:20]]
    assert theta_a[0] * 65_536 / 360 == pytest.approx(np.round(theta_a[0] * 65_536 / 360), abs=1e-6)
    assert theta_b % 360 == pytest.approx(180.0)


def test_a_drive_with_another_mapping_turns_stops_and_is_watched(tmp_path: Path) -> None:
    """As delivered its process data holds no speed; it is set up, turned to 90 rpm and brought to rest."""
    drive = OutsideDrive("drive", 9)
    device = """
[devices.motor]
driver = "cia402"
port = "can:virtual:drive"
node_id = 9
ramp_rpm_per_s = 120.0

"""
    log = tmp_path / "drive.mcap"
    try:
        with Session(rig_of(tmp_path, device), HostClock()) as session:
            motor = session.rotor.drive
            assert motor is not None
            session.start_recording(log, {"test": "record"})
            motor.enable()
            motor.set_speed(90.0)
            session.wait_for(lambda: abs(drive.rpm - 90.0) < 0.5, 3.0, "90 rpm")
            session.clock.wait(0.3)
            assert session.rotor.rpm() == pytest.approx(90.0, abs=1.0)
        assert drive.state in ("ready", "disabled")
        assert drive.quick_stops == 0
        assert drive.rpm == pytest.approx(0.0, abs=0.5)
    finally:
        drive.close()
    with decoded_again(log) as opened:
        speed = opened["motor"]["speed_rpm"]
    assert speed.max() == pytest.approx(90.0, abs=1.0)
    assert np.all(np.diff(speed[: int(np.argmax(speed))]) >= 0)


@pytest.mark.skipif(sys.platform == "win32", reason="needs ptys")
def test_a_converter_of_another_table_turns_backwards_and_stops(tmp_path: Path) -> None:
    """Registers of an Altivar behind pymodbus's server: three pole pairs, a gear of 2, a set-point with a sign."""
    converter = OutsideConverter(address=17)
    device = f"""
[devices.motor]
driver = "modbus_converter"
port = "{converter.port}"
table = "altivar"
address = 17
pole_pairs = 3
gear = 2.0
ramp_rpm_per_s = 120.0
report_Hz = 10

"""
    log = tmp_path / "converter.mcap"
    try:
        with Session(rig_of(tmp_path, device), HostClock()) as session:
            motor = session.rotor.drive
            assert motor is not None
            session.start_recording(log, {"test": "record"})
            motor.enable()
            motor.set_speed(-60.0)
            session.wait_for(lambda: converter.rpm < -119.0, 5.0, "120 rpm of the motor backwards")
            session.wait_for(lambda: abs(session.rotor.rpm()) > 59.0, 2.0, "60 rpm in the reports")
        assert converter.words[converter.CONTROL] in (0x0006, 0x0007)
        assert converter.rpm == pytest.approx(0.0, abs=1.0)
    finally:
        converter.close()
    with decoded_again(log) as opened:
        speed = opened["motor"]["speed_rpm"]
    assert speed.min() == pytest.approx(-60.0, abs=1.0)
    assert abs(speed[-1]) < 3.0
