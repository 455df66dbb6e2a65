"""Ports on which a log is played, new or existing ones, and the simulated devices behind them."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Protocol

from typing_extensions import override

from daq.drivers.contract import DeviceLine
from daq.drivers.devices import devices_of, installed_of
from daq.drivers.played import PlayedDevice
from daq.errors import DeviceError, LinkLost, LogError
from daq.log import Log
from daq.log.snapshot import identities_of, rig_of
from daq.transports.link import Link, open_link
from daq.transports.slcan import AdapterText
from daq.transports.wires import KINDS, make_wire
from rig_basics.texts import did_you_mean, number_of

_log = logging.getLogger(__name__)

# Baud rate of a line whose rate is not in the rig file.
_DEFAULT_BAUD = 115_200
_PIECE_BYTES = 4096  # largest write to a port that accepts everything or blocks


class Outlet(Protocol):
    """Destination of one device's bytes. `Wire` implements it."""

    port: str

    def offer(self, data: bytes) -> int:
        """Send as many bytes as there is room for and return their number. Raises LinkLost if the reader is gone."""
        ...

    def receive(self) -> bytes:
        """Return what the reader sent; never blocks."""
        ...

    def connected(self) -> bool:
        """Return True if a reader has the port open, as far as this can be detected."""
        ...

    def descriptor(self) -> int | None:
        """Return the file descriptor to wait on; None for outlets without one."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


class LinkOutlet(Outlet):
    """An existing port to write to. It cannot detect whether a program reads at its far end.

    Args:
        link: the open port.
        text: text of the CAN adapter that is played on it, if the records of a bus are.
    """

    def __init__(self, link: Link, text: AdapterText | None = None) -> None:
        self._link, self._text = link, text
        self.port: str = link.name
        self._open = True

    @override
    def offer(self, data: bytes) -> int:
        """A full port blocks until the timeout of its link, then the link is lost."""
        piece = data[:_PIECE_BYTES]
        try:
            self._link.write(piece if self._text is None else self._text.sent(piece))
        except LinkLost:
            self._open = False
            raise
        return len(piece)

    @override
    def receive(self) -> bytes:
        try:
            data = self._link.read(0.0) if self._open else b""
            if self._text is None or not data:
                return data
            records, answers = self._text.received(data)
            self._link.write(answers)
            return records
        except LinkLost as error:
            _log.info("%s: the port is lost: %s", self.port, error)
            self._open = False
            return b""

    @override
    def connected(self) -> bool:
        return self._open

    @override
    def descriptor(self) -> int | None:
        return None

    @override
    def close(self) -> None:
        self._open = False
        self._link.close()


def open_outlets(log: Log, to: str) -> dict[str, Outlet]:
    """Open one outlet for each device to be played.

    Args:
        log: the open log.
        to: "pty" or "tcp" for a new port per device of the log, or existing ports as "device=port,device=port", each
            any port that is valid in a rig file.

    Raises:
        LogError: the log has no bytes of a device, or the text does not name a port.
        LinkLost: a port cannot be opened or made.
    """
    if not log.devices:
        raise LogError(f"{log.path}: contains no raw bytes (it was not recorded from devices): nothing to play")
    lines = _lines(log)
    ports = dict.fromkeys(lines, to) if to in KINDS else _named_ports(log, to)
    outlets: dict[str, Outlet] = {}
    try:
        for device, port in ports.items():
            outlets[device] = _outlet(lines[device], port)
    except BaseException as fault:
        for outlet in outlets.values():
            outlet.close()
        if to in KINDS and isinstance(fault, OSError):
            raise LinkLost(f"expected {number_of(len(lines), f'{to} port')}, one cannot be made: {fault}") from fault
        raise
    return outlets


def _outlet(line: DeviceLine, port: str) -> Outlet:
    """Make a port of a kind, or open an existing one."""
    if port in KINDS:
        return make_wire(port, notice_host=True, adapter=line.bitrate is not None)
    is_text = line.bitrate is not None and not port.startswith("can:")
    link = open_link(port, line.baud, None if is_text else line.bitrate, line.parity, line.stop_bits)
    return LinkOutlet(link, AdapterText() if is_text else None)


def _named_ports(log: Log, to: str) -> Mapping[str, str]:
    ports: dict[str, str] = {}
    for pair in to.split(","):
        device, sign, port = (part.strip() for part in pair.partition("="))
        if not sign or not port:
            raise LogError(f"{to!r}: expected {', '.join(KINDS)}, or ports like laser_x=PORT,drive=PORT")
        if device not in log.devices:
            hint = did_you_mean(device, log.devices)
            raise LogError(f"{log.path}: contains raw bytes of {', '.join(log.devices)}, not of {device!r}{hint}")
        if device in ports:
            raise LogError(f"{to!r}: {device} is named twice; a device is played to one port")
        ports[device] = port
    return ports


def _lines(log: Log) -> Mapping[str, DeviceLine]:
    """Return the settings of each device's line."""
    devices = devices_of(installed_of(rig_of(log).devices))
    return {name: devices[name].line if name in devices else DeviceLine("", _DEFAULT_BAUD) for name in log.devices}


def played_devices(log: Log) -> dict[str, PlayedDevice]:
    """Return the simulated device for each device of a log.

    Raises:
        LogError: the log does not contain the settings of its devices.
    """
    devices, identities = devices_of(installed_of(rig_of(log).devices)), identities_of(log)

    def played(name: str) -> PlayedDevice:
        if name not in devices:
            return PlayedDevice()
        try:
            return devices[name].played(identities.get(name, {}))
        except (LogError, DeviceError) as fault:
            raise LogError(f"{log.path}: {name}: {fault}") from fault

    return {device: played(device) for device in log.devices}
