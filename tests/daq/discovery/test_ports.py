"""The ports of this machine, why one cannot be opened, tables for a rig file, and announcements on the network."""

from __future__ import annotations

import errno
import os
import socket
import sys
import threading
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
from serial.tools import list_ports

from daq.discovery import network, opening, ports
from daq.discovery.network import Announced, announced_devices
from daq.discovery.opening import PortNotOpened, has_line_rate, open_port, programs_with
from daq.discovery.ports import UsbIdentity, can_channels, serial_ports, usb_can_adapters, usb_facts
from daq.discovery.tables import Table, device_tables
from daq.drivers.contract import DeviceLine
from daq.drivers.driver import Driver
from daq.drivers.identification import Announcement, FoundDevice, NetworkDevice
from daq.drivers.registry import driver
from daq.errors import LinkLost
from daq.transports import HostClock
from rig_drivers.labjack import dialogue
from rig_drivers.labjack.dialogue import found as found_labjack
from rig_drivers.vesc.dialogue import announced
from tests.daq.free_ports import free_udp_port

# --- ports ---------------------------------------------------------------------------------------------------------


def port(device: str, vid: int | None = None, pid: int | None = None, **texts: str | None) -> SimpleNamespace:
    usual = {"serial_number": None, "manufacturer": None, "product": None}
    return SimpleNamespace(device=device, vid=vid, pid=pid, **{**usual, **texts})


