"""The line of a device follows from the settings that its driver has."""

from __future__ import annotations

import pytest

from daq.drivers.contract import ADAPTER_BAUD, DeviceLine
from daq.drivers.registry import driver


@pytest.mark.parametrize(
    ("name", "others", "line"),
    [
        ("optoncdt", {"baud": 691_200}, DeviceLine("p", 691_200)),
        ("modbus_converter", {"parity": "N", "stop_bits": 2}, DeviceLine("p", 19_200, parity="N", stop_bits=2)),
        ("cia402", {"bitrate": 250_000}, DeviceLine("p", ADAPTER_BAUD, 250_000)),
        ("cia406", {"bitrate": 250_000, "baud": 1_000_000}, DeviceLine("p", 1_000_000, 250_000)),
        ("optoncdt_ethernet", {}, DeviceLine("p", 0)),
    ],
)
def test_a_line_has_the_rates_of_the_settings(name: str, others: dict[str, object], line: DeviceLine) -> None:
    found = driver(name)
    assert found.line(found.example_at("p", **others)) == line
