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

    An adapter is recognised by vendor, product and serial number; one without a serial number by vendor and product.
    What is no USB adapter is looked for where it was.
    """

    def __init__(self) -> None:
        self._seen: dict[str, tuple[object, ...]] = {}
        self._look()

    def _look(self) -> dict[str, tuple[object, ...]]:
        now: dict[str, tuple[object, ...]] = {
            port.device: (port.vid, port.pid, port.serial_number) for port in list_ports.comports() if port.vid
        }
        self._seen = {**self._seen, **{name: who for name, who in now.items() if name not in self._seen}}
        return now

    def places(self, port: str) -> Sequence[str]:
        """See Edge."""
        who, now = self._seen.get(port), self._look()
        if who is None:
            return (port,)
        return sorted((name for name, other in now.items() if other == who), key=lambda name: name != port)


def real_edge() -> Edge:
    """The machine's own ports and disk."""
    return Edge(_connect, UsbPorts().places, RealDisk())
