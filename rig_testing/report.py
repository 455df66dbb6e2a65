# pyright: strict
"""What came of examining a driver."""

from __future__ import annotations

from dataclasses import dataclass


class Failed(AssertionError):
    """A driver does not keep what its contract promises; the text says what was expected and what came."""


class NotTried(Exception):
    """A test that says nothing of this driver; the text says why."""


@dataclass(frozen=True)
class Outcome:
    """One test's outcome.

    Attributes:
        name: of the test.
        passed: the verdict; true for what was not tried.
        why: why it failed or was not tried; of a passed one, what was measured. May be empty.
        seconds: wall time it took.
        tried: whether it was.
    """

    name: str
    passed: bool
    why: str
    seconds: float
    tried: bool = True


@dataclass(frozen=True)
class Report:
    """All outcomes of one driver.

    Attributes:
        driver: its name.
        outcomes: in the order of the tests.
    """

    driver: str
    outcomes: tuple[Outcome, ...]

    @property
    def passed(self) -> bool:
        """Whether no test failed."""
        return not self.failed

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """The failed ones."""
        return tuple(outcome for outcome in self.outcomes if not outcome.passed)

    @property
    def seconds(self) -> float:
        """Wall time of all tests."""
        return sum(outcome.seconds for outcome in self.outcomes)


def need(holds: bool, otherwise: str) -> None:
    """What must hold.

    Raises:
        Failed: it does not.
    """
    if not holds:
        raise Failed(otherwise)
