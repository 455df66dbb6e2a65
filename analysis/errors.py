"""What can go wrong in the analysis, as one tree.

AnalysisError
├── NotEnoughData     a run is too short, or too much of it is missing, to say anything
├── BadFigureName     a figure is to be written in a format not on offer (also a ValueError)
├── NoMapFile         a file cannot hold a map, or holds none (also a ValueError)
├── TakenName         a report would be written over a file that is no report's
└── NoStableState     the model has no stable steady state at the speed, or the search for one failed
"""


class AnalysisError(Exception):
    """Root of everything the analysis raises on purpose."""


class NotEnoughData(AnalysisError):
    """A run is too short, or too much of it is missing; the text says what, and how much is needed."""


class BadFigureName(AnalysisError, ValueError):
    """A figure's file name ends in none of the formats on offer; the text lists them."""


class NoMapFile(AnalysisError, ValueError):
    """A map is to be written under a name that cannot hold one, or read from what holds none; the text says why."""


class NoStableState(AnalysisError):
    """The model has no stable steady state at the speed, or the search failed; the text says which."""


class TakenName(AnalysisError):
    """A report, or its numbers, would be written over a file of somebody else's."""
