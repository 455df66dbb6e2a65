"""What can go wrong with a study.

StudyError
├── StudyInputError     what was asked cannot be
├── OtherSoftware       a worker runs other sources than the one who asks
├── EngineMissing       an engine's package is not installed
├── EngineLost          nobody is there to work, or no longer
├── TileFailed          a tile cannot be worked out
└── FolderFault         a finished tile cannot be kept or read
"""


class StudyError(Exception):
    """A study cannot go on."""


class StudyInputError(StudyError):
    """What was asked cannot be."""


class OtherSoftware(StudyError):
    """A worker runs other sources than the one who asks."""


class EngineMissing(StudyError):
    """An engine's package is not installed."""


class EngineLost(StudyError):
    """Nobody is there to work, or no longer."""


class TileFailed(StudyError):
    """A tile cannot be worked out."""


class FolderFault(StudyError):
    """A finished tile cannot be kept or read."""
