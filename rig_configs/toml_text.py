"""TOML files from outside: reading and parsing, with a message for every possible error."""

from __future__ import annotations

import codecs
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from rig_configs.errors import RigFileError
from rig_configs.regular_file import need_regular

_MAX_BYTES = 32_000_000
_MAX_DEPTH = 50
_OTHER_BOMS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path, *, other: str | None = None) -> str:
    """Return a file's text without a byte order mark.

    Args:
        path: the file.
        other: encoding of a file that is not UTF-8, as other programs write it.

    Raises:
        OSError: it cannot be read, or is not a regular file: a named pipe, a device.
        RigFileError: it is not UTF-8 text nor in the other encoding, or too large.
    """
    need_regular(path)
    with open(path, "rb") as file:
        data = file.read(_MAX_BYTES + 1)
    if len(data) > _MAX_BYTES:
        raise RigFileError(f"{path}: expected a TOML file, got more than {_MAX_BYTES // 10**6} MB")
    try:
        return data.decode("utf-16" if data.startswith(_OTHER_BOMS) else "utf-8-sig")
    except UnicodeDecodeError as fault:
        if other is not None:
            try:
                return data.decode(other)
            except UnicodeDecodeError:  # usual: no text at all; the error names the first byte that is not UTF-8
                pass
        raise RigFileError(f"{path}: cannot be read as a text file: {fault}; save it as UTF-8") from fault


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse a text as TOML.

    Args:
        text: TOML.
        source: origin of the text, for messages.
    Raises:
        RigFileError: not TOML, tables nested too deeply, whole numbers beyond 64 bits, or numbers too small for a
            float.
    """
    try:
        table = tomllib.loads(text, parse_float=_float)
    except tomllib.TOMLDecodeError as fault:
        raise RigFileError(f"{source}: not a TOML file: {fault}") from fault
    except RecursionError:
        raise RigFileError(f"{source}: expected a TOML file, got brackets nested thousands deep") from None
    except ValueError as fault:  # a whole number of more than 4300 digits, or a number that `_float` refuses
        raise RigFileError(f"{source}: not a TOML file: a number that cannot be read ({fault})") from fault
    _check(table, source)
    return table


def _float(text: str) -> float:
    """Parse a number with a point or an exponent; a number that is not zero must not become zero."""
    value = float(text)
    if value == 0 and text.lower().partition("e")[0].strip("+-0._"):
        raise ValueError(f"{text[:40]} is smaller than the smallest number that can be represented")
    return value


def _check(table: dict[str, Any], source: str) -> None:
    """Check nesting and whole numbers, without recursion, because deep nesting would exhaust the stack."""
    level: list[tuple[str, Any]] = list(table.items())
    for _ in range(_MAX_DEPTH):
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
    raise RigFileError(f"{source}: {name}: expected tables nested at most {_MAX_DEPTH} deep, got deeper ones")
