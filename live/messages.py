"""Messages of viewers: JSON objects that can be written out again, with finite numbers."""

from __future__ import annotations

import json
from typing import Any, NoReturn, cast

from live.errors import InvalidRequest

Facts = dict[str, Any]
"""Values by name, as in JSON."""
_MOST_DIGITS = 17  # of a whole number; all values of a double precision number are shorter or have an exponent


def parsed_object(message: str | bytes) -> dict[str, Any]:
    """Parse a message.

    Raises:
        InvalidRequest: it is not a JSON object, is nested too deeply, or contains a number that is not finite or a
            character that does not exist alone (half of a surrogate pair).
    """
    try:
        found: Any = json.loads(message, parse_constant=_no_number, parse_int=_whole, parse_float=_finite)
        json.dumps(found, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as fault:  # UnicodeError is a ValueError
        raise InvalidRequest(f"expected an object as JSON, got {type(fault).__name__}") from fault
    if not isinstance(found, dict):
        raise InvalidRequest(f"expected an object as JSON, got a {type(found).__name__}")
    return cast("dict[str, Any]", found)


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"expected a finite number, got {name}")


def _whole(digits: str) -> int:
    if len(digits.lstrip("-")) > _MOST_DIGITS:
        raise ValueError(f"expected a whole number of at most {_MOST_DIGITS} digits")
    return int(digits)


def _finite(digits: str) -> float:
    value = float(digits)
    if value in (float("inf"), -float("inf")):
        raise ValueError(f"expected a finite number, got {digits}")
    return value
