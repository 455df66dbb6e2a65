"""Ports and disk of a session: those of the machine, or simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from serial.tools import list_ports

from daq.acquisition.recorder import Disk, RealDisk
from daq.drivers.contract import DeviceLine
from daq.transports import Link, open_link


@dataclass(frozen=True)
class Edge:
    """Ports and disk of a session.

    Attributes:
        connect: opens a device's line on a port; raises LinkLost.
        places: returns the ports on which a device that was unplugged from a port may return, the most likely first.
        disk: disk to which logs are written.
    """

    connect: Callable[[DeviceLine, str], Link]
    places: Callable[[str], Sequence[str]]
    disk: Disk


def _connect(line: DeviceLine, port: str) -> Link:
    return open_link(port, line.baud, line.bitrate, line.parity, line.stop_bits)


class UsbPorts:
    """Finds the port of an adapter that was plugged in again, which may have a new name.

    An adapter is identified by vendor, product and serial number. Adapters without a unique serial number, and ports
    that are not USB adapters, are expected on their previous port.
    """

    def __init__(self) -> None:
        self._adapters_at_start = _adapters()

    def places(self, port: str) -> Sequence[str]:
        """See Edge."""
        adapter = self._adapters_at_start.get(port)
        if adapter is None or list(self._adapters_at_start.values()).count(adapter) > 1:
            return (port,)
        return sorted((name for name, other in _adapters().items() if other == adapter), key=lambda name: name != port)


def _adapters() -> dict[str, tuple[object, ...]]:
    """Return vendor, product and serial number of the USB adapters that report them, by port."""
    return {
        port.device: (port.vid, port.pid, port.serial_number)
        for port in list_ports.comports()
        if port.vid is not None and port.serial_number
    }


def real_edge() -> Edge:
    """Return the ports and the disk of this machine."""
    return Edge(_connect, UsbPorts().places, RealDisk())
