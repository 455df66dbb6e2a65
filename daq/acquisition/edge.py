# pyright: strict
"""What a session has of the outside world beside its clock: ports, and a disk. A simulation has its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from serial.tools import list_ports

from daq.acquisition.recorder import Disk, RealDisk
from daq.drivers.contract import Line
from daq.transports import Link, open_link


@dataclass(frozen=True)
class Edge:
    """See the module.

    Attributes:
        connect: opens a device's line on a port; raises LinkLost.
        places: ports on which a device may be found again that was unplugged from a port, the likeliest first.
        disk: where logs are written to.
    """

    connect: Callable[[Line, str], Link]
    places: Callable[[str], Sequence[str]]
    disk: Disk


def _connect(line: Line, port: str) -> Link:
    return open_link(port, line.baud, line.bitrate, line.parity)


class UsbPorts:
    """Where an adapter may come back: under another name, and another adapter may have taken its own.

    An adapter is recognised by vendor, product and serial number. What cannot be told from another so (without a serial
    number, or two of them had the same one at first; no USB adapter at all) is looked for where it was.
    """

    def __init__(self) -> None:
        self._first = _adapters()

    def places(self, port: str) -> Sequence[str]:
        """See Edge."""
        who = self._first.get(port)
        if who is None or list(self._first.values()).count(who) > 1:
            return (port,)
        return sorted((name for name, other in _adapters().items() if other == who), key=lambda name: name != port)


def _adapters() -> dict[str, tuple[object, ...]]:
    """Who is at which port now: USB adapters that say vendor and serial number."""
    return {
        port.device: (port.vid, port.pid, port.serial_number)
        for port in list_ports.comports()
        if port.vid is not None and port.serial_number
    }


def real_edge() -> Edge:
    """The machine's own ports and disk."""
    return Edge(_connect, UsbPorts().places, RealDisk())
