"""Ports of a rig file: equal ports are refused at loading, except placeholders."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig_configs import RigFileError, load_rig
from rig_configs.ports import is_placeholder

LASERS = ("laser_x", "laser_y")


def with_port(port: str) -> list[str]:
    return [f'devices.{name}.port="{port}"' for name in LASERS]


def test_a_file_in_which_two_devices_name_one_port_is_refused_with_both(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "rig_configs" / "virtual.toml").read_text(encoding="utf-8")
    file = tmp_path / "mine.toml"
    file.write_text(text.replace("printed by `rig virtual`", "/dev/ttyUSB0", 2), encoding="utf-8")
    with pytest.raises(RigFileError, match=r"mine\.toml: devices\.laser_x\.port and devices\.laser_y\.port are both"):
        load_rig(file)


@pytest.mark.parametrize("port", ["can:can0", "/dev/ttyUSB?", "COMx", "none", "-", "to be found"])
def test_a_bus_and_placeholders_may_be_named_twice(port: str) -> None:
    assert load_rig("virtual", settings=with_port(port)).devices["laser_x"].port == port


@pytest.mark.parametrize(
    "port",
    [
        "/dev/ttyUSB0",
        "COM3",
        "can:can0",
        "socket://10.0.0.2:4001",
        "spy:///dev/ttyS1?file=a",
        r"\\?\COM10",
        "loop://",
        "/dev/serial/by-id/usb-FTDI_X-if00-port0",
        "/dev/ttymxc0",
        "/dev/rfcomm1",
    ],
)
def test_a_port_s_name_is_no_placeholder(port: str) -> None:
    assert not is_placeholder(port)


@pytest.mark.parametrize("port", ["", "/dev/ttyUSB?", "/dev/ttyUSBX", "/dev/ttyACM*", "<port>", "COMx", "TODO"])
def test_a_text_that_waits_for_a_port_is_one(port: str) -> None:
    assert is_placeholder(port)


def test_locks_whose_state_nothing_reports_are_refused(tmp_path: Path) -> None:
    """The node reports its locks with its angles: without them every test would wait for the locks in vain."""
    with pytest.raises(RigFileError, match=r"devices\.encoder moves the locks .* no device measures the angles.*locks"):
        load_rig("virtual", settings=["devices.encoder.angles=false"])
    both = ["devices.encoder.angles=false", "devices.encoder.locks=false"]
    assert load_rig("virtual", settings=both).roles.locks is None
