"""Rows of guided tests that are nobody's: added to the table while a test runs."""

from __future__ import annotations

from daq.guided_tests.kinds import Asked, TestKind
from daq.guided_tests.table import Table


def row(name: str, needs: tuple[str, ...], turns: bool, gives: tuple[str, ...] = ()) -> TestKind:
    """A row of which identification knows no more than what it needs and gives; it cannot be run."""

    def table(asked: Asked) -> Table:
        raise NotImplementedError

    return TestKind(name, "a test of another package", needs, turns, table, gives)
