# pyright: strict
"""How a number and its values stand on the command line: KEY=A:B:N."""

from __future__ import annotations

from analysis.maps.axes import MapAxis
from rig_configs import RigFileError

_EXAMPLE = "for example speed_ratio=0.3:7:400 or pendulums.a.damping_Nms_per_rad=1e-4:1e-2:100:log"


def read_axis(option: str, text: str) -> MapAxis:
    """KEY=A:B:N or KEY=A:B:N:log; several keys that change alike are joined by +.

    Raises:
        RigFileError: what was expected, under the option's name.
    """
    keys, equals, numbers = text.partition("=")
    parts = numbers.split(":")
    wanted = f"rig map: {option} expected KEY=A:B:N or KEY=A:B:N:log, {_EXAMPLE}; got {text!r}"
    logarithmic = len(parts) == 4 and parts[-1] == "log"
    if not equals or len(parts) != (4 if logarithmic else 3):
        raise RigFileError(wanted)
    try:
        low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
    except ValueError:
        raise RigFileError(wanted) from None
    try:
        return MapAxis(tuple(key.strip() for key in keys.split("+")), low, high, count, logarithmic)
    except RigFileError as error:
        raise RigFileError(f"rig map: {option} {error}") from error
