"""Rows of guided tests that belong to no package: added to the table while a test runs."""

from __future__ import annotations

from daq.guided_test_kinds import GuidedTestRequest, TestKind
from daq.guided_tests.table import StateTable


def row(name: str, needs: tuple[str, ...], turns: bool, gives: tuple[str, ...] = ()) -> TestKind:
    """Row with the fields that identification uses (needs and gives). It cannot be run."""

    def table(asked: GuidedTestRequest) -> StateTable:
        raise NotImplementedError

    return TestKind(name, "a test of another package", needs, turns, table, gives)
