"""Errors of the analysis as one tree.

AnalysisError
├── NotEnoughData     a run is too short, or too much of it is missing, for a result
├── BadFigureName     the file name of a figure has an unsupported suffix (also a ValueError)
├── NoMapFile         a file name cannot hold a map, or a file contains none (also a ValueError)
├── TakenName         a report would overwrite a file that is not a report
└── NoStableState     the model has no stable steady state at the speed, or the search for one failed
"""

from rig_basics.errors import RigError


class AnalysisError(RigError):
    """Root of the errors that the analysis raises deliberately."""


class NotEnoughData(AnalysisError):
    """A run is too short, or too much of it is missing; the text contains what is missing and how much is needed."""


class BadFigureName(AnalysisError, ValueError):
    """The file name of a figure has an unsupported suffix; the text lists the supported ones."""


class NoMapFile(AnalysisError, ValueError):
    """A file name cannot hold a map, or a file to be read contains none; the text contains the reason."""


class NoStableState(AnalysisError):
    """The model has no stable steady state at the speed, or the search failed; the text contains which of the two."""


class TakenName(AnalysisError):
    """A report or its numbers would overwrite a file that is not an earlier report or its numbers."""
