"""The rig file and parameters.toml: schema, loading, `--set`, and the shipped rig files."""

from rig_configs.errors import ParametersFileError, RigConfigError, RigFileError
from rig_configs.load import load_rig, overridden, parse_setting, shipped_rigs, with_parameters
from rig_configs.parameters_file import PARAMETER_UNITS, IdentifiedParameters
from rig_configs.schema import Rig

__all__ = [
    "PARAMETER_UNITS",
    "IdentifiedParameters",
    "ParametersFileError",
    "Rig",
    "RigConfigError",
    "RigFileError",
    "load_rig",
    "overridden",
    "parse_setting",
    "shipped_rigs",
    "with_parameters",
]
