# pyright: strict
"""Errors of the uncertainty package.

UncertaintyError
├── BadInput       a source, a group or a number asked for is outside its domain (also a ValueError)
├── BadModel       the measurement model returned an array of the wrong shape or values that are not finite
└── TooManyTrials  the values of so many trials exceed the memory allowed for them (also a ValueError)
"""


class UncertaintyError(Exception):
    """Root of everything the uncertainty package raises on purpose."""


class BadInput(UncertaintyError, ValueError):
    """A source, a group, a table or a number is outside its domain; the message names it, its value and the domain."""


class BadModel(UncertaintyError):
    """The model returned a wrong shape or values that are not finite; the message gives the shape or the trial."""


class TooManyTrials(UncertaintyError, ValueError):
    """The values of the trials asked for do not fit the memory allowed; the message gives the largest number."""
