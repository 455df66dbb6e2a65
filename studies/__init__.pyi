"""Public names of `studies`; each is imported at its first use."""

from .errors import (
    EngineLost as EngineLost,
    EngineMissing as EngineMissing,
    FolderFault as FolderFault,
    OtherSoftware as OtherSoftware,
    StudyError as StudyError,
    StudyInputError as StudyInputError,
    TileFailed as TileFailed,
)
from .running import run_study as run_study
from .study import Study as Study
from .tile_files import TileFolder as TileFolder