def test_serial_ports_have_their_usb_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [
        port("COM7", 0x0403, 0x6001, serial_number="A50285BI", manufacturer="FTDI", product="FT232R"),
        port("COM1"),
        port("COM9", 0x16D0, 0x117E),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    plain, adapter, nameless = serial_ports()
    assert (plain.device, plain.stable, plain.usb) == ("COM1", "COM1", None)
    assert adapter.usb == UsbIdentity(0x0403, 0x6001, "A50285BI", "FTDI", "FT232R")
    assert nameless.usb.number == "16D0:117E"
    assert usb_facts(nameless.usb) == {"number": "16D0:117E"}
    assert usb_facts(None) == {}


@pytest.mark.skipif(sys.platform == "win32", reason="symbolic links need rights there")
def test_a_port_has_its_stable_name_where_there_is_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    device, by_id = tmp_path / "ttyUSB3", tmp_path / "by-id"
    device.touch()
    by_id.mkdir()
    (by_id / "usb-FTDI_A50285BI-if00-port0").symlink_to("../ttyUSB3")
    monkeypatch.setattr(ports, "_BY_ID", by_id)
    monkeypatch.setattr(list_ports, "comports", lambda: [port(str(device), 1, 2)])
    (found,) = serial_ports()
    assert found.stable == str(by_id / "usb-FTDI_A50285BI-if00-port0")
    monkeypatch.setattr(ports, "_BY_ID", tmp_path / "missing")
    assert serial_ports()[0].stable == str(device)


def test_can_channels_are_those_of_hardware(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []

    def detect(interfaces: list[str], timeout: float) -> list[dict[str, Any]]:
        asked.append(interfaces)
        return [{"interface": "socketcan", "channel": "can1"}, {"interface": "kvaser", "channel": 0, "serial": 1}]

    monkeypatch.setattr(can, "detect_available_configs", detect)
    assert [each.port for each in can_channels()] == ["can:kvaser:0", "can:socketcan:can1"]
    assert can_channels(network=True)
    without, with_network = asked
    assert not {"virtual", "udp_multicast", "socketcand", "slcan", "serial"} & set(without)
    assert {"socketcan", "pcan", "kvaser", "gs_usb"} <= set(without)
    assert set(with_network) - set(without) == {"socketcand"}


def test_a_library_that_fails_hides_no_other_port(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(interfaces: list[str], timeout: float) -> list[dict[str, Any]]:
        raise RuntimeError("vendor's library")

    monkeypatch.setattr(can, "detect_available_configs", fails)
    assert can_channels() == []


@pytest.mark.parametrize("number", ["1d50:606f", "1209:2323", "1cd2:606f", "16d0:10b8", "1209:ca01"])
def test_usb_can_adapters_are_known_by_their_identity(
    number: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    vendor, product = number.split(":")
    for name, texts in {
        "1-2": {"idVendor": vendor, "idProduct": product, "serial": "0042", "manufacturer": "maker"},
        "1-3": {"idVendor": "0403", "idProduct": "6001"},
        "1-3:1.0": {},
        "usb1": {"idVendor": "xyz", "idProduct": "0002"},
    }.items():
        (tmp_path / name).mkdir()
        for key, text in texts.items():
            (tmp_path / name / key).write_text(text + "\n")
    monkeypatch.setattr(ports, "_USB_DEVICES", tmp_path)
    monkeypatch.setattr(ports.sys, "platform", "linux")
    (found,) = usb_can_adapters()
    assert found.kind.startswith("gs_usb")
    assert (found.usb.number, found.usb.serial) == (number.upper(), "0042")


def test_other_systems_list_usb_devices_by_a_library_if_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports.sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "usb.core", None)
    assert usb_can_adapters() == []
    core = SimpleNamespace(find=lambda find_all: [SimpleNamespace(idVendor=0x1D50, idProduct=0x606F)])
    monkeypatch.setattr(ports, "import_module", lambda name: core)
    assert [each.usb.number for each in usb_can_adapters()] == ["1D50:606F"]


# --- opening ---------------------------------------------------------------------------------------------------------


def refused(port: str, words: str) -> str:
    """Return why a port is not opened; the message must contain the words."""
    with pytest.raises(PortNotOpened, match=words) as raised:
        open_port(DeviceLine(port, 115_200))
    return raised.value.state


@pytest.mark.parametrize(
    ("name", "has_rate"),
    [
        ("/dev/ttyUSB0", True),
        ("COM3", True),
        ("/dev/serial/by-id/usb-FTDI", True),
        ("/dev/cu.usbserial-1", True),
        ("/dev/pts/4", False),
        ("/dev/ttys004", False),
        ("socket://10.0.0.2:1024", False),
        ("can:socketcan:can0", False),
    ],
)
def test_only_a_serial_line_has_a_rate(name: str, has_rate: bool) -> None:
    assert has_line_rate(name) == has_rate


@pytest.mark.skipif(sys.platform == "win32", reason="ptys and flock")
def test_a_port_that_another_program_has_locked_is_in_use() -> None:
    import fcntl

    master, slave = os.openpty()
    try:
        fcntl.flock(slave, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert refused(os.ttyname(slave), "another program") == "in use"
    finally:
        os.close(master)
        os.close(slave)


def test_a_port_that_does_not_exist_is_not_opened() -> None:
    assert refused("/dev/ttyUSB987", "cannot be opened") == "not opened"


def denied(line: DeviceLine) -> Any:
    raise LinkLost(f"{line.port}: cannot be opened") from PermissionError(errno.EACCES, "Permission denied")


@pytest.mark.skipif(sys.platform != "linux", reason="groups of ports")
def test_a_missing_permission_names_the_group(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    monkeypatch.setattr(opening, "open_link", lambda port, *line: denied(DeviceLine(port, 1)))
    monkeypatch.setattr(opening.grp, "getgrgid", lambda number: SimpleNamespace(gr_name="uucp"))
    assert refused(str(port), r"group uucp \(sudo usermod -aG uucp \$USER\)") == "no permission"
    assert refused("/dev/missing", "dialout") == "no permission"
    monkeypatch.setattr(opening.grp, "getgrgid", lambda number: SimpleNamespace(gr_name="root"))
    assert refused(str(port), "udev rule") == "no permission"


def test_windows_denies_access_to_an_open_port(monkeypatch: pytest.MonkeyPatch) -> None:
    def open_link(port: str, *line: Any) -> Any:
        raise LinkLost(f"{port}: could not open port: PermissionError(13, 'Access is denied.', None, 5)")

    monkeypatch.setattr(opening, "open_link", open_link)
    monkeypatch.setattr(opening.sys, "platform", "win32")
    assert refused("COM3", "another program") == "in use"
    monkeypatch.setattr(opening.sys, "platform", "darwin")
    assert refused("/dev/cu.usbserial", "account") == "no permission"


def lists_programs(monkeypatch: pytest.MonkeyPatch, folder: Path, files: dict[str, str]) -> None:
    """Let the system list programs, by number, each with an open file."""
    for number, target in files.items():
        (folder / number / "fd").mkdir(parents=True)
        (folder / number / "fd" / "5").symlink_to(target)
        (folder / number / "comm").write_text("minicom\n")
    monkeypatch.setattr(opening, "_PROCESSES", folder)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_a_program_that_does_not_lock_its_port_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB3"
    device.touch()
    link = tmp_path / "by-id"
    link.symlink_to(device)
    files = {"812": str(device), "813": "/dev/null", str(os.getpid()): str(device)}
    lists_programs(monkeypatch, tmp_path / "proc", files)
    (tmp_path / "proc" / "814").mkdir()
    assert list(programs_with(str(link))) == ["minicom, process 812"]
    assert refused(str(link), "minicom, process 812") == "in use"
    assert list(programs_with("socket://h:1")) == []


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_a_simulated_device_that_keeps_both_ends_of_its_pty_open_is_no_other_program(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its link has a stable name; it keeps the end of the host open because the other end fails without one."""
    link = tmp_path / "laser"
    link.symlink_to("/dev/pts/812")
    lists_programs(monkeypatch, tmp_path / "proc", {"812": "/dev/pts/812"})
    assert list(programs_with(str(link))) == []
    assert list(programs_with("/dev/pts/812")) == []


@pytest.mark.skipif(sys.platform == "win32", reason="ptys")
def test_a_link_to_a_terminal_is_a_terminal_which_its_own_program_may_keep_open(tmp_path: Path) -> None:
    far, near = os.openpty()
    link = tmp_path / "emulator"
    link.symlink_to(os.ttyname(near))
    assert not has_line_rate(str(link))
    assert list(programs_with(str(link))) == []
    os.close(far)
    os.close(near)


# --- tables ----------------------------------------------------------------------------------------------------------


def table(name: str, where: str = "/dev/ttyUSB0", **settings: Any) -> Table:
    found: Driver = driver(name)
    roles = found.example_at(where, **found.usual[0]).roles("device")
    return Table(found, where, FoundDevice(settings, {"serial": "7"}), roles)


def test_tables_have_different_names_axes_and_channels() -> None:
    devices = [
        table("optoncdt"),
        table("riftek"),
        table("optoncdt"),
        table("rotorlink"),
        table("cia402"),
        table("vesc"),
    ]
    names = [name for name, _ in device_tables(devices)]
    assert names == ["displacement_x", "displacement_y", "displacement_3", "node", "drive", "drive_2"]
    read = tomllib.loads("\n".join(text for _, text in device_tables(devices)))["devices"]
    assert [read[name]["axis"] for name in names[:3]] == ["x", "y", "x"]
    assert read["displacement_3"]["witness"] == "witness_1"
    assert "witness" not in read["displacement_x"]


def test_a_table_holds_what_is_known_and_names_what_is_missing() -> None:
    ((_, text),) = device_tables([table("vesc", "COM3", baud=115_200)])
    assert tomllib.loads(text)["devices"]["drive"] == {"driver": "vesc", "port": "COM3", "baud": 115_200}
    for key in ("pole_pairs", "timeout_s", "brake_A"):
        assert f"# {key} =   # required" in text
    assert "min_erpm" not in text


def test_texts_of_a_device_cannot_end_a_line() -> None:
    hostile = Table(driver("optoncdt"), '/dev/t\n"y', FoundDevice({}, {"name": "x\n[devices.b]\x1b[2J\u2028"}))
    ((name, text),) = device_tables([hostile])
    read = tomllib.loads(text)["devices"]
    assert set(read) == {name}
    assert read[name]["port"] == '/dev/t\n"y'
    assert "\x1b" not in text


# --- announcements on the network ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"VESC front::192.168.4.1::65102\0", "socket://192.168.4.1:65102"),
        (b"a::0.0.0.0::65102", "socket://10.0.0.9:65102"),
        (b"a::1.2.3.4::0", None),
        (b"a::1.2.3.4::70000", None),
        (b"a::host::65102", None),
        (b"a::1.2.3.4::\xc2\xb2", None),
        (b"a::1.2.3.4", None),
        (b"", None),
        (b"\xff::1.2.3.4::5::6", None),
    ],
)
def test_an_announcement_of_a_controller_holds_its_address(data: bytes, expected: str | None) -> None:
    found = announced(data, "10.0.0.9")
    assert (found and found.port) == expected


LABJACK_REQUEST = bytes.fromhex("5052 0000 000E 01 4C 00EA6002 00EA6402 00EA7C02")
LABJACK_ANSWER = bytes.fromhex("5052 0000 000E 01 4C 40E00000 3F83BCD3 1C03A1D9")


@pytest.mark.parametrize(
    ("at", "data", "model"),
    [
        (0, b"", "T7"),
        (8, b"\x40\x80", "T4"),
        (8, b"\x40\x40", None),  # product 3
        (0, b"\x50\x53", None),  # the answer to another request
        (2, b"\x00\x01", None),  # no Modbus
        (5, b"\x02\x01\xcc\x01", None),  # a refusal
        (5, b"\x0f", None),  # cut
    ],
)
def test_an_answer_to_the_search_for_a_labjack(at: int, data: bytes, model: str | None) -> None:
    answer = LABJACK_ANSWER[:at] + data + LABJACK_ANSWER[at + len(data) :]
    found = found_labjack(answer, "10.0.0.9")
    assert (found and found.found.identity["model"]) == model
    assert all(found_labjack(answer[:cut], "10.0.0.9") is None for cut in range(len(answer)))


@dataclass(frozen=True)
class Announcing:
    """A driver's part that this module uses."""

    name: str
    announcement: Callable[[], Announcement]


def read(data: bytes, sender: str) -> NetworkDevice | None:
    if not data.startswith(b"I am"):
        return None
    return NetworkDevice(f"socket://{sender}:1", FoundDevice({}, {"name": data[5:].decode()}))


class PromptClock(HostClock):
    """A clock whose time is that of its readings: a wait ends after a number of them."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def now_ns(self) -> int:
        self.now += 0.5
        return round(self.now * 1e9)


def test_a_device_that_announces_itself_is_found_once() -> None:
    own: Any = Announcing("a", partial(Announcement, free_udp_port(), read, wait_s=5.0))
    stopping = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
            while not stopping.wait(0.01):
                for data in (b"noise", b"I am seven"):
                    device.sendto(data, ("127.0.0.1", own.announcement().port))

    sender = threading.Thread(target=send)
    sender.start()
    try:
        found, notes = announced_devices([own, driver("optoncdt")], PromptClock())
    finally:
        stopping.set()
        sender.join()
    assert notes == []
    assert [(each.device.port, each.device.found.identity) for each in found] == [
        ("socket://127.0.0.1:1", {"name": "seven"})
    ]


def asked(
    made: Callable[[Callable[[bytes, str], NetworkDevice | None], int], Any],
    read: Callable[[bytes, str], NetworkDevice | None],
    answer: bytes,
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[list[Announced], bytes]:
    """Search with a driver that reads announcements and sends its request to a UDP port.

    Returns:
        The devices found, and the request, which a device has answered.
    """
    clock, requests = PromptClock(), list[bytes]()

    def read_and_end(data: bytes, host: str) -> NetworkDevice | None:
        clock.now += 10.0  # the search ends at once: an answer has been taken
        return read(data, host)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(10)
        monkeypatch.setattr(network, "_BROADCAST", "127.0.0.1")
        own = made(read_and_end, device.getsockname()[1])

        def reply() -> None:
            data, host = device.recvfrom(100)
            requests.append(data)
            device.sendto(answer, host)

        answering = threading.Thread(target=reply)
        answering.start()
        found, notes = announced_devices([own], clock)
        answering.join()
    assert notes == []
    return found, requests[0]


def test_a_request_is_broadcast_and_its_answer_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def made(read: Callable[[bytes, str], NetworkDevice | None], port: int) -> Any:
        return Announcing("a", partial(Announcement, 0, read, b"who?", port, wait_s=5.0))

    (one,), request = asked(made, read, b"I am eight", monkeypatch)
    assert (request, one.device.found.identity) == (b"who?", {"name": "eight"})


def test_a_labjack_on_the_network_is_found_with_a_table_for_the_rig_file(monkeypatch: pytest.MonkeyPatch) -> None:
    labjack = driver("labjack")
    assert labjack.announcement is not None
    announcement = labjack.announcement()

    def made(read: Callable[[bytes, str], NetworkDevice | None], port: int) -> Driver:
        changed = partial(replace, announcement, read=read, request_port=port)
        monkeypatch.setattr(dialogue, "announcement", changed)
        return labjack

    (one,), request = asked(made, found_labjack, LABJACK_ANSWER, monkeypatch)
    assert request == LABJACK_REQUEST, "at most 64 bytes: the device's limit by UDP"
    assert one.device.port == "socket://127.0.0.1:502"
    assert one.device.found.identity == {"model": "T7", "firmware": 1.0292, "serial": 470000089}
    ((name, text),) = device_tables([Table(one.driver, one.device.port, one.device.found)])
    assert name == "labjack"
    assert "serial = 470000089" in text


def test_a_port_that_cannot_be_used_is_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(driver: object) -> socket.socket:
        raise OSError("Address already in use")

    monkeypatch.setattr(network, "_opened", fails)
    found, notes = announced_devices([driver("vesc"), driver("labjack")], PromptClock())
    assert found == []
    assert notes == [
        "vesc: UDP port 65109 cannot be used: Address already in use",
        "labjack: UDP port 52362 cannot be used: Address already in use",
    ]
