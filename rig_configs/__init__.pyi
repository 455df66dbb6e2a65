"""Public names of `rig_configs`; each is imported at its first use."""

from .error_label import ErrorLabel as ErrorLabel
from .errors import (
    ParametersFileError as ParametersFileError,
    RigConfigError as RigConfigError,
    RigFileError as RigFileError,
)
from .load import (
    load_rig as load_rig,
    overridden as overridden,
    parse_setting as parse_setting,
    shipped_rigs as shipped_rigs,
    with_parameters as with_parameters,
)
from .parameters_file import (
    PARAMETER_SYMBOLS as PARAMETER_SYMBOLS,
    PARAMETER_UNITS as PARAMETER_UNITS,
    IdentifiedParameters as IdentifiedParameters,
)
from .schema import Rig as Rig
