"""Required uncertainty of a parameter as text: `zeta1=1%`, `k1=5 N/m`."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass

from rig_configs.errors import RigFileError
from rig_configs.physical_numbers import PARAMETERS, short

SHORT: Mapping[str, str] = {short(name): name for name in PARAMETERS}
"""Short names k1, k2, zeta1, zeta2, c3, c4, SP → names in parameters.toml."""

_FORM = re.compile(r"\s*([0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*(.*?)\s*")


@dataclass(frozen=True)
class Requirement:
    """Required standard deviation of one parameter.

    Attributes:
        name: name of the parameter in parameters.toml.
        value: standard deviation, relative or in the parameter's unit.
        relative: whether `value` is relative.
    """

    name: str
    value: float
    relative: bool

    def relative_std(self, nominal: float) -> float:
        """Return the required relative standard deviation for a nominal value of the parameter."""
        return self.value if self.relative else self.value / abs(nominal)


def parse_requirement(text: str) -> Requirement:
    """Parse one required uncertainty.

    Args:
        text: NAME=VALUE. The name is short (k1, zeta2, c3, SP) or as in parameters.toml. The value is in per cent, or
            in the parameter's unit, which follows it.
    Raises:
        RigFileError: the text has another form. The message contains the expected form and the nearest known name.

    Example:
        >>> from identification import parse_requirement
        >>> parse_requirement("zeta1=1%")
        Requirement(name='zeta1', value=0.01, relative=True)
    """
    name, sign, amount = (part.strip() for part in text.partition("="))
    if not sign:
        raise RigFileError(f"required uncertainty {text!r}: expected NAME=VALUE, for example zeta1=1% or k1=5N/m")
    full = SHORT.get(name, name)
    if full not in PARAMETERS:
        near = difflib.get_close_matches(name, [*SHORT, *PARAMETERS], n=1, cutoff=0.3)
        hint = f", did you mean {near[0]}?" if near else "."
        known = ", ".join(SHORT)
        raise RigFileError(f"required uncertainty {text!r}: unknown parameter {name!r}{hint} Known: {known}")
    unit = PARAMETERS[full].unit
    match = _FORM.fullmatch(amount)
    given = re.sub(r"[\s·*]+", "", match[2]) if match else ""
    wanted = "" if unit == "1" else unit.replace(" ", "")
    if match is None or given not in ("%", wanted):
        also = f" or in {unit} with the unit written out" if wanted else " or as a plain number"
        raise RigFileError(
            f"required uncertainty {text!r}: expected a value above 0 in per cent (1%){also}, got {amount!r}"
        )
    value = float(match[1]) / (100.0 if given == "%" else 1.0)
    if not 0 < value < float("inf"):
        raise RigFileError(f"required uncertainty {text!r}: expected a value above 0, got {amount!r}")
    if (value > 1 and given == "%") or (value >= 1 and not given):  # a bare number is for a parameter without unit
        raise RigFileError(
            f"required uncertainty {text!r}: expected a relative value below 1, got {amount}; did you mean {name}=1%?"
        )
    return Requirement(full, value, given == "%")
