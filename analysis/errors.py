"""What can go wrong in the analysis, as one tree.

AnalysisError
├── NotEnoughData     a run is too short, or too much of it is missing, to say anything
└── NoStableState     the model has no stable steady state at the speed, or the search for one failed
"""


class AnalysisError(Exception):
    """Root of everything the analysis raises on purpose."""


class NotEnoughData(AnalysisError):
    """A run is too short, or too much of it is missing; the text says what, and how much is needed."""


class NoStableState(AnalysisError):
    """The model has no stable steady state at the speed, or the search failed; the text says which."""
