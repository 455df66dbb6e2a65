"""Devices that announce themselves on the network by datagrams (UDP)."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass

from daq.drivers.driver import Driver
from daq.drivers.identification import Announcement, NetworkDevice
from daq.transports import HostClock
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_MOST_BYTES = 2048
_BROADCAST = "255.255.255.255"


@dataclass(frozen=True)
class Announced:
    """A device on the network, and the driver that understood its announcement."""

    driver: Driver
    device: NetworkDevice


def announced_devices(drivers: Iterable[Driver], clock: HostClock) -> tuple[list[Announced], list[str]]:
    """Broadcast the requests of the drivers that have one, and receive announcements.

    Args:
        drivers: installed drivers.
        clock: clock of the waits.

    Returns:
        The devices, each once, and a message for each driver whose announcements cannot be received.
    """
    found: dict[tuple[str, str], Announced] = {}
    notes: list[str] = []
    with ExitStack() as stack:
        sockets: dict[socket.socket, tuple[Driver, Announcement]] = {}
        wait_s = 0.0
        for driver in drivers:
            if driver.announcement is None:
                continue
            announcement = driver.announcement()
            try:
                sockets[stack.enter_context(_opened(announcement))] = (driver, announcement)
            except OSError as error:
                port = announcement.port or announcement.request_port
                notes.append(f"{driver.name}: UDP port {port} cannot be used: {error}")
                continue
            wait_s = max(wait_s, announcement.wait_s)
        end = clock.now_s() + wait_s
        while sockets and (left := end - clock.now_s()) > 0:
            ready, _, _ = select.select(list(sockets), [], [], left)
            for each in ready:
                driver, announcement = sockets[each]
                with ignoring(_log, "receiving an announcement", OSError):  # Windows reports refused requests here
                    data, (host, *_) = each.recvfrom(_MOST_BYTES)
                    if (device := announcement.read(data, host)) is not None:
                        found[driver.name, device.port] = Announced(driver, device)
    return [found[key] for key in sorted(found)], notes


def _opened(announcement: Announcement) -> socket.socket:
    """Open the socket of announcements and send their request.

    Raises:
        OSError: another program has the port, or the network is down.
    """
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(("", announcement.port))
        if announcement.request:
            opened.sendto(announcement.request, (_BROADCAST, announcement.request_port))
    except OSError:
        opened.close()
        raise
    return opened
