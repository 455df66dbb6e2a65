# pyright: strict
"""TOML files from outside: read as text and parsed, every way in which they can be wrong an error in words."""

from __future__ import annotations

import codecs
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from rig_configs.errors import RigFileError
from rig_configs.regular_file import need_regular

_LARGEST_BYTES = 32_000_000
_DEEPEST = 50
_OTHER_BOMS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path) -> str:
    """A file's text; a byte order mark before it is left out.

    Raises:
        OSError: it cannot be read, or is no file: a named pipe, a device.
        RigFileError: it is no text of UTF-8, or too large for what it should be.
    """
    need_regular(path)
    with open(path, "rb") as file:
        data = file.read(_LARGEST_BYTES + 1)
    if len(data) > _LARGEST_BYTES:
        raise RigFileError(f"{path}: expected a TOML file, got more than {_LARGEST_BYTES // 10**6} MB")
    try:
        return data.decode("utf-16" if data.startswith(_OTHER_BOMS) else "utf-8-sig")
    except UnicodeDecodeError as fault:
        raise RigFileError(f"{path}: cannot be read as a text file: {fault}; save it as UTF-8") from fault


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """The table that a text holds.

    Args:
        text: TOML.
        source: where it is from, for messages.
    Raises:
        RigFileError: no TOML, tables nested deeper than any of ours, whole numbers beyond 64 bits, numbers too small
            to be kept.
    """
    try:
        table = tomllib.loads(text, parse_float=_float)
    except tomllib.TOMLDecodeError as fault:
        raise RigFileError(f"{source}: not a TOML file: {fault}") from fault
    except RecursionError:
        raise RigFileError(f"{source}: expected a TOML file, got brackets nested thousands deep") from None
    except ValueError as fault:  # Python reads no whole number of more than 4300 digits, `_float` none that vanishes
        raise RigFileError(f"{source}: not a TOML file: a number that cannot be read ({fault})") from fault
    _check(table, source)
    return table


def _float(text: str) -> float:
    """A number with a point or an exponent; one that is not zero does not become zero."""
    value = float(text)
    if value == 0 and text.lower().partition("e")[0].strip("+-0._"):
        raise ValueError(f"{text[:40]} is smaller than any that can be kept")
    return value


def _check(table: dict[str, Any], source: str) -> None:
    """Refuse what no later step should have to expect; without recursion, which is the point of it."""
    level: list[tuple[str, Any]] = list(table.items())
    for _ in range(_DEEPEST):
        below: list[tuple[str, Any]] = []
        for name, value in level:
            if isinstance(value, dict):
                below += cast(Mapping[str, Any], value).items()
            elif isinstance(value, list):
                below += ((name, item) for item in cast(Iterable[Any], value))
            elif isinstance(value, int) and not -(2**63) <= value < 2**63:
                raise RigFileError(f"{source}: {name[:80]}: expected a whole number within 64 bits, got a larger one")
        if not below:
            return
        level = below
    name = level[0][0][:80]
    raise RigFileError(f"{source}: {name}: expected tables nested at most {_DEEPEST} deep, got deeper ones")
