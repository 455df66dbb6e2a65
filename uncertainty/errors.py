"""Errors of the uncertainty package.

UncertaintyError
├── BadInput       a source, a group or an argument is outside its domain (also a ValueError)
├── BadModel       the measurement model returned an array of the wrong shape or values that are not finite
└── TooManyTrials  the values of the requested trials exceed the allowed memory (also a ValueError)
"""

from rig_basics.errors import RigError


class UncertaintyError(RigError):
    """Base class of all errors raised by the uncertainty package."""


class BadInput(UncertaintyError, ValueError):
    """A source, a group, a table or a number is outside its domain. The message contains its name, value and domain."""


class BadModel(UncertaintyError):
    """The model returned a wrong shape or values that are not finite. The message contains the shape or the trial."""


class TooManyTrials(UncertaintyError, ValueError):
    """The values of the requested trials exceed the allowed memory. The message contains the largest number."""
