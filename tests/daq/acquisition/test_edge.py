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


def looked(monkeypatch: pytest.MonkeyPatch, first: list[Port], now: list[Port], port: str) -> list[str]:
    """Return the ports on which an adapter is searched that was on a port at the start."""
    there = list(first)
    monkeypatch.setattr("daq.acquisition.edge.list_ports.comports", lambda: list(there))
    ports = UsbPorts()
    there[:] = now
    return list(ports.places(port))


def test_an_adapter_is_found_under_another_name(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looked(monkeypatch, [X, Y], [Y, Port("ttyUSB7", serial_number="X1")], "ttyUSB0") == ["ttyUSB7"]


def test_another_adapter_that_took_its_name_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looked(monkeypatch, [X, Y], [Port("ttyUSB0", serial_number="Y1")], "ttyUSB0") == []


def test_its_own_name_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """One adapter may show two ports: the one that it had is tried first."""
    now = [Port("ttyUSB9", serial_number="X1"), X]
    assert looked(monkeypatch, [X], now, "ttyUSB0") == ["ttyUSB0", "ttyUSB9"]


@pytest.mark.parametrize("serial", [None, ""])
def test_without_a_serial_number_it_is_looked_for_where_it_was(
    monkeypatch: pytest.MonkeyPatch, serial: str | None
) -> None:
    first = [Port("ttyUSB0", serial_number=serial), Port("ttyUSB1", serial_number=serial)]
    assert looked(monkeypatch, first, first[1:], "ttyUSB0") == ["ttyUSB0"]


def test_two_with_one_serial_number_are_looked_for_where_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = Port("ttyUSB1", serial_number="X1")
    assert looked(monkeypatch, [X, twin], [twin], "ttyUSB0") == ["ttyUSB0"]


def test_what_is_no_usb_adapter_is_looked_for_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looked(monkeypatch, [Port("ttyS0", vid=None)], [], "ttyS0") == ["ttyS0"]
    assert looked(monkeypatch, [], [], "tcp://[::1]:5000") == ["tcp://[::1]:5000"]
