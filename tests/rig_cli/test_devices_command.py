"""`rig devices`: from the ports of a virtual rig to a rig file that passes `rig check`, and its page."""

from __future__ import annotations

import json
import os
import pty
import sys
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from serial.tools import list_ports

from daq.discovery import ports
from daq.discovery.ports import CanChannel, SerialPort, UsbCanAdapter, UsbIdentity
from rig_cli.main import run
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from tests.conftest import LATE_BEATS

CAPTURE = pytest.CaptureFixture[str]


def devices(capsys: CAPTURE, *arguments: str) -> dict[str, Any]:
    assert run(["devices", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def rig_file(path: Path, rig: str, tables: list[str]) -> Path:
    """A shipped rig file whose devices are replaced by tables of `rig devices`."""
    document: Any = tomlkit.parse((resources.files("rig_configs") / f"{rig}.toml").read_text(encoding="utf-8"))
    del document["devices"], document["virtual"]
    path.write_text(tomlkit.dumps(document) + "\n" + "\n".join(tables), encoding="utf-8")
    return path


def on_ports(rig: VirtualRigProcess) -> list[str]:
    return [word for port in rig.ports.values() for word in ("--port", port)]


@pytest.mark.lengthy
@pytest.mark.parametrize("link", ["tcp", *([] if sys.platform == "win32" else ["pty"])])
def test_the_tables_of_a_virtual_rig_make_a_file_that_passes_the_check(
    link: str, capsys: CAPTURE, tmp_path: Path
) -> None:
    with VirtualRigProcess("virtual", ["virtual.seed=3"], link) as rig:
        found = devices(capsys, "--ask", *on_ports(rig))
        drivers = {each["port"]: each["driver"] for each in found["ports"]}
        assert {name: drivers[port] for name, port in rig.ports.items()} == {
            "laser_x": "optoncdt",
            "laser_y": "optoncdt",
            "encoder": "rotorlink",
            "drive": "cia402",
        }
        assert [each["name"] for each in found["tables"]] == ["displacement_x", "displacement_y", "node", "drive"]
        path = rig_file(tmp_path / "my.toml", "virtual", [each["text"] for each in found["tables"]])
        code = run(["check", str(path), "--seconds", "3", "--set", LATE_BEATS, "--json"])
    devices_found = json.loads(capsys.readouterr().out)["devices"]
    checks = {
        (device, what): one["verdict"]
        for device, found in devices_found.items()
        for what, one in found["checks"].items()
    }
    delay_ms = devices_found["node"]["checks"]["delay_ms"]["value"]  # None on a machine with other work
    assert delay_ms is None or delay_ms > 0.5, "half of the radio's 3 ms there and back"
    failed = {what for what, verdict in checks.items() if verdict == "fail"}
    clocks = {(device, "clock_std_us") for device in ("displacement_x", "displacement_y", "node")}
    assert clocks <= set(checks)
    assert not failed - clocks, failed  # a machine with other work passes bytes on unevenly
    assert code == (3 if failed else 0)


def test_other_devices_need_only_what_they_do_not_report(capsys: CAPTURE, tmp_path: Path) -> None:
    """Sensors, radio and controller of other makers: the page names the settings that are to be filled in."""
    with VirtualRigProcess("other_devices", ["virtual.seed=3"]) as rig:
        found = devices(capsys, "--ask", *on_ports(rig))
        drivers = {each["port"]: each["driver"] for each in found["ports"]}
        assert {name: drivers[port] for name, port in rig.ports.items()} == {
            "east": "riftek",
            "north": "riftek",
            "rotor": "xbee",
            "motor": "vesc",
        }
        assert [each["state"] for each in found["ports"]] == ["device"] * 4
        texts = {each["name"]: each["text"] for each in found["tables"]}
        assert 'node_address = "0013A20040522BBB"' in texts["node"]
        required = {line.split()[1] for line in texts["drive"].splitlines() if line.endswith("does not report it")}
        assert required == {"pole_pairs", "timeout_s", "brake_A"}
        texts["drive"] += "pole_pairs = 7\ntimeout_s = 1.0\nbrake_A = 10.0\n"
    read = load_rig(str(rig_file(tmp_path / "my.toml", "other_devices", list(texts.values()))))
    assert [each.axis for each in read.roles.displacements] == ["x", "y"]
    assert None not in (read.roles.angles, read.roles.phase, read.roles.speed)
    assert {device.port for device in read.devices.values()} == set(rig.ports.values())


@pytest.mark.skipif(sys.platform == "win32", reason="ptys")
def test_by_default_nothing_is_sent(capsys: CAPTURE) -> None:
    master, slave = pty.openpty()
    try:
        os.set_blocking(master, False)
        found = devices(capsys, "--port", os.ttyname(slave))
        with pytest.raises(BlockingIOError):
            os.read(master, 100)
    finally:
        os.close(master)
        os.close(slave)
    assert [each["state"] for each in found["ports"]] == ["silent"]
    assert found["tables"] == []


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A machine with an adapter, a port of the board and CAN adapters; the searches that were made."""
    searched: list[dict[str, Any]] = []

    class Search:
        def __init__(self, port: str, drivers: list[Any], clock: object, progress: Any) -> None:
            self.port, self.progress = port, progress

        def run(self, ask: bool) -> Any:
            from daq.discovery.search import Result

            self.progress("receiving", 0.5)
            searched.append({"port": self.port, "ask": ask})
            if "by-id" in self.port:
                return Result(self.port, "no permission", "you may not open it. Add yourself to the group dialout")
            return Result(self.port, "silent")

    usb = UsbIdentity(0x0403, 0x6001, "A50285BI", "FTDI", "FT232R")
    monkeypatch.setattr(
        ports,
        "serial_ports",
        lambda: [SerialPort("/dev/ttyS0", "/dev/ttyS0"), SerialPort("/dev/ttyUSB0", "/dev/serial/by-id/usb-FTDI", usb)],
    )
    channels = [CanChannel("socketcan", "can0"), CanChannel("kvaser", "0")]
    monkeypatch.setattr(ports, "can_channels", lambda network: channels)
    adapter = UsbCanAdapter(UsbIdentity(0x1D50, 0x606F, "0042"), "gs_usb")
    monkeypatch.setattr(ports, "usb_can_adapters", lambda: [adapter])
    monkeypatch.setattr("daq.discovery.search.PortSearch", Search)
    return searched


def test_the_page_shows_ports_reasons_and_what_to_do_next(capsys: CAPTURE, machine: list[dict[str, Any]]) -> None:
    assert run(["devices"]) == 0
    out = capsys.readouterr().out
    for text in ("/dev/serial/by-id/usb-FTDI", "0403:6001", "A50285BI", "can:kvaser:0", "gs_usb", "group dialout"):
        assert text in out
    assert "rig devices --ask" in out
    assert sorted(each["port"] for each in machine) == [
        "/dev/serial/by-id/usb-FTDI",
        "/dev/ttyS0",
        "can:socketcan:can0",
    ]
    assert not any(each["ask"] for each in machine)


def test_requests_go_to_usb_adapters_and_to_ports_that_are_named(
    capsys: CAPTURE, machine: list[dict[str, Any]]
) -> None:
    devices(capsys, "--ask")
    assert {each["port"]: each["ask"] for each in machine} == {
        "/dev/serial/by-id/usb-FTDI": True,
        "/dev/ttyS0": False,
        "can:socketcan:can0": True,
    }
    machine.clear()
    devices(capsys, "--ask", "--port", "/dev/ttyS0", "--port", "can:kvaser:0")
    assert [each for each in machine if not each["ask"]] == []
    assert {each["port"] for each in machine} == {"/dev/ttyS0", "can:kvaser:0"}


def test_a_list_opens_no_port(capsys: CAPTURE, machine: list[dict[str, Any]]) -> None:
    found = devices(capsys, "--list-only")
    assert machine == []
    assert [each["port"] for each in found["serial_ports"]] == ["/dev/ttyS0", "/dev/serial/by-id/usb-FTDI"]
    assert found["serial_ports"][1]["usb"]["number"] == "0403:6001"
    assert found["can_channels"] == ["can:socketcan:can0", "can:kvaser:0"]
    assert found["ports"] == []


def test_a_machine_without_ports_is_a_result(capsys: CAPTURE, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", list)
    monkeypatch.setattr(ports, "can_channels", lambda network: [])
    monkeypatch.setattr(ports, "usb_can_adapters", list)
    assert run(["devices"]) == 0
    assert "Is the adapter plugged in" in capsys.readouterr().out


def test_devices_on_the_network_are_shown_with_their_table(
    capsys: CAPTURE, machine: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    from daq.discovery.network import Announced
    from daq.drivers.identification import FoundDevice, NetworkDevice
    from daq.drivers.registry import driver

    device = NetworkDevice("socket://192.168.4.1:65102", FoundDevice({}, {"name": "front\x1b"}))
    found = [Announced(driver("vesc"), device)], ["note"]
    monkeypatch.setattr("daq.discovery.network.announced_devices", lambda drivers, clock: found)
    assert run(["devices", "--network", "--list-only"]) == 0
    captured = capsys.readouterr()
    assert "vesc at socket://192.168.4.1:65102" in captured.out
    assert 'port = "socket://192.168.4.1:65102"' in captured.out
    assert "\x1b" not in captured.out
    assert "note" in captured.err
