"""Errors of the rig file and of parameters.toml.

RigConfigError (also a ValueError)
├── RigFileError           a rig file or a setting that does not fit the schema
└── ParametersFileError    a parameters.toml that cannot be used
"""

from rig_basics.errors import RigError


class RigConfigError(RigError, ValueError):
    """Root of the package's errors; the message contains the file, the key, the expected and the actual value."""


class RigFileError(RigConfigError):
    """The rig file or a setting is wrong. The message lists every error found, one per line."""


class ParametersFileError(RigConfigError):
    """A parameters.toml is missing, damaged or incomplete."""
