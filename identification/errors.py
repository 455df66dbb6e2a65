"""Errors of the identification package.

IdentificationError
├── NotIdentifiable    the record does not hold what the estimator needs (also a ValueError)
└── FitFailed          the data are there, but no parameters reproduce them
"""


class IdentificationError(Exception):
    """Root of everything the identification package raises on purpose."""


class NotIdentifiable(IdentificationError, ValueError):
    """A record is too short, too quiet or lacks a signal; the message says what is missing and how to get it."""


class FitFailed(IdentificationError):
    """A fit did not converge or leaves residuals far above the noise; the message gives both."""
