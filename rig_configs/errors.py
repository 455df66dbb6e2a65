"""Errors of the rig file and of parameters.toml.

RigConfigError (also a ValueError)
├── RigFileError           a rig file or a `--set` that does not fit the schema
└── ParametersFileError    a parameters.toml that can't be used
"""


class RigConfigError(ValueError):
    """Root of the package's errors; the message names the file, the key, what was expected and what came."""


class RigFileError(RigConfigError):
    """The rig file or a setting laid over it is wrong. Lists every fault found, one a line."""


class ParametersFileError(RigConfigError):
    """A parameters.toml is missing, damaged or does not hold what a rig needs."""
