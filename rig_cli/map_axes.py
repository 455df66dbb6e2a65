"""Syntax of axes on the command line: KEY=A:B:N, KEY=1,2,3, KEY=A:B."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from analysis.maps.axes import MapAxis
from analysis.maps.families import BorderFamily, SearchRange
from rig_configs import RigFileError

_T = TypeVar("_T")
_EXAMPLE = "for example speed_ratio=0.3:7:400 or pendulums.a.damping_Nms_per_rad=1e-4:1e-2:100:log"


def read_axis(option: str, text: str, command: str = "rig map") -> MapAxis:
    """Read KEY=A:B:N or KEY=A:B:N:log; keys that change together are joined by +.

    Raises:
        RigFileError: the text has another form or a value out of range. The message contains the option's name.
    """
    wanted = f"KEY=A:B:N or KEY=A:B:N:log, {_EXAMPLE}"

    def read(keys: tuple[str, ...], values: str) -> MapAxis:
        parts = values.split(":")
        logarithmic = len(parts) == 4 and parts[-1] == "log"
        low, high, count = parts[:-1] if logarithmic else parts
        return _made(option, lambda: MapAxis(keys, float(low), float(high), int(count), logarithmic), command)

    return _read(option, text, wanted, read, command)


def read_family(option: str, text: str) -> BorderFamily:
    """Read KEY=V,V,V or KEY=A:B:N[:log].

    Raises:
        RigFileError: the text has another form or a value out of range. The message contains the option's name.
    """
    wanted = "KEY=V,V,V or KEY=A:B:N or KEY=A:B:N:log, for example suspension.zeta1+suspension.zeta2=0.005,0.02,0.1"

    def read(keys: tuple[str, ...], values: str) -> BorderFamily:
        if ":" in values:
            axis = read_axis(option, text)
            return _made(option, lambda: BorderFamily(axis.keys, tuple(axis.values.tolist())))
        numbers = tuple(sorted(float(value) for value in values.split(",")))
        return _made(option, lambda: BorderFamily(keys, numbers))

    return _read(option, text, wanted, read)


def read_range(option: str, text: str) -> SearchRange:
    """Read KEY=A:B or KEY=A:B:log.

    Raises:
        RigFileError: the text has another form or a value out of range. The message contains the option's name.
    """
    wanted = "KEY=A:B or KEY=A:B:log, for example suspension.zeta1+suspension.zeta2=0.005:2:log"

    def read(keys: tuple[str, ...], values: str) -> SearchRange:
        parts = values.split(":")
        logarithmic = len(parts) == 3 and parts[-1] == "log"
        low, high = parts[:-1] if logarithmic else parts
        return _made(option, lambda: SearchRange(keys, float(low), float(high), logarithmic))

    return _read(option, text, wanted, read)


def _read(
    option: str, text: str, wanted: str, read: Callable[[tuple[str, ...], str], _T], command: str = "rig map"
) -> _T:
    keys, equals, values = text.partition("=")
    fault = RigFileError(f"{command}: {option} expected {wanted}; got {text!r}")
    if not equals:
        raise fault
    try:
        return read(tuple(key.strip() for key in keys.split("+")), values)
    except RigFileError:
        raise
    except ValueError:  # too many or too few parts, or one that is not a number
        raise fault from None


def _made(option: str, make: Callable[[], _T], command: str = "rig map") -> _T:
    """Call `make`; its errors get the option's name in front."""
    try:
        return make()
    except RigFileError as error:
        raise RigFileError(f"{command}: {option} {error}") from error
