"""Ports of this machine: serial ports with their USB identity, CAN channels, USB-CAN adapters."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import can
from serial.tools import list_ports

from daq.transports.port_names import CAN_INTERFACES_WITHOUT_HARDWARE
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_BY_ID = Path("/dev/serial/by-id")
_USB_DEVICES = Path("/sys/bus/usb/devices")
_SERIAL = frozenset({"serial", "slcan", "robotell", "seeedstudio"})  # their adapters are listed as serial ports
_DETECTION_S = 3.0

GS_USB = {
    (0x1D50, 0x606F): "gs_usb",
    (0x1209, 0x2323): "gs_usb (candleLight)",
    (0x1CD2, 0x606F): "gs_usb (CES CANext FD)",
    (0x16D0, 0x10B8): "gs_usb (ABE CANdebugger FD)",
    (0x1209, 0xCA01): "gs_usb (CANnectivity)",
}
"""USB-CAN adapters by vendor and product number. Source: list of the Linux driver gs_usb."""


@dataclass(frozen=True)
class UsbIdentity:
    """USB identity of a device; texts are empty if it reports none.

    Attributes:
        vendor, product: numbers (VID, PID).
        serial: serial number.
        manufacturer, name: texts of the device.
    """

    vendor: int
    product: int
    serial: str = ""
    manufacturer: str = ""
    name: str = ""

    @property
    def number(self) -> str:
        """Vendor and product number as `VID:PID`."""
        return f"{self.vendor:04X}:{self.product:04X}"


@dataclass(frozen=True)
class SerialPort:
    """A serial port.

    Attributes:
        device: present name, for example /dev/ttyUSB0 or COM3.
        stable: name that stays with the adapter (/dev/serial/by-id on Linux); `device` without one.
        usb: identity of the USB adapter; None for another port.
    """

    device: str
    stable: str
    usb: UsbIdentity | None = None


@dataclass(frozen=True)
class CanChannel:
    """A channel of a CAN adapter that python-can supports; `port` is its name in a rig file."""

    interface: str
    channel: str

    @property
    def port(self) -> str:
        """Port in the notation of a rig file."""
        return f"can:{self.interface}:{self.channel}"


@dataclass(frozen=True)
class UsbCanAdapter:
    """A USB-CAN adapter, found by its USB identity; `kind` is that of `GS_USB`."""

    usb: UsbIdentity
    kind: str


def serial_ports() -> list[SerialPort]:
    """Return the serial ports of this machine in the order of their names."""
    stable = _stable_names()
    found: list[SerialPort] = []
    for port in list_ports.comports():
        usb = None
        if port.vid is not None and port.pid is not None:
            texts = (port.serial_number, port.manufacturer, port.product)
            usb = UsbIdentity(port.vid, port.pid, *(text or "" for text in texts))
        found.append(SerialPort(port.device, stable.get(_real(port.device), port.device), usb))
    return sorted(found, key=lambda port: port.device)


def _stable_names() -> dict[str, str]:
    """Return the stable name of each serial port; empty on systems without such names."""
    with ignoring(_log, "listing stable names", OSError):  # other systems, or no adapter
        return {_real(str(path)): str(path) for path in sorted(_BY_ID.iterdir(), reverse=True)}
    return {}


def _real(name: str) -> str:
    return str(Path(name).resolve()) if name.startswith("/") else name


def can_channels(network: bool = False) -> list[CanChannel]:
    """Return the CAN channels that python-can detects.

    Args:
        network: whether servers of CAN channels on the network are searched too, by their broadcasts.
    """
    left_out = _SERIAL | (
        CAN_INTERFACES_WITHOUT_HARDWARE - {"socketcand"} if network else CAN_INTERFACES_WITHOUT_HARDWARE
    )
    logging.getLogger("can").addHandler(logging.NullHandler())  # it reports each adapter whose software is missing
    interfaces = sorted(can.VALID_INTERFACES - left_out)
    found: list[CanChannel] = []
    with ignoring(_log, "detecting CAN adapters", Exception):  # vendors' libraries raise any exception
        configs: Any = can.detect_available_configs(interfaces, _DETECTION_S)
        found = [CanChannel(str(each["interface"]), str(each["channel"])) for each in configs]
    return sorted(found, key=lambda each: each.port)


def usb_can_adapters() -> list[UsbCanAdapter]:
    """Return the adapters of `GS_USB`. On Linux the kernel lists USB devices; elsewhere pyusb is used if installed."""
    found = _usb_of_kernel() if sys.platform == "linux" else _usb_of_library()
    return [UsbCanAdapter(usb, GS_USB[usb.vendor, usb.product]) for usb in found if (usb.vendor, usb.product) in GS_USB]


def _usb_of_kernel() -> list[UsbIdentity]:
    found: list[UsbIdentity] = []
    for folder in sorted(_USB_DEVICES.glob("*")):
        with ignoring(_log, "reading a USB device", OSError, ValueError):  # a hub's interface, or unplugged meanwhile
            vendor, product = (int((folder / name).read_text(), 16) for name in ("idVendor", "idProduct"))
            serial, manufacturer, name = (_text(folder / name) for name in ("serial", "manufacturer", "product"))
            found.append(UsbIdentity(vendor, product, serial, manufacturer, name))
    return found


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace").strip() if path.is_file() else ""


def _usb_of_library() -> list[UsbIdentity]:
    with ignoring(_log, "listing USB devices", Exception):  # not installed, or without its own library
        core: Any = import_module("usb.core")
        return [UsbIdentity(int(each.idVendor), int(each.idProduct)) for each in core.find(find_all=True)]
    return []


def usb_facts(usb: UsbIdentity | None) -> Mapping[str, str]:
    """Return a USB identity as texts by name."""
    if usb is None:
        return {}
    parts = {"number": usb.number, "serial": usb.serial, "manufacturer": usb.manufacturer, "name": usb.name}
    return {key: text for key, text in parts.items() if text}
