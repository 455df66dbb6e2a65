"""The tests of drivers for a driver in other settings than its default ones."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest

import rig_testing
from daq.drivers.driver import Driver
from tests.effort import thorough

LONG = frozenset({"mutations", "memory", "counter wrap", "clock wrap", "split"})
"""Tests that take long; in the suite tests/rig_testing/test_builtin_drivers.py runs them in each driver's default."""


def kit_cases(drivers: Iterable[Driver], without: Collection[tuple[Driver, str]] = ()) -> list[Any]:
    """Every test for every driver, and the long ones in the thorough run, but not those in `without`."""
    return [
        pytest.param(case, id=f"{driver.name} {number}-{case}", marks=[thorough] if case.name in LONG else [])
        for number, driver in enumerate(drivers, 1)
        for case in rig_testing.cases(driver)
        if (driver, case.name) not in without
    ]
