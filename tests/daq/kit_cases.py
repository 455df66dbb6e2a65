"""The tests of drivers for a driver in other settings than its default ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

import rig_testing
from daq.drivers.contract import Driver
from tests.effort import thorough

LONG = frozenset({"mutations", "memory", "counter wrap", "clock wrap", "split"})
"""Tests that take long; in the suite tests/rig_testing/test_builtin_drivers.py runs them in each driver's default."""


def kit_cases(kinds: Iterable[type[Driver]], without: Sequence[tuple[type[Driver], str]] = ()) -> list[Any]:
    """Every test for every kind of settings, and the long ones in the thorough run, but not those in `without`."""
    return [
        pytest.param(case, id=f"{kind.__name__}-{case}", marks=[thorough] if case.name in LONG else [])
        for kind in kinds
        for case in rig_testing.cases(kind())
        if (kind, case.name) not in without
    ]
