"""Errors of studies.

StudyError
├── StudyInputError     the question is impossible
├── OtherSoftware       a worker has other sources than the process that started the study
├── EngineMissing       an engine's package is not installed
├── EngineLost          no worker or scheduler is available (any more)
├── TileFailed          a tile cannot be computed
└── FolderFault         a finished tile cannot be written or read
"""

from rig_basics.errors import RigError


class StudyError(RigError):
    """Root of the errors that end a study."""


class StudyInputError(StudyError):
    """The question is impossible."""


class OtherSoftware(StudyError):
    """A worker has other sources than the process that started the study."""


class EngineMissing(StudyError):
    """An engine's package is not installed."""


class EngineLost(StudyError):
    """No worker or scheduler is available (any more)."""


class TileFailed(StudyError):
    """A tile cannot be computed."""


class FolderFault(StudyError):
    """A finished tile cannot be written or read."""
