"""Errors of the identification package.

IdentificationError
├── NotIdentifiable    the record does not contain what the estimator needs (also a ValueError)
└── FitFailed          the record is complete, but no parameters reproduce it
    ├── UnexplainedPassage   the model of a passage leaves a large part of the signal; the cause is still to be named
    └── OutOfWork            the bound of a fit's work was reached before an answer
"""

from rig_basics.errors import RigError

_SHOWN = 2
"""First and last attempts that a message names, each."""


class IdentificationError(RigError):
    """Base class of all errors of the identification package."""


class NotIdentifiable(IdentificationError, ValueError):
    """A record is too short, too weak or lacks a signal. The message states what is missing and how to record it."""


class FitFailed(IdentificationError):
    """A fit did not converge, or its residuals are far above the noise. The message contains both."""


class UnexplainedPassage(FitFailed):
    """The model of a passage leaves a large part of the signal. What contradicts phase and locks names the cause."""


class OutOfWork(FitFailed):
    """A fit was ended by its bound of work.

    Attributes:
        tried: descriptions of the attempts, in their order.
    """

    def __init__(self, what: str, limit_s: float, tried: tuple[str, ...]) -> None:
        between = len(tried) - 2 * _SHOWN
        shown = tried if between <= 0 else (*tried[:_SHOWN], f"{between} more", *tried[-_SHOWN:])
        super().__init__(
            f"{what}: ended without an answer after the work of {limit_s:g} s of processor. Tried: "
            f"{'; '.join(shown) or 'the first attempt was not complete'}. Either the motion is not the one that the "
            "model describes, or the record is too long: plot it, and give the part that the test is about"
        )
        self.tried = tried
