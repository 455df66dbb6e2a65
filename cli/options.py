"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

Settings = Annotated[
    list[str] | None,
    Parameter(name="--set", help="key=value laid over the rig file, e.g. suspension.zeta2=0.05; *1.05 and +5% too"),
]
Json = Annotated[bool, Parameter(name="--json", negative="", help="one JSON object on standard output")]
ParametersPath = Annotated[Path | None, Parameter(name="--parameters", help="parameters.toml laid over the rig file")]
