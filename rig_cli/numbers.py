"""Ranges of numbers on the command line, checked during parsing, before anything is started.

`EVERY_OPTION` is the default of every option of every command. The types below restrict single options further.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, cast, get_type_hints

from cyclopts import Parameter

LONGEST_S = 366 * 86_400.0  # a year; longer durations are taken for typing errors
_LONGEST_LOOK_S = 3600.0
_LARGEST = 1e15


def _finite(_: Any, value: Any) -> None:
    if is_dataclass(value):  # a group of options
        for field in fields(value):
            try:
                _finite(None, getattr(value, field.name))
            except ValueError as fault:
                raise ValueError(f"{_option(type(value), field.name)}: {fault}") from fault
        return
    numbers = cast("Sequence[Any]", value) if isinstance(value, list | tuple) else [value]
    for number in numbers:
        if isinstance(number, int | float) and not abs(number) <= _LARGEST:  # also true for NaN
            raise ValueError(f"expected a finite number, at most {_LARGEST:g}, got {number:.6g}")


def _option(group: type, name: str) -> str:
    """Return the option of a field in a group."""
    for mark in getattr(get_type_hints(group, include_extras=True)[name], "__metadata__", ()):
        if isinstance(mark, Parameter) and mark.name:
            return cast("tuple[str, ...]", mark.name)[0]
    return f"--{name.replace('_', '-')}"


def between(low: float, high: float, *, low_too: bool = False) -> Callable[[Any, Any], None]:
    """Return a validator of numbers above `low` (with `low_too`: from `low`) up to `high`. None passes."""

    def check(_: Any, value: Any) -> None:
        if value is None:
            return
        if not (low <= value if low_too else low < value) or not value <= high or not math.isfinite(value):
            first = f"from {low:g}" if low_too else f"above {low:g}"
            raise ValueError(f"expected a number {first} to {high:g}, got {value:.6g}")

    return check


def _shown_default(value: Any) -> str | None:
    """Return a default as it is shown in a help text; None for one that only means that the option was not given."""
    return None if value is None or value is False or value in ("", [], ()) else str(value)


EVERY_OPTION = Parameter(validator=_finite, negative_iterable=(), show_default=_shown_default)
PositiveSeconds = Annotated[float, Parameter(validator=between(0, LONGEST_S))]
LookSeconds = Annotated[float, Parameter(validator=between(0, _LONGEST_LOOK_S))]
SecondsOrNone = Annotated[float, Parameter(validator=between(0, LONGEST_S, low_too=True))]
PositiveRpm = Annotated[float, Parameter(validator=between(0, 1e6))]
Positive = Annotated[float, Parameter(validator=between(0, 1e9))]
Chance = Annotated[float, Parameter(validator=between(0, math.nextafter(1, 0)))]
WholeCount = Annotated[int, Parameter(validator=between(0, 1e7))]
