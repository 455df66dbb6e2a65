"""Outcomes of the tests of a driver."""

from __future__ import annotations

from dataclasses import dataclass


class Failed(AssertionError):
    """A driver violates its contract; the text contains what was expected and what was found."""


class NotTried(Exception):
    """A test that does not apply to this driver; the text contains the reason."""


@dataclass(frozen=True)
class CaseOutcome:
    """One test's outcome.

    Attributes:
        name: of the test.
        passed: the verdict; true for a test that was not tried.
        why: reason of a failure or of a test not tried; of a passed one, what was measured. May be empty.
        seconds: time.
        tried: whether the test applies to the driver.
    """

    name: str
    passed: bool
    why: str
    seconds: float
    tried: bool = True


@dataclass(frozen=True)
class DriverReport:
    """All outcomes of one driver.

    Attributes:
        driver: its name.
        outcomes: in the order of the tests.
    """

    driver: str
    outcomes: tuple[CaseOutcome, ...]

    @property
    def passed(self) -> bool:
        """Whether no test failed."""
        return not self.failed

    @property
    def failed(self) -> tuple[CaseOutcome, ...]:
        """The failed ones."""
        return tuple(outcome for outcome in self.outcomes if not outcome.passed)

    @property
    def seconds(self) -> float:
        """Wall time of all tests."""
        return sum(outcome.seconds for outcome in self.outcomes)


def need(holds: bool, otherwise: str) -> None:
    """Check a condition.

    Raises:
        Failed: it does not hold.
    """
    if not holds:
        raise Failed(otherwise)
