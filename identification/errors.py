"""Errors of the identification package.

IdentificationError
├── NotIdentifiable    the record does not contain what the estimator needs (also a ValueError)
└── FitFailed          the record is complete, but no parameters reproduce it
    ├── UnexplainedPassage   the model of a passage leaves a large part of the signal; the cause is still to be named
    └── work.OutOfWork     the bound of a fit's work was reached before an answer
"""

from rig_basics.errors import RigError


class IdentificationError(RigError):
    """Base class of all errors of the identification package."""


class NotIdentifiable(IdentificationError, ValueError):
    """A record is too short, too weak or lacks a signal. The message states what is missing and how to record it."""


class FitFailed(IdentificationError):
    """A fit did not converge, or its residuals are far above the noise. The message contains both."""


class UnexplainedPassage(FitFailed):
    """The model of a passage leaves a large part of the signal. What contradicts phase and locks names the cause."""
