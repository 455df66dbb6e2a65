"""Text of quantities for a terminal."""

from __future__ import annotations

import sys
from datetime import datetime

from rich.console import Console

_PLAIN_WIDTH = 400  # columns of output that is not a terminal


def stdout_console() -> Console:
    """Return a console on standard output: as wide as the terminal, without line breaks if it is not one."""
    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else _PLAIN_WIDTH)


def printable(text: object) -> str:
    """Return text as one line without control characters."""
    return "".join(letter if letter.isprintable() else " " for letter in str(text))


def local_time(text: str) -> str:
    """Return an instant in local time; other text is returned unchanged."""
    try:
        return f"{datetime.fromisoformat(text).astimezone():%Y-%m-%d %H:%M:%S}"
    except (ValueError, OverflowError, OSError):  # usual: other text
        return text


def length(seconds: float) -> str:
    """Return a duration with a suitable unit."""
    for unit, name in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * unit:
            return f"{seconds / unit:.2f} {name}"
    return f"{seconds:.1f} s"


def size(count: int) -> str:
    """Return a number of bytes with a suitable unit."""
    value, unit = float(count), "B"
    for unit in ("B", "kB", "MB", "GB"):
        if value < 1000 or unit == "GB":
            break
        value /= 1000
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"


def percent(share: float) -> str:
    """Return a share in percent with two digits, in exponential form if it is very small."""
    value = 100 * share
    if not value < float("inf"):
        return "—"
    return f"{value:.2g} %" if value >= 1e-4 or value == 0 else f"{value:.1e} %"
