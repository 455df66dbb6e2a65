"""Search for an unplugged adapter: only on ports with its identity."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from daq.acquisition.edge import UsbPorts


@dataclass(frozen=True)
class Port:
    """Description of a port as pyserial returns it."""

    device: str
    vid: int | None = 0x0403
    pid: int | None = 0x6001
    serial_number: str | None = None


X, Y = Port("ttyUSB0", serial_number="X1"), Port("ttyUSB1", serial_number="Y1")


@pytest.mark.parametrize(
    ("first", "now", "port", "expected"),
    [
        ([X, Y], [Y, Port("ttyUSB7", serial_number="X1")], "ttyUSB0", ["ttyUSB7"]),  # under another name
        ([X, Y], [Port("ttyUSB0", serial_number="Y1")], "ttyUSB0", []),  # another adapter has taken its name
        # one adapter may show two ports: the one that it had is tried first
        ([X], [Port("ttyUSB9", serial_number="X1"), X], "ttyUSB0", ["ttyUSB0", "ttyUSB9"]),
        # without a serial number of its own it is expected where it was
        ([Port("ttyUSB0"), Port("ttyUSB1")], [Port("ttyUSB1")], "ttyUSB0", ["ttyUSB0"]),
        ([Port("ttyUSB0", serial_number="")], [], "ttyUSB0", ["ttyUSB0"]),
        ([X, Port("ttyUSB1", serial_number="X1")], [Port("ttyUSB1", serial_number="X1")], "ttyUSB0", ["ttyUSB0"]),
        # and so is what is no USB adapter
        ([Port("ttyS0", vid=None)], [], "ttyS0", ["ttyS0"]),
        ([], [], "tcp://[::1]:5000", ["tcp://[::1]:5000"]),
    ],
)
def test_an_unplugged_adapter_is_looked_for_by_its_identity(
    monkeypatch: pytest.MonkeyPatch, first: list[Port], now: list[Port], port: str, expected: list[str]
) -> None:
    there = list(first)
    monkeypatch.setattr("daq.acquisition.edge.list_ports.comports", lambda: list(there))
    ports = UsbPorts()
    there[:] = now
    assert list(ports.places(port)) == expected
